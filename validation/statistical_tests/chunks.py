"""Chunks of worlds, simulated step by step.

Each chunk has a generator, ``SeedSequence(seed, spawn_key=(chunk,))``, from which it draws starts and noise. The draws
do not depend on what the policy does. So results do not depend on where and in which order chunks are computed, and two
policies with one seed meet the same noise (common random numbers). A policy that needs random numbers draws them from a
second generator, ``spawn_key=(chunk, 1)``; observations that get lost are drawn from a third, ``(chunk, 2)``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Dynamics, Worlds
from ...envs.simulation import batch_simulator as core
from ...envs.systems.arguments import checked_count
from .loop import BatchPolicy, Loop
from .mismatch import degraded, disturbed
from .streams import Streams

SETTLED_SHARE = 0.25
"""Share of settled worlds from which it pays to leave them behind; below it, copying the others costs more."""

Outcome = tuple[NDArray[np.bool_], NDArray[np.bool_]]
"""Per world of a chunk: whether it succeeded, and whether it met an inadmissible input before it was decided."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The worlds of a chunk at one time.

    Parameters
    ----------
    worlds : Worlds
        M worlds.
    memory : object
        The policy's memory after it has seen these worlds; None in the last frame of an episode.
    inadmissible : (M,) bool array
        Whether an inadmissible input was asked for before the world was decided.
    """

    worlds: Worlds
    memory: Any
    inadmissible: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ChunkResult:
    """Success (n,) of the n episodes of one chunk, and in how many of them an inadmissible input was asked for."""

    success: NDArray[np.bool_]
    inadmissible: int


def chunks_of(episodes: int, chunk: int) -> Iterator[tuple[int, int]]:
    """Return pairs: the number of each chunk, and how many of its worlds count (all, except in the last chunk)."""
    checked_count(episodes, "episodes")
    return ((number, min(chunk, episodes - first)) for number, first in enumerate(range(0, episodes, chunk)))


def chunk_results(loop: Loop, chunks: Sequence[tuple[int, int]]) -> list[ChunkResult]:
    """Return the outcomes of some chunks (number, worlds that count); other chunks beside them change nothing."""
    outcomes_by_task = [_outcomes(task, [number for number, _ in chunks]) for task in loop.parts]
    results = []
    # Independent tasks: an episode succeeds if it does so in every task.
    for (_, count), *outcomes in zip(chunks, *outcomes_by_task, strict=True):
        success = np.logical_and.reduce([success_of_task[:count] for success_of_task, _ in outcomes])
        beyond = np.logical_or.reduce([beyond_of_task[:count] for _, beyond_of_task in outcomes])
        results.append(ChunkResult(success, int(beyond.sum())))
    return results


def _outcomes(loop: Loop, numbers: Sequence[int]) -> list[Outcome]:
    """Return the outcomes of all worlds of some chunks of one task."""
    dynamics, policy = loop.arranged
    # Late observations are remembered for all worlds of a chunk, so none may leave.
    if hasattr(policy, "selected") and not _is_degraded(loop):
        return _leaving_settled(loop, dynamics, policy, numbers)
    return [_to_the_end(loop, dynamics, policy, number) for number in numbers]


def frames(loop: Loop, dynamics: Dynamics, policy: BatchPolicy, number: int) -> Iterator[Frame]:
    """Yield the worlds of one chunk at every time until all are decided; always ``loop.chunk`` of them.

    The number of worlds is fixed, even if fewer count, so that every episode keeps its noise.
    """
    rng = _generator(loop, number)
    worlds = core.begin(dynamics, _starts(loop, dynamics, number, rng))
    if loop.mismatch is not None:
        policy = degraded(policy, loop.mismatch, _generator(loop, number, 2))
    memory = policy.begin(worlds, _generator(loop, number, 1))
    inadmissible = np.zeros(loop.chunk, dtype=bool)
    for _ in range(dynamics.problem.horizon):
        if np.all(worlds.failed | worlds.accepted):
            break
        inputs, memory = policy.act(worlds, memory)
        yield Frame(worlds, memory, inadmissible)
        # The noise is drawn whether or not the input uses it up: two policies meet the same numbers.
        following, beyond = step(loop, dynamics, worlds, inputs, core.noise(dynamics, rng, loop.chunk))
        if beyond is not None:
            inadmissible = inadmissible | (beyond & ~(worlds.failed | worlds.accepted))
        worlds = following
    yield Frame(worlds, None, inadmissible)


def _to_the_end(loop: Loop, dynamics: Dynamics, policy: BatchPolicy, number: int) -> Outcome:
    """Return the outcome of one chunk in which every world is simulated until all are decided."""
    (last,) = deque(frames(loop, dynamics, policy, number), maxlen=1)
    return np.asarray(core.satisfied(dynamics, last.worlds)), last.inadmissible


def _leaving_settled(loop: Loop, dynamics: Dynamics, policy: Any, numbers: Sequence[int]) -> list[Outcome]:
    """Return the outcome of each of some chunks under a policy with ``selected``.

    The worlds move as in ``frames``, to the last bit, but the chunks stand side by side, and a world is simulated only
    while its task is open: a failure, an acceptance, and an automaton state from which nothing can change any more
    settle it. Random numbers are drawn for all worlds.
    """
    size = loop.chunk
    noise, auxiliary = (Streams([_seed(loop, n, *key) for n in numbers], size) for key in ((), (1,)))
    starts = [_starts(loop, dynamics, number, rng) for number, rng in zip(numbers, noise.rngs, strict=True)]
    worlds = core.begin(dynamics, _beside(starts))
    success, inadmissible = np.zeros((2, len(numbers) * size), dtype=bool)
    memory = policy.begin(worlds, auxiliary)
    settling = dynamics.problem.automaton.absorbing
    which = np.arange(len(success))  # numbers of the worlds that are still simulated
    for _ in range(dynamics.problem.horizon):
        # Once enough worlds are settled, note their success and go on with the others alone.
        settled = worlds.failed | settling.take(worlds.q)
        if np.count_nonzero(settled) >= SETTLED_SHARE * len(which):
            success[which[worlds.accepted]] = True
            going = np.flatnonzero(~settled)
            which, worlds, settled = which[going], core.selected(worlds, going), settled[going]
            if len(which) == 0:
                break
            memory = policy.selected(memory, going)
            for streams in (noise, auxiliary):
                streams.keep(which)
        inputs, memory = policy.act(worlds, memory)
        following, beyond = step(loop, dynamics, worlds, inputs, core.noise(dynamics, noise, len(which)))
        if beyond is not None:
            inadmissible[which] |= beyond & ~settled
        worlds = following
    # The worlds that are left are judged where they stand; then every chunk takes its rows.
    success[which] = core.satisfied(dynamics, worlds)
    return list(zip(success.reshape(-1, size), inadmissible.reshape(-1, size), strict=True))


def _starts(loop: Loop, dynamics: Dynamics, number: int, rng: np.random.Generator) -> tuple[NDArray[Any], ...]:
    """Return the initial states (d, n, M) per block of the M worlds of a chunk."""
    if loop.starts is None:
        return core.starts(dynamics, rng, loop.chunk)
    # Episode r, counted over all chunks, begins at start r modulo their number.
    rows = np.arange(number * loop.chunk, (number + 1) * loop.chunk) % len(loop.starts)
    return core.split_joint(dynamics, loop.starts[rows])


def _beside(chunks: Sequence[tuple[NDArray[Any], ...]]) -> tuple[NDArray[Any], ...]:
    """Return the arrays (.., M) per block of several chunks side by side, as arrays of all their worlds."""
    if len(chunks) == 1:
        return chunks[0]
    return tuple(np.concatenate(arrays, axis=-1) for arrays in zip(*chunks, strict=True))


def _is_degraded(loop: Loop) -> bool:
    """Return whether observations arrive late or get lost, so that the policy has to remember earlier ones."""
    return loop.mismatch is not None and (loop.mismatch.delay > 0 or loop.mismatch.dropout > 0.0)


def _seed(loop: Loop, *key: int) -> np.random.SeedSequence:
    """Return the seed of a chunk (key: its number) or of one of its further streams."""
    return np.random.SeedSequence(loop.seed, spawn_key=key)


def _generator(loop: Loop, *key: int) -> np.random.Generator:
    return np.random.default_rng(_seed(loop, *key))


def paths(loop: Loop, episodes: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return the states (T + 1, M, D) of the first M episodes, NaN after their decision, and their success (M,).

    M is at most one chunk.
    """
    if loop.problem.groups:
        # Simulate the tasks one by one, then put the columns back into the order of the joint state.
        tasks = [paths(task, episodes) for task in loop.parts]
        columns = np.concatenate(loop.columns)
        together = np.concatenate([states for states, _ in tasks], axis=2)
        return together[:, :, np.argsort(columns)], np.logical_and.reduce([success for _, success in tasks])
    dynamics, policy = loop.arranged
    states = np.full((loop.problem.horizon + 1, episodes, loop.problem.n_states), np.nan)
    decided = np.zeros(episodes, dtype=bool)
    number, _ = next(chunks_of(episodes, loop.chunk))
    count, last = min(episodes, loop.chunk), None
    for time, last in enumerate(frames(loop, dynamics, policy, number)):
        going = np.flatnonzero(~decided[:count])
        states[time, going] = core.joint(dynamics, last.worlds)[:count][going]
        decided[:count] |= (last.worlds.failed | last.worlds.accepted)[:count]
    assert last is not None
    return states[:, :count], np.asarray(core.satisfied(dynamics, last.worlds))[:count]


def step(
    loop: Loop, dynamics: Dynamics, worlds: Worlds, inputs: Sequence[NDArray[Any]], normals: Sequence[NDArray[Any]]
) -> tuple[Worlds, NDArray[np.bool_] | None]:
    """Return the worlds one step later, and whether (M,) any agent asked for an inadmissible input (None: nowhere).

    Actuators saturate: an input beyond the input box acts as the nearest admissible one.
    """
    beyond = _beyond(dynamics, inputs)
    if loop.mismatch is not None:
        inputs, normals = disturbed(dynamics, loop.mismatch, inputs, normals)
    if loop.mismatch is not None or beyond is not None:
        inputs = _saturated(dynamics, inputs)
    return core.transition(dynamics, worlds, inputs, normals), beyond


def _beyond(dynamics: Dynamics, inputs: Sequence[NDArray[Any]]) -> NDArray[np.bool_] | None:
    """Return whether (M,) any agent asks for an input outside its box, NaN included; None if no agent does."""
    pairs = list(zip(dynamics.blocks, inputs, strict=True))
    # Nearly always all inputs lie within the smallest range of their block, which two reductions decide.
    if all(_admissible(u, *block.input_range) for block, u in pairs):
        return None
    result = np.zeros(inputs[0].shape[-1], dtype=bool)
    for block, u in pairs:
        result |= ~((block.input_low <= u) & (u <= block.input_high)).all(axis=(0, 1))
    return result if result.any() else None


def _admissible(u: NDArray[Any], low: float, high: float) -> bool:
    """Return whether all numbers lie in an interval; NaN lies in no interval."""
    return bool(low <= u.min()) and bool(u.max() <= high)


def _saturated(dynamics: Dynamics, inputs: Sequence[NDArray[Any]]) -> tuple[NDArray[Any], ...]:
    """Return the admissible inputs nearest to those asked for."""
    return tuple(
        np.minimum(np.maximum(u, block.input_low), block.input_high)
        for block, u in zip(dynamics.blocks, inputs, strict=True)
    )
