"""The drawings of a report: bound against horizon, maps of bounds and margins, rollouts over the regions, automaton."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.interfaces import AGENTS, Curve, Panel, Region, coordinate_name, have_one_scale, places
from ....envs.tasks.automata import Automaton
from ....envs.tasks.problem import Problem
from ....synthesis.certificates.proofs import Tube, rounded_down
from ...statistical_tests import FieldReport, OddsScale
from . import svg
from .svg import Axes

MOST_HIGH = 306.0
"""Height of a map in units of the picture, where both axes have one scale: as much as its width."""

MOST_DOTS = 60
"""Horizon up to which every bound of a curve has a dot."""

FEW_STATES = 5
"""Automaton states up to which arrows to dead states are drawn; with more they would cover the others."""

BAR_ROOM, SHADES, NEAR_END = 24.0, 32, 0.93
"""Height of a colour bar with its numbers, how many shades it shows, and where numbers end with it."""

RADIUS = 20.0
"""Radius of an automaton state: ``places`` leaves room for as much."""


def bound_curve(bounds: NDArray[Any], estimate: tuple[float, float, float] | None) -> str:
    """Draw bounds (T,) against the number of steps played, and mark an estimate with its limits at the full horizon."""
    horizon = len(bounds)
    axes = Axes((0.0, 0.0), (float(horizon), 1.0))
    points = [axes.at(k + 1, float(b)) for k, b in enumerate(bounds)]
    shapes = svg.frame(axes, "control steps played", "probability", whole=True)
    shapes.append(svg.polyline(points, "bound"))
    shapes += [svg.circle(point, 2.2, "bound-dot") for point in points] if horizon <= MOST_DOTS else []
    if estimate is not None:
        middle, low, high = estimate
        shapes.append(svg.line(axes.at(horizon, low), axes.at(horizon, high), "estimate"))
        shapes.append(svg.circle(axes.at(horizon, middle), 3.2, "estimate-dot"))
    return svg.picture(axes, shapes, "Certified bound against the number of steps")


def meter(bound: tuple[float, float | None], estimate: tuple[float, float, float], word: str = "certified") -> str:
    """Draw what is certified (lower bound, upper bound or None) above what rollouts gave (mean, limits), on one scale.

    The ``word`` stands beside it: a bound whose check failed is not certified.

    The scale ends at what is drawn: bounds of .99998 and .99999 are to be told apart.
    """
    lower, upper = bound
    mean, low, high = estimate
    ends = [lower, low, high, *([] if upper is None else [upper])]
    span = max(max(ends) - min(ends), 1e-6)
    left, right = max(0.0, min(ends) - 0.12 * span), min(1.0, max(ends) + 0.12 * span)
    axes = Axes((left, 0.0), (right, 2.0), width=420.0, height=104.0, left=70.0, right=26.0, top=6.0, bottom=26.0)
    shapes = []
    for x in svg.ticks(left, right, 5):
        foot = axes.at(x, 0.0)
        shapes += [svg.line(axes.at(x, 2.0), foot, "grid"), svg.text(foot[0], foot[1] + 14, f"{x:.7g}", "tick middle")]
    end = right if upper is None else upper
    shapes.append(svg.rectangle(axes.at(lower, 1.32), axes.at(end, 1.68), "sure" if upper is not None else "sure open"))
    shapes.append(svg.line(axes.at(lower, 1.15), axes.at(lower, 1.85), "bound"))
    shapes.append(svg.line(axes.at(low, 0.5), axes.at(high, 0.5), "estimate"))
    shapes += [svg.line(axes.at(x, 0.36), axes.at(x, 0.64), "estimate") for x in (low, high)]
    shapes.append(svg.circle(axes.at(mean, 0.5), 4.0, "estimate-dot"))
    names = ((1.5, word), (0.5, "rollouts"))
    shapes += [svg.text(axes.left - 10, axes.at(left, y)[1] + 4, name, "end") for y, name in names]
    return svg.picture(axes, shapes, f"{word.capitalize()} bound and rollouts on one scale")


def margin_pictures(problem: Problem, field: FieldReport, axes_shown: tuple[int, ...]) -> dict[str, str]:
    """Draw claims, estimates and limits along a line, or two maps, of bounds and of margins; return them by title."""
    names = [coordinate_name(problem, k) for k in axes_shown]
    if len(names) == 1:
        return {"Bound and rollouts along a line": _margin_line(field, axes_shown[0], names[0])}
    scaled = have_one_scale(problem, axes_shown)
    # The stronger the colour, the larger the bound, or the margin relative to the largest one.
    scale = float(np.max(np.abs(field.margins), initial=1e-9))
    odds = OddsScale.of(field.lower_bounds)
    styles = [f"fill-opacity:{0.06 + 0.94 * odds.at(b):.3f}" for b in field.lower_bounds]
    bound = _map(field, axes_shown, names, styles, None, scaled, odds)
    roles = np.where(field.margins < 0, "under", "over").tolist()
    margin = _map(
        field, axes_shown, names, [f"fill-opacity:{abs(m) / scale:.3f}" for m in field.margins], roles, scaled
    )
    return {"Bound over a map of starts": bound, f"Rollouts minus bound (up to {scale:.2g})": margin}


def _margin_line(field: FieldReport, axis: int, name: str) -> str:
    """Draw bounds as steps, one per start, and the estimates with their limits."""
    x = field.states[:, axis]
    half = 0.5 * (x[1] - x[0]) if len(x) > 1 else 0.5
    axes = Axes((float(x[0] - half), 0.0), (float(x[-1] + half), 1.0))
    shapes = svg.frame(axes, f"start of {name}", "probability")
    for xk, low, high, mean, bad in zip(x, field.ci_low, field.ci_high, field.estimates, field.refuted):
        shapes.append(svg.line(axes.at(xk, low), axes.at(xk, high), "estimate"))
        shapes.append(svg.circle(axes.at(xk, mean), 2.0, "bad-dot" if bad else "estimate-dot"))
    steps = [p for xk, b in zip(x, field.lower_bounds) for p in (axes.at(xk - half, b), axes.at(xk + half, b))]
    shapes.append(svg.polyline(steps, "bound"))
    return svg.picture(axes, shapes, "Certified bound and rollouts along a line of starts")


def _map(
    field: FieldReport,
    shown: tuple[int, ...],
    names: list[str],
    styles: list[str],
    roles: list[str] | None,
    scaled: bool,
    odds: OddsScale | None = None,
) -> str:
    """Draw a cell per start, its numbers as a hint; refuted cells stand out, confirmed ones carry a dot.

    Parameters
    ----------
    field : FieldReport
        Tests at the points of a grid.
    shown : tuple of int
        Joint coordinates of the map.
    names : list of str
        Their names.
    styles : list of str
        Style of each cell that is not refuted.
    roles : list of str or None
        Role of each such cell; None for a map of bounds.
    scaled : bool
        Whether both axes have one scale.
    odds : OddsScale, optional
        What the colour of a map of bounds says.
    """
    # Starts are centres of equal cells: half a spacing around them, the cells tile the map.
    x, y = (np.unique(field.states[:, k]) for k in shown)
    half = [0.5 * (v[1] - v[0]) if len(v) > 1 else 0.5 for v in (x, y)]
    low, high = (x[0] - half[0], y[0] - half[1]), (x[-1] + half[0], y[-1] + half[1])
    axes = Axes((float(low[0]), float(low[1])), (float(high[0]), float(high[1])), height=330.0)
    if scaled:
        axes = _in_scale(axes, float((high[1] - low[1]) / (high[0] - low[0])))
    shapes = []
    for k, state in enumerate(field.states):
        a, b, bad = state[shown[0]], state[shown[1]], field.refuted[k]
        hint = (
            f"({svg.number(a)}, {svg.number(b)}): bound {rounded_down(field.lower_bounds[k], 4)}, "
            f"rollouts {field.estimates[k]:.4f} [{field.ci_low[k]:.4f}, {field.ci_high[k]:.4f}]"
            f"{', refuted' if bad else ''}"
        )
        corner, opposite = axes.at(a - half[0], b - half[1]), axes.at(a + half[0], b + half[1])
        role = "bad-cell" if bad else "cell" if roles is None else roles[k]
        shapes.append(svg.rectangle(corner, opposite, role, hint, "" if bad else styles[k]))
        if not bad and roles is None and field.confirmed[k]:
            shapes.append(svg.circle(axes.at(a, b), 1.3, "sure-dot"))
    # Grid lines would cross the cells.
    frame = svg.frame(axes, f"start of {names[0]}", f"start of {names[1]}")
    shapes += [shape for shape in frame if '"grid"' not in shape]
    if odds is None:
        return svg.picture(axes, shapes, "A map of starts")
    taller = replace(axes, height=axes.height + BAR_ROOM)
    return svg.picture(taller, [*shapes, *color_bar(odds, axes)], "A map of starts")


def color_bar(odds: OddsScale, axes: Axes) -> list[str]:
    """Draw what the colours of a map of bounds say, below its axes."""
    left, width = axes.left, axes.width - axes.left - axes.right
    top, step = axes.height + 2.0, width / SHADES
    shapes = [
        svg.rectangle(
            (left + k * step, top),
            (left + (k + 1) * step + 0.3, top + 8.0),
            "cell",
            style=f"fill-opacity:{0.06 + 0.94 * (k + 0.5) / SHADES:.3f}",
        )
        for k in range(SHADES)
    ]
    places = [(name, odds.at(p)) for name, p in odds.ticks]
    roles = ["tick end" if at > NEAR_END else "tick middle" for _, at in places]
    return shapes + [svg.text(left + at * width, top + 18.0, name, role) for (name, at), role in zip(places, roles)]


def _in_scale(axes: Axes, proportion: float) -> Axes:
    """Return the axes of a map with another height by width of the plot."""
    room = axes.width - axes.left - axes.right
    width = min(room, MOST_HIGH / proportion)
    height = axes.top + width * proportion + axes.bottom
    return replace(axes, height=height, right=axes.right + room - width)


def panel_axes(panel: Panel, horizon: int) -> Axes:
    """Return the axes of a panel: a map, or one coordinate over time."""
    if panel.is_map:
        axes = Axes((panel.low[0], panel.low[1]), (panel.high[0], panel.high[1]), height=330.0)
        return axes if panel.proportion is None else _in_scale(axes, panel.proportion)
    return Axes((0.0, panel.low[0]), (float(horizon), panel.high[0]))


def _axis_names(panel: Panel) -> tuple[str, str]:
    """Return what both axes of a panel are called."""
    return panel.names[0] if panel.is_map else "control step", panel.names[-1]


def tracks(panel: Panel, axes: Axes, states: NDArray[Any]) -> list[list[list[tuple[float, float]]]]:
    """Return picture points of paths (T + 1, M, D), per curve and episode, up to the decision.

    States outside the workspace are drawn on its edge.
    """
    result = []
    for curve in panel.curves:
        track = np.clip(states @ curve.rows.T, panel.low, panel.high)
        going = ~np.isnan(track).any(axis=2)
        episodes = [track[going[:, m], m].tolist() for m in range(states.shape[1])]
        points = [[axes.at(*p) if panel.is_map else axes.at(t, p[0]) for t, p in enumerate(path)] for path in episodes]
        result.append(points)
    return result


def rollouts_picture(
    panel: Panel,
    states: NDArray[Any],
    success: NDArray[np.bool_],
    number: int = 0,
    tubes: Mapping[int, Tube] | None = None,
) -> str:
    """Draw paths (T + 1, M, D) of episodes over the regions of a panel; failed episodes are broken lines.

    Below them come tubes, by the numbers of their curves.

    The last group is empty: the player of the page draws one episode into it, by the panel's ``number``.
    """
    axes = panel_axes(panel, len(states) - 1)
    shapes = svg.frame(axes, *_axis_names(panel), whole=not panel.is_map)
    shapes += [_region(axes, r, panel.is_map, len(states) - 1) for r in panel.drawn]
    shapes += _region_names(axes, panel)
    for curve in panel.curves:
        if tubes and curve.number in tubes:
            shapes += _tube(panel, axes, tubes[curve.number], f"tube agent{curve.number % len(AGENTS)}")
    shapes.append('<g class="all">')
    for curve, episodes in zip(panel.curves, tracks(panel, axes, states)):
        for m, (points, good) in enumerate(zip(episodes, success)):
            role = f"path agent{curve.number % len(AGENTS)} {'good' if good else 'lost'}"
            shapes.append(svg.polyline(points, role))
            shapes.append(_end(curve, points[-1], states[len(points) - 1, m], f"end {role}"))
    shapes.append(f'</g><g class="one" data-panel="{number}"></g>')
    return svg.picture(axes, shapes, f"Rollouts of {', '.join(curve.name for curve in panel.curves)} over the regions")


def _end(curve: Curve, at: tuple[float, float], state: NDArray[Any], role: str) -> str:
    """Return the mark at the end of a path: a dot, or an arrow where the agent has a heading."""
    arrow = curve.arrow(state)
    if arrow is None:
        return svg.circle(at, 2.0, role)
    return svg.polygon([(at[0] + 4.0 * a, at[1] - 4.0 * b) for a, b in arrow.tolist()], role)


def empty_panel(panel: Panel, horizon: int, number: int, tubes: Mapping[int, Tube] | None = None) -> str:
    """Draw the regions of a panel, and a group into which the explorer of the page draws episodes.

    Tubes, by the numbers of their curves, are in a group that is shown while the ring is at the certificate's start.
    """
    axes = panel_axes(panel, horizon)
    shapes = svg.frame(axes, *_axis_names(panel), whole=not panel.is_map)
    shapes += [_region(axes, r, panel.is_map, horizon) for r in panel.drawn]
    drawn = [
        _tube(panel, axes, tubes[c.number], f"tube agent{c.number % len(AGENTS)}")
        for c in panel.curves
        if tubes and c.number in tubes
    ]
    if drawn:
        shapes += ['<g class="x-tube">', *(shape for tube in drawn for shape in tube), "</g>"]
    shapes += [*_region_names(axes, panel), f'<g class="x-paths" data-panel="{number}"></g>']
    return svg.picture(axes, shapes, "Episodes from the chosen start")


def _tube(panel: Panel, axes: Axes, tube: Tube, role: str) -> list[str]:
    """Draw the tube along a nominal path: a band over time, or an ellipse for each time on a map; none at a point."""
    if panel.is_map:
        outlines = np.clip(tube.outlines(), panel.low, panel.high)
        return [svg.polygon([axes.at(x, y) for x, y in outline.tolist()], role) for outline in outlines[1:]]
    half = tube.half_widths()
    low, high = (np.clip(tube.middle + side * half, panel.low, panel.high)[:, 0].tolist() for side in (-1.0, 1.0))
    edge = [*enumerate(high), *reversed([*enumerate(low)])]
    return [svg.polygon([axes.at(float(t), x) for t, x in edge], role)]


def _region(axes: Axes, region: Region, is_map: bool, horizon: int) -> str:
    if is_map and region.outline is not None:
        fills, edges = ([[axes.at(*point) for point in own.tolist()] for own in part] for part in region.polygons)
        return svg.outlined(fills, edges, f"region r-{region.role}", region.name)
    first, last = region.span(horizon)
    low, high = (region.low, region.high) if is_map else ((first, region.low[0]), (last, region.high[0]))
    return svg.rectangle(axes.at(low[0], low[1]), axes.at(high[0], high[1]), f"region r-{region.role}", region.name)


def _region_names(axes: Axes, panel: Panel) -> list[str]:
    """Write the name of each region at a corner where it covers no other name; regions too small for it get none."""
    shapes: list[str] = []
    taken: list[tuple[float, float, float]] = []
    horizon_end = axes.high[0]
    for region in sorted(panel.named, key=lambda r: r.high[0] - r.low[0]):
        low, high = (region.low, region.high) if panel.is_map else ((0.0, region.low[0]), (horizon_end, region.high[0]))
        (left, bottom), (right, top) = axes.at(low[0], low[1]), axes.at(high[0], high[1])
        width = 5.2 * len(region.name) + 4.0
        spots = [(left + 3, top + 10), (left + 3, bottom - 3), (right - width, top + 10), (right - width, bottom - 3)]
        inside = [(x, y) for x, y in spots if x + width <= axes.width and bottom - top >= 11]
        free = [
            (x, y)
            for x, y in inside
            if all(y0 - y >= 10 or y - y0 >= 10 or x >= x0 + w or x0 >= x + width for x0, y0, w in taken)
        ]
        if free:
            taken.append((*free[0], width))
            shapes.append(svg.text(*free[0], region.name, "region-name"))
    return shapes


def automaton_picture(automaton: Automaton, transitions: Sequence[Any]) -> str:
    """Draw the states where ``places`` puts them, and the transitions that ``edges`` lists as arrows without guards.

    As in the other drawings of automata, arrows to dead states are left out if there are more than a few states.
    """
    spots = places(automaton, transitions)
    width, height = (max(spot[axis] for spot in spots.values()) + 60.0 for axis in (0, 1))
    axes = Axes((0.0, 0.0), (1.0, 1.0), width, height)
    shapes = [
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path class="tip" d="M0,0 L8,4 L0,8 z"/></marker></defs>'
    ]
    few = automaton.n_states <= FEW_STATES
    shapes += [_arrow(spots[e.source], spots[e.target]) for e in transitions if few or not automaton.dead[e.target]]
    # The arrow from nowhere marks the initial state.
    x, y = spots[automaton.initial]
    shapes.append(_path(f"M{x - RADIUS - 26:.1f},{y:.1f} L{x - RADIUS - 1:.1f},{y:.1f}"))
    for q, (x, y) in spots.items():
        role = "accepting" if automaton.accepting[q] else "dead" if automaton.dead[q] else "state"
        shapes.append(svg.circle((x, y), RADIUS, f"{role} state{q}"))
        shapes += [svg.circle((x, y), RADIUS - 4, role)] if automaton.accepting[q] else []
        # Short names stand in the circle, long ones below it.
        name = automaton.state_names[q]
        shapes.append(svg.text(x, y + 4 if len(name) <= 4 else y + RADIUS + 13, name, "state-name middle"))
    return svg.picture(axes, shapes, "Task automaton")


def _arrow(a: tuple[float, float], b: tuple[float, float]) -> str:
    """Draw an arrow between the circles of two states, or a loop over one."""
    if a == b:
        x, y = a
        top, side = y - RADIUS - 30.0, 18.0
        loop = f"C{x - side:.1f},{top:.1f} {x + side:.1f},{top:.1f} {x + 8:.1f},{y - RADIUS + 1:.1f}"
        return _path(f"M{x - 8:.1f},{y - RADIUS + 2:.1f} {loop}")
    # A bend to one side keeps arrows there and back apart.
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.hypot(dx, dy)
    ux, uy = dx / length, dy / length
    bend, gap = 0.16 * length, RADIUS + 2.0
    start, end = (a[0] + RADIUS * ux, a[1] + RADIUS * uy), (b[0] - gap * ux, b[1] - gap * uy)
    middle = (0.5 * (a[0] + b[0]) - bend * uy, 0.5 * (a[1] + b[1]) + bend * ux)
    return _path(f"M{start[0]:.1f},{start[1]:.1f} Q{middle[0]:.1f},{middle[1]:.1f} {end[0]:.1f},{end[1]:.1f}")


def _path(shape: str) -> str:
    """Return an arrow along a path."""
    return f'<path class="arrow" marker-end="url(#tip)" d="{shape}"/>'
