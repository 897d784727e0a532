"""Outlines of regions of any shape on the axes of a panel: polygons to fill, and edges. Data; nothing is drawn here.

A piece is convex, so that its part on a map is the map cut by half-planes and discs. A union is filled
part by part, and of a complement the hole is cut out. A limit on states that the panel does not show says nothing:
what is drawn of a ball is its shadow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..systems.agents import AnyAgent
from ..tasks.automata import Formula
from ..tasks.problem import Problem
from ..tasks.regions import Form, Piece, Proposition

ROUND = 96
"""Corners of the polygon that stands for a disc."""

MOST_TERMS = 64
"""Terms of a combination of shapes that are drawn: beyond them nothing is."""

Polygon = np.ndarray
"""Corners (n, 2), counter-clockwise."""


@dataclass(frozen=True, eq=False)
class Outline:
    """A region on a map: polygons (n, 2) to fill, each with holes cut in along a line, and closed edges (n, 2)."""

    fill: tuple[Polygon, ...]
    edges: tuple[Polygon, ...]

    @property
    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner of the box around it."""
        points = np.concatenate(self.fill)
        return points.min(axis=0), points.max(axis=0)


Literal = tuple[bool, str]


class Drawer:
    """What the regions of one agent look like on one or two of its states.

    Parameters
    ----------
    problem : Problem
    axes : sequence of int
        The states shown.
    low, high : np.ndarray
        Ends of the panel.
    """

    def __init__(self, problem: Problem, agent: int, axes: Sequence[int], low: np.ndarray, high: np.ndarray) -> None:
        self._problem, self._agent = problem, problem.agents[agent]
        self._axes, self._low, self._high = tuple(axes), low, high

    def outline(self, name: str, time: int) -> Outline | None:
        """Return a proposition on a map at a time; None where it is nowhere, or says nothing about the map."""
        fill, edges = list[Polygon](), list[Polygon]()
        for term in self._terms(name):
            whole = self._cut(self._frame(), [part for sign, part in term if sign], time)
            if whole is None or not len(whole):
                continue
            holes = [self._cut(whole, [part], time) for sign, part in term if not sign]
            known = [hole for hole in holes if hole is not None and len(hole)]
            if not any(sign for sign, _ in term) and not known:
                continue
            filled = whole
            for hole in known:
                filled = _with_hole(filled, hole)
            fill.append(filled)
            edges += [whole, *known] if any(sign for sign, _ in term) else known
        return Outline(tuple(fill), tuple(edges)) if fill else None

    def spans(self, name: str, time: int) -> list[tuple[float, float]]:
        """Return the intervals of a proposition along one axis at a time, in order; none where it says nothing."""
        ends = float(self._low[0]), float(self._high[0])
        found = list[tuple[float, float]]()
        for term in self._terms(name):
            own = [ends]
            for sign, part in term:
                span = self._span(part, time)
                if span is not None:
                    own = [cut for a, b in own for cut in _less_or_within(a, b, span, sign)]
            found += own
        return [] if found == [ends] else sorted(found)

    def _terms(self, name: str) -> list[list[Literal]]:
        meaning = self._problem.meanings.get(name, Formula("atom", name=name))
        terms = terms_of(meaning, True)
        return terms if len(terms) <= MOST_TERMS else []

    def _frame(self) -> Polygon:
        (a, c), (b, d) = self._low[:2], self._high[:2]
        return np.array([(a, c), (b, c), (b, d), (a, d)], dtype=float)

    def _cut(self, polygon: Polygon, names: list[str], time: int) -> Polygon | None:
        """Return the part of a convex polygon in all of some boxes; None if one says nothing about the map."""
        for name in names:
            limits = self._limits(name, time)
            if limits is None:
                return None
            for normal, offset in limits:
                polygon = _clipped(polygon, normal, offset)
        return polygon

    def _limits(self, name: str, time: int) -> list[tuple[np.ndarray, float]] | None:
        """Return half-planes `normal @ y <= offset` that cut out a box; None if none is about what is shown."""
        piece = self._problem.pieces.get(name)
        found = list(self._of_piece(piece.at(time)) if piece is not None else self._of_box(name, time))
        return found or None

    def _of_box(self, name: str, time: int) -> Iterator[tuple[np.ndarray, float]]:
        region = self._problem.propositions[name]
        assert isinstance(region, Proposition)
        region, sides = region.at(time), list[tuple[np.ndarray, float]]()
        for k in limited_outputs(self._agent, region.low, region.high):
            if (straight := self._agent.straight_output(k)) is None:
                return  # what is left without a limit that bends is more than the region
            row, offset = straight
            own = row[[*self._axes]]
            if np.count_nonzero(own) == np.count_nonzero(row):
                sides += _sides(own, float(region.low[k]) - offset, float(region.high[k]) - offset)
        yield from sides

    def _of_piece(self, piece: Piece) -> Iterator[tuple[np.ndarray, float]]:
        for limit in piece.limits:
            low, high = limit.low, limit.high
            assert not isinstance(low, str) and not isinstance(high, str)
            if limit.form.row:
                row = np.array(limit.form.row)
                own = row[[*self._axes]]
                if np.any(own) and np.count_nonzero(own) == np.count_nonzero(row) and not piece.is_cone:
                    yield from _sides(own, low, high)
            elif piece.is_cone:
                yield from self._of_cone(limit.form)
            elif high is not None:
                yield from self._of_ball(limit.form, float(np.sqrt(max(high, 0.0))))

    def _of_ball(self, form: Form, radius: float) -> Iterator[tuple[np.ndarray, float]]:
        """Yield tangents of the shadow of a ball."""
        centre = np.zeros(len(self._axes))
        inside = np.zeros(len(self._axes), dtype=bool)
        for _, row, middle in form.squares:
            state = row.index(1.0)
            if state in self._axes:
                centre[self._axes.index(state)], inside[self._axes.index(state)] = middle, True
        if not inside.any():
            return
        if len(self._axes) == 2 and inside.all():
            turns = 2.0 * np.pi * (np.arange(ROUND) + 0.5) / ROUND
            normals = np.stack([np.cos(turns), np.sin(turns)], axis=1)
        else:
            unit = np.eye(len(self._axes))[inside]
            normals = np.concatenate([unit, -unit])
        for normal in normals:
            yield normal, float(normal @ centre) + radius

    def _of_cone(self, form: Form) -> Iterator[tuple[np.ndarray, float]]:
        """Yield the two sides of a round cone whose axis lies in the map; nothing of others."""
        (_, row, _), *around = form.squares
        axis = np.array(row)[[*self._axes]]
        if len(self._axes) < 2 or not np.isclose(np.hypot(*axis), 1.0):
            return
        tip = {other.index(1.0): middle for _, other, middle in around}
        point = np.array([tip[state] for state in self._axes])
        half, middle = np.arccos(np.sqrt(-around[0][0])), np.arctan2(axis[1], axis[0])
        for angle, sign in ((middle + half, 1.0), (middle - half, -1.0)):
            normal = sign * np.array([-np.sin(angle), np.cos(angle)])
            yield normal, float(normal @ point)

    def _span(self, name: str, time: int) -> tuple[float, float] | None:
        """Return a box along one axis; None if it says nothing about it."""
        limits = self._limits(name, time)
        if limits is None:
            return None
        low, high = -np.inf, np.inf
        for (entry,), offset in limits:
            low, high = (low, min(high, offset / entry)) if entry > 0 else (max(low, offset / entry), high)
        return low, high


def terms_of(formula: Formula, positive: bool) -> list[list[Literal]]:
    """Return a disjunction of conjunctions of boxes and their complements: it is a formula, or its negation."""
    if formula.operator == "atom":
        return [[(positive, formula.name)]]
    if formula.operator == "!":
        return terms_of(formula.operands[0], not positive)
    parts = [terms_of(operand, positive) for operand in formula.operands]
    if (formula.operator == "|") == positive:
        return [term for part in parts for term in part]
    result: list[list[Literal]] = [[]]
    for part in parts:
        result = [[*term, *more] for term in result for more in part][: MOST_TERMS + 1]
    return result


def limited_outputs(agent: AnyAgent, low: np.ndarray, high: np.ndarray) -> list[int]:
    """Return the outputs that corners of a region limit within the workspace."""
    first, last = (ends[0] for ends in agent.output_range(agent.state_low[None], agent.state_high[None]))
    return np.flatnonzero((low > first) | (high < last)).tolist()


def _sides(row: np.ndarray, low: float | None, high: float | None) -> Iterator[tuple[np.ndarray, float]]:
    if high is not None and np.isfinite(high):
        yield row, high
    if low is not None and np.isfinite(low):
        yield -row, -low


def _clipped(polygon: Polygon, normal: np.ndarray, offset: float) -> Polygon:
    """Return the part of a convex polygon with `normal @ y <= offset`; no corners where nothing is left."""
    if not len(polygon):
        return polygon
    depth = offset - polygon @ normal
    corners = []
    for k, (here, inside) in enumerate(zip(polygon, depth, strict=True)):
        before, was = polygon[k - 1], depth[k - 1]
        if (inside >= 0.0) != (was >= 0.0):
            corners.append(before + (here - before) * (was / (was - inside)))
        if inside >= 0.0:
            corners.append(here)
    return np.array(corners).reshape(-1, 2)


def _with_hole(polygon: Polygon, hole: Polygon) -> Polygon:
    """Return a polygon with a hole in it, cut in along a line from its last corner: any painter fills it."""
    return np.concatenate([polygon, polygon[:1], hole[::-1], hole[-1:], polygon[:1]])


def _less_or_within(a: float, b: float, span: tuple[float, float], within: bool) -> Iterator[tuple[float, float]]:
    """Yield the parts of an interval within another one, or outside of it."""
    cuts = [(max(a, span[0]), min(b, span[1]))] if within else [(a, min(b, span[0])), (max(a, span[1]), b)]
    for low, high in cuts:
        if low < high:
            yield low, high
