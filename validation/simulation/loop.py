"""What is simulated: a problem, a policy for batches of worlds, and the seed that determines every number drawn."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...envs.dynamics import Dynamics, Worlds
from ...envs.problem import Problem
from .mismatch import Mismatch

CHUNK = 2000
"""Worlds per chunk: large enough for numpy, small enough for the cache."""


class BatchPolicy(Protocol):
    """Anything that chooses the inputs of all worlds at once; what it remembers is handed to it and handed back.

    A policy may have a method ``selected(memory, which)``, which returns what it remembers of the worlds ``which``
    alone, (k,) whole numbers in increasing order. With it the policy says that its inputs in one world are, to the last
    bit, the same whatever worlds are beside, that its draws are arrays whose last axis is that of the worlds, and that
    ``rng`` may be any ``envs.dynamics.Draws``. Its worlds are then simulated no further than they have to be, and
    inadmissible inputs are not looked for where no acceptance can be reached any more.
    """

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> Any:
        """Memory at time 0; ``rng`` serves auxiliary draws of the policy, of which there are none for most."""

    def act(self, worlds: Worlds, memory: Any) -> tuple[tuple[NDArray[Any], ...], Any]:
        """Inputs (m, n, M) per block of the dynamics, and the memory for the next step."""


class Batchable(Protocol):
    """Anything that can be arranged for batches, such as ``synthesis.controllers.Controller``."""

    def batch(self, dynamics: Dynamics) -> BatchPolicy:
        """The policy for batches of ``dynamics``."""


@dataclass(frozen=True, eq=False)
class Loop:
    """A closed loop and its random record: everything that determines the outcome of an episode.

    Parameters
    ----------
    problem : Problem
    controller : object with ``batch(dynamics)``
    seed : int
    chunk : int
        Worlds per chunk.
    starts : (N, D) array, optional
        Joint initial states; episode r begins at ``starts[r % N]``. Default: the problem's own start.
    mismatch : Mismatch, optional
        How the system differs from the model.
    """

    problem: Problem
    controller: Batchable
    seed: int
    chunk: int = CHUNK
    starts: NDArray[Any] | None = None
    mismatch: Mismatch | None = None

    def __post_init__(self) -> None:
        for name, least in (("seed", 0), ("chunk", 1)):
            check_whole(name, getattr(self, name), least)

    def __reduce__(self) -> tuple[type[Loop], tuple[Any, ...]]:
        """Workers are sent the fields alone; they arrange their own policies."""
        return Loop, tuple(getattr(self, field.name) for field in fields(self))

    @cached_property
    def arranged(self) -> tuple[Dynamics, BatchPolicy]:
        """Dynamics and policy, arranged once and not once per chunk."""
        dynamics = Dynamics.of(self.problem)
        return dynamics, self.controller.batch(dynamics)

    @cached_property
    def parts(self) -> tuple[Loop, ...]:
        """Loops of the independent tasks, each with noise of its own; the loop itself where there is one task.

        An episode succeeds if it does so in every part. Parts of co-safe tasks ask for more than the whole does (see
        ``envs.independent``): there it counts fewer successes than there are.
        """
        groups = self.problem.groups
        if not groups:
            return (self,)
        if not hasattr(self.controller, "parts"):
            raise ValueError(
                f"`controller`: expected a `ProductController` for {len(groups)} independent tasks, got "
                f"{type(self.controller).__name__}; simulate the problems of `problem.tasks` one by one"
            )
        seeds = np.random.SeedSequence(self.seed).generate_state(len(groups), np.uint64).tolist()
        loops = []
        tasks = zip(self.problem.tasks, self.controller.parts, self.columns, seeds, strict=True)
        for task, controller, columns, seed in tasks:
            starts = None if self.starts is None else self.starts[:, columns]
            loops.append(Loop(task, controller, seed, self.chunk, starts, self.mismatch))
        return tuple(loops)

    @cached_property
    def columns(self) -> tuple[NDArray[np.int64], ...]:
        """Components of a joint state that belong to each of the independent tasks."""
        ends = np.cumsum([0, *(agent.n_states for agent in self.problem.agents)])
        components = [np.arange(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
        return tuple(np.concatenate([components[i] for i in group.agents]) for group in self.problem.groups)


def check_whole(name: str, value: Any, least: int) -> None:
    """Raise ValueError unless a number is whole and large enough."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"`{name}`: expected a whole number of at least {least}, got {value!r}")
