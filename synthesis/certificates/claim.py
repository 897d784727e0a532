"""What a certificate claims of every start: the value function behind it, read with all reserves taken off.

At every state the value at time 0 is a lower bound, not only at the problem's start (THEORY section 5). A claim holds
what is needed to read it: the value function, the guards of the first letter, the rounding of floating point and, under
the a-posteriori bound, what lost relations may cost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.logic import Automaton
from ...envs.problem import Problem
from ..cells import FloatArray, start_share
from ..relations import Relation
from ..values import Guards, Skeleton, Terms, Trains, Unread, term_depths
from .part import AgentPart

MAX_JOINT_CELLS = 20_000_000
"""Largest number of joint cells over which ``min`` is taken cell by cell."""

NUMBERS_AT_ONCE = 2_000_000
"""Most numbers that reading the value at many joint cells holds at once."""


@dataclass(frozen=True, eq=False)
class Claim:
    """Lower bounds on the satisfaction probability, from every start.

    Parameters
    ----------
    problem : Problem
    agents : tuple of AgentPart
    relations : tuple of Relation
        Of each agent; they say in which coordinates its cells lie.
    start_target : (G0,) int array
        Automaton state after the letter of time 0, per start guard.
    start_mask : (G0, I) int array
        Factor of each agent in each start guard, an index into ``agents[i].start_masks``.
    value : Terms or Trains
        Value function at time 0, each term with what accepting early saves (``with_early_acceptance``).
    relative_rounding : float
        Relative reserve for floating point.
    correction : float
        What lost relations may cost a run that is undecided to the end, ``Delta T`` (0 where nothing can be lost), and
        what carrying the policies out in floating point may cost.
    """

    problem: Problem
    agents: tuple[AgentPart, ...]
    relations: tuple[Relation, ...]
    start_target: NDArray[np.int32]
    start_mask: NDArray[np.int32]
    value: Terms | Trains
    relative_rounding: float
    correction: float

    def at(self, states: Any) -> FloatArray:
        """Lower bounds (M,) on the satisfaction probability from each of M joint initial states.

        Parameters
        ----------
        states : array_like, shape (M, D) or (D,), or mapping from agent name to (d_i,) vector
            Joint states in agent order, ``D = sum d_i``, in state units. A single state gives an array of length 1.

        Raises
        ------
        ValueError
            If the shape does not fit.
        """
        joint = joint_states(self.problem, states)
        automaton = self.problem.automaton
        cells = np.empty((len(joint), len(self.agents)), dtype=np.int64)
        inside = np.ones(len(joint), dtype=bool)
        split = np.split(joint, np.cumsum([a.n_states for a in self.problem.agents])[:-1], axis=1)
        holds = []
        for i, (agent, part, own) in enumerate(zip(self.problem.agents, self.agents, split, strict=True)):
            inside &= np.all((agent.workspace.low <= own) & (own <= agent.workspace.high), axis=1)
            cells[:, i] = part.grid.cell_of(self.relations[i].to_grid(own.T))
            holds.append(self.problem.labeling.class_at(i, own.T))
        q = automaton.next_state(np.full(len(joint), automaton.initial), np.concatenate(holds))
        values = np.zeros(len(joint))
        for state in np.unique(q):
            here = np.flatnonzero(inside & (q == state))
            for chunk in np.array_split(here, max(1, len(here) * self.value.work(state) // NUMBERS_AT_ONCE + 1)):
                values[chunk] = self.value.at(int(state), cells[chunk])
        return self._certified(values)

    def mean(self, low: Any, high: Any) -> float:
        """Lower bound on the satisfaction probability from a start drawn uniformly from the box ``[low, high)``.

        Parameters
        ----------
        low, high : array_like, shape (D,), or mappings from agent name to (d_i,) vector
            Corners in joint state space; equal coordinates are points. The box is averaged cell by cell, each cell with
            the letters that are certain in it.
        """
        weights = self._box(low, high)
        return float(self._certified(np.array([self._unread.total(0, weights)]))[0])

    def min(self, low: Any, high: Any) -> float:
        """Lower bound on the satisfaction probability from every start in the box: the smallest value of its cells.

        Raises
        ------
        ValueError
            If the box holds more than ``MAX_JOINT_CELLS`` joint cells.
        """
        cells = [np.flatnonzero(w) for w in self._box(low, high)]
        shape = tuple(len(own) for own in cells)
        count = float(np.prod(shape, dtype=float))
        if count > MAX_JOINT_CELLS:
            raise ValueError(
                f"`low`, `high`: expected at most {MAX_JOINT_CELLS} joint cells, got {count:.3g}; ask for a smaller box"
            )
        smallest, chunk = np.inf, max(1, NUMBERS_AT_ONCE // max(1, self._unread.work(0)))
        for first in range(0, int(count), chunk):
            numbers = np.unravel_index(np.arange(first, min(first + chunk, int(count))), shape)
            joint = np.column_stack([own[n] for own, n in zip(cells, numbers, strict=True)])
            smallest = min(smallest, float(self._unread.at(0, joint).min()))
        return float(self._certified(np.array([smallest if count else 0.0]))[0])

    @cached_property
    def _unread(self) -> Terms | Unread:
        """Value before the first letter is read, as terms of a single state: the start guards and what they lead to."""
        initial, terms = self.problem.automaton.initial, self.value
        if isinstance(terms, Trains):
            if self.problem.automaton.finished[initial]:
                everywhere = tuple(np.ones((1, part.grid.n_cells)) for part in self.agents)
                return Unread(terms, np.array([initial]), np.zeros((1, len(self.agents)), dtype=int), everywhere)
            return Unread(terms, self.start_target, self.start_mask, tuple(part.start_masks for part in self.agents))
        if self.problem.automaton.finished[initial]:
            return Terms(terms.factors, (terms.index[initial],))
        counts = [len(terms.index[q]) for q in self.start_target]
        guard = np.repeat(np.arange(len(counts)), counts)
        none = np.zeros((0, len(self.agents)), dtype=np.int64)
        child = np.concatenate([terms.index[q] for q in self.start_target] or [none])
        factors, rows = [], np.zeros(child.shape, dtype=np.int64)
        for i, part in enumerate(self.agents):
            key = self.start_mask[guard, i].astype(np.int64) * len(terms.factors[i]) + child[:, i]
            pairs, rows[:, i] = np.unique(key, return_inverse=True)
            mask, factor = np.divmod(pairs, max(1, len(terms.factors[i])))
            factors.append(part.start_masks[mask] * terms.factors[i][factor])
        return Terms(tuple(factors), (rows,))

    def _certified(self, values: FloatArray) -> FloatArray:
        """Certified values: rounding and, under the a-posteriori bound, lost relations taken off."""
        return np.clip(values * (1.0 - self.relative_rounding) - self.correction, 0.0, 1.0)

    def _box(self, low: Any, high: Any) -> list[FloatArray]:
        """Share of the box in each agent's cells; it sums to 1 where the box lies inside the workspace."""
        corners = joint_states(self.problem, low)[0], joint_states(self.problem, high)[0]
        splits = np.cumsum([a.n_states for a in self.problem.agents])[:-1]
        weights = []
        for i, (a, b) in enumerate(zip(*(np.split(corner, splits) for corner in corners), strict=True)):
            if np.any(a > b):
                raise ValueError(
                    f"`low`, `high`: expected low <= high for agent `{self.problem.agent_names[i]}`, got {a} and {b}"
                )
            weights.append(start_share(self.agents[i].grid, self.agents[i].coordinates, a, b))
        return weights


def with_early_acceptance(
    terms: Terms, skeleton: Sequence[Skeleton], guards: Guards, automaton: Automaton, horizon: int, delta: float
) -> Terms:
    """Terms of a co-safe task, each with ``delta`` more per step that accepting early saves.

    Under the a-posteriori bound a run loses ``delta`` at every step that finds it undecided; the terms know by their
    depth when they accept (paper, Theorem 1). ``delta`` is rounded down here, since it adds.
    """
    depths = term_depths(skeleton, guards, automaton.accepting, automaton.absorbing)
    worth = delta * (1 - 1e-9) if automaton.is_co_safe else 0.0
    gains = [np.asarray(1.0 + worth * (horizon - depth)) for depth in depths]
    factors, index = list(terms.factors), [rows.astype(np.int64) for rows in terms.index]
    scaled = [factors[0][rows[:, 0]] * np.reshape(gain, (-1, 1)) for rows, gain in zip(index, gains, strict=True)]
    ends = np.cumsum([0, *(len(part) for part in scaled)])
    for rows, first in zip(index, ends, strict=False):
        rows[:, 0] = first + np.arange(len(rows))
    return Terms((np.concatenate(scaled), *factors[1:]), tuple(index))


def joint_states(problem: Problem, states: Any) -> FloatArray:
    """States as an (M, D) array: joint states (M, D) or (D,), or a mapping from agent name to (d_i,) vector."""
    if isinstance(states, Mapping):
        missing = sorted(set(problem.agent_names) ^ set(states))
        if missing:
            raise ValueError(f"`states`: expected one vector per agent, got a mismatch at {', '.join(missing[:5])}")
        states = np.concatenate([np.atleast_1d(np.asarray(states[n], dtype=float)) for n in problem.agent_names])
    joint = np.atleast_2d(np.asarray(states, dtype=float))
    if joint.ndim != 2 or joint.shape[1] != problem.n_states:
        raise ValueError(f"`states`: expected shape (M, {problem.n_states}), got {joint.shape}")
    return joint
