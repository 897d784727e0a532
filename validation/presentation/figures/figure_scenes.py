"""Figures of rollouts over the regions, of the task automaton, and of the value tree behind a bound."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ....envs.interfaces import edges, panels, places
from ....envs.suite import as_problem
from ....envs.tasks.automata import Automaton
from ....synthesis.certificates.proofs import OnGrid, certificate_from, of_first_task, tube_along
from ....synthesis.extended_check.claims import claim_text
from ...statistical_tests import Loop, paths
from .figure_regions import rollouts_panel
from .figure_style import FAILURE, INK, PALE, SERIES, SOFT, legend_above, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

MOST_PANELS = 4
"""Panels of one figure; the panels of further agents are left out, and the title says so."""

MOST_VERTICES = 400
"""Vertices of the largest value tree that is drawn: more could not be told apart."""

PIXELS_PER_INCH = 62.0
"""Turns the places of states, which are made for pictures in pixels, into inches of a figure."""

FEW_STATES = 5
"""States up to which they stand in columns, and arrows to dead states are drawn."""

NUMBERED_STATES = 9
"""States up to which arrows carry numbers, and arrows from a state to itself are drawn."""

MOST_LINES = 14
"""Transitions that are listed below an automaton."""

LINE_LENGTH = 88
"""Characters of a listed transition: the width of the figure."""


def rollouts_figure(certificate: Any, episodes: int = 40, seed: int = 0) -> Figure:
    """Draw episodes of the continuous system under the certified controllers, over the regions.

    Planar agents are drawn on a map, others over time. Episodes that do not satisfy the task end in a cross. Along
    nominal paths the tube is shaded that agents keep with probability .99 as long as no input is cut off.

    Parameters
    ----------
    certificate : Synthesis, Certificate or path
    episodes : int
    seed : int

    Raises
    ------
    ValueError
        If there is no episode to draw, or matplotlib is missing.
    """
    if episodes < 1:
        raise ValueError(f"`episodes`: expected at least 1, got {episodes}")
    certificate = certificate_from(certificate)
    problem = certificate.problem
    states, success = paths(Loop(problem, certificate.controller, seed, episodes), episodes)
    all_panels = panels(problem)
    shown = all_panels[:MOST_PANELS]
    columns = 1 if len(shown) == 1 or not shown[0].is_map else 2
    rows = -(-len(shown) // columns)
    # Sizes in inches; a single map gets the proportions of its workspace.
    height = 2.6 * rows + 0.6
    if shown[0].is_map and len(shown) == 1:
        sides = np.subtract(shown[0].high, shown[0].low)
        height = float(np.clip(6.0 * sides[1] / sides[0], 2.0, 6.5)) + 1.0
    figure, plots = new_figure(6.8, height, rows, columns)
    for panel, plot in zip(shown, plots, strict=False):
        tubes = {c.number: tube for c in panel.curves if (tube := tube_along(certificate, c.rows)) is not None}
        rollouts_panel(plot, panel, states, success, problem.horizon, tubes)
    for plot in plots[len(shown) :]:
        plot.set_visible(False)
    rest = len(all_panels) - len(shown)
    more = f"; {rest} more panels not shown" if rest else ""
    claim = claim_text(certificate)
    title = f"{problem.name}: certified {claim}; {success.sum()} of {len(success)} rollouts satisfied{more}"
    figure.suptitle(title, fontsize=10, color=SOFT, x=0.02, ha="left")
    return figure


def automaton_figure(problem: Any) -> Figure:
    """Draw the task automaton: states, numbered transitions, and below them the letters that take each transition.

    Accepting states have a double rim; states from which acceptance cannot be reached are grey. The transitions are
    those that a letter of the workspace can take; long guards are cut off. Of independent tasks the first one is drawn.
    """
    problem = as_problem(problem)
    problem = problem.tasks[0] if problem.groups else problem
    drawn, automaton = edges(problem), problem.automaton
    # The list of transitions below the picture decides on the width and the foot of the figure; one unit is an inch.
    spots = {q: (x / PIXELS_PER_INCH, -y / PIXELS_PER_INCH) for q, (x, y) in places(automaton, drawn).items()}
    low, high = np.min(list(spots.values()), axis=0), np.max(list(spots.values()), axis=0)
    words = [_guard_line(n, e.guard, automaton.state_names, e.source, e.target) for n, e in enumerate(drawn, 1)]
    words = [*words[:MOST_LINES], *(["..."] if len(words) > MOST_LINES else [])]
    width = float(max(high[0] - low[0] + 2.2, 0.075 * max(map(len, words)) + 0.3))
    foot = 0.9 + 0.155 * len(words)
    figure, (plot,) = new_figure(width, float(high[1] - low[1]) + 1.35 + foot)
    figure.set_layout_engine("none")
    plot.set_position((0.0, 0.0, 1.0, 1.0))
    plot.axis("off")
    plot.set_xlim(low[0] - 1.1, low[0] - 1.1 + width)
    plot.set_ylim(low[1] - foot, high[1] + 1.35)
    disks = {q: _state(plot, *spots[q], automaton, q) for q in spots}
    few, numbered = automaton.n_states <= FEW_STATES, automaton.n_states <= NUMBERED_STATES
    for number, edge in enumerate(drawn, 1):
        if (not few and automaton.dead[edge.target]) or (not numbered and edge.source == edge.target):
            continue
        # An arrow that skips a column of states bends the other way, past the states between.
        past = few and abs(spots[edge.source][0] - spots[edge.target][0]) > 3.0
        _arrow(plot, disks[edge.source], disks[edge.target], str(number) if numbered else "", -0.32 if past else 0.2)
    x, y = spots[automaton.initial]
    plot.annotate("", (x - 0.31, y), (x - 0.85, y), arrowprops={"arrowstyle": "-|>", "color": INK})
    title = f"{problem.name}: {automaton.semantics} task"
    plot.text(low[0] - 1.0, high[1] + 1.15, title, fontsize=10, color=SOFT, va="center")
    plot.text(low[0] - 1.0, low[1] - 0.75, "\n".join(words), fontsize=8, va="top", family="monospace", color=INK)
    return figure


def _guard_line(number: int, guard: str, names: Any, source: int, target: int) -> str:
    """Return the text of a transition, cut off if it is long."""
    words = f"{number:>2}  {names[source]} -> {names[target]}: {guard}"
    return words if len(words) <= LINE_LENGTH else words[: LINE_LENGTH - 4] + " ..."


def _state(plot: Axes, x: float, y: float, automaton: Automaton, q: int) -> Circle:
    """Draw and return the disk of a state, with its name in it or below it."""
    from matplotlib.patches import Circle

    accepting, dead, name = automaton.accepting[q], automaton.dead[q], automaton.state_names[q]
    rim, fill = ("#9aa1ab", "#eceef1") if dead else (INK, "#dcefe7" if accepting else "white")
    disk = Circle((x, y), 0.31, facecolor=fill, edgecolor=rim, linewidth=1.4, zorder=3)
    plot.add_patch(disk)
    if accepting:
        plot.add_patch(Circle((x, y), 0.255, fill=False, edgecolor=rim, linewidth=1.2, zorder=3))
    height = y if len(name) <= 4 else y - 0.45
    plot.text(x, height, name, ha="center", va="center", fontsize=9, color=SOFT if dead else INK, zorder=4)
    return disk


def _arrow(plot: Axes, a: Circle, b: Circle, number: str, bend: float) -> None:
    """Draw an arrow between two states; with a negative bend it passes below the states on the way."""
    from matplotlib.patches import FancyArrowPatch

    style: dict[str, Any] = {"arrowstyle": "-|>", "color": SOFT, "mutation_scale": 11, "linewidth": 1.1, "zorder": 2}
    (x0, y0), (x1, y1) = a.center, b.center
    if a is b:
        left, right = (x0 - 0.14, y0 + 0.28), (x0 + 0.14, y0 + 0.28)
        plot.add_patch(FancyArrowPatch(left, right, connectionstyle="arc3,rad=-1.9", **style))
        spot = (x0, y0 + 0.63)
    else:
        # Patches shorten the arrow to the rims of both disks; the number stands at the top of the arc.
        style |= {"patchA": a, "patchB": b, "shrinkA": 1, "shrinkB": 1}
        plot.add_patch(FancyArrowPatch((x0, y0), (x1, y1), connectionstyle=f"arc3,rad={-bend}", **style))
        spot = (0.5 * (x0 + x1) - 0.5 * bend * (y1 - y0), 0.5 * (y0 + y1) + 0.5 * bend * (x1 - x0))
    if number:
        box = {"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none"}
        plot.text(*spot, number, fontsize=8, color=FAILURE, ha="center", va="center", zorder=5, bbox=box)


def tree_figure(certificate: Any) -> Figure:
    """Draw the value tree: a vertex per kept term, coloured by automaton state, and an edge per guard.

    A term of the value function with k steps left is a guard applied to a term with k - 1 steps left. The tree grows
    from acceptance on the right; the bound is the sum over the terms on the left. Of independent tasks the first one is
    drawn.

    Raises
    ------
    ValueError
        If the tree has more vertices than can be drawn; take a shorter horizon.
    """
    certificate = of_first_task(certificate)
    problem, horizon = certificate.problem, certificate.problem.horizon
    layers = _layers(certificate)
    total = sum(len(layer) for layer in layers)
    if total > MOST_VERTICES:
        raise ValueError(
            f"`certificate`: expected a value tree of at most {MOST_VERTICES} vertices to draw, got {total}; "
            "synthesize it with a shorter horizon"
        )
    figure, (plot,) = new_figure(6.8, max(3.0, min(8.0, 0.24 * max(map(len, layers)) + 1.6)))
    # One column per time, its vertices centred; edges first, so that vertices cover their ends.
    row = [{vertex: r - 0.5 * (len(layer) - 1) for r, vertex in enumerate(layer)} for layer in layers]
    for t, layer in enumerate(layers[:-1]):
        for vertex in layer:
            for child in layer[vertex]:
                plot.plot([t, t + 1], [row[t][vertex], row[t + 1][child]], color=PALE, linewidth=0.8, zorder=1)
    names = problem.automaton.state_names
    for number, q in enumerate(sorted({q for layer in layers for q, _ in layer})):
        points = np.array([(t, r) for t, rows in enumerate(row) for (s, _), r in rows.items() if s == q])
        color, label = SERIES[number % len(SERIES)], f"automaton state {names[q]}"
        plot.scatter(points[:, 0], points[:, 1], s=46, color=color, edgecolor="white", zorder=3, label=label)
    plot.set_yticks([])
    plot.spines["left"].set_visible(False)
    plot.grid(visible=False)
    plot.set_xticks(range(horizon + 1), [str(horizon - t) for t in range(horizon + 1)])
    plot.set_xlabel("steps left (control steps)")
    legend_above(plot, 3)
    claim = claim_text(certificate)
    plot.set_title(f"{problem.name}: value tree behind {claim}", loc="left", fontsize=10, color=SOFT, pad=24)
    return figure


Vertex = tuple[int, int]
"""Automaton state and number of the term."""


def _layers(certificate: OnGrid) -> list[dict[Vertex, list[Vertex]]]:
    """Return per time the vertices (automaton state, term) to which the start leads, each with its children."""
    automaton, merge_log = certificate.problem.automaton, certificate.proof.merge_log
    started = dict.fromkeys(certificate.proof.start_target.tolist())
    roots = [(int(q), k) for q in started for k in range(len(certificate.proof.tree.index[q]))]
    layers: list[dict[Vertex, list[Vertex]]] = [{root: [] for root in roots}]
    # Follow the terms forward in time; only those that the start needs are drawn.
    for step in merge_log:
        following: dict[Vertex, list[Vertex]] = {}
        for (q, k), children in layers[-1].items():
            if automaton.finished[q]:
                children.append((q, 0))
            else:
                # A kept term stands for its candidate and for all candidates that were united with it.
                candidate, merges = int(step.kept[q][k]), step.merges[q]
                merged = [b for a, b in zip(merges.into.tolist(), merges.absorbed.tolist()) if a == candidate]
                for row in (candidate, *merged):
                    guard, term = (int(v) for v in step.origin[q][row])
                    children.append((int(certificate.proof.guard_target[guard]), term))
            following.update({child: [] for child in children})
        layers.append(dict(sorted(following.items())))
    return layers
