"""Batched rollouts of the continuous system.

Worlds are simulated in chunks of fixed size. Each chunk draws its starts and its noise from a generator of its own,
``SeedSequence(seed, spawn_key=(chunk,))``, and draws them whatever the policy does: results do not depend on the order
in which chunks are computed nor on where, and two policies with one seed meet the same noise (common random numbers).
Auxiliary draws of a policy come from a stream of their own, ``spawn_key=(chunk, 1)``. The chunk size is part of the
record. Memory is that of the chunks under way, whatever the number of episodes.

Actuators saturate: an input beyond the input box acts as the nearest admissible one. Controllers of certificates never
ask for that; episodes in which one did (before it was decided) are counted as ``inadmissible``.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from ...envs.problem import Problem, checked_problem
from .chunks import ChunkResult, chunk_results, chunks_of
from .loop import Loop
from .mismatch import Mismatch
from .spread import AHEAD, Executor, in_order
from .trials import TrialOptions, TrialPlan, collect, planned

TOGETHER = 65536
"""Numbers that the states of chunks simulated side by side may have, if one chunk alone has fewer."""


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
    inadmissible : int
        Episodes in which an input beyond the input box was asked for before the episode was decided.
    """

    success: NDArray[np.bool_]
    seed: int
    chunk: int
    inadmissible: int = 0

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
    controller: Any,
    plan: TrialPlan | int | None = None,
    *,
    initial_state: Any = None,
    mismatch: Mismatch | None = None,
    **trial: Unpack[TrialOptions],
) -> Rollouts:
    """Simulate episodes of the continuous system under ``controller``, the same for any executor.

    Parameters
    ----------
    problem : Problem
    controller : Synthesis, certificate, or object with ``batch(dynamics)``
    plan, **trial
        Episodes (default 10,000), seed, chunk, executor, progress; see ``TrialPlan``.
    initial_state : optional
        Start of every episode, as in ``Problem.replace``; default: the problem's own start.
    mismatch : Mismatch, optional
        How the system differs from the model.

    Raises
    ------
    ValueError
        If a number is out of range.
    KeyboardInterrupt
        On Ctrl-C: policies can be compared only over the same episodes, so that a part of them is nothing.
    """
    checked_problem(problem)
    controller = getattr(controller, "controller", controller)  # of a synthesis or certificate
    if not hasattr(controller, "batch"):
        raise ValueError(
            f"`controller`: expected an object with `batch(dynamics)`, got {type(controller).__name__}; give a "
            "synthesis, a certificate, or `as_controller(problem, policy)`"
        )
    if initial_state is not None:
        problem = problem.replace(initial_state=initial_state)
    settled = planned(plan, trial, 10_000)
    loop = Loop(problem, controller, settled.seed, settled.chunk, mismatch=mismatch)
    parts: list[ChunkResult] = []

    def take(part: ChunkResult) -> None:
        parts.append(part)
        settled.tell(len(part.success))

    if collect(stream(loop, settled.episodes, settled.executor), take):
        raise KeyboardInterrupt
    success = np.concatenate([part.success for part in parts])
    return Rollouts(success, settled.seed, settled.chunk, sum(part.inadmissible for part in parts))


def stream(loop: Loop, episodes: int, executor: Executor | None = None) -> Generator[ChunkResult, None, None]:
    """Outcomes chunk by chunk in index order, ``episodes`` in all; nothing is kept."""
    beside = max(1, TOGETHER // (loop.chunk * loop.problem.n_states))
    if executor is not None:  # workers must not wait for one another
        beside = min(beside, max(1, episodes // (2 * AHEAD * loop.chunk)))
    chunks = chunks_of(episodes, loop.chunk)
    with closing(in_order(chunk_results, loop, _grouped(chunks, beside), executor)) as groups:
        for group in groups:
            yield from group


def _grouped(chunks: Iterator[tuple[int, int]], beside: int) -> Iterator[tuple[tuple[int, int], ...]]:
    while group := tuple(islice(chunks, beside)):
        yield group
