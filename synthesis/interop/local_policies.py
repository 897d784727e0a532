"""Decentralised policies for batched rollouts, as they are: nothing is put on cells, inputs beyond the box saturate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Dynamics, Worlds
from ..certificates.controllers import LOCAL, Decentralised

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class LocalController:
    """Decentralised policies, not wrapped on cells ("raw"), for batched rollouts; inputs beyond the box saturate."""

    policy: Decentralised

    information = LOCAL

    def inputs(self, agent: int, states: Array, q: Array, time: int) -> Array:
        """Return the inputs (m, N) of one agent at states (d, N), automaton states (N,) and a time."""
        return self.policy.inputs(agent, states, q, time)

    def batch(self, dynamics: Dynamics) -> LocalBatch:
        """Return the policy for batches of ``dynamics``."""
        return LocalBatch(self.policy, dynamics)


@dataclass(frozen=True, eq=False)
class LocalBatch:
    """Decentralised policies arranged for batches; nothing is remembered."""

    policy: Decentralised
    dynamics: Dynamics

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> None:
        """Return no memory."""
        return None

    def act(self, worlds: Worlds, memory: Any) -> tuple[tuple[Array, ...], Any]:
        """Return inputs (m, n, M) per block; decided worlds, whose states may be anything, get the input 0."""
        # Ask only about undecided worlds: functions of users need not handle states outside the workspace.
        going = np.flatnonzero(~(worlds.failed | worlds.accepted))
        q, time, result = worlds.q[going], int(worlds.time), []
        for block, states in zip(self.dynamics.blocks, worlds.states, strict=True):
            inputs = np.zeros((block.n_inputs, len(block.agents), worlds.n_worlds))
            for k, agent in enumerate(block.agents):
                inputs[:, k, going] = self.policy.inputs(int(agent), states[:, k, going], q, time)
            result.append(inputs)
        return tuple(result), None
