"""Upper bounds by relaxation: each agent alone, the others' labels chosen in its favour.

For agent i let the letters of the other agents be chosen favourably, step by step and inside the expectation:

    V^i_q,t+1(x) = max_u E[ max over q' in next_exists(q, L_i(x')) of V^i_q',t(x') ] .

Where a cell may have several labels, the worst of them counts: the robust automaton goes to q' only if every letter
that is possible leads there, or to acceptance, which is worth no less.

Each ``V^i`` bounds the joint optimum from above (THEORY section 7), and so does their **product**, which is never
larger. For the joint optimum W, by induction, ``W_q,t(x) <= prod_i V^i_q,t(x_i)``: at t = 0 both sides are 1 or 0; and

    W_q,t+1(x) = max_u E[ W_q',t(x') ] <= max_u E[ prod_i V^i_q',t(x'_i) ]
              <= max_u E[ prod_i max over q'' in next_exists(q, L_i(x'_i)) of V^i_q'',t(x'_i) ]
               = prod_i V^i_q,t+1(x_i) ,

the last step because the agents' noises are independent and each factor depends on one agent alone. The joint optimum
is that of every policy, centralised or with any memory, of the same abstraction: ``abstract optimum``. For tasks that
ask for something of each agent separately the product is the optimum. The policies that attain the ``V^i`` go for the
task as if the team would follow; put together they make a good start for the ascent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.logic import Automaton, followed
from ...envs.problem import Problem
from ..cells import FloatArray
from ..models import AgentModel, JointModel, Policies
from ..values import UNIT, Occupancy
from .best_response import TIE, best_choices
from .tree import gather


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Optimum of one agent whose team follows.

    Parameters
    ----------
    values : (Q, S) array
        Upper bounds, up to rounding, on what any joint policy attains from each automaton state and cell.
    policy : (T, Q, S) int32 array
        The choices that attain them.
    """

    values: FloatArray
    policy: NDArray[np.int32]


def relax(problem: Problem, joint: JointModel, known: dict[object, Relaxation] | None = None) -> tuple[Relaxation, ...]:
    """The relaxation of every agent; agents that are alike share theirs. New ones are added to the ``known`` ones."""
    found = {} if known is None else known
    relaxations = []
    for model, follows in zip(joint.models, favourable_successors(problem), strict=True):
        key = (id(model), follows.tobytes())
        if key not in found:
            found[key] = _solve(joint, model, follows)
        relaxations.append(found[key])
    return tuple(relaxations)


def upper_bound(joint: JointModel, start: Occupancy, relaxations: tuple[Relaxation, ...]) -> float:
    """Upper bound on what any policy attains on this abstraction from the start (mean over a box)."""
    total = 0.0
    for q, rows in enumerate(start.terms.index):
        for row in rows:
            product = 1.0
            for own, k, one in zip(start.terms.factors, row, relaxations, strict=True):
                product *= float(own[k] @ one.values[q])
            total += product
    loss = joint.horizon * sum(model.kernel.loss for model in joint.models)
    n = joint.horizon * sum(s + 1 for s in joint.n_cells) + len(joint.models)
    ties = joint.horizon * len(joint.models) * TIE  # an incumbent stays where it is that close to the best
    return min(1.0, total * (1.0 + 4.0 * n * UNIT + 2.0 * ties) + loss + 1e-12)


def relaxed_policies(relaxations: tuple[Relaxation, ...]) -> Policies:
    """The policies of all relaxations, one per agent."""
    return tuple(one.policy for one in relaxations)


def _solve(joint: JointModel, model: AgentModel, follows: NDArray[np.bool_]) -> Relaxation:
    """Dynamic programming over one agent's cells; ``follows[q, c, p]`` where class c can lead from q to p."""
    n_q = joint.n_states
    value = np.repeat(joint.accepting.astype(float)[:, None], model.n_cells, axis=1)
    settled = value.copy()
    policy = np.tile(model.choices.resting_choice, (joint.horizon, n_q, 1))
    weights, classes = np.ones((model.n_cells, 1)), _cells_by_class(model, follows)
    for t in reversed(range(joint.horizon)):
        smoothed = model.kernel.smooth(_arriving(value, classes))
        for q in range(n_q):
            if joint.absorbing[q]:
                value[q] = settled[q]
                continue
            policy[t, q] = best_choices(model.choices, weights, smoothed[q : q + 1], policy[t, q])
            value[q] = gather(smoothed[q : q + 1], model.choices.points(policy[t, q]))[0]
    return Relaxation(value, policy)


def _cells_by_class(
    model: AgentModel, follows: NDArray[np.bool_]
) -> list[tuple[NDArray[np.bool_], NDArray[np.int64]]]:  # fmt: skip
    """What can follow (Q, Q) on each class of labels, and the cells that may have it; those that lead alike as one."""
    sets, number = model.labels.sets, model.labels.number
    _, kind = np.unique(follows.transpose(1, 0, 2).reshape(follows.shape[1], -1), axis=0, return_inverse=True)
    found = []
    for k in range(int(kind.max(initial=-1)) + 1):
        own = np.flatnonzero(kind.ravel() == k)
        has = np.append(sets[:, own].any(axis=1), False)  # the last one is of cells without labels
        found.append((follows[:, own[0]], np.flatnonzero(has[number])))
    return found


def _arriving(
    value: FloatArray, classes: list[tuple[NDArray[np.bool_], NDArray[np.int64]]]
) -> FloatArray:  # fmt: skip
    """(Q, S) most that arriving in a cell is worth, its worst class counting; 0 where nothing is known of it."""
    arriving = np.full(value.shape, np.inf)
    for follows, cells in classes:
        here = value[:, cells]
        for q, after in enumerate(follows):
            best = here[after].max(axis=0) if after.any() else 0.0
            arriving[q, cells] = np.minimum(arriving[q, cells], best)
    arriving[np.isinf(arriving)] = 0.0
    return arriving


def favourable_successors(problem: Problem) -> list[NDArray[np.bool_]]:
    """Per agent (Q, C_i, Q): whether some letter with its class c leads from q to q' (or more; never less)."""
    automaton, labeling = problem.automaton, problem.labeling
    ends = _terminals(automaton)
    tables = [
        np.zeros((automaton.n_states, len(classes), automaton.n_states), dtype=bool) for classes in labeling.classes
    ]
    for q in range(automaton.n_states):
        frontier = {int(automaton.root[q])}
        for i, (own, classes) in enumerate(zip(labeling.agent_propositions, labeling.classes, strict=True)):
            positions = {int(p): k for k, p in enumerate(own)}
            following: set[int] = set()
            for c, row in enumerate(classes):
                for entry in frontier:
                    e = followed(automaton, entry, positions, row)
                    following.add(e)
                    tables[i][q, c, list(ends(e))] = True
            frontier = following
    return tables


def _terminals(automaton: Automaton) -> Any:
    """Function from an entry of the decision diagram to the automaton states that can follow it."""
    known: dict[int, frozenset[int]] = {}

    def ends(entry: int) -> frozenset[int]:
        """States below one entry, by a depth-first walk."""
        stack = [entry]
        while stack:
            e = stack[-1]
            if e in known:
                stack.pop()
            elif e < 0:
                known[e] = frozenset((-1 - e,))
            else:
                below = [int(automaton.low[e]), int(automaton.high[e])]
                missing = [b for b in below if b not in known]
                if missing:
                    stack += missing
                else:
                    known[e] = known[below[0]] | known[below[1]]
        return known[entry]

    return ends
