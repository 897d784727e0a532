"""Regions of other shapes than boxes, in the state space of one agent, as they are written.

A shape is a table of one key: `disc`, `ball`, `box`, `polygon`, `polytope`, `halfspace`, `cone`, `heading`, or one made
of others: `union`, `intersection`, `complement`. Each is a combination, by and, or, not, of convex *pieces*; a piece is
a list of limits `low <= y < high` on outputs y, which are linear or of second degree in the states. Problems add these
outputs to their agents, so that a piece is a box like any other (docs/theory/regions.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fractions import Fraction
from typing import Any

import numpy as np

from ..expressions import Number, computed, names_in, read_expression
from .checks import float_array, shown

End = float | str
"""A number, or an expression in the time `t`."""

MOST_FACES = 60
"""Most faces of a polytope: each may be an output of its agent."""

MOST_TURNS = 50
"""Most turns of a heading that a workspace may hold: each is a piece."""

DEEPEST = 40
"""Lists and tables within one another: more would be a slip."""

TURN = 2.0 * math.pi


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
    """A convex set: all limits hold, which are on different forms."""

    limits: tuple[Limit, ...]

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
    """What shapes are asked to be regions of: the states of an agent.

    Attributes
    ----------
    names : tuple of str
        Names of the states; empty where they have none, as those of linear agents.
    low, high : tuple of float
        Workspace.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    def states(self, of: Sequence[int | str] | None, count: int) -> tuple[int, ...]:
        """Return the numbers of the states that a shape is over: those that it names, or the first ones."""
        d = len(self.low)
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


Maker = Callable[[Frame], Combined]


@dataclass(frozen=True, eq=False, repr=False)
class Shape:
    """A shape as it is written, checked as far as it can be without an agent.

    Attributes
    ----------
    key : str
        Its word, such as `disc`.
    data : object
        What is written behind it, as plain values.
    """

    key: str
    data: Any
    _make: Maker

    def __repr__(self) -> str:
        return f"Shape({self.text})"

    def __reduce__(self) -> tuple[Any, ...]:
        return read_shape, ({self.key: self.data},)

    @property
    def text(self) -> str:
        """The shape in words, for people."""
        return _words(self.key, self.data)

    def combined(self, frame: Frame) -> Combined:
        """Return the shape as a combination of pieces; ValueError if it does not suit the agent."""
        try:
            return self._make(frame)
        except ValueError as error:
            raise ValueError(f"`{self.key}`: {error}") from None


def read_shape(table: Any) -> Shape:
    """Return the shape of a table with one key; ValueError if it is none."""
    if not isinstance(table, Mapping) or len(table) != 1:
        raise ValueError(f"expected a shape such as {{disc = {{centre = [1, 2], radius = 0.5}}}}, got {shown(table)}")
    ((key, data),) = table.items()
    if key not in SHAPES:
        close = get_close_matches(str(key), SHAPES, n=1)
        remedy = f"did you mean `{close[0]}`?" if close else f"the shapes are {', '.join(SHAPES)}"
        raise ValueError(f"unknown shape {shown(key)}; {remedy}")
    data = _plain(data)
    try:
        return Shape(str(key), data, SHAPES[key](data))
    except ValueError as error:
        raise ValueError(f"`{key}`: {error}") from None


def _plain(value: Any, depth: int = 0) -> Any:
    """Return arrays and tuples as lists, so that what is written can be saved and compared."""
    if depth > DEEPEST:
        raise ValueError(f"expected shapes of shapes at most {DEEPEST} lists and tables deep, got more")
    if isinstance(value, Mapping):
        return {str(key): _plain(item, depth + 1) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    listed = isinstance(value, Sequence) and not isinstance(value, str)
    return [_plain(item, depth + 1) for item in value] if listed else value


def _words(key: str, data: Any) -> str:
    if isinstance(data, Mapping) and key not in ("complement",):
        return f"{key}({', '.join(f'{name}={_value(item)}' for name, item in data.items())})"
    parts = data if isinstance(data, list) else [data]
    return f"{key}({', '.join(map(_value, parts))})"


def _value(item: Any) -> str:
    if isinstance(item, list):
        return "(" + ", ".join(map(_value, item)) + ")"
    if isinstance(item, Mapping):
        return " ".join(_words(key, data) for key, data in item.items())
    return f"{item:g}" if isinstance(item, int | float) else str(item)


# What is written, read.


def _fields(data: Any, required: Sequence[str], optional: Sequence[str] = ("of",)) -> Mapping[str, Any]:
    """Return a table that has all required keys and no others than these and the optional ones."""
    example = ", ".join(f"{key} = ..." for key in required)
    if not isinstance(data, Mapping):
        raise ValueError(f"expected a table {{{example}}}, got {shown(data)}")
    for key in data:
        if key not in required and key not in optional:
            close = get_close_matches(str(key), [*required, *optional], n=1)
            remedy = f"did you mean `{close[0]}`?" if close else f"the keys are {', '.join([*required, *optional])}"
            raise ValueError(f"unknown key {shown(key)}; {remedy}")
    for key in required:
        if key not in data:
            raise ValueError(f"`{key}` is missing; expected {{{example}}}")
    return data


def _vector(value: Any, name: str, length: int | None = None) -> tuple[float, ...]:
    numbers = value
    if isinstance(value, Sequence) and any(isinstance(entry, str) for entry in value):
        raise ValueError(
            f"`{name}`: expected numbers, got {shown(value)}; what may name the time `t` are offsets, radii, and the "
            "corners of a region with `low` and `high`"
        )
    return tuple(float_array(numbers, name, (length,), "[1.0, 2.0]").tolist())


def _end(value: Any, name: str) -> End:
    """Return a number, or an expression in the time; an expression of numbers alone is a number."""
    if not isinstance(value, str):
        return float(float_array([value], name, (1,), "0.5")[0])
    try:
        tree = read_expression(value, ("t",))
    except ValueError as error:
        raise ValueError(f"`{name}`: {error}") from None
    if names_in(tree):
        return value
    found = float(computed([tree], {})[0][0]) if not isinstance(tree, Number) else tree.value
    return float(float_array([found], name, (1,), "0.5")[0])


def _still(value: Any, name: str) -> float:
    end = _end(value, name)
    if isinstance(end, str):
        raise ValueError(f"`{name}`: expected a number, got {shown(value)}, which names the time")
    return end


def _of(data: Mapping[str, Any]) -> tuple[int | str, ...] | None:
    """Return the states that a shape names; None for the first ones."""
    of = data.get("of")
    if of is None:
        return None
    entries = [of] if isinstance(of, str | int) else of
    good = isinstance(entries, list) and all(
        isinstance(entry, str | int) and not isinstance(entry, bool) for entry in entries
    )
    if not good or not entries:
        raise ValueError(f"`of`: expected names or numbers of states, got {shown(of)}")
    return tuple(entries)


# Faces: `normal @ x <= offset` becomes a limit on a form whose largest coefficient is 1.


def _face(row: Sequence[float], offset: End) -> Limit:
    """Return the limit that stands for `row @ x <= offset`."""
    factor = max(row, key=abs)
    scaled = tuple(float(Fraction(entry) / Fraction(factor)) for entry in row)
    if isinstance(offset, str):
        end: End = offset if factor == 1.0 else f"({offset})/({factor!r})"
    else:
        end = float(Fraction(offset) / Fraction(factor))
    return Limit(Form(scaled), high=end) if factor > 0 else Limit(Form(scaled), low=end)


def _through(row: Sequence[float], *points: Sequence[float]) -> Limit:
    """Return the face with a normal, outwards, through points (d,); its place is their mean, rounded once."""
    limit = _face(row, 0.0)
    places = [sum(Fraction(a) * Fraction(x) for a, x in zip(limit.form.row, point, strict=True)) for point in points]
    end = float(sum(places, Fraction(0)) / len(places))
    return Limit(limit.form, high=end) if limit.high is not None else Limit(limit.form, low=end)


def _piece(limits: Sequence[Limit]) -> Combined:
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


# The shapes.


def _ball(dimension: int | None) -> Callable[[Any], Maker]:
    def read(data: Any) -> Maker:
        table = _fields(data, ("centre", "radius"))
        centre, of = _vector(table["centre"], "centre", dimension), _of(table)
        radius = _end(table["radius"], "radius")
        if isinstance(radius, float) and not radius > 0.0:
            raise ValueError(f"`radius`: expected a number above 0, got {radius:g}")
        # A radius that falls below 0 leaves nothing, as one of 0 does.
        square: End = f"max({radius}, 0)**2" if isinstance(radius, str) else radius * radius
        if isinstance(square, float) and not 0.0 < square < math.inf:
            raise ValueError(f"`radius`: expected one whose square is a number, got {radius!r}")

        def make(frame: Frame) -> Combined:
            states = frame.states(of, len(centre))
            unit = np.eye(len(frame.low))
            squares = tuple((1.0, tuple(unit[s].tolist()), c) for s, c in zip(states, centre, strict=True))
            return _piece([Limit(Form(squares=squares), high=square)])

        return make

    return read


def _box(data: Any) -> Maker:
    table = _fields(data, ("low", "high"))
    low, high = ([_end(end, f"{key}[{k}]") for k, end in enumerate(_listed(table, key))] for key in ("low", "high"))
    of = _of(table)
    if len(low) != len(high):
        raise ValueError(f"`high`: expected {len(low)} entries, as `low` has, got {len(high)}")

    def make(frame: Frame) -> Combined:
        states = frame.states(of, len(low))
        unit = np.eye(len(frame.low))
        return _piece([Limit(Form(tuple(unit[s].tolist())), a, b) for s, a, b in zip(states, low, high, strict=True)])

    return make


def _listed(table: Mapping[str, Any], key: str) -> list[Any]:
    value = table[key]
    if not isinstance(value, list) or not value:
        raise ValueError(f"`{key}`: expected a list, got {shown(value)}")
    return value


def _normal(value: Any, name: str, length: int | None = None) -> tuple[float, ...]:
    normal = _vector(value, name, length)
    if not any(normal):
        raise ValueError(f"`{name}`: expected a vector with an entry other than 0, got {shown(value)}")
    return normal


def _halfspace(data: Any) -> Maker:
    table = _fields(data, ("normal", "offset"))
    normal, offset, of = _normal(table["normal"], "normal"), _end(table["offset"], "offset"), _of(table)
    return lambda frame: _piece([_face(frame.row(frame.states(of, len(normal)), normal), offset)])


def _polytope(data: Any) -> Maker:
    table = _fields(data, ("normals", "offsets"))
    rows, ends, of = _listed(table, "normals"), _listed(table, "offsets"), _of(table)
    if len(rows) != len(ends) or len(rows) > MOST_FACES:
        raise ValueError(
            f"`offsets`: expected as many as there are normals, up to {MOST_FACES}, got {len(ends)} and {len(rows)}"
        )
    first = _normal(rows[0], "normals[0]")
    normals = [_normal(row, f"normals[{k}]", len(first)) for k, row in enumerate(rows)]
    offsets = [_end(end, f"offsets[{k}]") for k, end in enumerate(ends)]

    def make(frame: Frame) -> Combined:
        states = frame.states(of, len(first))
        return _piece([_face(frame.row(states, n), b) for n, b in zip(normals, offsets, strict=True)])

    return make


def _polygon(data: Any) -> Maker:
    table = _fields(data, ("corners",))
    listed, of = _listed(table, "corners"), _of(table)
    corners = [_vector(corner, f"corners[{k}]", 2) for k, corner in enumerate(listed)]
    if not 3 <= len(corners) <= MOST_FACES:
        raise ValueError(f"`corners`: expected 3 to {MOST_FACES} corners, got {len(corners)}")
    if len(set(corners)) < len(corners):
        raise ValueError(
            "`corners`: expected different corners, got one twice; the last side closes the polygon itself"
        )
    edges = list(zip(corners, [*corners[1:], corners[0]], strict=True))
    turn = 1 if sum(_cross(a, b, (0.0, 0.0)) for a, b in edges) > 0 else -1
    for a, b in edges:
        # Exact: every corner but the two of an edge lies on its inner side.
        if any(turn * _cross(a, b, c) <= 0 for c in corners if c not in (a, b)):
            raise ValueError(
                "`corners`: expected the corners of a convex polygon in order, none on the line of two neighbours, got "
                f"a corner beyond, or on, the line from {_value(list(a))} to {_value(list(b))}; write others as a "
                "`union` of convex ones"
            )

    def make(frame: Frame) -> Combined:
        states = frame.states(of, 2)
        faces = []
        for a, b in edges:
            # To the right of an edge that goes round to the left is the outside.
            normal = [turn * (Fraction(b[1]) - Fraction(a[1])), -turn * (Fraction(b[0]) - Fraction(a[0]))]
            largest = max(map(abs, normal))
            row = frame.row(states, [float(entry / largest) for entry in normal])
            faces.append(_through(row, frame.row(states, a), frame.row(states, b)))
        return _piece(faces)

    return make


def _cross(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> Fraction:
    """Return twice the signed area of a triangle (exact): positive if c lies to the left of a to b."""
    (ax, ay), (bx, by), (cx, cy) = (map(Fraction, point) for point in (a, b, c))
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def _cone(data: Any) -> Maker:
    table = _fields(data, ("tip", "axis", "angle"))
    tip, of = _vector(table["tip"], "tip"), _of(table)
    axis, angle = _normal(table["axis"], "axis", len(tip)), _still(table["angle"], "angle")
    if len(tip) < 2:
        raise ValueError(f"`tip`: expected at least two dimensions, got {len(tip)}; in one take a `halfspace`")
    if not 0.0 < angle < math.pi:
        raise ValueError(
            f"`angle`: expected the whole opening, above 0 and below pi, got {angle:g}; wider ones are the "
            "`complement` of a cone, and one of pi is a `halfspace`"
        )
    return _plane_cone(tip, axis, angle, of) if len(tip) == 2 else _round_cone(tip, axis, angle, of)


def _plane_cone(tip: tuple[float, ...], axis: tuple[float, ...], angle: float, of: Any) -> Maker:
    """Return a cone of the plane: two half-planes through its tip."""
    middle = math.atan2(axis[1], axis[0])
    left, right = middle + 0.5 * angle, middle - 0.5 * angle

    def make(frame: Frame) -> Combined:
        states = frame.states(of, 2)
        normals = (-math.sin(left), math.cos(left)), (math.sin(right), -math.cos(right))
        return _piece([_through(frame.row(states, normal), frame.row(states, tip)) for normal in normals])

    return make


def _round_cone(tip: tuple[float, ...], axis: tuple[float, ...], angle: float, of: Any) -> Maker:
    """Return a round cone: its axis and the way from its tip have at least some cosine, in squares, on its side."""
    length = math.hypot(*axis)
    unit = [entry / length for entry in axis]
    cosine = math.cos(0.5 * angle)

    def make(frame: Frame) -> Combined:
        states = frame.states(of, len(tip))
        row, one = frame.row(states, unit), np.eye(len(frame.low))
        along = math.fsum(a * x for a, x in zip(unit, tip, strict=True))
        around = [(-cosine * cosine, tuple(one[s].tolist()), c) for s, c in zip(states, tip, strict=True)]
        squares = Form(squares=((1.0, row, along), *around))
        return _piece([_through([-a for a in row], frame.row(states, tip)), Limit(squares, low=0.0)])

    return make


def _heading(data: Any) -> Maker:
    table = _fields(data, ("of", "from", "to"), ())
    of, first, last = _of(table), _still(table["from"], "from"), _still(table["to"], "to")
    if of is None or len(of) != 1:
        raise ValueError(f"`of`: expected one state, got {shown(table['of'])}")
    if first == last or abs(last - first) >= TURN:
        raise ValueError(f"`to`: expected an angle less than a turn from `from`, and another one, got {last:g}")
    # From `from` on to the left until `to`, through pi where that is on the way.
    width = last - first if last > first else last - first + TURN

    def make(frame: Frame) -> Combined:
        (state,) = frame.states(of, 1)
        form = Form(tuple(np.eye(len(frame.low))[state].tolist()))
        low, high = frame.low[state], frame.high[state]
        turns = range(math.floor((low - first - width) / TURN), math.ceil((high - first) / TURN) + 1)
        if len(turns) > MOST_TURNS:
            raise ValueError(f"`of`: expected a state of at most {MOST_TURNS} turns, got a workspace of {len(turns)}")
        starts = [first + TURN * k for k in turns]
        here = [start for start in starts if start <= high and start + width > low]
        if not here:
            raise ValueError(f"expected a heading that the workspace of the state has, from {low:g} to {high:g}")
        return _either([_piece([Limit(form, start, start + width)]) for start in here])

    return make


def _either(parts: Sequence[Combined]) -> Combined:
    return parts[0] if len(parts) == 1 else Combined("or", tuple(parts))


def _all_of(parts: Sequence[Combined]) -> Combined:
    """Return an intersection: where all parts are pieces it is one of them, with all their limits."""
    pieces = [part.piece for part in parts if part.piece is not None]
    if len(pieces) == len(parts):
        return _piece([limit for piece in pieces for limit in piece.limits])
    return Combined("and", tuple(parts))


def _part(value: Any) -> Callable[[Frame], Combined]:
    """Return what is a name of a proposition, or a table of a shape."""
    if isinstance(value, str):
        return lambda _: Combined("name", name=value)
    return read_shape(value).combined


def _several(joined: Callable[[Sequence[Combined]], Combined]) -> Callable[[Any], Maker]:
    def read(data: Any) -> Maker:
        if not isinstance(data, list) or len(data) < 2:
            raise ValueError(f"expected a list of at least two names of propositions or shapes, got {shown(data)}")
        parts = [_part(entry) for entry in data]
        return lambda frame: joined([part(frame) for part in parts])

    return read


def _complement(data: Any) -> Maker:
    part = _part(data)
    return lambda frame: Combined("not", (part(frame),))


SHAPES: dict[str, Callable[[Any], Maker]] = {
    "disc": _ball(2),
    "ball": _ball(None),
    "box": _box,
    "polygon": _polygon,
    "polytope": _polytope,
    "halfspace": _halfspace,
    "cone": _cone,
    "heading": _heading,
    "union": _several(_either),
    "intersection": _several(_all_of),
    "complement": _complement,
}
"""The words that shapes have, and what reads what is written behind them."""
