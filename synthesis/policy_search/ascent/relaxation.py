"""Upper bounds by relaxation: each agent alone, the others' labels chosen in its favour.

For agent i let the letters of the other agents be chosen favourably, step by step and inside the expectation:

    V^i_q,t+1(x) = max_u E[ max over q' in next_exists(q, L_i(x')) of V^i_q',t(x') ] .

Where a cell may have several labels, the worst of them counts: the robust automaton goes to q' only if every letter
that is possible leads there, or to acceptance, which is worth no less.

Each ``V^i`` bounds the joint optimum from above, and so does their **product**, which is never larger
(docs/theory/bounds.md, "Upper bounds, and of what", Proposition Bounds.3). For the joint optimum W, by induction,
``W_q,t(x) <= prod_i V^i_q,t(x_i)``: at t = 0 both sides are 1 or 0; and

    W_q,t+1(x) = max_u E[ W_q',t(x') ] <= max_u E[ prod_i V^i_q',t(x'_i) ]
              <= max_u E[ prod_i max over q'' in next_exists(q, L_i(x'_i)) of V^i_q'',t(x'_i) ]
               = prod_i V^i_q,t+1(x_i) ,

the last step because the agents' noises are independent and each factor depends on one agent alone. The joint optimum
is that of every policy of the same abstraction, centralised or with any memory: ``abstract optimum``. For tasks that
ask for something of each agent separately the product is the optimum. The policies that attain the ``V^i`` go for the
task as if the team would follow; put together they make a good start for the ascent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.automata import Automaton, followed
from ....envs.tasks.problem import Problem
from ...abstraction.models import TIE, AgentModel, JointModel, Policies, best_offered
from ...certificates.value_functions import UNIT, Occupancy
from ...relations.grids import FloatArray


@dataclass(frozen=True, eq=False, repr=False)
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

    def __repr__(self) -> str:
        times, states, cells = self.policy.shape
        return f"Relaxation({times} times, {states} automaton states, {cells} cells)"


def relax(
    problem: Problem, joint: JointModel, solved: dict[object, Relaxation] | None = None
) -> tuple[Relaxation, ...]:
    """Return the relaxation of every agent (upper bounds); agents that are alike share theirs.

    Parameters
    ----------
    problem : Problem
    joint : JointModel
    solved : dict, optional
        Relaxations that were solved before; new ones are added.
    """
    solved = {} if solved is None else solved
    relaxations = []
    for model, follows in zip(joint.models, favourable_successors(problem), strict=True):
        key = (id(model), follows.tobytes())
        if key not in solved:
            solved[key] = _solve(joint, model, follows)
        relaxations.append(solved[key])
    return tuple(relaxations)


def upper_bound(joint: JointModel, start: Occupancy, relaxations: tuple[Relaxation, ...]) -> float:
    """Return an upper bound on what any policy attains on this abstraction from the start (mean over a box)."""
    total = 0.0
    for q, rows in enumerate(start.terms.index):
        for row in rows:
            product = 1.0
            for masses, k, relaxation in zip(start.terms.factors, row, relaxations, strict=True):
                product *= float(masses[k] @ relaxation.values[q])
            total += product
    # Add what kernels miss, what sums may have rounded, and what ties may have cost: incumbents that close to the best
    # stay where they are.
    loss = joint.horizon * sum(model.kernel.loss for model in joint.models)
    n = joint.horizon * sum(s + 1 for s in joint.n_cells) + len(joint.models)
    ties = joint.horizon * len(joint.models) * TIE
    return min(1.0, total * (1.0 + 4.0 * n * UNIT + 2.0 * ties) + loss + 1e-12)


def relaxed_policies(relaxations: tuple[Relaxation, ...]) -> Policies:
    """Return the policies of all relaxations, one per agent."""
    return tuple(relaxation.policy for relaxation in relaxations)


def relax_one(
    joint: JointModel,
    model: AgentModel,
    follows: NDArray[np.bool_],
    thinned: FloatArray,
    incumbent: NDArray[np.int32] | None = None,
) -> Relaxation:
    """Return the best policy of one agent whose team follows, and who is taken away at random on its way.

    A heuristic for teams that must not collide: nothing is bounded by its values. ``thinned`` (T + 1, S) is the chance
    to stay at each time in each cell, and ``incumbent`` (T, Q, S) the policy that stays where nothing is better
    (default: resting).
    """
    return _solve(joint, model, follows, thinned, incumbent)


def _solve(
    joint: JointModel,
    model: AgentModel,
    follows: NDArray[np.bool_],
    thinned: FloatArray | None = None,
    incumbent: NDArray[np.int32] | None = None,
) -> Relaxation:
    """Solve the dynamic program of one agent; ``follows[q, c, p]`` says whether class c can lead from q to p."""
    n_q = joint.n_states
    value = np.repeat(joint.accepting.astype(float)[:, None], model.n_cells, axis=1)
    settled = value.copy()
    resting = np.repeat(model.resting_policy(joint.horizon)[:, None], n_q, axis=1)
    policy = resting if incumbent is None else incumbent.copy()
    weights, classes = np.ones((model.n_cells, 1)), _cells_by_class(model, follows)
    for t in reversed(range(joint.horizon)):
        # The favourable label is chosen before smoothing: inside the expectation.
        # Where automata count steps few states occur at a time, and the others are not smoothed.
        rows = np.flatnonzero(joint.occurs[t])
        if joint.spend is not None:
            joint.spend(len(rows) * model.n_cells / model.choices.read_per_second)
        arriving = _arriving(value, classes, rows)
        backed_up = model.kernel.backup(arriving if thinned is None else arriving * thinned[t + 1])
        place = dict(zip(rows.tolist(), range(len(rows)), strict=True))
        for q in range(n_q):
            if joint.absorbing[q]:
                value[q] = settled[q]
                continue
            if not joint.occurs[t, q]:
                value[q] = 1.0  # no run is there at this time: any upper bound will do
                continue
            here = backed_up[place[q] : place[q] + 1]
            policy[t, q] = best_offered(model.offered(t), weights, here, policy[t, q])
            value[q] = model.choices.read(here, policy[t, q])[0]
    return Relaxation(value, policy)


SuccessorsAndCells = list[tuple[NDArray[np.bool_], NDArray[np.int64]]]
"""Per class of labels: which states (Q, Q) can follow which, and the cells that may have it."""


def _cells_by_class(model: AgentModel, follows: NDArray[np.bool_]) -> SuccessorsAndCells:
    """Return successors and cells of each class of labels, classes that lead alike taken as one."""
    sets, number = model.labels.sets, model.spread(model.labels.number)
    _, kind = np.unique(follows.transpose(1, 0, 2).reshape(follows.shape[1], -1), axis=0, return_inverse=True)
    result = []
    for k in range(int(kind.max(initial=-1)) + 1):
        members = np.flatnonzero(kind.ravel() == k)
        has = np.append(sets[:, members].any(axis=1), False)  # the last entry is read by cells with label -1
        result.append((follows[:, members[0]], np.flatnonzero(has[number])))
    return result


def _arriving(value: FloatArray, classes: SuccessorsAndCells, rows: NDArray[np.int64]) -> FloatArray:
    """Return upper bounds (n, S) on what arriving in a cell is worth from some states, its worst class counting.

    It is worth 0 in failed cells.
    """
    arriving = np.full((len(rows), value.shape[1]), np.inf)
    for follows, cells in classes:
        here = value[:, cells]
        for k, after in enumerate(follows[rows]):
            best = here[after].max(axis=0) if after.any() else 0.0
            arriving[k, cells] = np.minimum(arriving[k, cells], best)
    arriving[np.isinf(arriving)] = 0.0
    return arriving


def favourable_successors(problem: Problem) -> list[NDArray[np.bool_]]:
    """Return, per agent, (Q, C_i, Q): whether some letter with its class c leads from q to q' (or more; never less)."""
    automaton, labeling = problem.automaton, problem.labeling
    ends = _terminals(automaton)
    tables = [
        np.zeros((automaton.n_states, len(classes), automaton.n_states), dtype=bool) for classes in labeling.classes
    ]
    for q in range(automaton.n_states):
        # Agents are read in order. The frontier holds all entries of the diagram that the agents before can lead to;
        # from there any terminal below may follow.
        frontier = {int(automaton.root[q])}
        for i, (propositions, classes) in enumerate(zip(labeling.agent_propositions, labeling.classes, strict=True)):
            positions = {int(p): k for k, p in enumerate(propositions)}
            following: set[int] = set()
            for c, row in enumerate(classes):
                for entry in frontier:
                    e = followed(automaton, entry, positions, row)
                    following.add(e)
                    tables[i][q, c, list(ends(e))] = True
            frontier = following
    return tables


def _terminals(automaton: Automaton) -> Callable[[int], frozenset[int]]:
    """Return a function from an entry of the decision diagram to the automaton states that can follow it."""
    states_below: dict[int, frozenset[int]] = {}

    def ends(entry: int) -> frozenset[int]:
        """Return the states below one entry, by a depth-first walk."""
        stack = [entry]
        while stack:
            e = stack[-1]
            if e in states_below:
                stack.pop()
            elif e < 0:
                states_below[e] = frozenset((-1 - e,))
            else:
                # Visit the children first; this entry stays on the stack until both are there.
                children = [int(automaton.low[e]), int(automaton.high[e])]
                missing = [child for child in children if child not in states_below]
                if missing:
                    stack += missing
                else:
                    states_below[e] = states_below[children[0]] | states_below[children[1]]
        return states_below[entry]

    return ends
