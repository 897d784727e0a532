"""Convex pieces of regions: limits on forms that are linear or of second degree in the states of one agent.

A shape is a combination of pieces by and, or, not (docs/theory/regions.md, "Shapes and pieces").
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from fractions import Fraction

import numpy as np

from ...systems.arguments import shown
from ...systems.expressions import computed, read_expression

End = float | str
"""A number, or an expression in the time `t`."""


@dataclass(frozen=True)
class Form:
    """An output that limits are about: `row @ x`, or a sum of squares of linear forms.

    Attributes
    ----------
    row : tuple of float
        Coefficients (d,) of a linear form; empty for one of second degree. The largest is 1.
    squares : tuple of (float, tuple of float, float)
        `factor * (row @ x - offset)**2` each; empty for a linear form.
    """

    row: tuple[float, ...] = ()
    squares: tuple[tuple[float, tuple[float, ...], float], ...] = ()

    @property
    def size(self) -> int:
        """Number of coefficients: the states, and other outputs behind them where a shape names some."""
        return len(self.row or self.squares[0][1])

    def text(self, names: Sequence[str]) -> str:
        """Return the form as an expression in the names of the states, as a function of real numbers (exact)."""
        if self.row:
            return _sum(self.row, names)
        terms = [(factor, f"({_sum(row, names)}{_signed(-offset)})**2") for factor, row, offset in self.squares]
        return " ".join(
            f"{'-' if factor < 0 else '+' if k else ''} {_times(abs(factor), term)}".strip()
            for k, (factor, term) in enumerate(terms)
        )


def _sum(row: Sequence[float], names: Sequence[str]) -> str:
    """Return a linear form as text; the first entry has its sign in front."""
    parts = [(a, name) for a, name in zip(row, names, strict=True) if a]
    first, *rest = parts
    text = ("-" if first[0] < 0 else "") + _times(abs(first[0]), first[1])
    return text + "".join(f" {'-' if a < 0 else '+'} {_times(abs(a), name)}" for a, name in rest)


def _times(factor: float, text: str) -> str:
    return text if factor == 1.0 else f"{factor!r}*{text}"


def _signed(number: float) -> str:
    return "" if number == 0.0 else f" {'-' if number < 0 else '+'} {abs(number)!r}"


@dataclass(frozen=True)
class Limit:
    """`low <= form < high`; None where there is no end."""

    form: Form
    low: End | None = None
    high: End | None = None


@dataclass(frozen=True)
class Piece:
    """A convex set: all limits hold, which are on different forms.

    Attributes
    ----------
    limits : tuple of Limit
    by_time : tuple of Piece
        What it is at times 0, 1, ..., where its forms are others at each of them; else empty.
    """

    limits: tuple[Limit, ...]
    by_time: tuple[Piece, ...] = ()

    @property
    def moves(self) -> bool:
        """Whether an end names the time."""
        return any(isinstance(end, str) for limit in self.limits for end in (limit.low, limit.high))

    @property
    def is_cone(self) -> bool:
        """Whether it is a round cone: a square that is larger than the others together."""
        return any(factor < 0.0 for limit in self.limits for factor, _, _ in limit.form.squares)

    def at(self, time: int) -> Piece:
        """Return the piece at a time, its ends numbers (for pictures)."""
        if self.by_time:
            return self.by_time[time]
        ends = [(limit.form, _at(limit.low, time), _at(limit.high, time)) for limit in self.limits]
        return Piece(tuple(Limit(*end) for end in ends))


def _at(end: End | None, time: int) -> float | None:
    if not isinstance(end, str):
        return end
    return float(computed([read_expression(end, ("t",))], {"t": np.array([float(time)])})[0][0])


@dataclass(frozen=True)
class Combined:
    """A combination of pieces and names of other regions: `kind` is "piece", "name", "and", "or" or "not"."""

    kind: str
    parts: tuple[Combined, ...] = ()
    piece: Piece | None = None
    name: str = ""


@dataclass(frozen=True)
class Frame:
    """What shapes are asked to be regions of: the states of an agent, and other outputs behind them if they are named.

    Attributes
    ----------
    names : tuple of str
        Names of the states, and outputs as they are written; empty where states have none, as those of linear agents.
    low, high : tuple of float
        Workspace, and bounds of outputs in it.
    angles : frozenset of int
        States that are angles.
    times : int
        How many times there are, the start among them; 0 where they are not known.
    of : tuple of int or str, or None
        States of shapes that name none themselves; None for the first ones.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    angles: frozenset[int] = frozenset()
    times: int = 0
    of: tuple[int | str, ...] | None = None

    def with_outputs(self, names: Sequence[str], low: Sequence[float], high: Sequence[float]) -> Frame:
        """Return the frame of shapes that name outputs, which stand behind the states."""
        return replace(self, names=(*self.names, *names), low=(*self.low, *low), high=(*self.high, *high))

    def states(self, of: Sequence[int | str] | None, count: int) -> tuple[int, ...]:
        """Return the numbers of the states that a shape is over: those that it names, or the first ones."""
        d = len(self.low)
        of = self.of if of is None else of
        if of is None:
            if count > d:
                raise ValueError(f"expected a shape of at most {d} dimensions, as the agent has states, got {count}")
            return tuple(range(count))
        if len(of) != count:
            raise ValueError(f"`of`: expected {count} states, one for each dimension, got {shown(list(of))}")
        found = [self._number(state) for state in of]
        if len(set(found)) != len(found):
            raise ValueError(f"`of`: expected different states, got {shown(list(of))}")
        return tuple(found)

    def _number(self, state: int | str) -> int:
        if isinstance(state, str):
            if state in self.names:
                return self.names.index(state)
            close = get_close_matches(state, self.names, n=1)
            known = (
                f"the states are {', '.join(self.names)}" if self.names else "this agent has numbers, 0 for the first"
            )
            raise ValueError(
                f"`of`: expected states, got {shown(state)}; " + (f"did you mean {close[0]!r}?" if close else known)
            )
        if not 0 <= state < len(self.low):
            raise ValueError(f"`of`: expected numbers of states from 0 to {len(self.low) - 1}, got {state}")
        return state

    def row(self, states: Sequence[int], entries: Sequence[float]) -> tuple[float, ...]:
        """Return coefficients (d,) from those of some states."""
        row = [0.0] * len(self.low)
        for state, entry in zip(states, entries, strict=True):
            row[state] = entry
        return tuple(row)


# Faces: `normal @ x <= offset` becomes a limit on a form whose largest coefficient is 1.


def face(row: Sequence[float], offset: End) -> Limit:
    """Return the limit that stands for `row @ x <= offset`."""
    factor = max(row, key=abs)
    scaled = tuple(float(Fraction(entry) / Fraction(factor)) for entry in row)
    if isinstance(offset, str):
        end: End = offset if factor == 1.0 else f"({offset})/({factor!r})"
    else:
        end = float(Fraction(offset) / Fraction(factor))
    return Limit(Form(scaled), high=end) if factor > 0 else Limit(Form(scaled), low=end)


def face_through(row: Sequence[float], *points: Sequence[float]) -> Limit:
    """Return the face with a normal, outwards, through points (d,); its place is their mean, rounded once."""
    limit = face(row, 0.0)
    places = [sum(Fraction(a) * Fraction(x) for a, x in zip(limit.form.row, point, strict=True)) for point in points]
    end = float(sum(places, Fraction(0)) / len(places))
    return Limit(limit.form, high=end) if limit.high is not None else Limit(limit.form, low=end)


def piece_of(limits: Sequence[Limit]) -> Combined:
    """Return the piece in which all limits hold, those on one form united; ValueError if it is empty."""
    by_form: dict[Form, Limit] = {}
    for limit in limits:
        known = by_form.get(limit.form, Limit(limit.form))
        low, high = _tighter(known.low, limit.low, max), _tighter(known.high, limit.high, min)
        if isinstance(low, float) and isinstance(high, float) and not low < high:
            raise ValueError("expected faces with points between them, got opposite ones that leave none")
        by_form[limit.form] = Limit(limit.form, low, high)
    return Combined("piece", piece=Piece(tuple(by_form.values())))


def _tighter(a: End | None, b: End | None, best: Callable[..., float]) -> End | None:
    if a is None or b is None:
        return b if a is None else a
    if isinstance(a, str) or isinstance(b, str):
        return f"{best.__name__}({a if isinstance(a, str) else repr(a)}, {b if isinstance(b, str) else repr(b)})"
    return best(a, b)


def either(parts: Sequence[Combined]) -> Combined:
    """Return a union; of a single part that part."""
    return parts[0] if len(parts) == 1 else Combined("or", tuple(parts))


def all_of(parts: Sequence[Combined]) -> Combined:
    """Return an intersection: where all parts are pieces it is one of them, with all their limits."""
    pieces = [part.piece for part in parts if part.piece is not None]
    if len(pieces) == len(parts):
        return piece_of([limit for piece in pieces for limit in piece.limits])
    return Combined("and", tuple(parts))


# Pieces whose forms move: each time has forms of its own, and at all other times these have ends that are never met.

FAR = 2000.0
"""How far away ends lie that are never met, in sizes of what a form is in the workspace."""


def moving_piece(pieces: Sequence[Piece], frame: Frame) -> Combined:
    """Return the region that is another piece at each time, as one piece whose ends name the time."""
    by_form: dict[Form, dict[int, Limit]] = {}
    for time, piece in enumerate(pieces):
        for limit in piece.limits:
            by_form.setdefault(limit.form, {})[time] = limit
    limits = []
    for form, known in by_form.items():
        far = FAR * (1.0 + _size(form, frame))
        lows = {time: limit.low for time, limit in known.items() if limit.low is not None}
        highs = {time: limit.high for time, limit in known.items() if limit.high is not None}
        low, high = _table(lows, -far, len(pieces)), _table(highs, far, len(pieces))
        limits.append(Limit(form, low, high))
    return Combined("piece", piece=Piece(tuple(limits), tuple(pieces)))


def _size(form: Form, frame: Frame) -> float:
    """Return an upper bound on a form in the workspace, in absolute value."""
    largest = [max(abs(low), abs(high)) for low, high in zip(frame.low, frame.high, strict=True)]

    def linear(row: Sequence[float]) -> float:
        return sum(abs(a) * x for a, x in zip(row, largest, strict=True))

    return linear(form.row) if form.row else sum(abs(f) * (linear(row) + abs(c)) ** 2 for f, row, c in form.squares)


def _table(ends: dict[int, End], far: float, times: int) -> End | None:
    """Return an end that has these values at some whole times, and is far away at all others."""
    values = set(ends.values())
    if not ends or (len(ends) == times and len(values) == 1):
        return next(iter(values), None)
    # `max(0, 1 - abs(t - k))` is exactly 1 at the time k, and 0 at every other whole time.
    hats = [f"max(0, 1 - abs(t - {time}))" for time in ends]
    terms = [f"({end!r})*{hat}" for end, hat in zip(ends.values(), hats, strict=True)]
    terms += [f"({far!r})*max(0, 1 - ({' + '.join(hats)}))"] if len(ends) < times else []
    return " + ".join(terms)
