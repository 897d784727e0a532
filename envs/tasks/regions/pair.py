"""Propositions about two agents: a box for the difference of their outputs, or its length.

Where both agents have the same kind of output, `-1 <= y_a - y_b < 1` on every axis says that they are closer than 1 in
the maximum norm, and a distance says that they are in the Euclidean one. A pair belongs to no single agent, so whatever
works agent by agent has to refuse it: the attribute `agent` of a pair raises an error in words.

Reference: docs/theory/pairs.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from ...systems.agents import TIME, AnyAgent
from ...systems.arguments import box_text, checked_states, float_array, read_only, shown
from ...systems.expressions import Tree, computed, names_in, read_expression
from .pieces import Frame
from .shapes import Shape, read_shape
from .timed_corners import Corner, read_corners, values_over

PAIRS = ("all", "neighbours")
"""Which pairs of the agents that a pattern matches: each with each later one, or each with the next one."""

REFUSAL = (
    "`problem`: expected propositions of single agents, got some about pairs of agents, of which this knows nothing; "
    "`synthesize`, `check`, `validate` and `report` know them"
)
"""What is said where pairs are not understood."""

LEAST_DISTANCE = 1e-140
"""Least and, inverted, largest distance whose square is a number with all its digits."""

MOST_BY_DEFAULT = 2
"""Most outputs that a distance is about without being told: of three, one may be a heading."""


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Pair:
    """A half-open box for the difference of the outputs of two agents, `low <= y_a - y_b < high`, or a distance.

    Parameters
    ----------
    agents : pair of str, or str
        Names of the agents a and b. A name with one `*` in place of one of them makes a family, one member per agent
        that matches. A single text with one `*` makes a family of the agents that match: see `pairs`.
    low, high : array_like, shape (p,), or sequences of numbers and strings
        Corners, finite, `low < high`, in units of the outputs. Strings are expressions in the time `t`: then the box
        moves, and holds nothing at times at which `low < high` does not hold.
    outputs : pair of sequences of int or str, optional
        Which outputs of a and which of b are compared, in order, by number, or by the names of states; default: all of
        them.
    pairs : "all" or "neighbours"
        Of the agents that a single pattern matches, in the order of the problem: each with each later one, or each
        with the next one.
    distance : float or str, optional
        In the place of `low` and `high`: the pair holds where the Euclidean distance of the outputs that are compared
        is below this number, which is above 0; or below that of an expression in `t`, and nowhere where that is not.
    of : str, int, or sequence of them, optional
        In the place of `outputs`: the states that are compared, by name or number, the same of both agents.
    **shape
        In the place of corners: a flat shape by its word, `polygon`, `polytope`, `halfspace` or `cone`, with the same
        table as for one agent, that the difference of the states is in: of the first ones unless `of` names others.

    Raises
    ------
    ValueError
        If an argument is malformed.

    Examples
    --------
    >>> Pair(["left", "right"], [-1.0, -1.0], [1.0, 1.0])
    Pair(('left', 'right'), [-1, 1)^2)
    >>> Pair("drone_*", distance=0.8, of=["x", "y"])
    Pair('drone_*', distance < 0.8 of (x, y))
    """

    agents: tuple[str, str] | str
    low: np.ndarray
    high: np.ndarray
    outputs: tuple[tuple[str | int, ...], tuple[str | int, ...]] | None
    pairs: str
    distance: float | str | None
    of_states: tuple[str | int, ...] | None
    corners: tuple[Corner, Corner] | None
    trees: tuple[tuple[Tree, ...], ...]
    """Of a pair that moves: its corners, or its distance, as expressions in `t`; else nothing."""
    shape: Shape | None

    def __init__(
        self,
        agents: Any,
        low: Any = None,
        high: Any = None,
        outputs: Any = None,
        pairs: str = "all",
        distance: Any = None,
        of: Any = None,
        **shape: Any,
    ) -> None:
        if (distance is None) + (low is None and high is None) + (not shape) != 2 or len(shape) > 1:
            raise ValueError(
                "`distance`: expected either a distance, or `low` and `high`, or one shape; give one of them"
            )
        region: dict[str, Any]
        length = None
        if shape:
            region = {"shape": _flat(read_shape(shape), outputs)}
        elif distance is not None:
            region = _read_distance(distance)
        else:
            region = read_corners(low, high)
            length = len((region["corners"] or (region["low"],))[0])
        if pairs not in PAIRS:
            raise ValueError(f"`pairs`: expected {' or '.join(map(repr, PAIRS))}, got {shown(pairs)}")
        if pairs != "all" and not isinstance(agents, str):
            raise ValueError(
                "`pairs`: expected only with a single pattern such as 'drone_*' for `agents`; leave it out"
            )
        if of is not None and outputs is not None:
            raise ValueError("`of`: expected either states, or the `outputs` that are compared; give one of the two")
        values: dict[str, Any] = {
            "agents": _checked_names(agents),
            "outputs": None if outputs is None else _checked_outputs(outputs, length),
            "pairs": pairs,
            "of_states": None if of is None else _checked_states(of, length),
            "distance": None,
            "corners": None,
            "trees": (),
            "shape": None,
        }
        values |= region
        for key, value in values.items():
            object.__setattr__(self, key, value)

    if not TYPE_CHECKING:  # types are those of the attributes
        # Asked for corners that it has not: whoever reads boxes must not go on with any.
        def __getattr__(self, name: str) -> Any:
            if name in ("low", "high"):
                raise ValueError(
                    f"`proposition`: expected a box that stands still, got {self!r}; ask for `problem.labeling`"
                )
            raise AttributeError(name)

    def at(self, time: int) -> Pair:
        """Return the proposition itself, which stands still; pairs that move are boxes in `problem.labeling` alone."""
        if self.moves:
            raise ValueError(f"`proposition`: expected a pair that stands still, got {self!r}; ask `labeling.at(time)`")
        return self

    @property
    def agent(self) -> NoReturn:
        """There is no single agent: whoever asks for it does not know pairs, and is told so (ValueError)."""
        raise ValueError(REFUSAL)

    # Rebuilt from its arguments: a pickled array would come back writable.
    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (self.to_dict(),)

    def __repr__(self) -> str:
        more = "" if self.outputs is None else f", outputs {self.outputs}"
        more += "" if self.pairs == "all" else f", {self.pairs}"
        return f"Pair({self.agents!r}, {self.text}{more})"

    @property
    def moves(self) -> bool:
        """Whether a corner, or the distance, names the time."""
        return bool(self.trees)

    @property
    def text(self) -> str:
        """The box, the distance or the shape, for people; what moves as it is written."""
        if self.shape is not None:
            what = self.shape.text
        elif self.corners is not None:
            ends = (", ".join(e if isinstance(e, str) else f"{e:g}" for e in corner) for corner in self.corners)
            what = "[{}] to [{}]".format(*ends)
        elif self.distance is None:
            what = box_text(self.low, self.high, closed=False)
        else:
            what = f"distance < {self.distance if isinstance(self.distance, str) else format(self.distance, 'g')}"
        return what + ("" if self.of_states is None else f" of ({', '.join(map(str, self.of_states))})")

    def to_dict(self) -> dict[str, Any]:
        """Return the proposition as plain values, keyed as in problem files (exact)."""
        data: dict[str, Any] = {"agents": self.agents if isinstance(self.agents, str) else list(self.agents)}
        if self.shape is not None:
            data[self.shape.key] = self.shape.data
        elif self.corners is not None:
            data |= {"low": list(self.corners[0]), "high": list(self.corners[1])}
        elif self.distance is None:
            data |= {"low": self.low.tolist(), "high": self.high.tolist()}
        else:
            data["distance"] = self.distance
        if self.of_states is not None:
            data["of"] = list(self.of_states)
        if self.outputs is not None:
            data["outputs"] = [list(axes) for axes in self.outputs]
        if self.pairs != "all":
            data["pairs"] = self.pairs
        return data

    def of(self, first: str, second: str) -> Pair:
        """Return the member of a family that is about two agents."""
        return Pair(**{**self.to_dict(), "agents": (first, second), "pairs": "all"})


def _rebuilt(data: dict[str, Any]) -> Pair:
    """Return the pair of its arguments (for pickling)."""
    return Pair(**data)


def _read_distance(distance: Any) -> dict[str, Any]:
    """Return what a pair keeps of its distance: a number, or an expression in the time and its tree."""
    if not isinstance(distance, str):
        return {"distance": _checked_distance(distance)}
    try:
        tree = read_expression(distance, (TIME,))
    except ValueError as error:
        raise ValueError(f"`distance`: {error}") from None
    if names_in(tree):
        return {"distance": distance, "trees": ((tree,),)}
    return {"distance": _checked_distance(float(np.concatenate(computed([tree], {}))[0]))}


FLAT = ("polygon", "polytope", "halfspace", "cone")
"""Shapes that a difference may be in: an intersection of half-spaces is one of forms that both agents have."""


def _flat(shape: Shape, outputs: Any) -> Shape:
    """Return a shape; raise ValueError unless the difference of two agents may be in it."""
    if shape.key not in FLAT:
        raise ValueError(
            f"`{shape.key}`: expected a box, a distance, or one of {', '.join(FLAT)} that the difference of two agents "
            "is in; say of one agent where it is with `agent`"
        )
    if outputs is not None or "of" in shape.data:
        raise ValueError(f"`{shape.key}`: expected `of` beside the shape, to say which states of both it is about")
    return shape


def _checked_distance(distance: Any) -> float:
    value = float(float_array([distance], "distance", (1,), "1.0")[0])
    # Squares are compared: they have to be numbers with all their digits, too.
    if not LEAST_DISTANCE <= value <= 1.0 / LEAST_DISTANCE:
        raise ValueError(f"`distance`: expected a number above 0, from {LEAST_DISTANCE:g} on, got {shown(distance)}")
    return value


def _checked_states(of: Any, length: int | None) -> tuple[str | int, ...]:
    states = checked_states(of)
    if len(states) != (length or len(states)):
        raise ValueError(f"`of`: expected {length} states, as `low` has entries, got {shown(of)}")
    return states


def _checked_names(agents: Any) -> tuple[str, str] | str:
    """Return the names of two agents, or a pattern; raise ValueError if they are neither."""
    if isinstance(agents, str):
        if agents.count("*") != 1:
            raise ValueError(f"`agents`: expected two names, or one pattern with one `*`, got {shown(agents)}")
        return agents
    if not isinstance(agents, Sequence) or len(agents) != 2 or not all(isinstance(name, str) for name in agents):
        alone = "; a proposition about one agent has `agent`" if isinstance(agents, list) and len(agents) == 1 else ""
        raise ValueError(f"`agents`: expected two names, or one pattern with one `*`, got {shown(agents)}{alone}")
    first, second = agents
    if first.count("*") + second.count("*") > 1:
        raise ValueError(f"`agents`: expected at most one `*` in two names, got {shown(list(agents))}")
    if first == second:
        raise ValueError(f"`agents`: expected two different agents, got {first!r} twice")
    return first, second


def _checked_outputs(outputs: Any, length: int | None) -> tuple[tuple[str | int, ...], tuple[str | int, ...]]:
    """Return the numbers or names of the outputs compared, of both agents; raise ValueError if they are malformed."""
    if not isinstance(outputs, Sequence) or isinstance(outputs, str) or len(outputs) != 2:
        same = "; the same states of both are `of = [..]`"
        raise ValueError(f"`outputs`: expected two lists of numbers of outputs, got {shown(outputs)}{same}")
    result = []
    for axes in outputs:
        numbers = list(axes) if isinstance(axes, Sequence) and not isinstance(axes, str) else [axes]
        if not all(
            _is_name(k) or (isinstance(k, int | np.integer) and type(k) is not bool and k >= 0) for k in numbers
        ):
            raise ValueError(f"`outputs`: expected numbers of outputs from 0 on, or names, got {shown(axes)}")
        length = len(numbers) if length is None else length
        if not length or len(numbers) != length or len(set(numbers)) != length:
            raise ValueError(
                f"`outputs`: expected {length or 'some'} different outputs of each agent, as many as are compared, got "
                f"{numbers}"
            )
        result.append(tuple(k if _is_name(k) else int(k) for k in numbers))
    return result[0], result[1]


def _is_name(entry: Any) -> bool:
    """Return whether an entry of ``outputs`` is the name of one."""
    return isinstance(entry, str) and entry != ""


@dataclass(frozen=True, eq=False, repr=False)
class PairRegion:
    """A pair in terms of a problem's agents: the differences in a box that are shorter than a radius.

    Attributes
    ----------
    first, second : int
        Positions of the agents a and b.
    outputs : pair of tuple of int
        Outputs of a and of b that are compared.
    low, high : np.ndarray, shape (p,)
        Corners of the box; of a distance, a box around the whole ball. They are not in order where it is empty.
    radius : float
        Infinite where the box alone decides.

    One that moves has no box and no radius (ValueError): `at` a time there are.
    """

    first: int
    second: int
    outputs: tuple[tuple[int, ...], tuple[int, ...]]
    low: np.ndarray
    high: np.ndarray
    radius: float

    if not TYPE_CHECKING:  # types are those of the attributes
        # Asked for what it has not: whoever reads a box without a time must not go on with any.
        def __getattr__(self, name: str) -> Any:
            if name in ("low", "high", "radius"):
                raise ValueError(
                    "`problem`: expected pairs that stand still, got some whose box or distance names the time `t`, "
                    'which are certified along paths alone (`relation="path"`)'
                )
            raise AttributeError(name)

    def __repr__(self) -> str:
        if self.moving is not None:
            return f"PairRegion({self.first} less {self.second}, {self.moving.text})"
        what = f"shorter than {self.radius:g}" if self.is_round else box_text(self.low, self.high, closed=False)
        return f"PairRegion({self.first} less {self.second}, {what})"

    @property
    def size(self) -> int:
        """How many outputs are compared."""
        return len(self.outputs[0])

    @property
    def is_round(self) -> bool:
        """Whether it is a ball, and no box."""
        if self.moving is not None:
            return self.moving.distance is not None and self.size > 1
        return self.radius < math.inf

    @property
    def is_empty(self) -> bool:
        """Whether it holds nowhere, as it may at a time where it moves."""
        return bool(np.any(self.low >= self.high))

    moving: Pair | None = None
    """What says where it is at each time; None where it stands still."""

    @property
    def moves(self) -> bool:
        """Whether it is another one at other times."""
        return self.moving is not None

    def at(self, time: int) -> PairRegion:
        """Return the region at a time; itself if it stands still."""
        if self.moving is None:
            return self
        low, high, radius = self.over(np.array([float(time)]))
        return PairRegion(self.first, self.second, self.outputs, low[:, 0], high[:, 0], float(radius[0]))

    def over(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return both corners (p, n) and radii (n,) at times (n,).

        Raises
        ------
        ValueError
            If one of them is not finite at one of the times.
        """
        if self.moving is None:
            low, high = (np.repeat(corner[:, None], len(times), axis=1) for corner in (self.low, self.high))
            return low, high, np.full(len(times), self.radius)
        values = [values_over(own, times) for own in self.moving.trees]
        wrong = ~np.all([np.isfinite(own).all(axis=0) for own in values], axis=0)
        if wrong.any():
            raise ValueError(
                f"expected finite numbers at every time, got {self.moving.text}, which is not finite at t = "
                f"{times[int(np.argmax(wrong))]:g}"
            )
        if len(values) == 2:
            return values[0], values[1], np.full(len(times), math.inf)
        return ball_box(values[0][0], self.size)

    def difference(self, first: Any, second: Any) -> list[Any]:
        """Return the differences of the outputs compared, one per axis: numbers, or arrays of one shape."""
        return [first[k] - second[m] for k, m in zip(*self.outputs)]

    def possible(self, first: tuple[Any, Any], second: tuple[Any, Any]) -> tuple[bool, ...]:
        """Return whether it may hold where outputs are anywhere in two boxes (low, high): what is possible of both.

        A superset: where the boxes reach a face by rounding alone, both are.
        """
        if self.is_empty:
            return (False,)
        places = [(k, m) for k, m in zip(*self.outputs)]
        ends = np.array([[first[0][k] - second[1][m], first[1][k] - second[0][m]] for k, m in places], dtype=float).T
        if not np.all(np.isfinite(ends)):
            return False, True
        may = bool(np.all((ends[0] < self.high) & (ends[1] >= self.low)))
        surely = bool(np.all((self.low <= ends[0]) & (ends[1] < self.high)))
        if self.is_round:
            nearest = np.maximum(np.maximum(ends[0], -ends[1]), 0.0) / self.radius
            farthest = np.maximum(np.abs(ends[0]), np.abs(ends[1])) / self.radius
            may = may and float(nearest @ nearest) * INSIDE < 1.0
            surely = surely and float(farthest @ farthest) < INSIDE
        return (True,) if surely else (False, True) if may else (False,)

    @property
    def inner_box(self) -> tuple[np.ndarray, np.ndarray]:
        """A box all of whose points are in the region: itself, or a cube in its ball."""
        if not self.is_round:
            return self.low, self.high
        half = np.full(len(self.low), self.radius / math.sqrt(len(self.low)) * INSIDE)
        return -half, half

    @property
    def inner_faces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Forms (k, p) and limits (k,) of each, all of which together hold in points of the region alone.

        A box has its own; a disc has a regular octagon, which is larger than its square, and balls have their cube.
        """
        if len(self.low) != 2 or not self.is_round:
            return np.eye(len(self.low)), *self.inner_box
        turns = 0.25 * math.pi * np.arange(4)
        limits = np.full(4, self.radius * math.cos(0.125 * math.pi) * INSIDE)
        return np.column_stack([np.cos(turns), np.sin(turns)]), -limits, limits


INSIDE = 1.0 - 1e-12
"""Factor on what lies in a ball, far beyond the rounding of its faces."""


def holds(difference: Any, low: Any, high: Any, radius: Any) -> Any:
    """Return whether differences (p, ...) are in boxes and shorter than radii, which may be infinite.

    Exact for boxes, and up to the rounding of squares for lengths.

    Components may be numbers or arrays, in a list or in an array; differences that are no numbers are in nothing.
    """
    result = (low[0] <= difference[0]) & (difference[0] < high[0])
    squares = difference[0] * difference[0]
    for k in range(1, len(difference)):
        result = result & (low[k] <= difference[k]) & (difference[k] < high[k])
        squares = squares + difference[k] * difference[k]
    # Squares of what is in a box may overflow where there is no radius, which says nothing then.
    return result & ((squares < radius * radius) | (radius == math.inf))


def pair_region(name: str, pair: Pair, agents: Sequence[AnyAgent]) -> PairRegion:
    """Return a pair in terms of the agents; raise ValueError if its dimensions do not fit, or it can never hold."""
    places: Mapping[str, int] = {agent.name: i for i, agent in enumerate(agents)}
    i, j = (places[agent] for agent in pair.agents)
    # Those that were added for shapes are compared only where they are named, as problems name them.
    sizes = tuple(agents[k].n_outputs - agents[k].added_outputs for k in (i, j))
    names = agents[i].name, agents[j].name
    outputs = _compared(name, pair, (agents[i], agents[j]), sizes)
    for agent, axes in zip((agents[i], agents[j]), outputs):
        if max(axes) >= agent.n_outputs:
            raise ValueError(
                f"`propositions.{name}`: expected outputs of {agent.name} below {agent.n_outputs}, got {max(axes)}"
            )
    for member, axes in zip((agents[i], agents[j]), outputs):
        if {*axes} & {*member.angle_outputs}:
            raise ValueError(
                f"`propositions.{name}`: expected outputs that are numbers, got the angle {member.angles[0]!r} of "
                f"{member.name}, whose differences wrap; compare other states (`of`), or `outputs` such as `cos` of it"
            )
    if pair.moves:
        return _moving(i, j, outputs, pair)
    if isinstance(pair.distance, float):
        low, high, radii = ball_box(np.array([pair.distance]), len(outputs[0]))
        region = PairRegion(i, j, outputs, read_only(low[:, 0]), read_only(high[:, 0]), float(radii[0]))
    else:
        region = PairRegion(i, j, outputs, pair.low, pair.high, math.inf)
    # The difference lies between the outputs' extremes over both workspaces.
    (low_a, high_a), (low_b, high_b) = (agents[k].output_ends for k in (i, j))
    least = np.array(region.difference(low_a, high_b))
    most = np.array(region.difference(high_a, low_b))
    outside = (region.low > most) | (region.high <= least)
    if outside.any():
        axis = int(np.argmax(outside))
        raise ValueError(
            f"`propositions.{name}`: expected a box that differences of {names[0]} and {names[1]} can meet, got "
            f"[{region.low[axis]:g}, {region.high[axis]:g}) against [{least[axis]:g}, {most[axis]:g}] on axis {axis}; "
            "correct the box"
        )
    return region


def ball_box(radii: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the boxes (p, n) around balls of radii (n,) in p dimensions, and these radii; empty where one is none."""
    # Half-open boxes have their lower faces, which are as far away as the distance: the next number has not.
    there = radii >= LEAST_DISTANCE
    high = np.where(there, radii, np.minimum(radii, 0.0))
    low = np.where(there, np.nextafter(-high, 0.0), -high)
    # On a line the box alone decides.
    shape = (count, len(radii))
    radius = np.maximum(high, 0.0) if count > 1 else np.full(len(radii), np.inf)
    return np.broadcast_to(low, shape), np.broadcast_to(high, shape), radius


def _moving(i: int, j: int, outputs: tuple[tuple[int, ...], tuple[int, ...]], pair: Pair) -> PairRegion:
    """Return a region that moves: it has no box and no radius of its own."""
    region = object.__new__(PairRegion)
    for key, value in (("first", i), ("second", j), ("outputs", outputs), ("moving", pair)):
        object.__setattr__(region, key, value)
    return region


def _compared(
    name: str, pair: Pair, agents: tuple[AnyAgent, AnyAgent], sizes: Sequence[int]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the outputs of both agents that a pair compares."""
    if pair.outputs is not None:
        first, second = (_numbers_of(name, agent, axes) for agent, axes in zip(agents, pair.outputs, strict=True))
        return first, second
    if pair.of_states is not None:
        first, second = (_outputs_of(name, agent, pair.of_states) for agent in agents)
        return first, second
    length = most = len(pair.corners[0]) if pair.corners is not None else sizes[0]
    if pair.corners is None and pair.distance is None:
        length = most = pair.low.size
    most = MOST_BY_DEFAULT if pair.distance is not None else most
    if pair.distance is not None:
        what, got = f"as many outputs of both agents, up to {MOST_BY_DEFAULT}", ""
        remedy = 'say which to compare with `of = ["x", "y"]`, or with `outputs`'
    else:
        what, got = "corners of as many numbers as both agents have outputs", f"{length} against "
        named = ", ".join(f'["{agent.state_names[0]}"]' if agent.state_names else "[0]" for agent in agents)
        remedy = f"say which to compare, such as `outputs = [{named}]`"
    if tuple(sizes) != (length, length) or length > most:
        raise ValueError(
            f"`propositions.{name}`: expected {what}, got {got}{sizes[0]} ({agents[0].name}) and {sizes[1]} "
            f"({agents[1].name}); {remedy}"
        )
    return tuple(range(length)), tuple(range(length))


def _numbers_of(name: str, agent: AnyAgent, outputs: Sequence[str | int]) -> tuple[int, ...]:
    """Return the numbers of outputs of an agent; names are those of states that are outputs."""
    return tuple(_outputs_of(name, agent, [k])[0] if isinstance(k, str) else k for k in outputs)


def _outputs_of(name: str, agent: AnyAgent, states: Sequence[str | int]) -> tuple[int, ...]:
    """Return the outputs of an agent that are some of its states, by name or number."""
    axes = [agent.output_axis(k) for k in range(agent.n_outputs - agent.added_outputs)]
    frame = Frame(agent.state_names, tuple(agent.state_low.tolist()), tuple(agent.state_high.tolist()))
    try:
        numbers = frame.states(states, len(states))
    except ValueError as error:
        raise ValueError(f"`propositions.{name}`: agent {agent.name}: {error}") from None
    found = []
    for state, number in zip(states, numbers, strict=True):
        if (number, 1.0) not in axes:
            raise ValueError(
                f"`propositions.{name}`: expected states that are outputs of agent {agent.name}, got {shown(state)}; "
                "say which outputs to compare with `outputs`"
            )
        found.append(axes.index((number, 1.0)))
    return tuple(found)
