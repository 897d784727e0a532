"""Policies for batched rollouts: decentralised policies of any form, random inputs, and no effort at all.

All of them serve ``rollout`` and ``compare``, and say what information they use.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Dynamics, Worlds
from ...envs.suite import as_problem
from ...synthesis.interop import batchable
from ..statistical_tests import Batchable, BatchPolicy

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class RandomController:
    """A controller whose inputs are uniform in the input boxes, drawn from the auxiliary stream of the rollouts."""

    information = "none (uniformly random inputs)"

    def batch(self, dynamics: Dynamics) -> RandomBatch:
        """Return the policy for batches of ``dynamics``."""
        return RandomBatch(dynamics)


@dataclass(frozen=True, eq=False)
class RandomBatch:
    """Random inputs arranged for batches; the memory is the generator."""

    dynamics: Dynamics

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> np.random.Generator:
        """Return the generator as the memory."""
        return rng

    def act(self, worlds: Worlds, memory: np.random.Generator) -> tuple[tuple[Array, ...], np.random.Generator]:
        """Return inputs (m, n, M) per block."""
        drawn = []
        for block in self.dynamics.blocks:
            share = memory.random((*block.input_low.shape[:2], worlds.n_worlds))
            inputs = block.input_low + (block.input_high - block.input_low) * share
            drawn.append(np.minimum(inputs, block.input_high))  # rounding may lead beyond the upper face
        return tuple(drawn), memory


@dataclass(frozen=True, eq=False)
class IdleController:
    """A controller whose input is always the middle of the input box."""

    information = "none (central input)"

    def batch(self, dynamics: Dynamics) -> IdleBatch:
        """Return the policy for batches of ``dynamics``."""
        return IdleBatch(dynamics)


@dataclass(frozen=True, eq=False)
class IdleBatch:
    """Central inputs arranged for batches; nothing is remembered."""

    dynamics: Dynamics

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> None:
        """Return no memory."""
        return None

    def act(self, worlds: Worlds, memory: Any) -> tuple[tuple[Array, ...], Any]:
        """Return inputs (m, n, M) per block."""
        middles = [0.5 * block.input_low + 0.5 * block.input_high for block in self.dynamics.blocks]
        return tuple(np.repeat(middle, worlds.n_worlds, axis=-1) for middle in middles), None


@dataclass(frozen=True, eq=False)
class NoisyController:
    """An expert of which every agent takes a uniformly random input at a share of its steps.

    Parameters
    ----------
    expert : object with ``batch(dynamics)``
    share : float
        From 0, the expert itself, to 1, random inputs.
    sees : str
        What the agents of the expert see.
    """

    expert: Batchable
    share: float
    sees: str

    @property
    def information(self) -> str:
        """What agents see, and how often they do not look."""
        return f"{self.sees}; random inputs at {100.0 * self.share:.4g} % of the steps"

    def batch(self, dynamics: Dynamics) -> NoisyBatch:
        """Return the policy for batches of ``dynamics``."""
        return NoisyBatch(self.expert.batch(dynamics), RandomBatch(dynamics), self.share)


@dataclass(frozen=True, eq=False)
class NoisyBatch:
    """A policy with random inputs, arranged for batches; the memory is that of the policy, and the generator."""

    policy: BatchPolicy
    random: RandomBatch
    share: float

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> tuple[Any, np.random.Generator]:
        """Return the memory of the policy, and the generator."""
        return self.policy.begin(worlds, rng), rng

    def act(self, worlds: Worlds, memory: tuple[Any, np.random.Generator]) -> tuple[tuple[Array, ...], Any]:
        """Return inputs (m, n, M) per block."""
        chosen, own = self.policy.act(worlds, memory[0])
        drawn, rng = self.random.act(worlds, memory[1])
        mixed = [np.where(rng.random(u.shape[1:]) < self.share, v, u) for u, v in zip(chosen, drawn, strict=True)]
        return tuple(mixed), (own, rng)


def as_controller(problem: Any, policy: Any) -> Any:
    """Return policies of any form as a controller for ``rollout`` and ``compare``.

    Parameters
    ----------
    problem : Problem, id or path
    policy : mapping, function, InputTable, controller, actor or model
        As for ``certify`` and ``as_policy``: one policy for all agents, or one per agent by name.
    """
    return batchable(policy, as_problem(problem))
