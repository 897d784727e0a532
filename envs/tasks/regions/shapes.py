"""Regions of other shapes than boxes, in the state space of one agent, as they are written.

A shape is a table of one key: `disc`, `ball`, `box`, `polygon`, `polytope`, `halfspace`, `cone`, `heading`, or one made
of others: `union`, `intersection`, `complement`. Each is a combination, by and, or, not, of convex *pieces*; a piece is
a list of limits `low <= y < high` on outputs y, which are linear or of second degree in the states. Problems add these
outputs to their agents, so that a piece is a box like any other (docs/theory/regions.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fractions import Fraction
from typing import Any

import numpy as np

from ...systems.agents import TURN
from ...systems.arguments import checked_states, float_array, shown
from ...systems.expressions import Number, computed, names_in, read_expression
from .pieces import Combined, End, Form, Frame, Limit, all_of, either, face, face_through, moving_piece, piece_of

MOST_FACES = 60
"""Most faces of a polytope: each may be an output of its agent."""

MOST_TURNS = 50
"""Most turns of a heading that a workspace may hold: each is a piece."""

MOST_MOVES = 61
"""Most times of a shape that moves: it has outputs of its own at each of them."""

MOVED_DECIMALS = 12
"""Decimals to which what moves is rounded, so that it is the same on every machine."""

DEEPEST = 40
"""Lists and tables within one another: more would be a slip."""

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

    @property
    def tables(self) -> tuple[Mapping[str, Any], ...]:
        """The tables of the shapes that it consists of, which may say what they are about (`of`)."""
        return tuple(_tables(self.key, self.data))

    def combined(self, frame: Frame) -> Combined:
        """Return the shape as a combination of pieces; ValueError if it does not suit the agent."""
        try:
            return self._make(frame)
        except ValueError as error:
            raise ValueError(f"`{self.key}`: {error}") from None


def _tables(key: str, data: Any) -> Iterator[Mapping[str, Any]]:
    """Yield the tables of shapes that are not made of others."""
    if isinstance(data, Mapping) and key != "complement":
        yield data
        return
    for part in data if isinstance(data, list) else [data]:
        for word, inner in part.items() if isinstance(part, Mapping) else ():
            yield from _tables(word, inner)


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
        moves = isinstance(data, Mapping) and any(
            _names_time(data[name]) for name in MOVING.get(key, ()) if name in data
        )
        return Shape(str(key), data, _moving(str(key), data) if moves else SHAPES[key](data))
    except ValueError as error:
        raise ValueError(f"`{key}`: {error}") from None


MOVING = {
    "disc": ("centre",), "ball": ("centre",), "cone": ("tip", "axis"), "polygon": ("corners",),
    "halfspace": ("normal",), "polytope": ("normals",),
}  # fmt: skip
"""What of a shape may name the time, so that it has other outputs at every time; ends of limits may do so without."""


def _names_time(value: Any) -> bool:
    """Return whether a number, or lists of them, names the time."""
    if isinstance(value, list):
        return any(map(_names_time, value))
    if not isinstance(value, str):
        return False
    try:
        return isinstance(_end(value, ""), str)
    except ValueError:
        return True  # what is wrong with it is said where it is read


def _moving(key: str, data: Mapping[str, Any]) -> Maker:
    """Return what makes a shape that is another one at each time."""
    SHAPES[key](_at_time(data, 0))  # mistakes show where they are made

    def make(frame: Frame) -> Combined:
        if frame.times > MOST_MOVES:
            raise ValueError(
                f"expected a horizon of at most {MOST_MOVES - 1} steps beside a shape that moves, as it has outputs of "
                f"its own at every time, got {frame.times - 1}; let it be an agent without inputs, whose dynamics name "
                "`t`, and a pair (`agents`, `distance`)"
            )
        found = []
        for time in range(frame.times):
            try:
                found.append(SHAPES[key](_at_time(data, time))(frame))
            except ValueError as error:
                raise ValueError(f"at t = {time}: {error}") from None
        pieces = [part.piece for part in found if part.piece is not None]
        if len(pieces) < len(found):
            raise ValueError("expected a convex shape at each time, got one that is wider than half a turn at some")
        return moving_piece(pieces, frame)

    return make


def _at_time(value: Any, time: int, key: str = "") -> Any:
    """Return what is written of a shape with numbers in the place of expressions in the time."""
    if isinstance(value, Mapping):
        return {name: item if name == "of" else _at_time(item, time, name) for name, item in value.items()}
    if isinstance(value, list):
        return [_at_time(item, time, f"{key}[{k}]") for k, item in enumerate(value)]
    end = _end(value, key) if isinstance(value, str) else value
    if not isinstance(end, str):
        return end
    found = float(computed([read_expression(end, ("t",))], {"t": np.array([float(time)])})[0][0])
    return float(float_array([round(found, MOVED_DECIMALS)], f"{key} at t = {time}", (1,), "0.5")[0])


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
    return tuple(float_array(value, name, (length,), "[1.0, 2.0]").tolist())


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
        raise ValueError(
            f"`{name}`: expected a number, got {shown(value)}, which names the time; the opening of a cone stands "
            "still, its tip and axis may move"
        )
    return end


def _of(data: Mapping[str, Any]) -> tuple[int | str, ...] | None:
    """Return the states that a shape names; None for the first ones."""
    of = data.get("of")
    return None if of is None else checked_states(of)


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
            return piece_of([Limit(Form(squares=squares), high=square)])

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
        return piece_of([Limit(Form(tuple(unit[s].tolist())), a, b) for s, a, b in zip(states, low, high, strict=True)])

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
    return lambda frame: piece_of([face(frame.row(frame.states(of, len(normal)), normal), offset)])


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
        return piece_of([face(frame.row(states, n), b) for n, b in zip(normals, offsets, strict=True)])

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
            faces.append(face_through(row, frame.row(states, a), frame.row(states, b)))
        return piece_of(faces)

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
        return piece_of([face_through(frame.row(states, normal), frame.row(states, tip)) for normal in normals])

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
        return piece_of([face_through([-a for a in row], frame.row(states, tip)), Limit(squares, low=0.0)])

    return make


def _heading(data: Any) -> Maker:
    table = _fields(data, ("from", "to"))
    of, first, last = _of(table), _end(table["from"], "from"), _end(table["to"], "to")
    if of is not None and len(of) != 1:
        raise ValueError(f"`of`: expected one state, got {shown(table['of'])}")
    if isinstance(first, str) or isinstance(last, str):
        return _moving_heading(first, last, of)
    if first == last or abs(last - first) >= TURN:
        raise ValueError(f"`to`: expected an angle less than a turn from `from`, and another one, got {last:g}")
    # From `from` on to the left until `to`, through pi where that is on the way.
    width = last - first if last > first else last - first + TURN

    def make(frame: Frame) -> Combined:
        state, form = _angle(frame, of)
        low, high = frame.low[state], frame.high[state]
        if state in frame.angles:
            return _arc(form, _into(first, low, high), _into(last, low, high), (low, high))
        turns = _turns(low - first - width, high - first)
        starts = [first + TURN * k for k in turns]
        here = [start for start in starts if start <= high and start + width > low]
        if not here:
            raise ValueError(f"expected a heading that the workspace of the state has, from {low:g} to {high:g}")
        return either([piece_of([Limit(form, start, start + width)]) for start in here])

    return make


def _angle(frame: Frame, of: Sequence[int | str] | None) -> tuple[int, Form]:
    """Return the state that a heading is about, and the form that it is."""
    if of is None and frame.of is None:
        raise ValueError("`of`: expected the state that is the angle, got none")
    (state,) = frame.states(of, 1)
    return state, Form(tuple(np.eye(len(frame.low))[state].tolist()))


def _turns(low: float, high: float) -> range:
    """Return the whole turns from one angle to another, and one more on either side."""
    turns = range(math.floor(low / TURN), math.ceil(high / TURN) + 1)
    if len(turns) > MOST_TURNS:
        raise ValueError(f"`of`: expected a state of at most {MOST_TURNS} turns, got a workspace of {len(turns)}")
    return turns


def _moving_heading(first: End, last: End, of: Sequence[int | str] | None) -> Maker:
    """Return a heading whose ends name the time: an interval that moves for each turn of the workspace."""

    def make(frame: Frame) -> Combined:
        state, form = _angle(frame, of)
        if state in frame.angles:
            raise ValueError(
                "expected `from` and `to` that stand still where the state wraps, got some that name the time; "
                "leave the state out of `angles`, with a workspace of the turns that it may make, such as -7 to 7, or "
                "give the agent the `outputs` `cos` and `sin` of the angle, and a region of these"
            )
        times = np.arange(max(frame.times, 1), dtype=float)
        start, stop = (_over(end, times) for end in (first, last))
        width = stop - start
        # From `from` on to the left until `to`, through pi where that is on the way: at all times, or at none.
        is_through = bool(np.all(width < 0.0))
        if not (is_through or np.all(width > 0.0)) or not np.all(np.abs(width) < TURN):
            raise ValueError(
                "`to`: expected an angle less than a turn from `from`, and on the same side of it at all times; add "
                "`2*pi` to one of them where it would pass the other"
            )
        low, high, turn = frame.low[state], frame.high[state], TURN * is_through
        limits = []
        for k in _turns(low - float(start.max()) - TURN, high - float(start.min())):
            if np.any((start + TURN * k <= high) & (stop + turn + TURN * k > low)):
                limits.append(Limit(form, _plus(first, TURN * k), _plus(last, TURN * k + turn)))
        if not limits:
            raise ValueError(f"expected a heading that the workspace has at some time, from {low:g} to {high:g}")
        return either([piece_of([limit]) for limit in limits])

    return make


def _over(end: End, times: np.ndarray) -> np.ndarray:
    """Return an end (n,) at times (n,)."""
    if not isinstance(end, str):
        return np.full(len(times), end)
    values = np.broadcast_to(computed([read_expression(end, ("t",))], {"t": times})[0], times.shape)
    if not np.all(np.isfinite(values)):
        raise ValueError(f"expected angles that are finite at all times, got {shown(end)}")
    return values


def _plus(end: End, more: float) -> End:
    return f"({end}) + ({more!r})" if isinstance(end, str) else end + more


def _into(angle: float, low: float, high: float) -> float:
    """Return an angle less whole turns, in the workspace of an angle (rounded once)."""
    turn = Fraction(TURN)
    return min(max(float(Fraction(angle) - turn * math.floor((Fraction(angle) - Fraction(low)) / turn)), low), high)


def _arc(form: Form, first: float, last: float, ends: tuple[float, float]) -> Combined:
    """Return the part of a circle from one angle on to the left until another one: an interval of the workspace of the
    angle, or what is outside of one."""
    if first < last:
        return piece_of([Limit(form, first, last)])
    # It goes on through the place where the workspace ends.
    if last <= ends[0]:
        return piece_of([Limit(form, first, ends[1])])
    return Combined("not", (piece_of([Limit(form, last, first)]),))


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
    "union": _several(either),
    "intersection": _several(all_of),
    "complement": _complement,
}
"""The words that shapes have, and what reads what is written behind them."""
