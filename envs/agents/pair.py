"""Propositions about two agents: a box for the difference of their outputs.

Where both agents have the same kind of output, `-1 <= y_a - y_b < 1` on every axis says that they are closer than 1 in
the maximum norm. A pair belongs to no single agent, so whatever works agent by agent has to refuse it: the attribute
`agent` of a pair raises an error in words.

Reference: docs/theory/pairs.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from .any_agent import AnyAgent
from .box import Box
from .checks import shown
from .printing import box_text

PAIRS = ("all", "neighbours")
"""Which pairs of the agents that a pattern matches: each with each later one, or each with the next one."""

REFUSAL = (
    "`problem`: expected propositions of single agents, got some about pairs of agents, of which this knows nothing; "
    "`synthesize`, `check`, `validate` and `report` know them"
)
"""What is said where pairs are not understood."""


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Pair:
    """A half-open box for the difference of the outputs of two agents: `low <= y_a - y_b < high`.

    Parameters
    ----------
    agents : pair of str, or str
        Names of the agents a and b. A name with one `*` in place of one of them makes a family, one member per agent
        that matches. A single text with one `*` makes a family of the agents that match: see `pairs`.
    low, high : array_like, shape (p,)
        Corners, finite, `low < high`, in units of the outputs.
    outputs : pair of sequences of int, optional
        Which outputs of a and which of b are compared, in order; default: all of them.
    pairs : "all" or "neighbours"
        Of the agents that a single pattern matches, in the order of the problem: each with each later one, or each
        with the next one.

    Raises
    ------
    ValueError
        If an argument is malformed.

    Examples
    --------
    >>> Pair(["left", "right"], [-1.0, -1.0], [1.0, 1.0])
    Pair(('left', 'right'), [-1, 1)^2)
    """

    agents: tuple[str, str] | str
    low: np.ndarray
    high: np.ndarray
    outputs: tuple[tuple[int, ...], tuple[int, ...]] | None
    pairs: str

    moves = False

    def at(self, time: int) -> Pair:
        """Return the proposition at a time: itself, as boxes for differences stand still."""
        return self

    def __init__(self, agents: Any, low: Any, high: Any, outputs: Any = None, pairs: str = "all") -> None:
        box = Box(low, high)
        if pairs not in PAIRS:
            raise ValueError(f"`pairs`: expected {' or '.join(map(repr, PAIRS))}, got {shown(pairs)}")
        if pairs != "all" and not isinstance(agents, str):
            raise ValueError(
                "`pairs`: expected only with a single pattern such as 'drone_*' for `agents`; leave it out"
            )
        object.__setattr__(self, "agents", _checked_names(agents))
        object.__setattr__(self, "low", box.low)
        object.__setattr__(self, "high", box.high)
        object.__setattr__(self, "outputs", None if outputs is None else _checked_outputs(outputs, box.low.size))
        object.__setattr__(self, "pairs", pairs)

    @property
    def agent(self) -> NoReturn:
        """There is no single agent: whoever asks for it does not know pairs, and is told so (ValueError)."""
        raise ValueError(REFUSAL)

    # Rebuilt from its arguments: a pickled array would come back writable.
    def __reduce__(self) -> tuple[type[Pair], tuple[Any, ...]]:
        return Pair, (self.agents, self.low, self.high, self.outputs, self.pairs)

    def __repr__(self) -> str:
        more = "" if self.outputs is None else f", outputs {self.outputs}"
        more += "" if self.pairs == "all" else f", {self.pairs}"
        return f"Pair({self.agents!r}, {box_text(self.low, self.high, closed=False)}{more})"

    def to_dict(self) -> dict[str, Any]:
        """Return the proposition as plain values, keyed as in problem files (exact)."""
        data: dict[str, Any] = {
            "agents": self.agents if isinstance(self.agents, str) else list(self.agents),
            "low": self.low.tolist(),
            "high": self.high.tolist(),
        }
        if self.outputs is not None:
            data["outputs"] = [list(axes) for axes in self.outputs]
        if self.pairs != "all":
            data["pairs"] = self.pairs
        return data

    def of(self, first: str, second: str) -> Pair:
        """Return the member of a family that is about two agents."""
        return Pair((first, second), self.low, self.high, self.outputs)


def _checked_names(agents: Any) -> tuple[str, str] | str:
    """Return the names of two agents, or a pattern; raise ValueError if they are neither."""
    if isinstance(agents, str):
        if agents.count("*") != 1:
            raise ValueError(f"`agents`: expected two names, or one pattern with one `*`, got {shown(agents)}")
        return agents
    if not isinstance(agents, Sequence) or len(agents) != 2 or not all(isinstance(name, str) for name in agents):
        raise ValueError(f"`agents`: expected two names, or one pattern with one `*`, got {shown(agents)}")
    first, second = agents
    if first.count("*") + second.count("*") > 1:
        raise ValueError(f"`agents`: expected at most one `*` in two names, got {shown(list(agents))}")
    if first == second:
        raise ValueError(f"`agents`: expected two different agents, got {first!r} twice")
    return first, second


def _checked_outputs(outputs: Any, length: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the numbers of the outputs compared, of both agents; raise ValueError if they are malformed."""
    if not isinstance(outputs, Sequence) or isinstance(outputs, str) or len(outputs) != 2:
        raise ValueError(f"`outputs`: expected two lists of numbers of outputs, got {shown(outputs)}")
    result = []
    for axes in outputs:
        numbers = list(axes) if isinstance(axes, Sequence) and not isinstance(axes, str) else [axes]
        if not all(isinstance(k, int | np.integer) and not isinstance(k, bool) and k >= 0 for k in numbers):
            raise ValueError(f"`outputs`: expected numbers of outputs from 0 on, got {shown(axes)}")
        if len(numbers) != length or len(set(numbers)) != length:
            raise ValueError(
                f"`outputs`: expected {length} different outputs of each agent, as `low` has, got {numbers}"
            )
        result.append(tuple(int(k) for k in numbers))
    return result[0], result[1]


@dataclass(frozen=True, eq=False, repr=False)
class PairRegion:
    """A pair in terms of a problem's agents.

    Attributes
    ----------
    first, second : int
        Positions of the agents a and b.
    outputs : pair of tuple of int
        Outputs of a and of b that are compared.
    low, high : np.ndarray, shape (p,)
    """

    first: int
    second: int
    outputs: tuple[tuple[int, ...], tuple[int, ...]]
    low: np.ndarray
    high: np.ndarray

    def __repr__(self) -> str:
        return f"PairRegion({self.first} less {self.second}, {box_text(self.low, self.high, closed=False)})"

    def difference(self, first: Any, second: Any) -> list[Any]:
        """Return the differences of the outputs compared, one per axis: numbers, or arrays of one shape."""
        return [first[k] - second[m] for k, m in zip(*self.outputs)]


def pair_region(name: str, pair: Pair, agents: Sequence[AnyAgent]) -> PairRegion:
    """Return a pair in terms of the agents; raise ValueError if its dimensions do not fit, or it can never hold."""
    places: Mapping[str, int] = {agent.name: i for i, agent in enumerate(agents)}
    i, j = (places[agent] for agent in pair.agents)
    # Those that were added for shapes are not compared.
    sizes = tuple(agents[k].n_outputs - agents[k].added_outputs for k in (i, j))
    length, names = pair.low.size, (agents[i].name, agents[j].name)
    outputs = pair.outputs
    if outputs is None:
        if sizes != (length, length):
            raise ValueError(
                f"`propositions.{name}`: expected corners of as many numbers as both agents have outputs, got {length} "
                f"against {sizes[0]} ({names[0]}) and {sizes[1]} ({names[1]}); say which to compare with `outputs`"
            )
        outputs = tuple(range(length)), tuple(range(length))
    for agent, size, axes in zip(names, sizes, outputs):
        if max(axes) >= size:
            raise ValueError(f"`propositions.{name}`: expected outputs of {agent} below {size}, got {max(axes)}")
    region = PairRegion(i, j, outputs, pair.low, pair.high)
    # The difference lies between the outputs' extremes over both workspaces.
    (low_a, high_a), (low_b, high_b) = (agents[k].output_ends for k in (i, j))
    least = np.array(region.difference(low_a, high_b))
    most = np.array(region.difference(high_a, low_b))
    outside = (pair.low > most) | (pair.high <= least)
    if outside.any():
        axis = int(np.argmax(outside))
        raise ValueError(
            f"`propositions.{name}`: expected a box that differences of {names[0]} and {names[1]} can meet, got "
            f"[{pair.low[axis]:g}, {pair.high[axis]:g}) against [{least[axis]:g}, {most[axis]:g}] on axis {axis}; "
            "correct the box"
        )
    return region
