"""What a certificate claims of every start: the value function behind it, read with all reserves taken off.

At every state the value at time 0 is a lower bound, not only at the problem's start (docs/theory/bounds.md, "Other
starts"). A claim holds what is needed to read it: the value function, the guards of the first letter, the rounding of
floating point and, under the a-posteriori bound, what lost relations may cost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.arguments import slices_of, tree_text
from ....envs.tasks.automata import Automaton
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray, alike_text, shape_text
from ...relations.kinds import Relation
from ..cell_probabilities import AgentRecord
from ..value_functions import Guards, MergeLog, Terms, Trains, Unread, ValueFunction, term_depths

MAX_JOINT_CELLS = 20_000_000
"""Largest number of joint cells over which ``min`` is taken cell by cell."""

NUMBERS_AT_ONCE = 2_000_000
"""Most numbers that reading the value at many joint cells holds at once: 16 MB."""


@dataclass(frozen=True, eq=False, repr=False)
class Claim:
    """Lower bounds on the satisfaction probability, from every start.

    Parameters
    ----------
    problem : Problem
    agents : tuple of AgentPart
    relations : tuple of Relation
        Relation of each agent.
    start_target : (G0,) int array
        Automaton state after the letter of time 0, per start guard.
    start_mask : (G0, I) int array
        Factor of each agent in each start guard, an index into ``agents[i].start_masks``.
    value : ValueFunction
        Value function at time 0, terms or trains; each term with what accepting early saves
        (``with_early_acceptance``).
    relative_rounding : float
        Relative reserve for floating point.
    correction : float
        What lost relations may cost a run that is undecided to the end, ``Delta T`` (0 where nothing can be lost), and
        what carrying the policies out in floating point may cost.
    """

    problem: Problem
    agents: tuple[AgentRecord, ...]
    relations: tuple[Relation, ...]
    start_target: NDArray[np.int32]
    start_mask: NDArray[np.int32]
    value: ValueFunction
    relative_rounding: float
    correction: float

    def __repr__(self) -> str:
        rows = [
            ("cells", alike_text(shape_text(part.grid.shape) for part in self.agents)),
            ("value", self.value),
            ("taken off", f"{self.relative_rounding:.2g} of the value and {self.correction:.2g}"),
        ]
        return tree_text(f"Claim about every start of {self.problem.name!r}", rows)

    def at(self, states: Any) -> FloatArray:
        """Return lower bounds (M,) on the satisfaction probability from each of M joint initial states.

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
        automaton, labeling = self.problem.automaton, self.problem.labeling
        holds = [labeling.class_at(i, joint[:, columns].T) for i, columns in enumerate(self.problem.columns)]
        # The true letter of each state decides the automaton state in which the value is read.
        q = automaton.next_state(np.full(len(joint), automaton.initial), np.concatenate(holds))
        return self.in_state(joint, q)

    def in_state(self, joint: FloatArray, q: NDArray[Any]) -> FloatArray:
        """Return lower bounds (M,) from joint states (M, D) in automaton states (M,), which have read their letters."""
        places, weights = [], []
        inside = np.ones(len(joint), dtype=bool)
        for i, (agent, part) in enumerate(zip(self.problem.agents, self.agents, strict=True)):
            x = joint[:, self.problem.columns[i]]
            inside &= np.all((agent.workspace.low <= x) & (x <= agent.workspace.high), axis=1)
            at, weight = part.places_at(x.T)
            places.append(at)
            weights.append(weight)
        values = np.zeros(len(joint))
        for state in np.unique(q):
            here = np.flatnonzero(inside & (q == state))
            for chunk in np.array_split(here, max(1, len(here) * self.value.work(state) // NUMBERS_AT_ONCE + 1)):
                values[chunk] = self._value_at(int(state), [at[chunk] for at in places], [w[chunk] for w in weights])
        return self._certified(values)

    def _value_at(self, q: int, places: list[NDArray[np.int64]], weights: list[FloatArray]) -> FloatArray:
        """Return the value (M,) in one automaton state: per agent, its places (M, K) and their weights."""
        if all(at.shape[1] == 1 for at in places) or not isinstance(self.value, Terms):
            return self.value.at(q, np.concatenate(places, axis=1))
        return np.asarray(self.value.products_between(q, places, weights).sum(axis=1))

    def mean(self, low: Any, high: Any) -> float:
        """Return a lower bound on the satisfaction probability from a start drawn uniformly from ``[low, high)``.

        Parameters
        ----------
        low, high : array_like, shape (D,), or mappings from agent name to (d_i,) vector
            Corners in joint state space; equal ends are points. The box is averaged cell by cell, each cell with
            the letters that are certain in it.
        """
        weights = self._box(low, high)
        return float(self._certified(np.array([self._unread.total(0, weights)]))[0])

    def min(self, low: Any, high: Any) -> float:
        """Return a lower bound on the satisfaction probability from every start in the box: the least of its cells.

        Raises
        ------
        ValueError
            If the box holds more than ``MAX_JOINT_CELLS`` joint cells.
        """
        boxes = zip(self.agents, *self._corners(low, high), strict=True)
        cells = [np.flatnonzero(part.share(a, b)) for part, a, b in boxes]
        shape = tuple(len(numbers) for numbers in cells)
        count = float(np.prod(shape, dtype=float))
        if count > MAX_JOINT_CELLS:
            raise ValueError(
                f"`low`, `high`: expected at most {MAX_JOINT_CELLS} joint cells, got {count:.3g}; ask for a smaller box"
            )
        # All joint cells of the box, chunk by chunk in C order.
        smallest, chunk = np.inf, max(1, NUMBERS_AT_ONCE // max(1, self._unread.work(0)))
        for first in range(0, int(count), chunk):
            places = np.unravel_index(np.arange(first, min(first + chunk, int(count))), shape)
            joint = np.column_stack([numbers[place] for numbers, place in zip(cells, places, strict=True)])
            smallest = min(smallest, float(self._unread.at(0, joint).min()))
        return float(self._certified(np.array([smallest if count else 0.0]))[0])

    @cached_property
    def _unread(self) -> ValueFunction:
        """Value before the first letter is read, as that of a single state: the start guards and what they lead to."""
        initial, value = self.problem.automaton.initial, self.value
        # An initial state that accepts has no start guards: the value is its own.
        accepted = bool(self.problem.automaton.finished[initial])
        if isinstance(value, Trains):
            if accepted:
                everywhere = tuple(np.ones((1, part.grid.n_cells)) for part in self.agents)
                return Unread(value, np.array([initial]), np.zeros((1, len(self.agents)), dtype=int), everywhere)
            return Unread(value, self.start_target, self.start_mask, tuple(part.start_masks for part in self.agents))
        assert isinstance(value, Terms)
        if accepted:
            return Terms(value.factors, (value.index[initial],))
        # Pair every start guard with every term of its target, and mask each distinct factor once.
        counts = [len(value.index[q]) for q in self.start_target]
        guard = np.repeat(np.arange(len(counts)), counts)
        no_terms = np.zeros((0, len(self.agents)), dtype=np.int64)
        child = np.concatenate([value.index[q] for q in self.start_target] or [no_terms])
        factors, rows = [], np.zeros(child.shape, dtype=np.int64)
        for i, part in enumerate(self.agents):
            key = self.start_mask[guard, i].astype(np.int64) * len(value.factors[i]) + child[:, i]
            pairs, rows[:, i] = np.unique(key, return_inverse=True)
            mask, factor = np.divmod(pairs, max(1, len(value.factors[i])))
            factors.append(part.masks_at_start[mask] * value.factors[i][factor])
        return Terms(tuple(factors), (rows,))

    def _certified(self, values: FloatArray) -> FloatArray:
        """Return values with rounding and, under the a-posteriori bound, lost relations taken off: lower bounds."""
        return np.clip(values * (1.0 - self.relative_rounding) - self.correction, 0.0, 1.0)

    def _corners(self, low: Any, high: Any) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return the lower and upper corners of a box, agent by agent; raise ValueError where it is none."""
        first, last = joint_states(self.problem, low)[0], joint_states(self.problem, high)[0]
        pairs = [(first[columns], last[columns]) for columns in self.problem.columns]
        for name, (a, b) in zip(self.problem.agent_names, pairs, strict=True):
            if np.any(a > b):
                raise ValueError(f"`low`, `high`: expected low <= high for agent `{name}`, got {a} and {b}")
        return [a for a, _ in pairs], [b for _, b in pairs]

    def _box(self, low: Any, high: Any) -> list[FloatArray]:
        """Return the share of the box in each agent's cells; it sums to 1 if the box lies inside the workspace."""
        return [part.share(a, b) for part, a, b in zip(self.agents, *self._corners(low, high), strict=True)]


def with_early_acceptance(
    terms: Terms, merge_log: Sequence[MergeLog], guards: Guards, automaton: Automaton, horizon: int, delta: float
) -> Terms:
    """Return the terms of a co-safe task, each with ``delta`` more per step that accepting early saves.

    Under the a-posteriori bound a run loses ``delta`` at every step that finds it undecided; the depth of a term says
    when it accepts (docs/theory/bounds.md, "A-posteriori"). ``delta`` is rounded down here, since it adds.
    """
    depths = term_depths(merge_log, guards, automaton.accepting, automaton.absorbing)
    worth = delta * (1 - 1e-9) if automaton.is_co_safe else 0.0
    gains = [np.asarray(1.0 + worth * (horizon - depth)) for depth in depths]
    # Terms with equal factors may differ in depth: give the first agent a factor for each term.
    factors, index = list(terms.factors), [rows.astype(np.int64) for rows in terms.index]
    scaled = [factors[0][rows[:, 0]] * np.reshape(gain, (-1, 1)) for rows, gain in zip(index, gains, strict=True)]
    for rows, places in zip(index, slices_of(map(len, scaled)), strict=True):
        rows[:, 0] = np.arange(places.start, places.stop)
    return Terms((np.concatenate(scaled), *factors[1:]), tuple(index))


def joint_states(problem: Problem, states: Any) -> FloatArray:
    """Return states as an array (M, D): joint states (M, D) or (D,), or a mapping from agent name to (d_i,) vector."""
    if isinstance(states, Mapping):
        missing = sorted(set(problem.agent_names) ^ set(states))
        if missing:
            raise ValueError(f"`states`: expected one vector per agent, got a mismatch at {', '.join(missing[:5])}")
        states = np.concatenate([np.atleast_1d(np.asarray(states[n], dtype=float)) for n in problem.agent_names])
    joint = np.atleast_2d(np.asarray(states, dtype=float))
    if joint.ndim != 2 or joint.shape[1] != problem.n_states:
        raise ValueError(f"`states`: expected shape (M, {problem.n_states}), got {joint.shape}")
    return joint
