"""Dense joint dynamic programming: the exact oracle for small problems.

No guards, no terms, no sharing: one array over all joint cells per automaton state, and the outcome of every joint cell
is looked up in the automaton letter by letter. ``dense_value`` evaluates given policies, also in exact rationals;
``dense_optimum`` maximises over all policies of the same abstraction, centralised and history-dependent ones included.
That is an optimum of the *abstraction*, no upper bound for the continuous system (docs/theory/bounds.md, "Upper bounds,
and of what").
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...abstraction.models import AgentModel, Policies

UNCERTAIN = -1
"""Entry of a joint cell whose successor is not certain: failure."""

MAX_ENTRIES = 50_000_000
"""Most entries of one dense array, 400 MB."""


def dense_value(problem: Problem, models: Sequence[AgentModel], policies: Policies) -> NDArray:
    """Return the value (Q, S_1, .., S_I) at time 0 of the abstraction under ``policies`` (exact for exact tables).

    Raises
    ------
    ValueError
        If a joint array would have more than ``MAX_ENTRIES`` entries.
    """
    _refuse_bounds(models)
    outcome = joint_outcomes(problem, models)
    value = _terminal(problem, outcome, models)
    transitions = [_full_table(model) for model in models]
    for t in reversed(range(problem.horizon)):
        following = np.zeros_like(value)
        for q in range(len(value)):
            # Read the letter, then take the expectation over one agent after the other: their noises are independent.
            expected = _read(problem, value, outcome[q])
            for i, table in enumerate(transitions):
                policy = models[i].choices.points(policies[i][t, q])
                matrix = table[np.maximum(policy, 0)] * (policy >= 0)[:, None]
                expected = np.moveaxis(np.tensordot(matrix, expected, axes=(1, i)), 0, i)
            following[q] = expected
        value = _absorb(problem, following)
    return value


def dense_optimum(problem: Problem, models: Sequence[AgentModel]) -> NDArray[np.float64]:
    """Return the largest value (Q, S_1, .., S_I) at time 0 over all policies of the abstraction (abstract optimum).

    Agents choose from a menu of inputs, or targets whose admissible ones are products of intervals (scaled permutation
    inputs).
    """
    _refuse_bounds(models)
    if any(model.choices.dense_cost is None for model in models):
        raise ValueError("`models`: expected agents whose admissible targets are boxes")
    outcome = joint_outcomes(problem, models)
    value = _terminal(problem, outcome, models).astype(float)
    for _ in range(problem.horizon):
        following = np.zeros_like(value)
        for q in range(len(value)):
            # All expectations first, then all maxima: nobody chooses knowing another agent's noise.
            expected = _read(problem, value, outcome[q])
            for i, model in enumerate(models):
                expected = np.moveaxis(_expected_along(model, np.moveaxis(expected, i, -1)), -1, i)
            for i, model in enumerate(models):
                expected = np.moveaxis(_best_along(model, np.moveaxis(expected, i, -1)), -1, i)
            following[q] = expected
        value = _absorb(problem, following)
    return value


def _refuse_bounds(models: Sequence[AgentModel]) -> None:
    """Raise ValueError if a model has values at corners, or boxes of means: dense programming knows neither."""
    for model in models:
        if not model.is_additive:
            raise ValueError(
                f"`models`: expected one value per cell and one mean per choice, got the relation "
                f"`{model.relation.kind}`; use another relation"
            )


def joint_outcomes(problem: Problem, models: Sequence[AgentModel]) -> NDArray[np.int64]:
    """Return the successor (Q, S_1, .., S_I) of every automaton state in every joint cell, in the robust automaton.

    It is ``UNCERTAIN`` where a cell may lead to several states, acceptance of co-safe tasks aside.
    """
    shape = tuple(model.n_cells for model in models)
    if problem.automaton.n_states * float(np.prod(shape, dtype=float)) > MAX_ENTRIES:
        raise ValueError(
            f"`models`: expected at most {MAX_ENTRIES} joint entries, got cells {shape}; use fewer `cells`"
        )
    automaton, labeling = problem.automaton, problem.labeling
    # One row and column more per agent for failed cells, whose label -1 picks the last entry.
    table = np.full((automaton.n_states, *(len(m.labels.sets) + 1 for m in models)), UNCERTAIN, dtype=np.int64)
    for sets in product(*(range(len(m.labels.sets)) for m in models)):
        classes = [labeling.classes[i][models[i].labels.sets[n]] for i, n in enumerate(sets)]
        letters = np.array([np.concatenate(rows) for rows in product(*classes)]).T
        for q in range(automaton.n_states):
            reached = {int(r) for r in automaton.next_state(np.full(letters.shape[1], q), letters)}
            unfinished = {r for r in reached if not automaton.finished[r]}
            if len(unfinished) <= 1:
                table[(q, *sets)] = unfinished.pop() if unfinished else reached.pop()
    labels = np.ix_(*(model.labels.number for model in models))
    return np.stack([successors[labels] for successors in table])


def _terminal(problem: Problem, outcome: NDArray, models: Sequence[AgentModel]) -> NDArray:
    """Return the value with no step to go."""
    dtype = models[0].kernel.tables[0].blocks[0][-1].dtype
    value = np.zeros(outcome.shape, dtype=dtype)
    value[problem.automaton.accepting] = 1
    return value


def _absorb(problem: Problem, value: NDArray) -> NDArray:
    """Return the value with 1 in accepting states of co-safe tasks, which keep it."""
    value[problem.automaton.finished] = 1
    return value


def _read(problem: Problem, value: NDArray, outcome: NDArray) -> NDArray:
    """Return the value of arriving in each joint cell, its letter read: 0 where that fails."""
    arriving = np.zeros_like(value[0])
    for q in range(len(value)):
        arriving = np.where(outcome == q, value[q], arriving)
    return arriving


def _full_table(model: AgentModel) -> NDArray:
    """Return the masses (Z, S) over all axes."""
    table, *others = (axis_table.toarray() for axis_table in model.kernel.tables)
    for axis in others:
        table = np.einsum("as,bt->abst", table, axis).reshape(len(table) * len(axis), -1)
    return table


def _expected_along(model: AgentModel, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return expectations (.., Z) at an agent's lattice points, of values (.., S) of arriving in its cells."""
    backed_up = model.kernel.backup(np.ascontiguousarray(values).reshape(-1, model.n_cells))
    return backed_up.reshape(*values.shape[:-1], -1)


def _best_along(model: AgentModel, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the best (.., S) over an agent's admissible choices, of expectations (.., Z) at its lattice points."""
    best = model.choices.dense_best(np.ascontiguousarray(values).reshape(-1, values.shape[-1]))
    return best.reshape(*values.shape[:-1], model.n_cells)
