"""Boxes around means where inputs that move several agents are chosen in common (docs/theory/boxes.md, "Inputs that
move several agents").

At each time and in each automaton state the *numbers* of such inputs are the same for the whole team, whatever the
states are. An agent that names the inputs knows the numbers: a choice of it is a pair, its own input and the numbers,
and its boxes are those of the agent with the numbers in the place of the names. The owner of an input applies it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent
from ..grids import FloatArray, RelationRefused
from .symbolic_means import SymbolicMeans


@dataclass(frozen=True, eq=False)
class CommonInputs:
    """Inputs that are chosen in common, as far as an agent names or owns them, and the numbers that they may be.

    Parameters
    ----------
    names : tuple of str
        Such as ``boiler.heat``; inputs of the agent itself have its own name in front.
    numbers : (L, n) array
        Numbers of the n inputs. The choices of a menu come in L parts of equal length, one for each row.
    """

    names: tuple[str, ...]
    numbers: FloatArray

    def own(self, agent: Agent) -> dict[int, int]:
        """Return which input of the agent itself each of its columns is, as input by column."""
        pairs = [name.split(".") for name in self.names]
        return {k: agent.inputs.index(name) for k, (owner, name) in enumerate(pairs) if owner == agent.name}

    def known(self, agent: Agent, number: int) -> dict[str, float]:
        """Return the numbers of inputs of other agents in a row, by name."""
        own, row = self.own(agent), self.numbers[number].tolist()
        return {name: row[k] for k, name in enumerate(self.names) if k not in own}

    @property
    def description(self) -> dict[str, Any]:
        """The same as plain values."""
        return {"names": [*self.names], "numbers": self.numbers.tolist()}

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """The same as arrays, for comparing relations."""
        return np.frombuffer(" ".join(self.names).encode(), dtype=np.uint8), self.numbers


@dataclass(frozen=True, eq=False)
class CommonMeans:
    """Boxes around the means of an agent that knows numbers; it makes boxes like ``SymbolicMeans``.

    Parameters
    ----------
    pieces : tuple of WrittenMeans
        For each row of numbers, the boxes of the agent with the numbers in the place of the names.
    kept : (l,) bool array
        Which of the states and inputs of others that the agent names are no such numbers.
    """

    pieces: tuple[SymbolicMeans, ...]
    kept: NDArray[np.bool_]

    def around(
        self, low: FloatArray, high: FloatArray, input_set: FloatArray, gains: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the corners (n, A, d) of boxes around the means from the closed cells ``[low, high]``, (n, d) each."""
        parts = zip(self.pieces, np.split(input_set, len(self.pieces)), np.split(gains, len(self.pieces)), strict=True)
        ends = [piece.around(low, high, inputs, own_gains) for piece, inputs, own_gains in parts]
        first, last = (np.concatenate(side, axis=1) for side in zip(*ends, strict=True))
        return first, last

    def steered(
        self,
        choices: NDArray[np.intp],
        points: FloatArray,
        centres: FloatArray,
        u: FloatArray,
        beside: FloatArray | None = None,
    ) -> FloatArray:
        """Return the inputs (m, ...) of choices (...), as ``SymbolicMeans.steered`` does."""
        if not np.any(self.steer):
            return u
        length = len(self.steer) // len(self.pieces)
        number, own = np.divmod(choices, length)
        others = None if beside is None or not np.any(self.kept) else beside[self.kept]
        # At one time and in one automaton state there is a single number.
        for k in np.unique(number).tolist():
            piece = self.pieces[k]
            u = np.where(number == k, piece.steered(np.where(number == k, own, 0), points, centres, u, others), u)
        return u

    def scales(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return ends (n, A, d) of what the noise is multiplied with, as ``SymbolicMeans.scales`` does."""
        return self.pieces[0].scales(low, high, input_set)  # scales name nothing of others

    @property
    def agent(self) -> Agent:
        """The agent, with the first row of numbers in the place of the names."""
        return self.pieces[0].agent

    @property
    def parts(self) -> int:
        """Parts into which cells are cut along each axis."""
        return self.pieces[0].parts

    @cached_property
    def steer(self) -> NDArray[np.bool_]:
        """Which choices (A,) steer."""
        flags = [piece.steer for piece in self.pieces]
        return np.concatenate([flag for flag in flags if flag is not None])

    network = None

    @property
    def description(self) -> dict[str, Any]:
        """What files hold of it."""
        return {"parts": self.parts, "steer": [] if self.steer is None else self.steer.tolist()}

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that boxes depend on, for comparing relations."""
        return tuple(array for piece in self.pieces for array in piece.arrays)


def common_inputs(described: Mapping[str, Any], agent: Agent) -> CommonInputs:
    """Return the inputs that are chosen in common, from plain values.

    Raises
    ------
    RelationRefused
        If the agent neither names nor owns one of them, or a number is outside the box of its input.
    """
    names, numbers = tuple(described["names"]), np.array(described["numbers"], dtype=float)
    ranges = dict(zip(agent.others, agent.neighbour_ranges or (), strict=True))
    inputs = {name for name, is_input in zip(agent.others, agent.neighbour_inputs, strict=True) if is_input}
    own = zip(agent.inputs, agent.input_low.tolist(), agent.input_high.tolist(), strict=True)
    ranges = {name: ranges[name] for name in inputs} | {f"{agent.name}.{name}": (a, b) for name, a, b in own}
    for name in names:
        if name not in ranges:
            raise RelationRefused(f"agent `{agent.name}`: {name!r} is no input that it names or owns")
    low, high = np.array([ranges[name] for name in names]).T
    if not np.all((low <= numbers) & (numbers <= high)):
        raise RelationRefused(f"agent `{agent.name}`: numbers that are chosen in common are outside their input box")
    return CommonInputs(names, numbers)


def common_means(
    agent: Agent, coordinates: FloatArray, input_set: FloatArray, written: Mapping[str, Any], common: CommonInputs
) -> SymbolicMeans | CommonMeans:
    """Return boxes around the means of an agent that knows the numbers of ``common``, or owns them.

    ``written`` holds ``parts`` and ``steer``, see ``SymbolicMeans``.

    Raises
    ------
    RelationRefused
        If the menu does not hold the numbers of inputs that the agent owns, or these would steer.
    """
    count, steer = len(common.numbers), np.array(written["steer"], dtype=bool)
    if len(input_set) % count or steer.shape != (len(input_set),):
        raise RelationRefused(f"agent `{agent.name}`: its menu has not the same choices for each of the common numbers")
    for column, j in common.own(agent).items():
        if not np.array_equal(input_set[:, j], np.repeat(common.numbers[:, column], len(input_set) // count)):
            raise RelationRefused(f"agent `{agent.name}`: its menu has other inputs than those chosen in common")
    if np.any(steer) and common.own(agent):
        raise RelationRefused(f"agent `{agent.name}`: choices with inputs that are chosen in common cannot steer")
    parts, pieces = int(written["parts"]), []
    for number, flags in enumerate(np.split(steer, count)):
        known = common.known(agent, number)
        try:
            knowing = agent.knowing(known)
        except ValueError as error:  # expressions have limits, and numbers are longer than names
            raise RelationRefused(f"agent `{agent.name}`: {error}") from None
        pieces.append(SymbolicMeans(knowing, coordinates, parts, flags))
        if np.any(flags) and not pieces[-1].commands:
            raise RelationRefused(f"agent `{agent.name}`: its choices cannot steer, as no input commands an axis")
    if not known:  # all of them are its own
        return SymbolicMeans(agent, coordinates, parts, steer)
    return CommonMeans(tuple(pieces), np.array([name not in known for name in agent.others]))
