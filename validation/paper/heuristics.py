"""The paper's policy heuristics: the other agents' 1-norms as weights.

Backward in time, one policy per automaton state and agent, chosen anew at every step for all agents at once. With the
candidate terms of state q and the policies of the step before, agent i maximises in every cell

    sum_l  c_l  zeta_l  P_u[mask v_l,i],      c_l = prod_{j != i} || P_j^{pi_j} [mask v_l,j] ||_1,

over the terms that are alive under those policies (``> ALIVE`` in their largest value). ``zeta`` is 1 for the base form
and for the robust tree, whose operator loses delta, and ``1 + Delta (T - depth)`` for the a-posteriori form. Ties go to
the first choice, so the result is deterministic.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...synthesis.bounds import plain_loss
from ...synthesis.cells import FloatArray
from ...synthesis.models import JointModel, Policies
from ...synthesis.relations import joint_delta
from ...synthesis.search import Candidates, assemble, best_choices, candidates, gather, terminal_terms
from ...synthesis.values import Terms, candidate_depths, compress

ALIVE = 1e-15
"""The paper's pruning rule: terms whose largest value does not exceed this are dropped."""

KINDS = ("base", "a-posteriori", "robust tree")


@dataclass(frozen=True, eq=False)
class HeuristicStep:
    """Outcome with t steps to go.

    Parameters
    ----------
    steps : int
        t.
    policies : tuple of (Q, S_i) arrays
        Policies of the first of these steps.
    terms : Terms
        Value of the policies so far (for ``robust tree`` their robust value).
    depths : tuple of (R_q,) arrays
        Steps to acceptance of each term.
    """

    steps: int
    policies: tuple[NDArray[np.int32], ...]
    terms: Terms
    depths: tuple[NDArray[np.int64], ...]


def paper_steps(joint: JointModel, kind: str) -> Iterator[HeuristicStep]:
    """The paper's value iteration with policies on the way, for 1, 2, .. ``joint.horizon`` steps to go.

    Parameters
    ----------
    joint : JointModel
    kind : str
        ``"base"``, ``"a-posteriori"`` or ``"robust tree"`` (with the plain operator, refused for factors above 1).
    """
    if kind not in KINDS:
        raise ValueError(f"`kind`: expected one of {', '.join(KINDS)}, got {kind!r}")
    delta = joint_delta([model.delta for model in joint.models]) if kind == "a-posteriori" else 0.0
    loss = plain_loss if kind == "robust tree" else None
    policies = tuple(np.tile(np.maximum(m.choices.resting_choice, 0) * 0, (joint.n_states, 1)) for m in joint.models)
    policies = tuple(
        np.where(m.choices.resting_choice < 0, -1, policy) for m, policy in zip(joint.models, policies, strict=True)
    )
    terms = terminal_terms(joint.accepting, joint.n_cells)
    depths = [np.zeros(int(accepted), dtype=np.int64) for accepted in joint.accepting]
    for t in range(1, joint.horizon + 1):
        options = candidates(joint.guards, joint.masks, joint.models, terms, loss)
        parts, new_policies, new_depths = [], tuple(policy.copy() for policy in policies), []
        for q in range(joint.n_states):
            if joint.absorbing[q]:
                parts.append(
                    (
                        [np.ones((1, n)) for n in joint.n_cells],
                        np.zeros((int(joint.accepting[q]), len(joint.models)), dtype=np.int64),
                    )
                )
                new_depths.append(np.zeros(int(joint.accepting[q]), dtype=np.int64))
                continue
            depth = candidate_depths(options.origin[q], options.merges[q], joint.guards, depths)[options.row[q]]
            chosen, part, kept = _choose(
                joint, options, q, [policy[q] for policy in policies], 1.0 + delta * (t - depth)
            )
            for policy, own in zip(new_policies, chosen, strict=True):
                policy[q] = own
            parts.append(part)
            new_depths.append(depth[kept])
        terms, policies, depths = assemble(parts, joint.n_cells), new_policies, new_depths
        yield HeuristicStep(t, policies, terms, tuple(depths))


def paper_policies(joint: JointModel, kind: str) -> Policies:
    """Policies (T, Q, S_i) of the paper's heuristic for the whole horizon."""
    steps = [step.policies for step in paper_steps(joint, kind)]
    return tuple(
        np.stack([policies[i] for policies in reversed(steps)]).astype(np.int32) for i in range(len(joint.models))
    )


def _choose(
    joint: JointModel, options: Candidates, q: int, policies: list[NDArray[np.int32]], zeta: FloatArray
) -> tuple[list[NDArray[np.int32]], tuple[list[FloatArray], NDArray[np.int64]], NDArray[np.int64]]:
    """New policies of state q, the terms they leave alive, and which candidates those are."""
    rows = options.index[q].copy()
    tables, norms, largest = [], [], np.ones(len(rows))
    for i, model in enumerate(joint.models):
        table, rows[:, i] = compress(options.smoothed[i], rows[:, i])
        values = gather(table, model.choices.points(policies[i]))
        tables.append(table)
        norms.append(values.sum(axis=1)[rows[:, i]])
        largest *= values.max(axis=1, initial=0.0)[rows[:, i]]
    logs = np.log(np.maximum(np.array(norms), 1e-300))
    alive = (largest > ALIVE) * zeta
    chosen, factors, after = [], [], np.ones(len(rows))
    for i, model in enumerate(joint.models):
        log_weight = logs.sum(axis=0) - logs[i]
        weight = np.exp(log_weight - log_weight.max(initial=-np.inf, where=alive > 0)) * alive if alive.any() else alive
        weights = np.bincount(rows[:, i], weights=np.where(alive > 0, weight, 0.0), minlength=len(tables[i]))
        nothing = np.full(model.n_cells, -1, dtype=np.int32)
        policy = best_choices(model.choices, weights[None], tables[i], nothing)
        values = gather(tables[i], model.choices.points(policy))
        chosen.append(policy)
        factors.append(values)
        after *= values.max(axis=1, initial=0.0)[rows[:, i]]
    kept = np.flatnonzero(after > ALIVE)
    rows = rows[kept]
    for i in range(len(factors)):
        factors[i], rows[:, i] = compress(factors[i], rows[:, i])
    return chosen, (factors, rows), kept
