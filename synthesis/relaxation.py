"""Upper bounds by relaxation: each agent alone, the others' labels chosen in its favour.

For agent i let the letters of the other agents be chosen favourably, step by step and inside the expectation:

    V^i_q,t+1(x) = max_u E[ max over q' in next_exists(q, L_i(x')) of V^i_q',t(x') ] .

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

from ..envs.automaton import Automaton
from ..envs.problem import Problem
from .abstraction import AgentModel
from .ascent import Laws
from .best_response import TIE, best_choices
from .grid import FloatArray
from .joint import JointModel
from .kernel import UNIT
from .occupancy import Occupancy
from .value import gather


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Optimum of one agent whose team follows.

    Parameters
    ----------
    values : (Q, S) array
        Upper bounds, up to rounding, on what any joint policy attains from each automaton state and cell.
    law : (T, Q, S) int32 array
        The choices that attain them.
    """

    values: FloatArray
    law: NDArray[np.int32]


def relax(problem: Problem, joint: JointModel) -> tuple[Relaxation, ...]:
    """The relaxation of every agent; agents that are alike share theirs."""
    found: dict[tuple[int, bytes], Relaxation] = {}
    relaxations = []
    for model, follows in zip(joint.models, favourable_successors(problem), strict=True):
        sets = model.labels.sets.astype(np.int64)
        possible = np.einsum("nc,qcp->qnp", sets, follows.astype(np.int64)) > 0
        key = (id(model), possible.tobytes())
        if key not in found:
            found[key] = _solve(joint, model, possible)
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


def relaxed_laws(relaxations: tuple[Relaxation, ...]) -> Laws:
    """The policies of all relaxations, one per agent."""
    return tuple(one.law for one in relaxations)


def _solve(joint: JointModel, model: AgentModel, possible: NDArray[np.bool_]) -> Relaxation:
    """Dynamic programming over one agent's cells; ``possible[q, n, p]`` where label set n can lead from q to p."""
    n_q, number = joint.n_states, model.labels.number
    reachable = possible[:, np.maximum(number, 0)] & (number >= 0)[None, :, None]
    value = np.repeat(joint.accepting.astype(float)[:, None], model.n_cells, axis=1)
    settled = value.copy()
    law = np.tile(model.choices.resting_law, (joint.horizon, n_q, 1))
    weights = np.ones((model.n_cells, 1))
    for t in reversed(range(joint.horizon)):
        arriving = np.zeros_like(value)
        for p in range(n_q):
            arriving = np.maximum(arriving, reachable[:, :, p] * value[p])
        smoothed = model.kernel.smooth(arriving)
        for q in range(n_q):
            if joint.absorbing[q]:
                value[q] = settled[q]
                continue
            law[t, q] = best_choices(model.choices, weights, smoothed[q : q + 1], law[t, q])
            value[q] = gather(smoothed[q : q + 1], model.choices.points(law[t, q]))[0]
    return Relaxation(value, law)


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
                    e = entry
                    while e >= 0 and (k := positions.get(int(automaton.variable[e]))) is not None:
                        e = int(automaton.high[e] if row[k] else automaton.low[e])
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
