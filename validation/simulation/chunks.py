"""Chunks of worlds, simulated time after time.

Each chunk draws its starts and its noise from a generator of its own, ``SeedSequence(seed, spawn_key=(chunk,))``, and
draws them whatever the policy does: results do not depend on the order in which chunks are computed nor on where, and
two policies with one seed meet the same noise (common random numbers). Auxiliary draws of a policy come from a stream
of their own, ``spawn_key=(chunk, 1)``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.dynamics import Dynamics, Worlds
from ...envs.dynamics import worlds as core
from .loop import BatchPolicy, Loop, check_whole
from .mismatch import degraded, disturbed
from .streams import Streams

LEAVE = 0.25
"""Share of settled worlds from which it pays to go on without them."""

Outcome = tuple[NDArray[np.bool_], NDArray[np.bool_]]
"""Success of each world, and whether it was asked for an inadmissible input before it was decided."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The worlds of a chunk at one time, and what the policy remembers once it has seen them (None at the horizon)."""

    worlds: Worlds
    memory: Any
    inadmissible: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ChunkResult:
    """Success (n,) of the episodes of one chunk, and how many of them asked for an inadmissible input."""

    success: NDArray[np.bool_]
    inadmissible: int


def chunks_of(episodes: int, chunk: int) -> Iterator[tuple[int, int]]:
    """Numbers of the chunks and how many of their worlds count."""
    check_whole("episodes", episodes, 1)
    return ((number, min(chunk, episodes - first)) for number, first in enumerate(range(0, episodes, chunk)))


def chunk_results(loop: Loop, chunks: Sequence[tuple[int, int]]) -> list[ChunkResult]:
    """Outcomes of some chunks (number, worlds that count), the same whichever are asked for together."""
    parts = [_outcomes(part, [number for number, _ in chunks]) for part in loop.parts]
    results = []
    for (_, count), *of_parts in zip(chunks, *parts, strict=True):
        success = np.logical_and.reduce([own[:count] for own, _ in of_parts])
        beyond = np.logical_or.reduce([own[:count] for _, own in of_parts])
        results.append(ChunkResult(success, int(beyond.sum())))
    return results


def _outcomes(loop: Loop, numbers: Sequence[int]) -> list[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """Success and inadmissible inputs of the worlds of some chunks."""
    dynamics, policy = loop.arranged
    if hasattr(policy, "selected") and not _is_degraded(loop):
        return _leaving_settled(loop, dynamics, policy, numbers)
    return [_to_the_end(loop, dynamics, policy, number) for number in numbers]


def run_chunk(dynamics: Dynamics, policy: BatchPolicy, seed: int, number: int, size: int) -> NDArray[np.bool_]:
    """Success of the worlds of one chunk, always ``size`` of them, so that every episode keeps its noise."""
    loop = Loop(dynamics.problem, _Arranged(policy), seed, size)
    return chunk_results(loop, [(number, size)])[0].success


@dataclass(frozen=True, eq=False)
class _Arranged:
    """A batch policy where something to arrange is asked for."""

    policy: BatchPolicy

    def batch(self, dynamics: Dynamics) -> BatchPolicy:
        return self.policy


def frames(loop: Loop, dynamics: Dynamics, policy: BatchPolicy, number: int) -> Iterator[Frame]:
    """The worlds of one chunk, time after time, until all of them are decided; always ``loop.chunk`` of them."""
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
        following, beyond = step(loop, dynamics, worlds, inputs, core.noise(dynamics, rng, loop.chunk))
        if beyond is not None:
            inadmissible = inadmissible | (beyond & ~(worlds.failed | worlds.accepted))
        worlds = following
    yield Frame(worlds, None, inadmissible)


def _to_the_end(loop: Loop, dynamics: Dynamics, policy: BatchPolicy, number: int) -> Outcome:
    """Success, and inadmissible inputs, of the worlds of one chunk."""
    (last,) = deque(frames(loop, dynamics, policy, number), maxlen=1)
    return np.asarray(core.satisfied(dynamics, last.worlds)), last.inadmissible


def _leaving_settled(loop: Loop, dynamics: Dynamics, policy: Any, numbers: Sequence[int]) -> list[Outcome]:
    """Success, and inadmissible inputs, of the worlds of each of some chunks, under a policy with ``selected``.

    The worlds go as in ``frames``, to the last bit, but side by side, and only while the task is open in them: failure,
    acceptance, and an automaton state from which no acceptance can be reached settle it. Draws are made for all.
    """
    size = loop.chunk
    noise, auxiliary = (Streams([_seed(loop, n, *key) for n in numbers], size) for key in ((), (1,)))
    starts = [_starts(loop, dynamics, *one) for one in zip(numbers, noise.rngs, strict=True)]
    worlds = core.begin(dynamics, _beside(starts))
    success, inadmissible = np.zeros((2, len(numbers) * size), dtype=bool)
    memory = policy.begin(worlds, auxiliary)
    settling = dynamics.problem.automaton.absorbing
    which = np.arange(len(success))
    for _ in range(dynamics.problem.horizon):
        settled = worlds.failed | settling.take(worlds.q)
        if np.count_nonzero(settled) >= LEAVE * len(which):
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
    success[which] = core.satisfied(dynamics, worlds)
    return list(zip(success.reshape(-1, size), inadmissible.reshape(-1, size), strict=True))


def _starts(loop: Loop, dynamics: Dynamics, number: int, rng: np.random.Generator) -> tuple[NDArray[Any], ...]:
    """Initial states of the worlds of a chunk, (d, n, M) per block."""
    if loop.starts is None:
        return core.starts(dynamics, rng, loop.chunk)
    rows = np.arange(number * loop.chunk, (number + 1) * loop.chunk) % len(loop.starts)
    return core.split_joint(dynamics, loop.starts[rows])


def _beside(parts: Sequence[tuple[NDArray[Any], ...]]) -> tuple[NDArray[Any], ...]:
    """Arrays (.., M) per block of several chunks as such arrays of all their worlds."""
    return parts[0] if len(parts) == 1 else tuple(np.concatenate(own, axis=-1) for own in zip(*parts, strict=True))


def _is_degraded(loop: Loop) -> bool:
    """Whether agents see their states late or not at all, which a policy then has to remember."""
    return loop.mismatch is not None and (loop.mismatch.delay > 0 or loop.mismatch.dropout > 0.0)


def _seed(loop: Loop, *key: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(loop.seed, spawn_key=key)


def _generator(loop: Loop, *key: int) -> np.random.Generator:
    return np.random.default_rng(_seed(loop, *key))


def paths(loop: Loop, episodes: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """States (T + 1, M, D) of the first episodes up to their decision (NaN afterwards), and their success (M,)."""
    if loop.problem.groups:
        tasks = [paths(part, episodes) for part in loop.parts]
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
    """The worlds one step later, and whether any agent asked for an inadmissible input (None: nowhere)."""
    beyond = _beyond(dynamics, inputs)
    if loop.mismatch is not None:
        inputs, normals = disturbed(dynamics, loop.mismatch, inputs, normals)
    if loop.mismatch is not None or beyond is not None:
        inputs = _saturated(dynamics, inputs)
    return core.transition(dynamics, worlds, inputs, normals), beyond


def _beyond(dynamics: Dynamics, inputs: Sequence[NDArray[Any]]) -> NDArray[np.bool_] | None:
    """Whether any agent asks for an input outside its box (not a number counts), per world; None if none does."""
    pairs = list(zip(dynamics.blocks, inputs, strict=True))
    if all(_admissible(u, *block.input_range) for block, u in pairs):
        return None
    result = np.zeros(inputs[0].shape[-1], dtype=bool)
    for block, u in pairs:
        result |= ~((block.input_low <= u) & (u <= block.input_high)).all(axis=(0, 1))
    return result if result.any() else None


def _admissible(u: NDArray[Any], low: float, high: float) -> bool:
    """Whether all numbers lie in an interval; not a number lies in none."""
    return bool(low <= u.min()) and bool(u.max() <= high)


def _saturated(dynamics: Dynamics, inputs: Sequence[NDArray[Any]]) -> tuple[NDArray[Any], ...]:
    return tuple(
        np.minimum(np.maximum(u, block.input_low), block.input_high)
        for block, u in zip(dynamics.blocks, inputs, strict=True)
    )
