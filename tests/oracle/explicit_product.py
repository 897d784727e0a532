"""The finite joint model written out state by state, as a model checker needs it.

The states are joint cells times automaton states, and one failure state for all lost mass: cells outside the workspace,
failed letters, and the tails that the kernels leave out. The model grows like the product of the agents' cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from certigym import Problem
from certigym.synthesis.abstraction.models.action_tables import Policies
from certigym.synthesis.abstraction.models.finite_models import AgentModel
from certigym.synthesis.abstraction.models.target_windows import TargetWindows
from certigym.synthesis.policy_search.bounds.dense import joint_outcomes


@dataclass(frozen=True, eq=False)
class Explicit:
    """A Markov chain or decision process with explicit states.

    Parameters
    ----------
    transitions : sparse (rows, states)
        Probabilities; every row sums to 1.
    first : (states + 1,) int array
        Rows of a state s: ``first[s] .. first[s + 1] - 1``, one per choice; in a chain every state has one.
    goal : (states,) bool array
    """

    transitions: scipy.sparse.csr_array
    first: NDArray[np.int64]
    goal: NDArray[np.bool_]

    def reach_within(self, steps: int) -> NDArray[np.float64]:
        """Return the largest probability (states,) to reach the goal within so many steps, by plain value iteration."""
        value = self.goal.astype(float)
        for _ in range(steps):
            value = np.maximum.reduceat(self.transitions @ value, self.first[:-1])
            value[self.goal] = 1.0
        return value


def chain_under(problem: Problem, models: Sequence[AgentModel], policies: Policies) -> Explicit:
    """Return the Markov chain of a co-safe task under changing policies, states ``(t Q + q) S + s`` and failure."""
    outcome = _outcomes(problem, models)
    n_states, n_joint = outcome.shape
    layer = n_states * n_joint
    failure = (problem.horizon + 1) * layer
    rows = []
    for t in range(problem.horizon):
        for q in range(n_states):
            factors = [_law_rows(model, policy[t, q]) for model, policy in zip(models, policies)]
            rows.append(_landing(_kron(factors), outcome[q], (t + 1) * layer, failure))
    rows.append(_selves(np.arange(problem.horizon * layer, failure + 1), failure + 1))
    accepting = np.repeat(np.asarray(problem.automaton.accepting), n_joint)
    goal = np.append(np.tile(accepting, problem.horizon + 1), False)
    return Explicit(scipy.sparse.csr_array(scipy.sparse.vstack(rows)), np.arange(failure + 2), goal)


def decision_process(problem: Problem, models: Sequence[AgentModel]) -> Explicit:
    """Return the Markov decision process of a co-safe task over all joint targets, states ``q S + s`` and failure."""
    outcome = _outcomes(problem, models)
    n_states, n_joint = outcome.shape
    failure = n_states * n_joint
    tables = [model.kernel.tables[0].toarray() for model in models]
    windows = [_windows(model) for model in models]
    joint_cells = list(product(*(range(model.n_cells) for model in models)))
    choices = [list(product(*(own[s] for own, s in zip(windows, cells)))) for cells in joint_cells]
    counts = [max(1, len(own)) for own in choices]
    rows = []
    for q in range(n_states):
        if problem.automaton.accepting[q]:
            rows.append(_selves(np.repeat(np.arange(q * n_joint, (q + 1) * n_joint), counts), failure + 1))
            continue
        points = np.array([point for own in choices for point in own or [(-1,) * len(models)]])
        policy = _kron_rows([table[points[:, i]] for i, table in enumerate(tables)])
        rows.append(_landing(policy * (points[:, :1] >= 0), outcome[q], 0, failure))
    rows.append(_selves(np.array([failure]), failure + 1))
    first = np.concatenate([[0], np.cumsum([*counts * n_states, 1])])
    goal = np.append(np.repeat(np.asarray(problem.automaton.accepting), n_joint), False)
    return Explicit(scipy.sparse.csr_array(scipy.sparse.vstack(rows)), first, goal)


def _outcomes(problem: Problem, models: Sequence[AgentModel]) -> NDArray[np.int64]:
    """Return the successor (Q, S) of every automaton state in every joint cell; negative where the task fails."""
    if problem.automaton.semantics != "co-safe":
        raise ValueError(f"`problem`: expected a co-safe task, got {problem.automaton.semantics}")
    return joint_outcomes(problem, models).reshape(problem.automaton.n_states, -1)


def _windows(model: AgentModel) -> list[range]:
    assert isinstance(model.choices, TargetWindows) and len(model.grid.shape) == 1
    return [range(int(low[0]), int(high[0])) for low, high in zip(model.choices.low, model.choices.high)]


def _law_rows(model: AgentModel, policy: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the transition rows (S, S) of one agent under a policy; 0 at cells without a choice."""
    points = model.choices.points(policy)
    return np.asarray(model.kernel.tables[0].toarray()[np.maximum(points, 0)] * (points >= 0)[:, None])


def _kron(factors: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    return reduce(lambda joint, factor: np.asarray(np.kron(joint, factor)), factors)


def _kron_rows(factors: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    joint = np.ones((len(factors[0]), 1))
    for factor in factors:
        joint = (joint[:, :, None] * factor[:, None, :]).reshape(len(joint), -1)
    return joint


def _landing(
    policy: NDArray[np.float64], outcome: NDArray[np.int64], offset: int, failure: int
) -> scipy.sparse.csr_array:
    """Return rows (n, failure + 1) over joint cells after reading each cell's letter; the rest is failure."""
    n_joint = len(outcome)
    kept = np.where(outcome >= 0, policy, 0.0)
    row, cell = np.nonzero(kept)
    lost = np.maximum(0.0, 1.0 - kept.sum(axis=1))
    columns = np.concatenate([offset + outcome[cell] * n_joint + cell, np.full(len(policy), failure)])
    entries, rows = np.concatenate([kept[row, cell], lost]), np.concatenate([row, np.arange(len(policy))])
    return scipy.sparse.csr_array((entries, (rows, columns)), (len(policy), failure + 1))


def _selves(states: NDArray[np.int64], size: int) -> scipy.sparse.csr_array:
    """Return rows of states that stay where they are."""
    return scipy.sparse.csr_array((np.ones(len(states)), (np.arange(len(states)), states)), (len(states), size))
