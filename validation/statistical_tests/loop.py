"""What is simulated: a problem, a policy for batches of worlds, and the seed that determines every number drawn."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Behaviour, Dynamics, Worlds
from ...envs.systems.arguments import checked_count, counted, tree_text
from ...envs.tasks.problem import Problem
from .mismatch import Mismatch

CHUNK = 2000
"""Worlds per chunk: large enough for numpy, small enough for the cache."""


class BatchPolicy(Protocol):
    """Anything that chooses the inputs of all worlds at once; its memory is passed in and handed back.

    A policy may have a method ``selected(memory, which)``, which returns its memory of the worlds ``which`` alone, (k,)
    whole numbers in increasing order. A policy with this method promises three things: its inputs in one world are the
    same, to the last bit, with any other worlds beside it; its random draws are arrays whose last axis is that of the
    worlds; and ``rng`` may be any ``envs.dynamics.Draws``. Its worlds are then simulated only as long as their task is
    open, and inadmissible inputs in settled worlds are not counted.
    """

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> Any:
        """Return the memory at time 0; ``rng`` serves the policy's own draws, which most policies do not make."""

    def act(self, worlds: Worlds, memory: Any) -> tuple[tuple[NDArray[Any], ...], Any]:
        """Return inputs (m, n, M) per block of the dynamics, and the memory for the next step."""


class Batchable(Protocol):
    """Anything that can be arranged for batches, such as ``synthesis.controllers.Controller``."""

    def batch(self, dynamics: Dynamics) -> BatchPolicy:
        """Return the policy for batches of ``dynamics``."""


@dataclass(frozen=True, eq=False, repr=False)
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
    disturbance : "zero", "random", "periodic" or a function
        How bounded disturbances behave (``envs.dynamics.disturbances``).
    """

    problem: Problem
    controller: Batchable
    seed: int
    chunk: int = CHUNK
    starts: NDArray[Any] | None = None
    mismatch: Mismatch | None = None
    disturbance: Behaviour = "zero"

    def __post_init__(self) -> None:
        for name, least in (("seed", 0), ("chunk", 1)):
            checked_count(getattr(self, name), name, least)

    def __repr__(self) -> str:
        starts = "the problem's" if self.starts is None else counted(len(self.starts), "joint state")
        rows = [
            ("controller", type(self.controller).__name__),
            ("seed", f"{self.seed}, {counted(self.chunk, 'world')} per chunk"),
            ("starts", starts),
            ("mismatch", str(self.mismatch or Mismatch())),
        ]
        agents = counted(self.problem.n_agents, "agent")
        return tree_text(f"Loop {self.problem.name!r}: {agents}, horizon {self.problem.horizon}", rows)

    def __reduce__(self) -> tuple[type[Loop], tuple[Any, ...]]:
        """Send the fields alone to workers; they arrange the policy themselves."""
        return Loop, tuple(getattr(self, field.name) for field in fields(self))

    @cached_property
    def arranged(self) -> tuple[Dynamics, BatchPolicy]:
        """Dynamics and policy, arranged once for all chunks."""
        dynamics = Dynamics.of(self.problem, self.disturbance)
        return dynamics, self.controller.batch(dynamics)

    @cached_property
    def parts(self) -> tuple[Loop, ...]:
        """One loop per independent task, each with its own noise; the loop itself if there is one task.

        An episode succeeds if it succeeds in every task. A co-safe task that decomposes is judged more strictly task by
        task than as a whole (``envs/tasks/problem/groups.py``): then fewer episodes count as successes than really are.
        """
        groups = self.problem.groups
        if not groups:
            return (self,)
        if not hasattr(self.controller, "parts"):
            raise ValueError(
                f"`controller`: expected a `ProductController` for {len(groups)} independent tasks, got "
                f"{type(self.controller).__name__}; simulate the problems of `problem.tasks` one by one"
            )
        # Seeds of the tasks are derived from the seed of the whole, so that they share no noise.
        seeds = np.random.SeedSequence(self.seed).generate_state(len(groups), np.uint64).tolist()
        # Each loop gets the controller of its task, and its columns of the starts.
        loops = []
        tasks = zip(self.problem.tasks, self.controller.parts, self.columns, seeds, strict=True)
        for task, controller, columns, seed in tasks:
            starts = None if self.starts is None else self.starts[:, columns]
            loops.append(Loop(task, controller, seed, self.chunk, starts, self.mismatch, self.disturbance))
        return tuple(loops)

    @cached_property
    def columns(self) -> tuple[NDArray[np.int64], ...]:
        """Components of a joint state that belong to each of the independent tasks."""
        components = [np.arange(columns.start, columns.stop) for columns in self.problem.columns]
        return tuple(np.concatenate([components[i] for i in group.agents]) for group in self.problem.groups)
