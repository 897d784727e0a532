"""The batched functional core: start, noise, transition, letters, automaton step. Every environment is a view of it.

Agents of equal sizes (d, m, p) form a *block*, whose states are one array (d, n, M): component, agent of the block,
world. All sums run elementwise in a fixed order, so a world's trajectory does not depend, to the last bit, on how many
others are computed beside it.

The step of an agent (`moved`), membership (`labeling.inside`, `contains`) and the order of decisions (`decided`) are
written for anything that adds, multiplies and compares: this module runs them on arrays, `one_world` on numbers.

One step, in this order: `x' = A x + B u + c + L z` with `z` standard normal and `L L' = Sigma`; a world in which any
agent has left its workspace fails (also where another agent would complete the task in the same step); the letter of
x' is read by the automaton; a co-safe task is accepted on entering an accepting state. Failed and accepted are
absorbing; the states of decided worlds move on. Reference: THEORY section 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from ..agents import contains, inside, linear, read_only
from ..problem import Problem
from .blocks import Block, block_of
from .rules import decided, moved
from .tables import Reader, reader


class Draws(Protocol):
    """Where random numbers of worlds come from: a `numpy.random.Generator`, or several, one for some worlds each."""

    def standard_normal(self, size: tuple[int, ...], /) -> np.ndarray:
        """Return standard normal numbers; the last axis is that of the worlds."""

    def random(self, size: tuple[int, ...], /) -> np.ndarray:
        """Return numbers uniform on [0, 1); the last axis is that of the worlds."""


@dataclass(frozen=True, eq=False)
class Dynamics:
    """A problem arranged for batches.

    Attributes
    ----------
    problem : Problem
    blocks : tuple of Block
    position : tuple of (int, int)
        Per agent: its block, and its place in the block.
    accepting : np.ndarray of bool, shape (Q,)
        Automaton states on entering which the task is accepted at once: none for finite-trace tasks.
    """

    problem: Problem
    blocks: tuple[Block, ...]
    position: tuple[tuple[int, int], ...]
    accepting: np.ndarray

    @classmethod
    def of(cls, problem: Problem) -> Dynamics:
        """Return the dynamics of a problem."""
        members: dict[tuple[int, int, int], list[int]] = {}
        for i, agent in enumerate(problem.agents):
            members.setdefault((agent.n_states, agent.n_inputs, agent.n_outputs), []).append(i)
        place = {i: (b, k) for b, group in enumerate(members.values()) for k, i in enumerate(group)}
        blocks = tuple(block_of(problem, group) for group in members.values())
        automaton = problem.automaton
        return cls(problem, blocks, tuple(place[i] for i in range(problem.n_agents)), automaton.finished)

    @cached_property
    def reader(self) -> Reader | None:
        """Tables by which worlds are judged; None if they would not do."""
        return reader(self.blocks, self.problem.labeling, self.problem.automaton, self.accepting, decided)


@dataclass(frozen=True, eq=False)
class Worlds:
    """A batch of M worlds.

    Attributes
    ----------
    states : tuple of np.ndarray, shape (d, n, M)
        One array per block.
    q : np.ndarray of int32, shape (M,)
        Automaton states; they stand still from the failure on.
    time : int, or np.ndarray of int, shape (M,)
        Control steps taken: one number, or one per world where `restart` has set some of them back.
    failed, accepted : np.ndarray of bool, shape (M,)
        At most one of them holds; both are absorbing. Accepted is never set for finite-trace tasks; for others it says
        that the world has not failed and its automaton state is accepting.
    """

    states: tuple[np.ndarray, ...]
    q: np.ndarray
    time: Any
    failed: np.ndarray
    accepted: np.ndarray

    @property
    def n_worlds(self) -> int:
        """Number of worlds M."""
        return int(self.q.size)


def initial(dynamics: Dynamics, rng: np.random.Generator, n_worlds: int) -> Worlds:
    """Return worlds at time 0, their starts drawn uniformly from the start boxes; a fixed start draws nothing."""
    return begin(dynamics, starts(dynamics, rng, n_worlds))


def starts(dynamics: Dynamics, rng: np.random.Generator, n_worlds: int) -> tuple[np.ndarray, ...]:
    """Return initial states as `initial` draws them, one array (d, n, M) per block."""
    states = []
    for block in dynamics.blocks:
        width = block.initial_high - block.initial_low
        shape = (*width.shape[:2], n_worlds)
        start = np.empty(shape)
        start[...] = block.initial_low
        if width.any():
            start += width * rng.random(shape)
            # Rounding can carry a draw to the upper corner, which half-open neighbours own.
            last = np.where(width > 0.0, np.nextafter(block.initial_high, -np.inf), block.initial_high)
            start = np.minimum(start, last)
        states.append(start)
    return tuple(states)


def initial_at(dynamics: Dynamics, states: np.ndarray) -> Worlds:
    """Return worlds at time 0 with given joint states (M, D), components in agent order."""
    states = np.asarray(states, dtype=float)
    n_states = dynamics.problem.n_states
    if states.ndim != 2 or states.shape[1] != n_states:
        raise ValueError(f"`states`: expected shape (number of worlds, {n_states}), got {states.shape}")
    return begin(dynamics, split_joint(dynamics, states))


def begin(dynamics: Dynamics, states: tuple[np.ndarray, ...]) -> Worlds:
    """Return worlds at time 0 with given states, one array (d, n, M) per block."""
    n_worlds = states[0].shape[-1]
    q = np.full(n_worlds, dynamics.problem.automaton.initial, dtype=np.int32)
    undecided = np.zeros(n_worlds, dtype=bool)
    return _read(dynamics, states, 0, q, undecided, undecided)


def restart(dynamics: Dynamics, worlds: Worlds, which: np.ndarray, rng: np.random.Generator) -> Worlds:
    """Return the worlds with those of `which`, bool (M,), put back to a start drawn for them at time 0."""
    fresh = initial(dynamics, rng, int(which.sum()))
    states = tuple(x.copy() for x in worlds.states)
    for x, start in zip(states, fresh.states):
        x[..., which] = start
    marks = {"time": np.broadcast_to(np.asarray(worlds.time), which.shape).copy()}
    marks |= {name: getattr(worlds, name).copy() for name in ("q", "failed", "accepted")}
    for name, values in marks.items():
        values[which] = getattr(fresh, name)
    return replace(worlds, states=states, **marks)


def selected(worlds: Worlds, which: np.ndarray) -> Worlds:
    """Return only the worlds of `which`, whole numbers in increasing order; all must be at one time."""
    states = tuple(x.take(which, axis=-1) for x in worlds.states)
    return Worlds(states, worlds.q[which], worlds.time, worlds.failed[which], worlds.accepted[which])


def noise(dynamics: Dynamics, rng: Draws, n_worlds: int) -> tuple[np.ndarray, ...]:
    """Return standard normal numbers for one step, one array (d, n, M) per block."""
    return tuple(rng.standard_normal((*block.offset.shape[:2], n_worlds)) for block in dynamics.blocks)


def transition(
    dynamics: Dynamics, worlds: Worlds, inputs: Sequence[np.ndarray], normals: Sequence[np.ndarray]
) -> Worlds:
    """Return the worlds one step later.

    Parameters
    ----------
    dynamics : Dynamics
    worlds : Worlds
        Before the horizon.
    inputs : sequence of np.ndarray, shape (m, n, M)
        One array per block, used as they are: keeping them in the input box is the caller's duty.
    normals : sequence of np.ndarray, shape (d, n, M)
        As `noise` draws them.

    Raises
    ------
    ValueError
        If the worlds are at the horizon.
    """
    over = worlds.time >= dynamics.problem.horizon
    if over if isinstance(over, bool) else over.any():
        raise ValueError(f"`worlds`: expected a time before the horizon {dynamics.problem.horizon}, got {worlds.time}")
    states = tuple(successor(block, x, u, z) for block, x, u, z in zip(dynamics.blocks, worlds.states, inputs, normals))
    return _read(dynamics, states, worlds.time + 1, worlds.q, worlds.failed, worlds.accepted)


def successor(block: Block, x: np.ndarray, u: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return the next states of a block, shape (d, n, M).

    The states of a decided world under an unstable A may grow beyond all numbers; infinity and NaN lie outside every
    workspace.
    """
    components = []
    with np.errstate(over="ignore", invalid="ignore"):
        for (a, to_a), (b, to_b), c, (factor, to_z) in block.motion:
            own = [x[k] for k in to_a], [u[k] for k in to_b], [z[k] for k in to_z]
            components += moved([a], [b], [c], [factor], *own)
    return np.stack(components) if len(components) > 1 else components[0][None]


def letters(dynamics: Dynamics, states: Sequence[np.ndarray]) -> np.ndarray:
    """Return which propositions hold in each world, bool (P, M), for states (d, n, M) per block."""
    result = np.zeros((len(dynamics.problem.propositions), states[0].shape[-1]), dtype=bool)
    for block, x in zip(dynamics.blocks, states):
        if block.propositions.size:
            with np.errstate(over="ignore", invalid="ignore"):
                y = x if block.identity_output else linear(block.C, x)
            result[block.propositions] = contains(y.take(block.owners, axis=1), block.region_low, block.region_high)
    return result


def satisfied(dynamics: Dynamics, worlds: Worlds) -> np.ndarray:
    """Whether the task is satisfied so far, bool (M,): a finite-trace task can be so at the horizon only."""
    automaton = dynamics.problem.automaton
    if automaton.is_co_safe:
        return worlds.accepted
    judged = worlds.time == dynamics.problem.horizon
    return judged & ~worlds.failed & np.asarray(automaton.accepting)[worlds.q]


def joint(dynamics: Dynamics, worlds: Worlds) -> np.ndarray:
    """Return the joint states, shape (M, D), components in agent order."""
    result = np.empty((worlds.n_worlds, dynamics.problem.n_states))
    for block, x in zip(dynamics.blocks, worlds.states):
        result[:, block.columns] = np.moveaxis(x, -1, 0)
    return result


def split_joint(dynamics: Dynamics, states: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return joint states (M, D) as one array (d, n, M) per block."""
    return tuple(np.ascontiguousarray(np.moveaxis(states[:, block.columns], 0, -1)) for block in dynamics.blocks)


def _read(
    dynamics: Dynamics, states: tuple[np.ndarray, ...], time: Any, q: np.ndarray, failed: Any, accepted: Any
) -> Worlds:
    """Judge the exits and let the automaton read the letters of the states."""
    if dynamics.reader is not None:
        q, failed, accepted = dynamics.reader.read(states, q, failed)
    else:
        following = dynamics.problem.automaton.next_state(q, letters(dynamics, states))
        q, failed, accepted = decided(dynamics.accepting, q, following, failed, accepted, _outside(dynamics, states))
        q = q.astype(np.int32)
    return Worlds(states, read_only(q), time, read_only(failed), read_only(accepted))


def _outside(dynamics: Dynamics, states: Sequence[np.ndarray]) -> np.ndarray:
    """Whether any agent is outside its workspace, bool (M,)."""
    result = np.zeros(states[0].shape[-1], dtype=bool)
    for block, x in zip(dynamics.blocks, states):
        result |= ~inside(x, block.state_low, block.state_high).all(axis=0)
    return result
