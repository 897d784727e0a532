"""Regions along the edges and inside of maps of starts, and panels of rollouts over regions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ....envs.interfaces import LOOKS, Drawer, Panel, Region, roles
from ....envs.tasks.problem import Problem
from ....envs.tasks.regions import Proposition
from ....synthesis.certificates.proofs import Tube
from .figure_style import FAILURE, INK, SERIES, legend_above, whole_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Interval = tuple[float, float]

MOST_LABELS = 8
"""Agents of a panel up to which a legend names them: two lines of it."""


def intervals(problem: Problem, k: int) -> dict[str, Interval]:
    """Return the regions that restrict joint state coordinate k, by name, cut to the workspace."""
    i = next(i for i, columns in enumerate(problem.columns) if k < columns.stop)
    agent, axis = problem.agents[i], k - problem.columns[i].start
    low, high = float(agent.state_low[axis]), float(agent.state_high[axis])
    intervals_of_regions = {}
    for name, proposition in problem.propositions.items():
        if not isinstance(proposition, Proposition) or proposition.agent != agent.name:
            continue
        piece = problem.pieces.get(name)
        if piece is not None and any(sum(map(bool, limit.form.row)) != 1 for limit in piece.limits):
            continue  # it is no box: maps show its outline
        region = proposition.at(0)  # starts are there at time 0
        if np.any(region.low >= region.high):
            continue
        # An output that is a multiple of the coordinate restricts it; others are no intervals of one coordinate.
        for output, (a, b) in enumerate(zip(region.low, region.high, strict=True)):
            found = agent.output_axis(output)
            if found is not None and found[0] == axis:
                a, b = sorted((float(a) / found[1], float(b) / found[1]))
                cut = max(low, a), min(high, b)
                if cut != (low, high):
                    intervals_of_regions[name] = cut
    return intervals_of_regions


def bands(plot: Axes, problem: Problem, k: int, across: bool) -> int:
    """Draw the regions of joint coordinate k as bars along the upper (``across``) or right edge; return their rows."""
    taken: list[tuple[int, float, float]] = []
    told = roles(problem)
    for name, (a, b) in intervals(problem, k).items():
        # The lowest row in which the bar overlaps no other.
        level = next(n for n in range(len(taken) + 1) if all(n != m or b <= c or d <= a for m, c, d in taken))
        taken.append((level, a, b))
        place, color = 1.015 + 0.055 * level, LOOKS[told[name]].color
        bar, middle = ([a, b], [place, place]), (0.5 * (a + b), place + 0.008)
        style: dict[str, Any] = {"color": color, "linewidth": 3, "clip_on": False, "solid_capstyle": "butt"}
        words: dict[str, Any] = {"fontsize": 8, "color": INK, "clip_on": False}
        if across:
            plot.plot(*bar, transform=plot.get_xaxis_transform(), **style)
            plot.text(*middle, name, transform=plot.get_xaxis_transform(), ha="center", va="bottom", **words)
        else:
            words |= {"ha": "left", "va": "center", "rotation": 90}
            plot.plot(*bar[::-1], transform=plot.get_yaxis_transform(), **style)
            plot.text(*middle[::-1], name, transform=plot.get_yaxis_transform(), **words)
    return 1 + max((level for level, _, _ in taken), default=-1)


def region_boxes(plot: Axes, problem: Problem, shown: Sequence[int]) -> int | None:
    """Outline the regions if both coordinates belong to one agent and return 0; return None if they do not."""
    if not any(columns.start <= min(shown) and max(shown) < columns.stop for columns in problem.columns):
        return None
    from matplotlib.patches import Rectangle

    first, second = (intervals(problem, k) for k in shown)
    for name in first:
        if name in second and name in problem.written:
            (a, b), (c, d) = first[name], second[name]
            plot.add_patch(Rectangle((a, c), b - a, d - c, fill=False, edgecolor="white", linewidth=1.6))
            plot.add_patch(Rectangle((a, c), b - a, d - c, fill=False, edgecolor=INK, linewidth=0.8, linestyle="--"))
            box = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.7}
            plot.text(a, d, name, fontsize=7.5, color=INK, va="bottom", bbox=box)
    _outlines(plot, problem, shown, {*first} & {*second} & {*problem.written})
    return 0


def _outlines(plot: Axes, problem: Problem, shown: Sequence[int], done: set[str]) -> None:
    """Outline the shapes of the agent of both coordinates, as they are at the start, but those that are boxes."""
    i = next(i for i, columns in enumerate(problem.columns) if shown[0] < columns.stop)
    axes = [k - problem.columns[i].start for k in shown]
    agent = problem.agents[i]
    drawer = Drawer(problem, i, axes, agent.state_low[axes], agent.state_high[axes])
    for name, region in problem.written.items():
        if not isinstance(region, Proposition) or region.agent != agent.name or not region.shape or name in done:
            continue
        outline = drawer.outline(name, 0)
        if outline is None:
            continue
        for edge in outline.edges:
            plot.fill(*edge.T, fill=False, edgecolor="white", linewidth=1.6)
            plot.fill(*edge.T, fill=False, edgecolor=INK, linewidth=0.8, linestyle="--")
        box = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.7}
        (left, _), (_, top) = (outline.edges[0].min(axis=0), outline.edges[0].max(axis=0))
        plot.text(left, top, name, fontsize=7.5, color=INK, va="bottom", bbox=box)


def rollouts_panel(
    plot: Axes,
    panel: Panel,
    states: NDArray[Any],
    success: NDArray[np.bool_],
    horizon: int,
    tubes: Mapping[int, Tube] | None = None,
) -> None:
    """Draw paths (T + 1, M, D) of episodes over the regions of a panel; failed episodes end in a cross.

    Below them come tubes along nominal paths, by the numbers of their curves.
    """
    if not panel.is_map:
        plot.set_xlim(0, horizon)
    _regions(plot, panel)
    for curve in panel.curves:
        if tubes and curve.number in tubes:
            _draw_tube(plot, panel, tubes[curve.number], SERIES[curve.number % len(SERIES)])
        track = states @ curve.rows.T
        color = SERIES[curve.number % len(SERIES)]
        for m in range(track.shape[1]):
            # States are NaN after the decision; successful paths are thin, so that failures stand out.
            here = track[~np.isnan(track[:, m]).any(axis=1), m]
            x = here[:, 0] if panel.is_map else np.arange(len(here))
            label = curve.name if m == 0 and len(panel.curves) <= MOST_LABELS else None
            line: dict[str, Any] = {"linewidth": 1.0, "alpha": 0.55, "label": label}
            mark: dict[str, Any] = {"color": color, "marker": "o", "ms": 3.5, "mew": 0.5}
            if not success[m]:
                line |= {"alpha": 0.9, "linestyle": (0, (3, 2))}
                mark = {"color": FAILURE, "marker": "X", "ms": 7, "mew": 0.7}
            elif curve.heading is not None:
                # A triangle, which points upwards when it is not turned.
                angle = np.degrees(states[len(here) - 1, m, curve.heading])
                mark |= {"marker": (3, 0, angle - 90.0), "ms": 7}
            plot.plot(x, here[:, -1], color=color, **line)
            plot.plot(x[-1:], here[-1:, -1], mec="white", zorder=4, clip_on=False, **mark)
    _name_axes(plot, panel)


def _name_axes(plot: Axes, panel: Panel) -> None:
    """Give a panel its limits, the names of its axes, and a legend where its agents are few."""
    if panel.is_map:
        plot.set_xlim(panel.low[0], panel.high[0])
        plot.set_aspect("auto" if panel.proportion is None else "equal")
        plot.set_xlabel(f"{panel.names[0]} (state units)")
    else:
        whole_ticks(plot.xaxis)
        plot.set_xlabel("control step")
    plot.set_ylabel(f"{panel.names[-1]} (state units)")
    plot.set_ylim(panel.low[-1], panel.high[-1])
    if len(panel.curves) <= MOST_LABELS:
        legend_above(plot, 4)


def _draw_tube(plot: Axes, panel: Panel, tube: Tube, color: str) -> None:
    """Shade the tube along a nominal path: a band over time, or an ellipse for each time on a map."""
    if panel.is_map:
        for outline in tube.outlines()[1:]:
            plot.fill(*outline.T, facecolor=color, alpha=0.06, linewidth=0, zorder=0.8)
            plot.fill(*outline.T, fill=False, edgecolor=color, alpha=0.5, linewidth=0.8, zorder=0.8)
        return
    half, times = tube.half_widths()[:, 0], np.arange(len(tube.middle))
    low, high = tube.middle[:, 0] - half, tube.middle[:, 0] + half
    plot.fill_between(times, low, high, facecolor=color, alpha=0.16, linewidth=0, zorder=0.8)


def _regions(plot: Axes, panel: Panel) -> None:
    """Draw the regions of a panel with their names, in the looks of their roles: boxes on a map, bands over time."""
    for region in panel.drawn:
        _region(plot, panel, region)
        if region not in panel.named:
            continue
        words: dict[str, Any] = {"fontsize": 8, "color": INK, "zorder": 5}
        if panel.is_map:
            plot.text(region.low[0], region.high[1], f" {region.name}", va="top", **words)
        elif region.time is not None:
            plot.text(region.time, region.high[0], f" {region.name}", va="bottom", **words)
        else:
            middle = 0.5 * (region.low[0] + region.high[0])
            place: dict[str, Any] = {"transform": plot.get_yaxis_transform(), "va": "center", "clip_on": False}
            plot.text(1.015, middle, region.name, **place, **words)


def _region(plot: Axes, panel: Panel, region: Region) -> None:
    """Draw one region: its tint, the hatch of its role, and on a map its rim."""
    from matplotlib.patches import Rectangle

    look = LOOKS[region.role]
    fill: dict[str, Any] = {"facecolor": look.color, "alpha": 0.16, "linewidth": 0, "zorder": 0.5}
    lines: dict[str, Any] = {"fill": False, "edgecolor": look.color, "alpha": 0.55, "linewidth": 0, "zorder": 0.6}
    is_told = region.time is None or region in panel.named
    if panel.is_map and region.outline is not None:
        fills, edges = region.polygons
        for polygon in fills:
            plot.fill(*polygon.T, **fill)
            if is_told:
                plot.fill(*polygon.T, hatch=2 * look.hatch, **lines)
        for polygon in edges:
            plot.fill(*polygon.T, fill=False, edgecolor=look.color, linewidth=1.2, zorder=0.6)
        return
    if panel.is_map:
        corner, size = (region.low[0], region.low[1]), [b - a for a, b in zip(region.low, region.high, strict=True)]
    else:
        # A band over the whole figure; one that moves is there for half a step around its time.
        left, right = plot.get_xlim() if region.time is None else (max(0.0, region.time - 0.5), region.time + 0.5)
        corner, size = (left, region.low[0]), [right - left, region.high[0] - region.low[0]]
    plot.add_patch(Rectangle(corner, *size, **fill))
    if is_told:
        plot.add_patch(Rectangle(corner, *size, hatch=2 * look.hatch, **lines))
    if panel.is_map:
        plot.add_patch(Rectangle(corner, *size, fill=False, edgecolor=look.color, linewidth=1.2, zorder=0.6))
