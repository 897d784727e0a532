"""Draw the pictures of the theory pages into ``docs/theory/pictures``: ``python docs/draw_theory.py [PAGE ...]``.

Each shows the one idea of its page. What has numbers is computed here, or read from the page.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch, Polygon, Rectangle
from scipy.special import ndtr
from scipy.stats import beta

from certigym.envs.interfaces import AGENTS, LOOKS
from certigym.validation.presentation.figures.figure_style import BOUND, ESTIMATE, FAILURE, INK, PALE, SOFT, new_figure

PAGES = Path(__file__).parent / "theory"
FOLDER = PAGES / "pictures"
REACH, AVOID, KEEP = (LOOKS[role].color for role in ("reached", "avoided", "kept"))


def density(x: Any) -> Any:
    """Standard normal density."""
    return np.exp(-0.5 * np.square(x)) / np.sqrt(2 * np.pi)


def _region(plot: Any, shape: Any, role: str) -> None:
    """Draw a region with the colour and hatch of its role."""
    look = LOOKS[role]
    # A pale colour and not a transparent one: in SVG the hatch would be as transparent.
    pale = [(0.16 * part + 0.84 * 255) / 255 for part in look.rgb]
    shape.set(facecolor=pale, edgecolor=look.color, hatch=look.hatch * 2, linewidth=1.2)
    plot.add_patch(shape)


def _box(
    plot: Any, at: tuple[float, float], words: str, color: str = INK, size: tuple[float, float] = (2.2, 0.8)
) -> None:
    """Draw a box of words around a point."""
    (x, y), (width, height) = at, size
    style = "round,pad=0,rounding_size=0.12"
    corner = (x - width / 2, y - height / 2)
    plot.add_patch(FancyBboxPatch(corner, width, height, boxstyle=style, facecolor="white", edgecolor=color))
    plot.text(x, y, words, ha="center", va="center", color=color, fontsize=10)


def _arrow(
    plot: Any, begin: tuple[float, float], end: tuple[float, float], color: str = SOFT, bend: float = 0.0
) -> None:
    style: Any = {"arrowstyle": "-|>", "mutation_scale": 11, "connectionstyle": f"arc3,rad={bend}"}
    plot.add_patch(FancyArrowPatch(begin, end, color=color, **style))


def _bare(plot: Any, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Take axes and grid away."""
    plot.set(xlim=x, ylim=y)
    plot.axis("off")


def index() -> Any:
    """From a problem to a claim that others check: the pages along the way."""
    figure, (plot,) = new_figure(8.0, 2.9)
    _bare(plot, (-1.3, 13.3), (-1.7, 1.7))
    steps = ["problem", "finite models", "value", "bound", "check"]
    notes = [
        "setting, regions,\ntime, pairs",
        "relations, linear, boxes,\nnetworks; or paths",
        "guards,\ntree",
        "bounds,\nnumerics",
        "the trusted base;\nevidence, shields",
    ]
    for k, (step, note) in enumerate(zip(steps, notes)):
        _box(plot, (3.0 * k, 0.7), step, BOUND if step in ("bound", "check") else INK, (2.3, 0.9))
        plot.text(3.0 * k, -0.2, note, ha="center", va="top", color=SOFT, fontsize=10)
        if k:
            _arrow(plot, (3.0 * k - 1.85, 0.7), (3.0 * k - 1.15, 0.7))
    return figure


def setting() -> Any:
    """A run, the letters that it reads, and the verdict."""
    figure, (plot,) = new_figure(6.4, 3.2)
    times, track = np.arange(7), np.array([0.6, 1.4, 2.3, 2.1, 3.2, 4.3, 4.6])
    _region(plot, Rectangle((-0.3, 4.0), 6.6, 1.2), "reached")
    _region(plot, Rectangle((-0.3, 1.8), 6.6, 0.9), "kept")
    plot.plot(times, track, "o-", color=AGENTS[0], markersize=5, linewidth=1.2)
    for time, y in zip(times.tolist(), track.tolist()):
        letter = "goal" if y >= 4.0 else "lane" if 1.8 <= y < 2.7 else ""
        plot.text(time, -0.55, "{" + letter + "}", ha="center", fontsize=10, color=INK)
    plot.text(6.45, 4.6, "goal", va="center", color=REACH)
    plot.text(6.45, 2.25, "lane", va="center", color=KEEP)
    plot.text(6.45, -0.55, "letters", va="bottom", color=SOFT)
    plot.set(xlim=(-0.3, 7.4), ylim=(-0.8, 5.4), xlabel="time", ylabel="output", yticks=[])
    plot.set_xticks(times)
    plot.grid(visible=False)
    return figure


def relations() -> Any:
    """Two laws of the noise that differ by a shift, and their common part."""
    figure, (plot,) = new_figure(6.4, 2.9)
    x, shift = np.linspace(-3.6, 4.6, 400), 1.0
    first, second = density(x), density(x - shift)
    plot.fill_between(x, np.minimum(first, second), color=BOUND, alpha=0.22)
    plot.plot(x, first, color=AGENTS[0], label="noise of the system, $w$")
    plot.plot(x, second, color=AGENTS[1], linestyle="--", label=r"noise of the model, $\hat w = w + v$")
    delta = 2 * ndtr(shift / 2) - 1
    plot.text(shift / 2, 0.14, f"equal with probability\n$1 - \\delta$ = {1 - delta:.3f}", ha="center", color=INK)
    _arrow(plot, (0.0, 0.415), (shift, 0.415), INK)
    plot.text(shift / 2, 0.43, "$v$", ha="center")
    plot.set(ylim=(0, 0.5), yticks=[], xlabel="deviations")
    plot.legend(loc="upper left", frameon=False, fontsize=9)
    return figure


def linear() -> Any:
    """The worked example: what is true in a cell, and what may be promised."""
    figure, (plot,) = new_figure(6.4, 3.4)
    x = np.linspace(0, 1, 200)
    truth = ndtr((4 - 1 - x / 2) / 0.5) - ndtr((2 - 1 - x / 2) / 0.5)
    ends = truth[[0, -1]]
    middle, bend = truth[100], 0.5**2 / 8 * 0.24197
    theta = min((middle - bend) / ends.mean(), *((ends - bend) / ends))
    between = ends[0] + (ends[1] - ends[0]) * x
    plot.plot(x, truth, color=INK, label="truth")
    plot.plot(x, between, color=SOFT, linestyle=":", label="through the corners: too high")
    plot.plot(x, theta * between, color=BOUND, label="linear cell: promised")
    plot.plot(x, np.full_like(x, truth[0]), color=ESTIMATE, linestyle="--", label="one box for the cell: promised")
    plot.fill_between(x, theta * between, truth, color=BOUND, alpha=0.12)
    plot.set(xlabel="state in the cell", ylabel="probability of the goal", xlim=(0, 1), ylim=(0, None))
    plot.legend(frameon=False, fontsize=9)
    return figure


def networks() -> Any:
    """A network on a line, and boxes that hold it on every cell."""
    figure, (plot,) = new_figure(6.4, 3.2)
    x = np.linspace(-2, 2, 400)

    def net(x: Any) -> Any:
        return 0.9 * np.tanh(2.2 * x) - 0.5 * np.tanh(3 * x - 2.4) + 0.25 * np.sin(3 * x)

    for low in np.arange(-2, 2, 0.5):
        inside = net(np.linspace(low, low + 0.5, 200))
        least, most = inside.min() - 0.06, inside.max() + 0.06
        plot.add_patch(Rectangle((low, least), 0.5, most - least, facecolor=BOUND + "22", edgecolor=BOUND))
    plot.plot(x, net(x), color=INK, linewidth=1.6)
    plot.text(-1.9, 0.75, "boxes that hold the input\non every cell, rounding included", color=BOUND, fontsize=9.5)
    plot.text(0.98, 1.1, "network", color=INK, fontsize=9.5)
    plot.set(xlim=(-2, 2), xlabel="state", ylabel="input", xticks=np.arange(-2, 2.1, 0.5))
    return figure


def paths() -> Any:
    """A nominal path around a rock, with the tube in which deviations stay."""
    figure, (plot,) = new_figure(6.4, 3.5)
    _region(plot, Polygon([(3.2, 0.9), (5.0, 0.5), (5.6, 2.0), (4.2, 2.6)]), "avoided")
    _region(plot, Rectangle((8.0, 0.9), 1.7, 1.7), "reached")
    along = np.linspace(0, 1, 13)
    x, y = 0.6 + 8.2 * along, 1.2 + 2.9 * np.sin(np.pi * np.clip(along, 0, 1)) ** 1.4 + 0.5 * along
    for k, (a, b) in enumerate(zip(x, y)):
        plot.add_patch(Circle((a, b), 0.08 + 0.42 * (1 - 0.75**k), facecolor=AGENTS[0] + "22", edgecolor="none"))
    generator = np.random.default_rng(3)
    for _ in range(6):
        wave, walk = np.zeros((13, 2)), np.zeros(2)
        for k in range(1, 13):
            walk = 0.75 * walk + generator.normal(0, 0.12, 2)
            wave[k] = walk
        plot.plot(x + wave[:, 0], y + wave[:, 1], color=AGENTS[0], alpha=0.35, linewidth=0.9)
    plot.plot(x, y, "o-", color=AGENTS[0], markersize=3.5, linewidth=1.6)
    plot.text(4.35, 0.1, "avoid", ha="center", color=INK)
    plot.text(8.85, 2.7, "reach", ha="center", color=INK)
    plot.text(0.3, 5.15, "nominal path, feedback, and the tube that every limit leaves room for", color=AGENTS[0])
    plot.set(xlim=(0, 10), ylim=(0, 5.7), xticks=[], yticks=[], aspect="equal")
    return figure


def time() -> Any:
    """A region that moves with the time, and a run that stays in it."""
    figure, (plot,) = new_figure(6.4, 3.0)
    times = np.arange(21)
    middle = 2 * np.sin(0.4 * times)
    for t, m in zip(times, middle):
        _region(plot, Rectangle((t - 0.5, m - 0.7), 1.0, 1.4), "kept")
    noise = np.random.default_rng(1).normal(0, 0.2, 21)
    plot.plot(times, middle + noise, "o-", color=AGENTS[0], markersize=4, linewidth=1.0)
    plot.set(xlabel="time $t$", ylabel="state", xlim=(-0.5, 20.5))
    plot.set_title(r"keep $2 \sin(0.4\, t) \pm 0.7$: each letter is read where the region is then", fontsize=10)
    return figure


def regions() -> Any:
    """Shapes, and the outputs whose limits they are."""
    figure, plots = new_figure(8.0, 2.6, 1, 3)
    turns = np.linspace(0, 2 * np.pi, 100)
    _region(plots[0], Circle((0, 0), 1.0), "reached")
    plots[0].set_title("disc: one output\n$y = |x - c|^2 < r^2$", fontsize=10)
    corners = np.array([(-1.0, -0.8), (1.1, -0.5), (0.7, 0.9), (-0.6, 0.8)])
    _region(plots[1], Polygon(corners), "avoided")
    for a, b in zip(corners, np.roll(corners, -1, axis=0)):
        line = np.stack([a - 0.5 * (b - a), b + 0.5 * (b - a)])
        plots[1].plot(*line.T, color=SOFT, linewidth=0.8, linestyle=":")
    plots[1].set_title("polygon: one output for each edge\n$n_k \\cdot x < b_k$ for all $k$", fontsize=10)
    _region(plots[2], Circle((-0.45, 0.1), 0.7), "mixed")
    _region(plots[2], Rectangle((-0.1, -0.9), 1.2, 1.1), "mixed")
    plots[2].set_title("union: a formula\n$p_1 \\vee p_2$", fontsize=10)
    for plot in plots:
        plot.plot(1.7 * np.cos(turns), 1.7 * np.sin(turns), alpha=0)
        plot.set(xlim=(-1.6, 1.6), ylim=(-1.3, 1.3), aspect="equal", xticks=[], yticks=[])
    return figure


def angles() -> Any:
    """The line on which a path goes on, with a copy of a region for every turn, and the density of one step."""
    figure, (plot,) = new_figure(7.2, 2.6)
    for turn in (-1, 0, 1):
        first = 2.0 * np.pi * turn
        _region(plot, Rectangle((first + np.pi - 0.5, 0.0), 1.0, 0.9), "reached")
        plot.axvline(first + np.pi, color=SOFT, linewidth=0.8, linestyle=":")
        plot.text(first, -0.14, f"turn {turn:+d}" if turn else "the workspace", color=SOFT, ha="center", va="top")
    x = np.linspace(-3.0 * np.pi, 3.0 * np.pi, 900)
    plot.plot(x, 1.9 * density((x - 2.2) / 1.3), color=AGENTS[0])
    plot.text(4.0, 0.45, "where a step may end", color=AGENTS[0], ha="left")
    plot.set(xlim=(-3.0 * np.pi - 0.6, 3.0 * np.pi + 0.7), ylim=(-0.35, 1.0), yticks=[])
    plot.set_xticks([-3.0 * np.pi, -np.pi, np.pi, 3.0 * np.pi], ["$-3\\pi$", "$-\\pi$", "$\\pi$", "$3\\pi$"])
    plot.set_title("a heading through $\\pi$: one copy for every turn, and the mass of all of them", fontsize=10)
    plot.grid(visible=False)
    return figure


def pairs() -> Any:
    """Where two agents are near is a band along the diagonal, which no cell has for its own."""
    figure, (plot,) = new_figure(6.4, 3.6)
    band = Polygon([(0, 0), (1, 0), (8, 7), (8, 8), (7, 8), (0, 1)])
    _region(plot, band, "avoided")
    for k in range(9):
        plot.axvline(k, color=PALE, linewidth=0.7)
        plot.axhline(k, color=PALE, linewidth=0.7)
    for a in range(8):
        for b in (a - 1, a, a + 1):
            if 0 <= b < 8:
                plot.add_patch(Rectangle((a, b), 1, 1, facecolor=AVOID + "1c", edgecolor="none"))
    plot.plot([1, 2.2, 3.4, 4.6, 5.8], [4.2, 4.9, 5.4, 6.4, 7.2], "o-", color=AGENTS[0], markersize=4)
    plot.text(8.2, 7.4, "near: $|x_a - x_b| < 1$", color=AVOID, va="center")
    plot.text(8.2, 5.4, "tinted: cells of which\nsome point is near", color=SOFT, va="center")
    plot.text(8.2, 3.2, "a run that keeps apart", color=AGENTS[0], va="center")
    plot.set(xlim=(0, 8), ylim=(0, 8), xlabel="agent a", ylabel="agent b", aspect="equal", xticks=[], yticks=[])
    plot.grid(visible=False)
    return figure


def guards() -> Any:
    """A set of letters cut into products that have nothing in common."""
    figure, plots = new_figure(7.2, 3.0, 1, 2)
    wanted = {(0, 2), (1, 2), (2, 2), (3, 2), (2, 0), (2, 1), (3, 0), (3, 1)}
    pieces = [((0, 2), (4, 1), AGENTS[0]), ((2, 0), (2, 2), AGENTS[1])]
    for plot in plots:
        for i in range(4):
            for j in range(3):
                inside = (i, j) in wanted
                plot.add_patch(Rectangle((i, j), 1, 1, facecolor=REACH + "33" if inside else "white", edgecolor=PALE))
        plot.set(
            xlim=(-0.1, 4.1), ylim=(-0.1, 3.1), aspect="equal", xlabel="classes of agent 1", ylabel="classes of agent 2"
        )
        plot.set(xticks=[], yticks=[])
        plot.grid(visible=False)
    for (x, y), (width, height), color in pieces:
        plots[1].add_patch(
            Rectangle(
                (x + 0.06, y + 0.06), width - 0.12, height - 0.12, facecolor=color + "22", edgecolor=color, linewidth=2
            )
        )
    plots[0].set_title("letters that take the transition", fontsize=10)
    plots[1].set_title("the same, as two disjoint products", fontsize=10)
    return figure


def tree() -> Any:
    """A value of two agents as a sum of products."""
    figure, plots = new_figure(8.2, 2.4, 1, 4)
    s = np.linspace(0, 1, 60)
    factors = [
        (ndtr((s - 0.7) / 0.08), ndtr((0.45 - s) / 0.08)),
        (ndtr((s - 0.35) / 0.08) * ndtr((0.7 - s) / 0.08), ndtr((s - 0.75) / 0.06)),
        (0.8 * density((s - 0.2) / 0.1) / density(0), 0.9 * density((s - 0.5) / 0.14) / density(0)),
    ]
    products = [np.outer(b, a) for a, b in factors]
    titles = [
        "$v_{1,1}\\, v_{1,2}$",
        "$+\\;\\; v_{2,1}\\, v_{2,2}$",
        "$+\\;\\; v_{3,1}\\, v_{3,2}$",
        "$=\\;\\; V(s_1, s_2)$",
    ]
    for plot, values, title in zip(plots, [*products, sum(products)], titles):
        plot.imshow(values, origin="lower", cmap="Blues", vmin=0, vmax=1.1, interpolation="nearest")
        plot.set_title(title, fontsize=11)
        plot.set(xticks=[], yticks=[], xlabel="agent 1")
        plot.grid(visible=False)
    plots[0].set_ylabel("agent 2")
    return figure


def bounds() -> Any:
    """The worked example: the intervals that the page prints."""
    text = (PAGES / "bounds.md").read_text(encoding="utf-8")
    rows = re.findall(r"^(\w+) +[\w ]+\[([\d.]+), ([\d.]+)\] +rollouts ([\d.]+)$", text, re.MULTILINE)
    found = re.search(
        r"^finite models of `exact`: at most ([\d.]+); any controller: at most ([\d.]+)$", text, re.MULTILINE
    )
    assert len(rows) == 4 and found
    figure, (plot,) = new_figure(7.2, 3.0)
    for k, (_, *numbers) in enumerate(rows):
        low, high, rate = map(float, numbers)
        plot.plot([low, max(high, low + 0.002)], [-k, -k], color=BOUND, linewidth=9, alpha=0.3, solid_capstyle="butt")
        plot.plot([low], [-k], marker="|", color=BOUND, markersize=15, markeredgewidth=2.5)
        plot.plot([rate], [-k], "o", color=ESTIMATE, markersize=5)
    finite, most = float(found[1]), float(found[2])
    plot.axvline(most, color=FAILURE, linewidth=1.3)
    plot.text(most + 0.004, 0.62, "no controller\nis beyond", color=FAILURE, fontsize=9, va="top")
    plot.axvline(finite, color=SOFT, linestyle=":", linewidth=1.3)
    plot.text(finite - 0.004, -2.9, "finite models\nof `exact` end here", color=SOFT, fontsize=9, ha="right")
    plot.plot(
        [],
        [],
        marker="|",
        color=BOUND,
        markersize=12,
        markeredgewidth=2.5,
        linestyle="none",
        label="certified from below",
    )
    plot.plot([], [], color=BOUND, linewidth=9, alpha=0.3, label="up to what is certified from above")
    plot.plot([], [], "o", color=ESTIMATE, label="rollouts")
    figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    plot.set_yticks([0, -1, -2, -3], [name for name, *_ in rows])
    plot.set(xlabel="probability of success", ylim=(-3.5, 0.7))
    return figure


def numerics() -> Any:
    """Far from the mean a difference of distribution functions has no correct digit."""
    figure, (plot,) = new_figure(6.4, 3.0)
    x = np.linspace(1, 11, 200)
    truth = ndtr(-x) - ndtr(-(x + 0.1))
    naive = np.abs((ndtr(x + 0.1) - ndtr(x)) / truth - 1)
    plot.semilogy(x, np.maximum(naive, 1e-17), color=AVOID, label=r"$\Phi(b) - \Phi(a)$, both near 1")
    plot.axhline(2.0**-52, color=BOUND, label="on the smaller tail, then lowered by its error")
    plot.axhline(1.0, color=SOFT, linewidth=0.8, linestyle=":")
    plot.text(1.1, 1.6, "no digit is right", color=SOFT, fontsize=9)
    plot.set(xlabel="standard deviations from the mean", ylabel="relative error", ylim=(1e-17, 30), xlim=(1, 11))
    plot.legend(frameon=False, fontsize=9, loc="center right")
    return figure


def shields() -> Any:
    """What is left of the certified probability while somebody else proposes."""
    figure, (plot,) = new_figure(6.4, 3.0)
    worth = [0.995, 0.991, 0.982, 0.968, 0.955, 0.955, 0.955, 0.968, 0.961, 0.95, 0.95, 0.972, 1.0]
    taken = [1, 1, 1, 1, 0, 0, 0, 1, 1, 0, 0, 0]
    times = np.arange(len(worth))
    plot.step(times, worth, where="post", color=BOUND, linewidth=1.8, label="worth of what is applied")
    for t, free in zip(times, taken):
        plot.plot([t + 0.5], [worth[t]], "o" if free else "s", color=REACH if free else AVOID, markersize=6)
    plot.plot([], [], "o", color=REACH, label="proposal let through")
    plot.plot([], [], "s", color=AVOID, label="certified input instead")
    plot.axhline(0.95, color=INK, linestyle="--", linewidth=1)
    plot.text(12.1, 0.9505, "$p$", va="bottom")
    plot.set(xlabel="time (a sketch)", ylabel="certified from here on", ylim=(0.94, 1.004), xlim=(0, 12.6))
    plot.legend(frameon=False, fontsize=9, loc="upper center", ncols=1)
    return figure


def evidence() -> Any:
    """Three verdicts: a claim, rollouts, and their exact limits."""
    figure, (plot,) = new_figure(6.8, 2.7)
    claim, count, alpha = 0.9, 400, 0.001
    for k, (successes, verdict, color) in enumerate(
        ((331, "refuted", FAILURE), (362, "consistent", AGENTS[0]), (386, "confirmed", REACH))
    ):
        low = beta.ppf(alpha / 2, successes, count - successes + 1)
        high = beta.ppf(1 - alpha / 2, successes + 1, count - successes)
        assert {"refuted": high < claim, "confirmed": low >= claim}.get(verdict, low < claim <= high)
        plot.plot([low, high], [-k, -k], color=color, linewidth=2.2)
        plot.plot([successes / count], [-k], "o", color=color, markersize=7)
        plot.text(low, -k + 0.2, f"{verdict}: {successes} of {count}", color=color)
    plot.axvline(claim, color=INK, linestyle="--", linewidth=1.2)
    plot.text(claim, 0.62, "claim $\\ell$", ha="center", va="bottom")
    plot.set(xlabel="success rate, with limits of level .999", yticks=[], ylim=(-2.6, 0.6), xlim=(0.75, 1.02))
    plot.set_xticks([0.75, 0.8, 0.85, 0.9, 0.95, 1.0])
    return figure


PICTURES: dict[str, Callable[[], Any]] = {
    draw.__name__: draw
    for draw in (
        index, setting, relations, linear, networks, paths, time, regions, angles, pairs, guards, tree, bounds,
        numerics, shields, evidence,
    )
}  # fmt: skip


def main(names: list[str]) -> None:
    """Draw the named pictures, or all."""
    FOLDER.mkdir(exist_ok=True)
    settings: Any = {"svg.fonttype": "none", "svg.hashsalt": "certigym", "font.family": "sans-serif"}
    for name in names or list(PICTURES):
        with matplotlib.rc_context(settings):
            PICTURES[name]().savefig(FOLDER / f"{name}.svg", metadata={"Date": None, "Creator": None})
        print(f"{name}.svg: {(FOLDER / f'{name}.svg').stat().st_size // 1024} KiB")


if __name__ == "__main__":
    main(sys.argv[1:])
