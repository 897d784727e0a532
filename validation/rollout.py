"""Batched rollouts of the continuous system.

Worlds are simulated in chunks of fixed size. Each chunk draws its starts and its noise from a generator of its own,
``SeedSequence(seed, spawn_key=(chunk,))``, and draws them whatever the policy does: results do not depend on the order
in which chunks are computed, and two policies with one seed meet the same noise (common random numbers). Auxiliary
draws of a policy come from a stream of their own, ``spawn_key=(chunk, 1)``. The chunk size is part of the record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..envs import dynamics as core
from ..envs.dynamics import Dynamics, Worlds
from ..envs.problem import Problem

CHUNK = 2000
"""Worlds per chunk: large enough for numpy, small enough for the cache."""


class BatchPolicy(Protocol):
    """Anything that chooses the inputs of all worlds at once; what it remembers is handed to it and handed back."""

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> Any:
        """Memory at time 0; ``rng`` serves auxiliary draws of the policy, of which there are none for most."""

    def act(self, worlds: Worlds, memory: Any) -> tuple[tuple[NDArray[Any], ...], Any]:
        """Inputs (m, n, M) per block of the dynamics, and the memory for the next step."""


class Batchable(Protocol):
    """Anything that can be arranged for batches, such as ``certigym.synthesis.controller.Controller``."""

    def batch(self, dynamics: Dynamics) -> BatchPolicy:
        """The policy for batches of ``dynamics``."""


@dataclass(frozen=True, eq=False)
class Rollouts:
    """Outcomes of M independent episodes of one closed loop.

    Parameters
    ----------
    success : (M,) bool array
        Whether each episode satisfied the task, in index order.
    seed : int
    chunk : int
        Worlds per chunk; with the seed it determines every number drawn.
    """

    success: NDArray[np.bool_]
    seed: int
    chunk: int

    @property
    def episodes(self) -> int:
        """Number of episodes M."""
        return len(self.success)

    @property
    def successes(self) -> int:
        """Number of episodes that satisfied the task."""
        return int(self.success.sum())


def rollout(
    problem: Problem,
    controller: Batchable,
    episodes: int,
    seed: int = 0,
    *,
    initial_state: Any = None,
    chunk: int = CHUNK,
    progress: Callable[[int], None] | None = None,
) -> Rollouts:
    """Simulate ``episodes`` episodes of the continuous system under ``controller``.

    Parameters
    ----------
    problem : Problem
    controller : object with ``batch(dynamics)``
    episodes : int
        Positive.
    seed : int
        Not negative.
    initial_state : optional
        Start of every episode, as in ``Problem.replace``; default: the problem's own start.
    chunk : int
        Worlds per chunk.
    progress : callable, optional
        Called with the number of episodes finished since the last call.

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    for name, value, least in (("episodes", episodes, 1), ("seed", seed, 0), ("chunk", chunk, 1)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise ValueError(f"`{name}`: expected a whole number of at least {least}, got {value!r}")
    if initial_state is not None:
        problem = problem.replace(initial_state=initial_state)
    dynamics = Dynamics.of(problem)
    policy = controller.batch(dynamics)
    success = np.empty(episodes, dtype=bool)
    for number, first in enumerate(range(0, episodes, chunk)):
        worlds = min(chunk, episodes - first)
        success[first : first + worlds] = run_chunk(dynamics, policy, seed, number, chunk)[:worlds]
        if progress is not None:
            progress(worlds)
    return Rollouts(success, int(seed), int(chunk))


def run_chunk(dynamics: Dynamics, policy: BatchPolicy, seed: int, number: int, size: int) -> NDArray[np.bool_]:
    """Success of the worlds of one chunk, always ``size`` of them, so that every episode keeps its noise."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    worlds = core.initial(dynamics, rng, size)
    memory = policy.begin(worlds, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, 1))))
    for _ in range(dynamics.problem.horizon):
        if np.all(worlds.failed | worlds.accepted):
            break
        inputs, memory = policy.act(worlds, memory)
        worlds = core.transition(dynamics, worlds, inputs, core.noise(dynamics, rng, size))
    return np.asarray(core.satisfied(dynamics, worlds))
