"""The drawings of a report: bound against horizon, maps of bounds and margins, rollouts over the regions, automaton."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.logic import Automaton
from ...envs.pictures import Panel, coordinate_name, places
from ...envs.problem import Problem
from ...synthesis.certificates import rounded_down
from ..verdicts import FieldReport
from . import svg
from .svg import Axes

MOST_DOTS = 60
"""Horizon up to which every bound of a curve has a dot."""

FEW_STATES = 5
"""Automaton states up to which arrows to dead states are drawn; with more they would cover the others."""

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


def margin_pictures(problem: Problem, field: FieldReport, axes_shown: tuple[int, ...]) -> dict[str, str]:
    """Draw claims, estimates and limits along a line, or two maps, of bounds and of margins; return them by title."""
    names = [coordinate_name(problem, k) for k in axes_shown]
    if len(names) == 1:
        return {"Bound and rollouts along a line": _margin_line(field, axes_shown[0], names[0])}
    # The stronger the colour, the larger the bound, or the margin relative to the largest one.
    scale = float(np.max(np.abs(field.margins), initial=1e-9))
    bound = _map(field, axes_shown, names, [f"fill-opacity:{0.06 + 0.94 * b:.3f}" for b in field.lower_bounds], None)
    roles = np.where(field.margins < 0, "under", "over").tolist()
    margin = _map(field, axes_shown, names, [f"fill-opacity:{abs(m) / scale:.3f}" for m in field.margins], roles)
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
    field: FieldReport, shown: tuple[int, ...], names: list[str], styles: list[str], roles: list[str] | None
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
    """
    # Starts are centres of equal cells: half a spacing around them, the cells tile the map.
    x, y = (np.unique(field.states[:, k]) for k in shown)
    half = [0.5 * (v[1] - v[0]) if len(v) > 1 else 0.5 for v in (x, y)]
    axes = Axes(
        (float(x[0] - half[0]), float(y[0] - half[1])), (float(x[-1] + half[0]), float(y[-1] + half[1])), height=330.0
    )
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
    return svg.picture(axes, shapes, "A map of starts")


def rollouts_picture(panel: Panel, states: NDArray[Any], success: NDArray[np.bool_]) -> str:
    """Draw paths (T + 1, M, D) of episodes over the regions of a panel; failed episodes are broken lines."""
    horizon = len(states) - 1
    if panel.is_map:
        axes = Axes((panel.low[0], panel.low[1]), (panel.high[0], panel.high[1]), height=330.0)
        shapes = svg.frame(axes, "first coordinate", "second coordinate")
    else:
        axes = Axes((0.0, panel.low[0]), (float(horizon), panel.high[0]))
        shapes = svg.frame(axes, "control step", "position", whole=True)
    for r in panel.regions:
        low, high = (r.low, r.high) if panel.is_map else ((0.0, r.low[0]), (float(horizon), r.high[0]))
        a, b = axes.at(low[0], low[1]), axes.at(high[0], high[1])
        shapes.append(svg.rectangle(a, b, "region", r.name))
        shapes.append(svg.text(min(a[0], b[0]) + 3, min(a[1], b[1]) + 10, r.name, "region-name"))
    for curve in panel.curves:
        track = states @ curve.rows.T
        for m in range(states.shape[1]):
            # States are NaN after the decision; those outside the workspace are drawn on its edge.
            here = track[~np.isnan(track[:, m]).any(axis=1), m]
            here = np.clip(here, panel.low, panel.high)
            points = [axes.at(*p) if panel.is_map else axes.at(t, p[0]) for t, p in enumerate(here)]
            role = f"path agent{curve.number % 6} {'good' if success[m] else 'lost'}"
            shapes += [svg.polyline(points, role), svg.circle(points[-1], 2.0, f"end {role}")]
    names = ", ".join(curve.name for curve in panel.curves)
    return svg.picture(axes, shapes, f"Rollouts of {names} over the regions")


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
        shapes.append(svg.circle((x, y), RADIUS, role))
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
