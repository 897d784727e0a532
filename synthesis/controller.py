"""Per-agent finite-memory controllers that carry out a policy on the continuous system.

Each agent sees its own state, the shared automaton state and the time (THEORY section 6).

``exact``   the cell of its state decides the target mean, and the input puts the mean of the next state on it.
coupled     (``paper``, ``tube``, ``ellipsoid``) the agent remembers the abstract state xhat. From the next state it
            recovers the noise ``w``, draws the abstract noise from the coupling, ``what = w + F e`` with probability
            ``min(1, phi(what)/phi(w))`` and its mirror image otherwise (always ``what = w`` where F = 0), and moves
            xhat as the finite model does. When ``x - xhat`` leaves the relation the certificate claims nothing any
            more; the agent starts again from the cell of its state.

Controllers are total: outside the workspace, in states and at times that no certificate speaks of, the input is the one
of the nearest cell, and always admissible.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..envs.dynamics import Dynamics, Worlds
from ..envs.problem import Problem
from .abstraction import Relation
from .grid import FloatArray, Grid
from .lookup import cell_finder
from .relation_coupled import CoupledRelation, couple
from .relation_exact import ExactRelation, apply

MOST_AIMS = 1 << 22
"""Largest law whose lattice points are looked up once for all."""


@dataclass(frozen=True, eq=False)
class Memory:
    """What coupled agents remember between steps, for the n agents of a group and M worlds.

    Parameters
    ----------
    cells : (n, M) int array
        Abstract states xhat, as cells.
    states, inputs, means : (d, n, M), (m, n, M), (d, n, M) arrays
        State (grid coordinates) and input of the last step, and the mean of the abstract successor.
    lost : (n, M) bool array
        Whether the relation was ever lost.
    """

    cells: NDArray[Any]
    states: FloatArray
    inputs: FloatArray
    means: FloatArray
    lost: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class AgentController:
    """Controller of one agent, or of n agents that share grid and relation.

    Parameters
    ----------
    name : str
    grid : Grid
    lattice : tuple of (Z_k,) arrays
        Means per axis, in grid coordinates.
    relation : Relation
    law : (T, Q, S) int32 array, or (n, T, Q, S) for n agents
        Choice in each cell by time and automaton state; -1 where there is none. The last time's goes on for ever.
    menu : (S, A) int32 array or None
        Lattice point that each input of each cell leads to (coupled agents).
    """

    name: str
    grid: Grid
    lattice: tuple[FloatArray, ...]
    relation: Relation
    law: NDArray[np.int32]
    menu: NDArray[np.int32] | None = None

    @property
    def is_coupled(self) -> bool:
        """Whether it remembers an abstract state."""
        return isinstance(self.relation, CoupledRelation)

    @cached_property
    def _laws(self) -> NDArray[np.int32]:
        return self.law if self.law.ndim == 4 else self.law[None]

    def begin(self, states: FloatArray) -> Memory | None:
        """Memory at time 0 for states (d, n, M): the cells of the states."""
        if not self.is_coupled:
            return None
        nothing = np.zeros(states.shape)
        cells = self.grid.cell_of(self.project(states))
        return Memory(cells, nothing, nothing, nothing, np.zeros(cells.shape, dtype=bool))

    def act(
        self, states: FloatArray, q: NDArray[Any], time: int, memory: Memory | None, uniform: FloatArray | None = None
    ) -> tuple[FloatArray, Memory | None]:
        """Inputs (m, n, M) at states (d, n, M) and automaton states (M,), the same bits for any number of worlds.

        Coupled agents take ``uniform`` (n, M), one auxiliary draw per step.
        """
        if memory is not None and isinstance(self.relation, CoupledRelation):
            points = self.relation.to_grid(states)
            if time > 0 and uniform is not None:
                memory = follow(self.relation, self.grid, memory, points, uniform)
            return self._coupled(self.relation, memory, points, q, time)
        points = self.project(states)
        return self._towards(self._places(self._cell_of(points), q, time), points, time), None

    def _places(self, cells: NDArray[Any], q: NDArray[Any], time: int) -> NDArray[np.int64]:
        """Places (n, M) in the flat laws for cells (n, M) and automaton states (M,)."""
        n, n_times, n_states, n_cells = self._laws.shape
        rows = q.astype(np.intp)
        rows += min(time, n_times - 1) * n_states
        rows *= n_cells
        places = cells + rows
        if n > 1:
            places += self._first_places
        return places

    @cached_property
    def _first_places(self) -> NDArray[np.int64]:
        """Where the law of each agent begins in the flat laws, (n, 1)."""
        return np.arange(0, self._laws.size, self._laws[0].size)[:, None]

    def _choice(self, cells: NDArray[Any], q: NDArray[Any], time: int) -> NDArray[np.int32]:
        """Choices (n, M) in cells (n, M) and automaton states (M,)."""
        return self._laws.reshape(-1).take(self._places(cells, q, time))

    def _towards(self, places: NDArray[Any], points: FloatArray, time: int) -> FloatArray:
        """Inputs that put the mean of the next state where the laws say, from points (d, n, M) of the grid."""
        assert isinstance(self.relation, ExactRelation)
        aims = [own.take(places) for own in self._aims] if self._aims else self._aims_of(self._laws.take(places))
        inputs = self.relation.inputs(aims, points)
        if self._idles[min(time, len(self._idles) - 1)]:
            inputs[:, np.isnan(aims[0])] = self.relation.input_centre[:, None]
        return inputs

    @cached_property
    def _aims(self) -> list[FloatArray]:
        """``_aims_of`` all laws, flat; empty if there were too many."""
        return [] if self._laws.size > MOST_AIMS else self._aims_of(self._laws.reshape(-1))

    def _aims_of(self, choices: NDArray[np.int32]) -> list[FloatArray]:
        """Per axis, what ``ExactRelation.inputs`` takes for choices; not a number where there is none."""
        assert isinstance(self.relation, ExactRelation)
        aims = self.relation.aims(_means(self.lattice, np.maximum(choices, 0)))
        aims[0, choices < 0] = np.nan
        return list(aims)

    @cached_property
    def _idles(self) -> NDArray[np.bool_]:
        """Whether there are, at each time, cells without a choice."""
        return np.asarray((self._laws < 0).any(axis=(0, 2, 3)))

    def _coupled(
        self, relation: CoupledRelation, memory: Memory, points: FloatArray, q: NDArray[Any], time: int
    ) -> tuple[FloatArray, Memory]:
        """Inputs ``uhat + K e`` and the memory of this step.

        The input is admissible by the relation; only where the relation is lost it is moved into the input box.
        """
        assert self.menu is not None
        choice = np.maximum(self._choice(memory.cells, q, time), 0)
        shape = (-1, *[1] * memory.cells.ndim)
        reach = relation.reach.reshape(shape)
        error = np.nan_to_num(points - np.moveaxis(self._centres[memory.cells], -1, 0))
        lost = ~relation.related(error)
        inputs = np.moveaxis(relation.inputs[choice], -1, 0) + apply(relation.feedback, np.clip(error, -reach, reach))
        admissible = np.clip(inputs, relation.input_low.reshape(shape), relation.input_high.reshape(shape))
        inputs = np.where(lost | memory.lost, admissible, inputs)
        means = _means(self.lattice, self.menu[memory.cells, choice])
        return inputs, Memory(memory.cells, points, inputs, means, memory.lost)

    @cached_property
    def _centres(self) -> FloatArray:
        return self.grid.centres

    @cached_property
    def _cell_of(self) -> Callable[[FloatArray], NDArray[np.int64]]:
        return cell_finder(self.grid)

    def project(self, states: FloatArray) -> FloatArray:
        """Grid coordinates of the states, moved into the grid where they are outside; NaN goes to the low edge."""
        return _into(self.grid, states if self._in_state_coordinates else self.relation.to_grid(states))

    @cached_property
    def _in_state_coordinates(self) -> bool:
        return self.relation.has_state_coordinates


def follow(relation: CoupledRelation, grid: Grid, memory: Memory, points: FloatArray, uniform: FloatArray) -> Memory:
    """Move the abstract states along with the continuous ones, now at grid coordinates ``points`` (d, n, M)."""
    column = (-1, *[1] * memory.cells.ndim)
    centres = grid.centres
    with np.errstate(over="ignore", invalid="ignore"):
        expected = apply(relation.A, memory.states) + apply(relation.B, memory.inputs) + relation.drift.reshape(column)
        noise = points - expected
        if np.any(relation.coupling):
            deviation = np.sqrt(relation.covariance).reshape(column)
            error = memory.states - np.moveaxis(centres[memory.cells], -1, 0)
            noise = deviation * couple(noise / deviation, apply(relation.coupling, error) / deviation, uniform)
        landed = memory.means + noise
        inside = np.ones(memory.cells.shape, dtype=bool)
        for edges, own in zip(grid.edges, landed, strict=True):
            inside &= (edges[0] <= own) & (own <= edges[-1])
        cells = grid.cell_of(_into(grid, landed))
        kept = inside & relation.related(points - np.moveaxis(centres[cells], -1, 0))
    again = grid.cell_of(_into(grid, points))
    return Memory(np.where(kept, cells, again), points, memory.inputs, memory.means, memory.lost | ~kept)


def _into(grid: Grid, points: FloatArray) -> FloatArray:
    """Points moved into the grid; NaN goes to the low edge."""
    inside = np.empty(points.shape)
    for own, moved, edges in zip(points, inside, grid.edges, strict=True):
        np.fmax(own, float(edges[0]), out=moved)  # fmax passes over NaN
        np.fmin(moved, float(edges[-1]), out=moved)
    return inside


def _means(lattice: tuple[FloatArray, ...], flat: NDArray[Any]) -> FloatArray:
    """Lattice points (d, n, M) by their flat numbers (n, M)."""
    indices = np.unravel_index(flat, tuple(len(axis) for axis in lattice)) if len(lattice) > 1 else (flat,)
    return np.stack([axis.take(index) for axis, index in zip(lattice, indices, strict=True)])


@dataclass(frozen=True, eq=False)
class Controller:
    """Controllers of all agents of a problem, usable in a PettingZoo loop and in batched rollouts.

    The information structure is that of the certificate: own state, shared automaton state, time, and per coupled
    agent its abstract state.

    Parameters
    ----------
    problem : Problem
    agents : tuple of AgentController
    """

    problem: Problem
    agents: tuple[AgentController, ...]
    _episode: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def _by_name(self) -> dict[str, AgentController]:
        return {agent.name: agent for agent in self.agents}

    def reset(
        self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None, seed: int | None = None
    ) -> None:
        """Begin an episode with the observations of ``env.reset``.

        ``seed`` fixes the auxiliary draws of coupled agents; there are none under the ``exact`` relation.

        Raises
        ------
        ValueError
            If the agents are not those of the controller's problem.
        """
        strangers = sorted(set(observations) ^ set(self._by_name))
        if strangers:
            raise ValueError(
                f"`observations`: expected exactly the agents of problem {self.problem.name!r}, got a mismatch at "
                f"{', '.join(strangers[:5])}; reset the controller of this environment's own problem"
            )
        if seed is not None or "rng" not in self._episode:
            self._episode["rng"] = np.random.default_rng(seed)
        self._episode["memory"] = {}

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, FloatArray]:
        """Action of every agent observed: name -> (m,) float64.

        The state is read from the observation, or from ``infos[agent]`` (keys ``state``, ``automaton_state``, ``time``)
        where that is given: it survives wrappers that round or rescale observations.
        """
        actions = {}
        for name, observation in observations.items():
            if name not in self._by_name:
                raise ValueError(
                    f"`observations`: expected agents of problem {self.problem.name!r}, got {name!r}; act in its own "
                    "environment"
                )
            agent = self._by_name[name]
            info = infos.get(name) if infos is not None else None
            if info is not None and "state" in info:
                state, q, time = info["state"], int(info["automaton_state"]), int(info["time"])
            else:
                state, q, time = self._read(agent, np.asarray(observation, dtype=float))
            actions[name] = self._act_one(agent, np.asarray(state, dtype=float)[:, None, None], q, time)
        return actions

    def _act_one(self, agent: AgentController, state: FloatArray, q: int, time: int) -> FloatArray:
        """Action of one agent, its memory kept between calls of one episode."""
        if not agent.is_coupled:
            return np.ascontiguousarray(agent.act(state, np.array([q]), time, None)[0][:, 0, 0])
        memories, rng = self._episode.setdefault("memory", {}), self._episode.setdefault("rng", np.random.default_rng())
        if time == 0 or agent.name not in memories:
            memories[agent.name] = agent.begin(state)
        inputs, memories[agent.name] = agent.act(state, np.array([q]), time, memories[agent.name], rng.random((1, 1)))
        return np.ascontiguousarray(inputs[:, 0, 0])

    def _read(self, agent: AgentController, observation: FloatArray) -> tuple[FloatArray, int, int]:
        """State, automaton state and time in an observation (own state, one-hot automaton state, fraction left)."""
        d, n_q = len(agent.grid.edges), self.problem.automaton.n_states
        if observation.shape != (d + n_q + 1,):
            raise ValueError(
                f"`observations`: expected {d + n_q + 1} numbers for agent `{agent.name}` (state, automaton state, "
                f"time left), got shape {observation.shape}"
            )
        q = int(np.argmax(observation[d : d + n_q]))
        return observation[:d], q, round((1.0 - float(observation[-1])) * self.problem.horizon)

    def batch(self, dynamics: Dynamics) -> BatchController:
        """The same controllers for batched rollouts of ``dynamics``."""
        return BatchController.of(self, dynamics)


@dataclass(frozen=True, eq=False)
class Group:
    """Agents of one block that share grid and relation: their places in the block, and their common controller."""

    members: NDArray[np.int64]
    controller: AgentController


@dataclass(frozen=True, eq=False)
class BatchMemory:
    """Memory of a batch: one entry per group of each block, and the generator of auxiliary draws."""

    groups: tuple[tuple[Memory | None, ...], ...]
    rng: np.random.Generator

    @property
    def lost(self) -> NDArray[np.bool_] | None:
        """(M,) whether any agent's relation was ever lost; None if there is nothing to lose."""
        flags = [memory.lost.any(axis=0) for block in self.groups for memory in block if memory is not None]
        return np.logical_or.reduce(flags) if flags else None


@dataclass(frozen=True, eq=False)
class BatchController:
    """Controllers arranged for batches: agents with the same grid and relation act in one call."""

    blocks: tuple[tuple[Group, ...], ...]
    shapes: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, controller: Controller, dynamics: Dynamics) -> BatchController:
        """Group the agents of each block of ``dynamics``."""
        blocks, shapes = [], []
        for block in dynamics.blocks:
            groups: dict[object, list[int]] = {}
            for k, i in enumerate(block.agents):
                groups.setdefault(_signature(controller.agents[i]), []).append(k)
            blocks.append(tuple(_group(controller.agents, block.agents, members) for members in groups.values()))
            shapes.append((block.B.shape[1], len(block.agents)))
        return cls(tuple(blocks), tuple(shapes))

    @property
    def is_memoryless(self) -> bool:
        """Whether inputs depend on state, automaton state and time alone, whatever worlds are beside."""
        return not any(group.controller.is_coupled for groups in self.blocks for group in groups)

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> BatchMemory:
        """Memory at time 0; coupled agents take one auxiliary draw per step and world from ``rng``."""
        pairs = zip(self.blocks, worlds.states, strict=True)
        memory = tuple(tuple(g.controller.begin(states[:, g.members]) for g in groups) for groups, states in pairs)
        return BatchMemory(memory, rng)

    def act(self, worlds: Worlds, memory: BatchMemory) -> tuple[tuple[FloatArray, ...], BatchMemory]:
        """Inputs (m, n, M) per block, and the memory for the next step."""
        result, remembered = [], []
        for groups, memories, (m, n), states in zip(
            self.blocks, memory.groups, self.shapes, worlds.states, strict=True
        ):
            inputs, kept = [], []
            for group, own in zip(groups, memories, strict=True):
                uniform = memory.rng.random((len(group.members), worlds.n_worlds)) if own is not None else None
                here = states if len(groups) == 1 else states.take(group.members, axis=1)
                chosen, own = group.controller.act(here, worlds.q, worlds.time, own, uniform)
                inputs.append(chosen)
                kept.append(own)
            result.append(inputs[0] if len(groups) == 1 else _placed(groups, inputs, (m, n, worlds.n_worlds)))
            remembered.append(tuple(kept))
        return tuple(result), BatchMemory(tuple(remembered), memory.rng)


def _placed(groups: Sequence[Group], parts: Sequence[FloatArray], shape: tuple[int, int, int]) -> FloatArray:
    """Inputs (m, n, M) of a block from those of its groups."""
    inputs = np.empty(shape)
    for group, part in zip(groups, parts, strict=True):
        inputs[:, group.members] = part
    return inputs


def _signature(agent: AgentController) -> object:
    arrays = (*agent.grid.edges, *agent.lattice, *agent.relation.arrays)
    return (agent.relation.kind, *(a.tobytes() for a in arrays))


def _group(agents: Sequence[AgentController], block: NDArray[Any], members: list[int]) -> Group:
    first = agents[block[members[0]]]
    law = np.stack([agents[block[k]].law for k in members])
    shared = AgentController("", first.grid, first.lattice, first.relation, law, first.menu)
    return Group(np.array(members), shared)
