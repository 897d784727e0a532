"""Means of agents with expressions as an affine map of the state in each cell, and a small box around what is left.

In a cell with centre c, under an input of the menu, the mean from x is

    z + G (x - c) + r,      |r_k| <= rho_k,

with G the Jacobian at the centre. It is the *residual* ``f(x, u, v) - G (x - c) - z`` that is enclosed, over the closed
cell and all disturbances, by the intervals of ``expressions.enclosed``: it is of second order in the cell, and of first
order in the disturbances only (docs/theory/linear.md, "One reading for all"). Any G would do, so that its
rounding does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, Protocol

import numpy as np

from ....envs.systems.agents import Agent, AnyAgent, with_expressions
from ....envs.systems.arguments import counted
from ....envs.systems.expressions import (
    Affine,
    Interval,
    Name,
    Operation,
    Tree,
    computed,
    enclosed,
    gradients,
    names_in,
    split_at,
)
from ..grids import FloatArray, RelationRefused, linear_agent
from .boxes import MeanBoxes
from .cell_relation import ReadsCells
from .exact import ExactRelation, aimed_relation
from .inverse_means import SymbolicTargets
from .linear_means import LinearMeans, linear_means

BLOCKS, LEAST_REACH = 3, 4
"""Blocks of lattice points within reach to either side, and the reach from which two of them are enough: more of them
see less that is beyond reach, and take longer."""

COMPUTED = 1e-13
"""Share of the size of a mean by which it may be off as it is computed; the check allows for less."""


@dataclass(frozen=True, eq=False)
class AffineBoxes:
    """Means of n cells under A choices: affine maps, and boxes around what they leave (outer bounds).

    Parameters
    ----------
    centre : (n, A, d) array
        z; not a number where nothing is known of the mean.
    gain : (n, 1 or A, d, d) array
        G; for all choices alike if they differ by constants.
    rest : (n, 1 or A, d) array
        rho.
    """

    centre: FloatArray
    gain: FloatArray
    rest: FloatArray


class AffineMaps(Protocol):
    """What makes affine maps; nothing else is asked of an agent."""

    @property
    def network(self) -> Any:
        """The network that is enclosed; None for constant inputs."""

    @property
    def cuts(self) -> int:
        """Parts into which cells are cut along each axis to enclose what maps leave."""

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that maps depend on, for comparing relations."""

    def around(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> AffineBoxes:
        """Return the maps of the closed cells ``[low, high]``, (n, d) each, under choices (A, m)."""


@dataclass(frozen=True, eq=False)
class AffineMeans:
    """Affine maps of an agent with expressions, over all its disturbances.

    Parameters
    ----------
    agent : Agent
    cuts : int
        Parts into which cells are cut along each axis to enclose what is left.
    """

    agent: Agent
    cuts: int
    network = None

    def around(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> AffineBoxes:
        """Return the maps of the closed cells ``[low, high]``, (n, d) each, under inputs (A, m)."""
        inputs = input_set if self.pushes is None else input_set[:1]
        middle = 0.5 * (low + high)
        names = self._names(inputs)
        unknown = [0.5 * (a + b) * np.ones((1, 1)) for a, b in self.agent.unknowns.values()]
        shape = (len(low), len(inputs), self.agent.n_states)
        # The map: value and Jacobian at the centre of the cell, with everything else at the middle of its interval.
        at = [*(column[:, None] for column in middle.T), *unknown]
        centre, gain = np.empty(shape), np.zeros((*shape, shape[2]))
        for k, (value, slopes) in enumerate(gradients(self.agent.trees, names, at)):
            centre[..., k] = value
            for j in range(shape[2]):
                gain[..., k, j] = slopes.get(j, 0.0)
        # What is left, on every part of the cell.
        first, last = np.full(shape, np.inf), np.full(shape, -np.inf)
        trees = self._residuals(gain)
        names |= self._map_names(centre, gain, middle)
        for box in self._parts(low, high):
            for k, (below, above) in enumerate(enclosed(trees, names, box)):
                np.minimum(first[..., k], below, out=first[..., k])
                np.maximum(last[..., k], above, out=last[..., k])
        moved = 0.5 * (first + last)
        rest = np.maximum(last - moved, moved - first) * (1.0 + COMPUTED)
        centre += moved
        if self.pushes is None:
            rest += COMPUTED * np.abs(centre)
        else:
            centre = centre + ((input_set - input_set[0]) @ self.pushes.T)[None]
            rest += COMPUTED * np.abs(centre).max(axis=1, keepdims=True)
        known = np.all(np.isfinite(rest) & np.isfinite(gain).all(axis=-1), axis=2)
        return AffineBoxes(np.where(known[..., None], centre, np.nan), gain, rest)

    def _residuals(self, gain: FloatArray) -> tuple[Tree, ...]:
        """Return the expressions of what is left along each axis."""
        maps: list[Tree] = []
        for k in range(self.agent.n_states):
            total: Tree = Name(f"centre {k}")
            for j in range(self.agent.n_states):
                if np.any(gain[..., k, j]):
                    away = Operation("-", (Name(f"axis {j}"), Name(f"middle {j}")))
                    total = Operation("+", (total, Operation("*", (Name(f"gain {k} {j}"), away))))
            maps.append(total)
        return tuple(Operation("-", pair) for pair in zip(self.agent.trees, maps, strict=True))

    def _map_names(self, centre: FloatArray, gain: FloatArray, middle: FloatArray) -> dict[str, Affine]:
        """Return what the names of the maps are; no state has a name with a blank."""
        d, one = self.agent.n_states, np.ones((1, 1))
        names = {f"axis {k}": Affine(np.zeros((1, 1)), {k: one}) for k in range(d)}
        names |= {f"centre {k}": Affine(centre[..., k]) for k in range(d)}
        names |= {f"middle {k}": Affine(middle[:, k, None]) for k in range(d)}
        return names | {f"gain {k} {j}": Affine(gain[..., k, j]) for k, j in product(range(d), repeat=2)}

    def _parts(self, low: FloatArray, high: FloatArray) -> list[list[Interval]]:
        """Return the parts of cells, and what is not known, as boxes of (n, 1) intervals."""
        # Neighbouring parts share the numbers that are their ends, so that nothing is left out between them.
        ends = [low + (high - low) * (k / self.cuts) for k in range(self.cuts)] + [high]
        one = np.ones((1, 1))
        unknown = [(a * one, b * one) for a, b in self.agent.unknowns.values()]
        return [
            [*((ends[k][:, axis, None], ends[k + 1][:, axis, None]) for axis, k in enumerate(part)), *unknown]
            for part in product(range(self.cuts), repeat=low.shape[1])
        ]

    def _names(self, inputs: FloatArray) -> dict[str, Affine]:
        """Return what states, inputs and all that is not known are in the variables."""
        one, names = np.ones((1, 1)), {}
        for k, state in enumerate(self.agent.states):
            names[state] = Affine(np.zeros((1, 1)), {k: one})
        names |= {name: Affine(column[None]) for name, column in zip(self.agent.inputs, inputs.T, strict=True)}
        unknown = enumerate(self.agent.unknowns, start=self.agent.n_states)
        return names | {name: Affine(np.zeros((1, 1)), {k: one}) for k, name in unknown}

    @cached_property
    def pushes(self) -> FloatArray | None:
        """(d, m) matrix P if inputs enter as ``P u``, added to what does not depend on them; None otherwise."""
        matrix = np.zeros((self.agent.n_states, self.agent.n_inputs))
        for k, tree in enumerate(self.agent.trees):
            for j, name in enumerate(self.agent.inputs):
                split = split_at(tree, name)
                if split is None or names_in(split[1]):
                    return None
                tree, factor = split
                matrix[k, j] = float(computed([factor], {name: np.zeros(1)})[0][0])
        return matrix

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that maps depend on, for comparing relations."""
        texts = (np.frombuffer(text, dtype=np.uint8) for text in self.agent.motion_key)
        return (*texts, np.array([self.cuts]))


@dataclass(frozen=True, eq=False)
class MatrixMaps:
    """The maps of a linear agent: one slope for all cells, and nothing but rounding is left.

    Parameters
    ----------
    linear : LinearMeans
    """

    linear: LinearMeans
    cuts = 1  # there is nothing to enclose
    network = None

    def around(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> AffineBoxes:
        """Return the maps of the closed cells ``[low, high]``, (n, d) each, under inputs (A, m)."""
        moves, middle = self.linear, 0.5 * (low + high)
        centre = (middle @ moves.A.T + moves.offset)[:, None] + input_set @ moves.B.T
        gain = np.broadcast_to(moves.A, (len(low), 1, *moves.A.shape))
        return AffineBoxes(centre, gain, np.broadcast_to(moves.rounding, (len(low), 1, len(moves.rounding))))

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that maps depend on, for comparing relations."""
        return self.linear.arrays


@dataclass(frozen=True, eq=False, repr=False)
class MapRelation(ReadsCells):
    """The relation ``linear``: constant inputs, whose means are affine maps in a cell, and targets beside them.

    Choices below the number of inputs are inputs; ``number of inputs + z`` puts the mean on lattice point z from all
    of the cell.

    Parameters
    ----------
    means : AffineMaps
        What makes the maps of inputs.
    menu : (A, m) array
        Inputs to choose from; for networks they stand for nothing, and the choices are their modes.
    parts : int
        Parts of each side of a cell at whose ends the value on its image is read, to see how it bends.
    reach : tuple of int
        Lattice steps along each axis around the mean of a centre within which the lattice is looked at.
    aims : ExactRelation or WrittenTargets, optional
        What puts means on targets; None for agents whose inputs do not reach all means, and for networks.
    """

    means: AffineMaps
    input_set: FloatArray
    parts: int = 1
    reach: tuple[int, ...] = ()
    mean_targets: ExactRelation | SymbolicTargets | None = None

    kind = "linear"
    delta = 0.0

    def __repr__(self) -> str:
        d, m = len(self.reach), self.input_set.shape[1]
        targets = "" if self.mean_targets is None else ", and targets"
        choices = counted(len(self.input_set), "choice")
        return f"MapRelation({counted(d, 'state')}, {counted(m, 'input')}, {choices}{targets})"

    @property
    def network(self) -> Any:
        """The network whose modes are the choices, if one moves the agent."""
        return self.means.network

    @property
    def matrices(self) -> tuple[Any, FloatArray] | None:
        """The exact relation of its targets, or None, and its inputs; None beside networks, and targets of others."""
        mean_targets = (None, None) if self.mean_targets is None else self.mean_targets.matrices
        return (
            None
            if self.network is not None or mean_targets is None
            else (mean_targets[0], np.asarray(self.input_set, dtype=float))
        )

    def mean_boxes(self, low: FloatArray, high: FloatArray) -> MeanBoxes:
        """Return boxes around the means of inputs from the closed cells ``[low, high]``, (n, d) each (outer bounds)."""
        maps, half = self.means.around(low, high, self.input_set), 0.5 * (high - low) * (1.0 + COMPUTED)
        reach = np.einsum("nakj,nj->nak", np.abs(maps.gain), half) + maps.rest
        least, most = maps.centre - reach, maps.centre + reach
        return MeanBoxes(least, most, np.all(np.isfinite(least) & np.isfinite(most), axis=2))

    def describe(self) -> dict[str, Any]:
        """Return the description that files hold."""
        blocks = [block_of(n) for n in self.reach]
        numbers = {"parts": self.parts, "cuts": self.means.cuts, "reach": [*self.reach], "blocks": blocks}
        network = {} if self.network is None else {"network": self.network.description}
        mean_targets = {} if self.mean_targets is None else {"aims": True}
        return {"kind": "linear", "menu": self.input_set.tolist(), **numbers, **network, **mean_targets}

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All numbers, for comparing relations."""
        of_aims = () if self.mean_targets is None else (np.ones(1), *self.mean_targets.arrays)
        numbers = np.array([self.parts, *self.reach])
        return (*self.means.arrays, self.input_set, numbers, *of_aims)

    def rounding_loss(self, agent: AnyAgent, edges: Sequence[FloatArray]) -> float:
        """Return an upper bound on what carrying the relation out in floating point costs per step, a probability.

        What means under inputs are off by is in what is left of them; there remains what means miss targets by.
        """
        return 0.0 if self.mean_targets is None else self.mean_targets.rounding_loss(agent, edges)


def block_of(reach: int) -> int:
    """Return the lattice points of a block along an axis: those for which largest differences are taken at once."""
    return max(2, reach // BLOCKS) if reach >= LEAST_REACH else 1


def map_relation(
    agent: AnyAgent,
    input_set: FloatArray,
    numbers: tuple[int, int, Sequence[int]] | None = None,
    with_aims: bool = False,
) -> MapRelation:
    """Return the relation ``linear`` of an agent.

    Parameters
    ----------
    agent : AnyAgent
    menu : (A, m) array
        Inputs to choose from.
    numbers : parts, cuts and reach, optional
        See ``MapRelation`` and ``AffineMeans``.
    with_aims : bool
        Whether targets are offered beside the inputs, which inputs must reach all means for.

    Raises
    ------
    ValueError
        If an input is outside its box, or targets are asked for and not all means can be reached.
    """
    box, d = agent.input_box, agent.n_states
    if not len(input_set) or not np.all((box.low <= input_set) & (input_set <= box.high)):
        raise RelationRefused(f"agent `{agent.name}`: the linear relation needs inputs inside their box")
    parts, cuts, reach = numbers or (1, 1, (0,) * d)
    means: AffineMaps
    if agent.is_affine:
        means = MatrixMaps(linear_means(linear_agent(agent, "linear")))
    else:
        means = AffineMeans(with_expressions(agent), cuts)
    mean_targets = aimed_relation(agent) if with_aims else None
    return MapRelation(means, input_set, parts, tuple(int(n) for n in reach), mean_targets)
