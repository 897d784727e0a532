"""Task automata as text and as SVG, for pages and figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from itertools import islice

from ..tasks.automata import Automaton, letter_text
from .guard_texts import Edge

_DOT_CUBES = 200  # cubes of a state that Graphviz pictures show

# With few states, columns show the progress of the task and numbers on edges lead to a table; with many, both overlap.
_LAYERED = 5  # states up to which they stand in columns; more stand in a circle, without edges to dead states
_LABELLED = 9  # states up to which edges carry their numbers

_RADIUS, _STEP_X, _STEP_Y = 20, 130, 84  # pixels: radius of a state, distances of columns and of rows


def svg(automaton: Automaton, drawn: Sequence[Edge]) -> str:
    """Return a picture: states in columns by their distance from the initial one, edges numbered from 1."""
    spots = places(automaton, drawn)
    width = max(x for x, _ in spots.values()) + 70
    height = max(y for _, y in spots.values()) + 60
    elements = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}" '
        f'height="{height:g}" font-family="sans-serif" font-size="12">',
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
    ]
    # The arrow from nowhere marks the initial state.
    x, y = spots[automaton.initial]
    elements.append(_path(f"M{x - 48:g} {y:g}L{x - _RADIUS:g} {y:g}", (x - _RADIUS, y), (x - 48, y)))
    elements += _drawn_edges(automaton, drawn, spots)
    for q, spot in spots.items():
        stroke, fill = ("#aab", "#f4f4f6") if automaton.dead[q] else ("#223", "white")
        circle = '<circle cx="{:g}" cy="{:g}" r="{:g}" fill="{}" stroke="{}"/>'
        elements.append(circle.format(*spot, _RADIUS, fill, stroke))
        if automaton.accepting[q]:
            elements.append(circle.format(*spot, _RADIUS - 4, fill, stroke))
        # Short names stand in the circle, long ones below it.
        name = automaton.state_names[q]
        short = len(name) <= 4
        elements.append(_text(spot if short else (spot[0], spot[1] + _RADIUS + 12), name, "#223"))
    return "\n".join([*elements, "</svg>", ""])


def _drawn_edges(automaton: Automaton, drawn: Sequence[Edge], spots: Mapping[int, tuple[float, float]]) -> list[str]:
    """Return the arrows, and after all of them their numbers, so that no arrow covers a number."""
    labelled = automaton.n_states <= _LABELLED
    pairs = {(edge.source, edge.target) for edge in drawn}
    curves, numbers = [], []
    for number, edge in enumerate(drawn, 1):
        if automaton.n_states > _LAYERED and automaton.dead[edge.target]:
            continue
        if not labelled and edge.source == edge.target:
            continue
        curve, spot = _curve(spots[edge.source], spots[edge.target], (edge.target, edge.source) in pairs)
        curves.append(curve)
        if labelled:
            numbers.append(_text(spot, str(number), "#a33", halo=True))
    return curves + numbers


def places(automaton: Automaton, drawn: Sequence[Edge]) -> dict[int, tuple[float, float]]:
    """Return the centre of each state: few stand in breadth-first columns, many in a circle from the initial one on.

    Dead states stand in the last column.
    """
    # Breadth first from the initial state; then states that no edge leads to, and the dead ones last.
    order = [automaton.initial]
    column = {automaton.initial: 0}
    for q in order:
        for edge in drawn:
            if edge.source == q and edge.target not in column:
                column[edge.target] = column[q] + 1
                order.append(edge.target)
    order += [q for q in range(automaton.n_states) if q not in column]
    order.sort(key=lambda q: bool(automaton.dead[q]) and q != automaton.initial)
    if automaton.n_states > _LAYERED:
        radius = 11.5 * automaton.n_states + 30.0
        angles = [math.pi + 2.0 * math.pi * k / len(order) for k in range(len(order))]
        center = radius + 80.0
        return {q: (center + radius * math.cos(t), center - 20.0 + radius * math.sin(t)) for q, t in zip(order, angles)}
    last = max(column.values())
    rows: dict[int, int] = {}
    centers = {}
    for q in order:
        c = last if automaton.dead[q] and q != automaton.initial else column.get(q, 0)
        row = rows.get(c, 0)
        rows[c] = row + 1
        centers[q] = (70.0 + _STEP_X * c, 64.0 + _STEP_Y * row + 14.0 * (c % 2))  # every other column is set lower
    return centers


def _curve(start: tuple[float, float], end: tuple[float, float], both_ways: bool) -> tuple[str, tuple[float, float]]:
    """Return an arrow from circle to circle, and the place of its number."""
    (x0, y0), (x1, y1) = start, end
    if start == end:
        top = y0 - _RADIUS
        loop = f"M{x0 - 8:g} {top + 2:g}C{x0 - 26:g} {top - 30:g} {x0 + 26:g} {top - 30:g} {x0 + 8:g} {top + 2:g}"
        return _path(loop, (x0 + 8.0, top + 2.0), (x0 + 15.0, top - 12.0)), (x0, top - 21)
    # A quadratic curve whose control point lies beside the middle: arrows there and back part clearly.
    length = math.hypot(x1 - x0, y1 - y0)
    bend = 26.0 if both_ways else 10.0
    across = (-(y1 - y0) / length, (x1 - x0) / length)
    middle = ((x0 + x1) / 2 - across[0] * bend, (y0 + y1) / 2 - across[1] * bend)
    first, last = _towards(start, middle), _towards(end, middle)
    weights = (0.36, 0.48, 0.16)  # of the three points of a quadratic curve at 0.4 of its way
    spot = tuple(weights[0] * a + weights[1] * m + weights[2] * b for a, m, b in zip(first, middle, last))
    curve = f"M{first[0]:.1f} {first[1]:.1f}Q{middle[0]:.1f} {middle[1]:.1f} {last[0]:.1f} {last[1]:.1f}"
    return _path(curve, last, middle), (spot[0], spot[1])


def _towards(center: tuple[float, float], point: tuple[float, float]) -> tuple[float, float]:
    """Return the point of the circle around a state that is closest to another point."""
    length = math.hypot(point[0] - center[0], point[1] - center[1])
    return center[0] + (point[0] - center[0]) * _RADIUS / length, center[1] + (point[1] - center[1]) * _RADIUS / length


def _path(curve: str, tip: tuple[float, float], origin: tuple[float, float]) -> str:
    """Return a line with an arrow head at `tip`, which points away from `origin`."""
    length = math.hypot(tip[0] - origin[0], tip[1] - origin[1])
    x, y = (tip[0] - origin[0]) / length, (tip[1] - origin[1]) / length
    left, right = (-9 * x + 3.5 * y, -9 * y - 3.5 * x), (-9 * x - 3.5 * y, -9 * y + 3.5 * x)
    head = " ".join(f"{tip[0] + a:.1f},{tip[1] + b:.1f}" for a, b in ((0.0, 0.0), left, right))
    return f'<path d="{curve}" fill="none" stroke="#556"/><polygon points="{head}" fill="#556"/>'


def _text(spot: tuple[float, float], text: str, color: str, halo: bool = False) -> str:
    place = f'x="{spot[0]:.1f}" y="{spot[1] + 4:.1f}" text-anchor="middle"'
    behind = f'<text {place} stroke="white" stroke-width="4">{escape(text)}</text>' if halo else ""
    return f'{behind}<text {place} fill="{color}">{escape(text)}</text>'


def automaton_to_dot(automaton: Automaton) -> str:
    """Return a Graphviz picture: accepting states have a double circle, edges carry their guards.

    Long guards end in an ellipsis; the edges themselves are complete.
    """
    manager, roots = automaton.diagrams()
    lines = ["digraph automaton {", "  rankdir=LR;", '  start [shape=point, label=""];']
    for q, name in enumerate(automaton.state_names):
        shape = "doublecircle" if automaton.accepting[q] else "circle"
        lines.append(f"  {q} [shape={shape}, label={_quoted(name)}];")
    lines.append(f"  start -> {automaton.initial};")
    for q, root in enumerate(roots):
        cubes: dict[int, list[str]] = {target: [] for target in manager.leaves(root)}
        # One path more than is shown tells whether any is left out.
        paths = list(islice(manager.paths(root), _DOT_CUBES + 1))
        for assignment, target in paths[:_DOT_CUBES]:
            cubes[target].append(letter_text(assignment, automaton.propositions) if assignment else "true")
        for target, texts in cubes.items():
            label = " | ".join(texts if len(paths) <= _DOT_CUBES else [*texts, "..."])
            lines.append(f"  {q} -> {target} [label={_quoted(label)}];")
    return "\n".join([*lines, "}", ""])


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
