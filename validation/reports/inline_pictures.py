"""The drawings of a report: bound against horizon, map of margins, rollouts over the regions, automaton."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.logic import Automaton
from ...envs.pictures import Panel, coordinate_name
from ...envs.problem import Problem
from ...synthesis.certificates import rounded_down
from ..verdicts import FieldReport
from . import svg
from .svg import Axes


def bound_curve(bounds: NDArray[Any], estimate: tuple[float, float, float] | None) -> str:
    """Bounds against the number of steps played; ``estimate`` with its limits is marked at the full horizon."""
    horizon = len(bounds)
    axes = Axes((0.0, 0.0), (float(horizon), 1.0))
    points = [axes.at(k + 1, float(b)) for k, b in enumerate(bounds)]
    parts = svg.frame(axes, "control steps played", "probability", whole=True)
    parts.append(svg.polyline(points, "bound"))
    parts += [svg.circle(point, 2.2, "bound-dot") for point in points] if horizon <= 60 else []
    if estimate is not None:
        middle, low, high = estimate
        parts.append(svg.line(axes.at(horizon, low), axes.at(horizon, high), "estimate"))
        parts.append(svg.circle(axes.at(horizon, middle), 3.2, "estimate-dot"))
    return svg.picture(axes, parts, "Certified bound against the number of steps")


def margin_pictures(problem: Problem, field: FieldReport, axes_shown: tuple[int, ...]) -> dict[str, str]:
    """Claims, estimates and limits along a line; or two maps, of the bounds and of the margins."""
    names = [coordinate_name(problem, k) for k in axes_shown]
    if len(names) == 1:
        return {"Bound and rollouts along a line": _margin_line(field, axes_shown[0], names[0])}
    scale = float(np.max(np.abs(field.margins), initial=1e-9))
    bound = _map(field, axes_shown, names, [f"fill-opacity:{0.06 + 0.94 * b:.3f}" for b in field.lower_bounds], None)
    roles = np.where(field.margins < 0, "under", "over").tolist()
    margin = _map(field, axes_shown, names, [f"fill-opacity:{abs(m) / scale:.3f}" for m in field.margins], roles)
    return {"Bound over a map of starts": bound, f"Rollouts minus bound (up to {scale:.2g})": margin}


def _margin_line(field: FieldReport, axis: int, name: str) -> str:
    x = field.states[:, axis]
    half = 0.5 * (x[1] - x[0]) if len(x) > 1 else 0.5
    axes = Axes((float(x[0] - half), 0.0), (float(x[-1] + half), 1.0))
    parts = svg.frame(axes, f"start of {name}", "probability")
    for xk, low, high, mean, bad in zip(x, field.ci_low, field.ci_high, field.estimates, field.refuted):
        parts.append(svg.line(axes.at(xk, low), axes.at(xk, high), "estimate"))
        parts.append(svg.circle(axes.at(xk, mean), 2.0, "bad-dot" if bad else "estimate-dot"))
    steps = [p for xk, b in zip(x, field.lower_bounds) for p in (axes.at(xk - half, b), axes.at(xk + half, b))]
    parts.append(svg.polyline(steps, "bound"))
    return svg.picture(axes, parts, "Certified bound and rollouts along a line of starts")


def _map(
    field: FieldReport, shown: tuple[int, ...], names: list[str], styles: list[str], roles: list[str] | None
) -> str:
    """A cell per start, with its figures as a hint; refuted ones stand out, confirmed ones carry a dot."""
    x, y = (np.unique(field.states[:, k]) for k in shown)
    half = [0.5 * (v[1] - v[0]) if len(v) > 1 else 0.5 for v in (x, y)]
    axes = Axes(
        (float(x[0] - half[0]), float(y[0] - half[1])), (float(x[-1] + half[0]), float(y[-1] + half[1])), height=330.0
    )
    parts = []
    for k, state in enumerate(field.states):
        a, b, bad = state[shown[0]], state[shown[1]], field.refuted[k]
        hint = (
            f"({svg.number(a)}, {svg.number(b)}): bound {rounded_down(field.lower_bounds[k], 4)}, "
            f"rollouts {field.estimates[k]:.4f} [{field.ci_low[k]:.4f}, {field.ci_high[k]:.4f}]"
            f"{', refuted' if bad else ''}"
        )
        corner, other = axes.at(a - half[0], b - half[1]), axes.at(a + half[0], b + half[1])
        role = "bad-cell" if bad else "cell" if roles is None else roles[k]
        parts.append(svg.rectangle(corner, other, role, hint, "" if bad else styles[k]))
        if not bad and roles is None and field.confirmed[k]:
            parts.append(svg.circle(axes.at(a, b), 1.3, "sure-dot"))
    parts += [p for p in svg.frame(axes, f"start of {names[0]}", f"start of {names[1]}") if '"grid"' not in p]
    return svg.picture(axes, parts, "A map of starts")


def rollouts_picture(panel: Panel, states: NDArray[Any], success: NDArray[np.bool_]) -> str:
    """Paths (T + 1, M, D) of episodes over the regions of a panel."""
    horizon = len(states) - 1
    if panel.is_map:
        axes = Axes((panel.low[0], panel.low[1]), (panel.high[0], panel.high[1]), height=330.0)
        parts = svg.frame(axes, "first coordinate", "second coordinate")
    else:
        axes = Axes((0.0, panel.low[0]), (float(horizon), panel.high[0]))
        parts = svg.frame(axes, "control step", "position", whole=True)
    for r in panel.regions:
        low, high = (r.low, r.high) if panel.is_map else ((0.0, r.low[0]), (float(horizon), r.high[0]))
        a, b = axes.at(low[0], low[1]), axes.at(high[0], high[1])
        parts.append(svg.rectangle(a, b, "region", r.name))
        parts.append(svg.text(min(a[0], b[0]) + 3, min(a[1], b[1]) + 10, r.name, "region-name"))
    for curve in panel.curves:
        track = states @ curve.rows.T
        for m in range(states.shape[1]):
            here = track[~np.isnan(track[:, m]).any(axis=1), m]
            here = np.clip(here, panel.low, panel.high)
            points = [axes.at(*p) if panel.is_map else axes.at(t, p[0]) for t, p in enumerate(here)]
            role = f"path agent{curve.number % 6} {'good' if success[m] else 'lost'}"
            parts += [svg.polyline(points, role), svg.circle(points[-1], 2.0, f"end {role}")]
    names = ", ".join(curve.name for curve in panel.curves)
    return svg.picture(axes, parts, f"Rollouts of {names} over the regions")


def automaton_picture(automaton: Automaton, most: int = 30) -> str:
    """States as circles in layers by their distance from the initial one, transitions as arrows; guards are left out.

    Automata of more than ``most`` states give an empty string.
    """
    if automaton.n_states > most:
        return ""
    manager, roots = automaton.diagrams()
    targets = [sorted(manager.leaves(root)) for root in roots]
    place = _layers(automaton.initial, targets)
    height = 60.0 + 62.0 * max(sum(1 for x, _ in place.values() if x == column) for column, _ in place.values())
    axes = Axes((0.0, 0.0), (1.0, 1.0), height=height)
    columns = 1 + max(x for x, _ in place.values())
    at = {q: (30.0 + 300.0 * (x + 0.5) / columns, 40.0 + 62.0 * y) for q, (x, y) in place.items()}
    parts = [
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path class="tip" d="M0,0 L8,4 L0,8 z"/></marker></defs>'
    ]
    for q, own in enumerate(targets):
        parts += [_arrow(at[q], at[p]) for p in own if q in at and p in at]
    first = at[automaton.initial]
    parts.append(_path(f"M{first[0] - 34:.1f},{first[1]:.1f} L{first[0] - 15:.1f},{first[1]:.1f}"))
    for q, (x, y) in at.items():
        role = "accepting" if automaton.accepting[q] else "dead" if automaton.dead[q] else "state"
        parts.append(svg.circle((x, y), 14, role))
        parts += [svg.circle((x, y), 11, role)] if automaton.accepting[q] else []
        parts.append(svg.text(x, y + 3.5, automaton.state_names[q][:6], "state-name middle"))
    return svg.picture(axes, parts, "Task automaton")


def _layers(initial: int, targets: list[list[int]]) -> dict[int, tuple[int, int]]:
    """Column and row of every state that can be reached."""
    place, layer, column = {initial: (0, 0)}, [initial], 0
    while layer:
        column += 1
        layer = sorted({p for q in layer for p in targets[q]} - set(place))
        place |= {q: (column, row) for row, q in enumerate(layer)}
    return place


def _arrow(a: tuple[float, float], b: tuple[float, float]) -> str:
    if a == b:
        x, y = a
        return _path(f"M{x - 6:.1f},{y - 13:.1f} C{x - 18:.1f},{y - 38:.1f} {x + 18:.1f},{y - 38:.1f} "
                     f"{x + 6:.1f},{y - 14:.1f}")  # fmt: skip
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.hypot(dx, dy)
    ux, uy = dx / length, dy / length
    bend = 0.16 * length
    start, end = (a[0] + 14 * ux, a[1] + 14 * uy), (b[0] - 16 * ux, b[1] - 16 * uy)
    middle = (0.5 * (a[0] + b[0]) - bend * uy, 0.5 * (a[1] + b[1]) + bend * ux)
    return _path(f"M{start[0]:.1f},{start[1]:.1f} Q{middle[0]:.1f},{middle[1]:.1f} {end[0]:.1f},{end[1]:.1f}")


def _path(shape: str) -> str:
    return f'<path class="arrow" marker-end="url(#tip)" d="{shape}"/>'
