"""Controllers of all agents in many worlds at once: agents that share grid, relation and menu act in one call."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..envs.dynamics import Draws, Dynamics, Worlds
from .abstract_state import Memory
from .agent_controller import AgentController
from .grid import FloatArray


@dataclass(frozen=True, eq=False)
class Group:
    """Agents of one block that share grid and relation: their places in the block, and their common controller."""

    members: NDArray[np.int64]
    controller: AgentController


@dataclass(frozen=True, eq=False)
class BatchMemory:
    """Memory of a batch: one entry per group of each block, and the generator of auxiliary draws."""

    groups: tuple[tuple[Memory | None, ...], ...]
    rng: Draws

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
    def of(cls, agents: Sequence[AgentController], dynamics: Dynamics) -> BatchController:
        """Group the agents of each block of ``dynamics``."""
        blocks, shapes = [], []
        for block in dynamics.blocks:
            groups: dict[object, list[int]] = {}
            for k, i in enumerate(block.agents):
                groups.setdefault(_signature(agents[i]), []).append(k)
            blocks.append(tuple(_group(agents, block.agents, members) for members in groups.values()))
            shapes.append((block.B.shape[1], len(block.agents)))
        return cls(tuple(blocks), tuple(shapes))

    def begin(self, worlds: Worlds, rng: Draws) -> BatchMemory:
        """Memory at time 0; agents with a coupling F take one auxiliary draw per step and world from ``rng``."""
        pairs = zip(self.blocks, worlds.states, strict=True)
        memory = tuple(tuple(g.controller.begin(states[:, g.members]) for g in groups) for groups, states in pairs)
        return BatchMemory(memory, rng)

    def selected(self, memory: BatchMemory, which: NDArray[Any]) -> BatchMemory:
        """Memory of the worlds ``which`` alone, whole numbers in increasing order."""
        groups = (tuple(own and own.selected(which) for own in block) for block in memory.groups)
        return BatchMemory(tuple(groups), memory.rng)

    def act(self, worlds: Worlds, memory: BatchMemory) -> tuple[tuple[FloatArray, ...], BatchMemory]:
        """Inputs (m, n, M) per block, and the memory for the next step."""
        result, remembered = [], []
        for groups, memories, (m, n), states in zip(
            self.blocks, memory.groups, self.shapes, worlds.states, strict=True
        ):
            inputs, kept = [], []
            for group, own in zip(groups, memories, strict=True):
                uniform = memory.rng.random((len(group.members), worlds.n_worlds)) if group.controller.draws else None
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
    """What agents that act in one call have in common: all but their names and what their laws hold."""
    arrays = (*agent.grid.edges, *agent.lattice, *agent.relation.arrays)
    menu = b"" if agent.menu is None else sha256(agent.menu.tobytes()).digest()
    return (agent.relation.kind, len(agent.law), menu, *(a.tobytes() for a in arrays))


def _group(agents: Sequence[AgentController], block: NDArray[Any], members: list[int]) -> Group:
    first = agents[block[members[0]]]
    law = np.stack([agents[block[k]].law for k in members])
    shared = AgentController("", first.grid, first.lattice, first.relation, law, first.menu)
    return Group(np.array(members), shared)
