"""The paper's policy heuristics: the 1-norms of the other agents' factors serve as weights.

The policies are chosen backward in time: one per automaton state and agent, at every step anew, for all agents at once.
Given the candidate terms of state q and the policies of the step before, agent i maximises in every cell

    sum_l  c_l  P_u[mask v_l,i],      c_l = prod_{j != i} || P_j^{pi_j} [mask v_l,j] ||_1,

over the terms that are alive under those policies (their largest value exceeds ``ALIVE``), with the operator of the
robust tree, which loses delta. Ties go to the first choice, so the result is deterministic.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....synthesis.abstraction.models import JointModel, gather
from ....synthesis.certificates.value_functions import Terms, compress
from ....synthesis.policy_search.ascent import Candidates, assemble, candidates, terminal_terms
from ....synthesis.policy_search.bounds import plain_loss
from ....synthesis.relations.grids import FloatArray

ALIVE = 1e-15
"""The paper's pruning rule: terms whose largest value does not exceed this are dropped."""


@dataclass(frozen=True, eq=False)
class HeuristicStep:
    """The policies and the value with t steps to go.

    Parameters
    ----------
    steps : int
        Number of steps t.
    policies : tuple of (Q, S_i) arrays
        Policies of the first of these steps.
    terms : Terms
        Value of the policies so far, a lower bound.
    """

    steps: int
    policies: tuple[NDArray[np.int32], ...]
    terms: Terms


def paper_steps(joint: JointModel) -> Iterator[HeuristicStep]:
    """Yield the paper's value iteration, which chooses policies as it goes, for 1, 2, .. ``joint.horizon`` steps."""
    # Before the first step every cell takes its first choice; cells without a choice have -1.
    policies = tuple(np.tile(np.maximum(m.choices.resting_choice, 0) * 0, (joint.n_states, 1)) for m in joint.models)
    policies = tuple(
        np.where(m.choices.resting_choice < 0, -1, policy) for m, policy in zip(joint.models, policies, strict=True)
    )
    terms = terminal_terms(joint.accepting, joint.n_cells)
    for t in range(1, joint.horizon + 1):
        options = candidates(joint.guards, joint.masks, joint.models, terms, plain_loss)
        terms_by_state, new_policies = [], tuple(policy.copy() for policy in policies)
        for q in range(joint.n_states):
            # In absorbing states nothing is chosen: the value is 1 if the state accepts, otherwise it has no terms.
            if joint.absorbing[q]:
                ones = [np.ones((1, n)) for n in joint.n_cells]
                rows = np.zeros((int(joint.accepting[q]), len(joint.models)), dtype=np.int64)
                terms_by_state.append((ones, rows))
                continue
            chosen, terms_of_state = _choose(joint, options, q, [policy[q] for policy in policies])
            for policy, choice in zip(new_policies, chosen, strict=True):
                policy[q] = choice
            terms_by_state.append(terms_of_state)
        terms, policies = assemble(terms_by_state, joint.n_cells), new_policies
        yield HeuristicStep(t, policies, terms)


def _choose(
    joint: JointModel, options: Candidates, q: int, policies: list[NDArray[np.int32]]
) -> tuple[list[NDArray[np.int32]], tuple[list[FloatArray], NDArray[np.int64]]]:
    """Return the new policies of state q, and the terms that they leave alive."""
    # Tables of the factors of each agent, and under the old policies their 1-norms and largest values.
    rows = options.index[q].copy()
    tables, norms, largest = [], [], np.ones(len(rows))
    for i, model in enumerate(joint.models):
        table, rows[:, i] = compress(options.backed_up[i], rows[:, i])
        values = gather(table, model.choices.points(policies[i]))
        tables.append(table)
        norms.append(values.sum(axis=1)[rows[:, i]])
        largest *= values.max(axis=1, initial=0.0)[rows[:, i]]
    # Products of many norms underflow, so weights are formed from logarithms and scaled to a largest value of 1.
    logs = np.log(np.maximum(np.array(norms), 1e-300))
    alive = (largest > ALIVE).astype(float)
    chosen, factors, after = [], [], np.ones(len(rows))
    for i, model in enumerate(joint.models):
        log_weight = logs.sum(axis=0) - logs[i]
        weight = np.exp(log_weight - log_weight.max(initial=-np.inf, where=alive > 0)) * alive if alive.any() else alive
        weights = np.bincount(rows[:, i], weights=np.where(alive > 0, weight, 0.0), minlength=len(tables[i]))
        nothing = np.full(model.n_cells, -1, dtype=np.int32)
        policy = model.choices.best(weights[None], tables[i], nothing)
        values = gather(tables[i], model.choices.points(policy))
        chosen.append(policy)
        factors.append(values)
        after *= values.max(axis=1, initial=0.0)[rows[:, i]]
    # Drop the terms that the new policies leave dead.
    survivors = np.flatnonzero(after > ALIVE)
    rows = rows[survivors]
    for i in range(len(factors)):
        factors[i], rows[:, i] = compress(factors[i], rows[:, i])
    return chosen, (factors, rows)
