"""Batched rollouts of the continuous system.

Worlds are simulated in chunks of fixed size; ``chunks`` says which random numbers each chunk draws. The results depend
on seed and chunk size only: not on the order in which chunks are computed, nor on the machine that computes them. Two
policies with one seed meet the same noise. Only the chunks under way are in memory, however many episodes there are.

Actuators saturate: an input beyond the input box acts as the nearest admissible one. Controllers of certificates never
ask for such inputs. Episodes in which a policy did, before they were decided, are counted as ``inadmissible``.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Behaviour, checked_behaviour
from ...envs.suite import as_problem
from ...envs.systems.arguments import counted, tree_text
from ...synthesis.interop import batchable
from .chunks import ChunkResult, chunk_results, chunks_of
from .loop import Loop
from .mismatch import Mismatch
from .spread import AHEAD, Executor, in_order
from .trials import TrialOptions, TrialPlan, collect, names_plan, planned

NUMBERS_SIDE_BY_SIDE = 65536
"""Most numbers in the states of chunks that are simulated side by side: half a MiB, which fits into the cache."""


@dataclass(frozen=True, eq=False, repr=False)
class Rollouts:
    """Outcomes of M independent episodes of one closed loop.

    Parameters
    ----------
    success : (M,) bool array
        Whether each episode satisfied the task, in index order.
    seed : int
    chunk : int
        Worlds per chunk; together with the seed it determines every number drawn.
    inadmissible : int
        Number of episodes in which the policy asked for an input beyond the input box before they were decided.
    """

    success: NDArray[np.bool_]
    seed: int
    chunk: int
    inadmissible: int = 0

    def __repr__(self) -> str:
        rows: list[tuple[str, object]] = [
            ("satisfied", f"{self.successes}, a share of {self.successes / max(self.episodes, 1):.6f}"),
            ("seed", f"{self.seed}, {counted(self.chunk, 'world')} per chunk"),
        ]
        if self.inadmissible:
            rows.append(("inputs", f"inadmissible in {counted(self.inadmissible, 'episode')} (they saturated)"))
        return tree_text(f"Rollouts: {counted(self.episodes, 'episode')}", rows)

    @property
    def episodes(self) -> int:
        """Number of episodes M."""
        return len(self.success)

    @property
    def successes(self) -> int:
        """Number of episodes that satisfied the task."""
        return int(self.success.sum())


@names_plan
def rollout(
    problem: Any,
    controller: Any,
    plan: TrialPlan | int | None = None,
    *,
    initial_state: Any = None,
    mismatch: Mismatch | None = None,
    disturbance: Behaviour = "zero",
    **trial: Unpack[TrialOptions],
) -> Rollouts:
    """Simulate episodes of the continuous system under ``controller``; the outcomes are the same on every executor.

    Parameters
    ----------
    problem : Problem, id or path
    controller : Synthesis, certificate, object with ``batch(dynamics)``, or what ``as_policy`` takes
    plan, **trial
        Episodes (default 10,000), seed, chunk, executor, progress; see ``TrialPlan``.
    initial_state : optional
        Start of every episode, as in ``Problem.replace``; default: the problem's own start.
    mismatch : Mismatch, optional
        How the system differs from the model.
    disturbance : "zero", "random", "periodic" or a function
        How bounded disturbances behave.

    Raises
    ------
    ValueError
        If a number is out of range.
    KeyboardInterrupt
        On Ctrl-C. Policies can be compared only over the same episodes, so a part of them is of no use.
    """
    problem = as_problem(problem)
    controller = getattr(controller, "controller", controller)  # syntheses and certificates have one
    if not hasattr(controller, "batch"):
        controller = batchable(controller, problem, argument="controller")
    if initial_state is not None:
        problem = problem.replace(initial_state=initial_state)
    settled = planned(plan, trial, 10_000)
    loop = Loop(
        problem, controller, settled.seed, settled.chunk, mismatch=mismatch, disturbance=checked_behaviour(disturbance)
    )
    results: list[ChunkResult] = []

    def take(result: ChunkResult) -> None:
        results.append(result)
        settled.tell(len(result.success))

    if collect(stream(loop, settled.episodes, settled.executor), take):
        raise KeyboardInterrupt
    success = np.concatenate([result.success for result in results])
    return Rollouts(success, settled.seed, settled.chunk, sum(result.inadmissible for result in results))


def stream(loop: Loop, episodes: int, executor: Executor | None = None) -> Generator[ChunkResult, None, None]:
    """Yield the outcomes chunk by chunk in index order, ``episodes`` in all; none is kept here."""
    # Small chunks are simulated side by side, where the cost of a call of numpy is shared. With an executor there must
    # stay enough jobs for all workers.
    beside = max(1, NUMBERS_SIDE_BY_SIDE // (loop.chunk * loop.problem.n_states))
    if executor is not None:
        beside = min(beside, max(1, episodes // (2 * AHEAD * loop.chunk)))
    chunks = chunks_of(episodes, loop.chunk)
    with closing(in_order(chunk_results, loop, _grouped(chunks, beside), executor)) as groups:
        for group in groups:
            yield from group


def _grouped(chunks: Iterator[tuple[int, int]], beside: int) -> Iterator[tuple[tuple[int, int], ...]]:
    """Yield tuples of ``beside`` chunks; the last one may be shorter."""
    while group := tuple(islice(chunks, beside)):
        yield group
