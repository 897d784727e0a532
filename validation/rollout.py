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

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any, Protocol
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..envs import dynamics as core
from ..envs.dynamics import Dynamics, Worlds
from ..envs.problem import Problem, checked_problem
from ..spread import AHEAD, Executor, in_order, interrupts_at_checkpoints
from .mismatch import Mismatch, degraded, disturbed

CHUNK = 2000
"""Worlds per chunk: large enough for numpy, small enough for the cache."""

TOGETHER = 32768
"""Numbers that the states of chunks simulated side by side may have, if one chunk alone has fewer."""

LEAVE = 0.25
"""Share of settled worlds from which it pays to go on without them."""


Outcome = tuple[NDArray[np.bool_], NDArray[np.bool_]]
"""Success of each world, and whether it was asked for an inadmissible input before it was decided."""


class BatchPolicy(Protocol):
    """Anything that chooses the inputs of all worlds at once; what it remembers is handed to it and handed back.

    A policy with a true attribute ``is_memoryless`` remembers nothing, and its inputs in one world are, to the last
    bit, the same whatever worlds are beside: its worlds are simulated no further than they have to be, and inadmissible
    inputs are not looked for where no acceptance can be reached any more.
    """

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
            _check_whole(name, getattr(self, name), least)

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
        ends = np.cumsum([0, *(agent.n_states for agent in self.problem.agents)])
        loops = []
        for group, task, own, seed in zip(groups, self.problem.tasks, self.controller.parts, seeds, strict=True):
            columns = np.concatenate([np.arange(ends[i], ends[i + 1]) for i in group.agents])
            starts = None if self.starts is None else self.starts[:, columns]
            loops.append(Loop(task, own, seed, self.chunk, starts, self.mismatch))
        return tuple(loops)


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


def rollout(
    problem: Problem,
    controller: Batchable,
    episodes: int,
    seed: int = 0,
    *,
    initial_state: Any = None,
    chunk: int = CHUNK,
    mismatch: Mismatch | None = None,
    executor: Executor | None = None,
    progress: Callable[[int], None] | None = None,
) -> Rollouts:
    """Simulate ``episodes`` episodes of the continuous system under ``controller``, the same for any executor.

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
    mismatch : Mismatch, optional
        How the system differs from the model.
    executor : Executor, optional
        Where chunks are computed; default: here.
    progress : callable, optional
        Called with the number of episodes finished since the last call.

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    checked_problem(problem)
    if not hasattr(controller, "batch"):
        raise ValueError(
            f"`controller`: expected an object with `batch(dynamics)`, got {type(controller).__name__}; give the "
            "`.controller` of a synthesis or certificate, or `as_controller(problem, policy)`"
        )
    if initial_state is not None:
        problem = problem.replace(initial_state=initial_state)
    loop = Loop(problem, controller, seed, chunk, mismatch=mismatch)
    parts = []
    with interrupts_at_checkpoints() as checkpoint, closing(stream(loop, episodes, executor)) as chunks:
        for part in chunks:
            parts.append(part)
            if progress is not None:
                progress(len(part.success))
            checkpoint()
    success = np.concatenate([part.success for part in parts])
    return Rollouts(success, int(seed), int(chunk), sum(part.inadmissible for part in parts))


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


def chunks_of(episodes: int, chunk: int) -> Iterator[tuple[int, int]]:
    """Numbers of the chunks and how many of their worlds count."""
    _check_whole("episodes", episodes, 1)
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
    dynamics, policy = arranged(loop)
    if getattr(policy, "is_memoryless", False) and not _is_degraded(loop):
        return _leaving_settled(loop, dynamics, policy, numbers)
    return [_to_the_end(loop, dynamics, policy, number) for number in numbers]


_ARRANGED: WeakKeyDictionary[Loop, tuple[Dynamics, BatchPolicy]] = WeakKeyDictionary()


def arranged(loop: Loop) -> tuple[Dynamics, BatchPolicy]:
    """Dynamics and policy of a loop, arranged once and not once per chunk."""
    if loop not in _ARRANGED:
        dynamics = Dynamics.of(loop.problem)
        _ARRANGED[loop] = dynamics, loop.controller.batch(dynamics)
    return _ARRANGED[loop]


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
        following, beyond = _step(loop, dynamics, worlds, inputs, core.noise(dynamics, rng, loop.chunk))
        if beyond is not None:
            inadmissible = inadmissible | (beyond & ~(worlds.failed | worlds.accepted))
        worlds = following
    yield Frame(worlds, None, inadmissible)


def _to_the_end(loop: Loop, dynamics: Dynamics, policy: BatchPolicy, number: int) -> Outcome:
    """Success, and inadmissible inputs, of the worlds of one chunk."""
    (last,) = deque(frames(loop, dynamics, policy, number), maxlen=1)
    return np.asarray(core.satisfied(dynamics, last.worlds)), last.inadmissible


def _leaving_settled(loop: Loop, dynamics: Dynamics, policy: BatchPolicy, numbers: Sequence[int]) -> list[Outcome]:
    """Success, and inadmissible inputs, of the worlds of each of some chunks, under a policy without memory.

    The worlds go as in ``frames``, to the last bit, but side by side, and only while the task is open in them: failure,
    acceptance, and an automaton state from which no acceptance can be reached settle it. Noise is drawn for all.
    """
    size, rngs = loop.chunk, [_generator(loop, number) for number in numbers]
    worlds = core.begin(dynamics, _beside([_starts(loop, dynamics, *one) for one in zip(numbers, rngs, strict=True)]))
    success, inadmissible = np.zeros((2, len(numbers) * size), dtype=bool)
    memory = policy.begin(worlds, _generator(loop, numbers[0], 1))
    settling = np.asarray(dynamics.accepting | dynamics.problem.automaton.dead)
    which = np.arange(len(success))
    for _ in range(dynamics.problem.horizon):
        settled = worlds.failed | settling.take(worlds.q)
        if np.count_nonzero(settled) >= LEAVE * len(which):
            success[which[worlds.accepted]] = True
            going = np.flatnonzero(~settled)
            which, worlds, settled = which[going], core.selected(worlds, going), settled[going]
            if len(which) == 0:
                break
        inputs, memory = policy.act(worlds, memory)
        normals = _beside([core.noise(dynamics, rng, size) for rng in rngs])
        if len(which) < len(success):
            normals = tuple(z.take(which, axis=-1) for z in normals)
        following, beyond = _step(loop, dynamics, worlds, inputs, normals)
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


def _step(
    loop: Loop, dynamics: Dynamics, worlds: Worlds, inputs: Sequence[NDArray[Any]], normals: Sequence[NDArray[Any]]
) -> tuple[Worlds, NDArray[np.bool_] | None]:
    """The worlds one step later, and whether any agent asked for an inadmissible input (None: nowhere)."""
    beyond = _beyond(dynamics, inputs)
    if loop.mismatch is not None:
        inputs, normals = disturbed(dynamics, loop.mismatch, inputs, normals)
    if loop.mismatch is not None or beyond is not None:
        inputs = _saturated(dynamics, inputs)
    return core.transition(dynamics, worlds, inputs, normals), beyond


def _is_degraded(loop: Loop) -> bool:
    """Whether agents see their states late or not at all, which a policy then has to remember."""
    return loop.mismatch is not None and (loop.mismatch.delay > 0 or loop.mismatch.dropout > 0.0)


def _generator(loop: Loop, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(loop.seed, spawn_key=key))


def paths(loop: Loop, episodes: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """States (T + 1, M, D) of the first episodes up to their decision (NaN afterwards), and their success (M,)."""
    dynamics, policy = arranged(loop)
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


def _check_whole(name: str, value: Any, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"`{name}`: expected a whole number of at least {least}, got {value!r}")
