"""One step of the value function, agent by agent: which agent's kernel, or which guard, is to blame if it falls.

In state q at time t the tree claims ``V_t(q, s) = sum_r prod_i (P_i h_r,i)(s_i)``, where ``h_r,i`` is a masked
factor of the next time. Replace the expectations by what happened, one agent after the other:

    H_k = sum_r  prod_{i <= k} h_r,i(s'_i)  prod_{i > k} (P_i h_r,i)(s_i),        H_0 = V_t(q, s).

Agents move independently, so ``E[H_k - H_{k-1} | the past, s'_1 .. s'_{k-1}] >= 0`` if agent k moves as its kernel
says. This splits the fall of the value among the agents, and each share is tested separately. The remainder needs no
statistics: ``V_{t+1}(q', s') >= H_I`` in every single episode, unless guards overlap or a cell carries a label that
some of its points do not have. All this holds for controllers without memory, whose cells are those of the states.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Dynamics, Worlds
from ...synthesis.certificates.proofs import OnGrid
from ...synthesis.certificates.value_functions import Terms
from .value_at import PRODUCTS


def terminal_values(certificate: OnGrid) -> Terms:
    """Return the value function at the horizon (exact): 1 in accepting automaton states, 0 in others."""
    n = len(certificate.proof.agents)
    ones = tuple(np.ones((1, agent.grid.n_cells)) for agent in certificate.proof.agents)
    rows = (np.zeros((int(yes), n), dtype=np.int64) for yes in certificate.problem.automaton.accepting)
    return Terms(ones, tuple(rows))


def agents_outside(dynamics: Dynamics, worlds: Worlds) -> NDArray[np.bool_]:
    """Return which agents (M, I) are outside their workspaces."""
    result = np.zeros((worlds.n_worlds, len(dynamics.position)), dtype=bool)
    for block, x in zip(dynamics.blocks, worlds.states, strict=True):
        result[:, block.agents] = (~((block.state_low <= x) & (x <= block.state_high))).any(axis=0).T
    return result


def tree_fits(certificate: OnGrid, time: int, now: Terms, following: Terms) -> bool:
    """Return whether the terms at ``time`` and one step later have the sizes of the certificate's tree."""
    step = certificate.proof.merge_log[time]
    final = certificate.problem.automaton.finished
    for q in np.flatnonzero(~final):
        # Every kept vertex needs its term now, and every child that a vertex points to a term one step later.
        guard, child = step.origin[q].T
        sizes = np.array([len(rows) for rows in following.index])[certificate.proof.guard_target[guard]]
        if len(now.index[q]) != len(step.kept[q]) or np.any(child >= sizes):
            return False
    return True


def levels_by_agent(
    certificate: OnGrid,
    time: int,
    now: Terms,
    following: Terms,
    q: NDArray[Any],
    cells: NDArray[Any],
    next_cells: NDArray[Any],
    outside: NDArray[np.bool_],
) -> NDArray[Any]:
    """Return ``H_0 .. H_I``, shape (I + 1, n), as the module docstring defines them (exact up to rounding).

    Parameters
    ----------
    certificate : Certificate
    time : int
    now, following : Terms
        Value functions at ``time`` and one step later.
    q : (n,) int array
        Automaton states before the step.
    cells, next_cells : (n, I) int arrays
        Joint cells before and after the step.
    outside : (n, I) bool array
        Which agents left their workspaces in the step.
    """
    result = np.zeros((cells.shape[1] + 1, len(q)))
    # Worlds in the same automaton state share their terms; pieces of at most PRODUCTS numbers bound the memory.
    for state in np.unique(q):
        here = np.flatnonzero(q == state)
        size = max(1, len(certificate.proof.merge_log[time].origin[state]))
        for rows in np.array_split(here, max(1, -(-len(here) * size // PRODUCTS))):
            claimed = _factors_now(now, int(state), cells[rows])
            met = _factors_met(certificate, time, int(state), following, next_cells[rows], outside[rows])
            result[:, rows] = _hybrids(claimed, met)
    return result


def _factors_now(now: Terms, q: int, cells: NDArray[Any]) -> list[NDArray[Any]]:
    """Return per agent (R, n) the factors of the terms of state q at the cells."""
    rows = now.index[q]
    return [factors[rows[:, i]][:, cells[:, i]] for i, factors in enumerate(now.factors)]


def _factors_met(
    certificate: OnGrid,
    time: int,
    q: int,
    following: Terms,
    next_cells: NDArray[Any],
    outside: NDArray[np.bool_],
) -> list[NDArray[Any]]:
    """Return per agent (R, n) the masked factors one step later behind those terms, at the cells that were met."""
    step = certificate.proof.merge_log[time]
    origin, merges, kept_rows = step.origin[q], step.merges[q], step.kept[q]
    # Each vertex that was formed applies a guard to a child, which is a term of the guard's target state.
    guard, child = origin[:, 0], origin[:, 1]
    target = certificate.proof.guard_target[guard]
    below = np.zeros((len(guard), next_cells.shape[1]), dtype=np.int64)
    for state in np.unique(target):
        into = target == state
        below[into] = following.index[state][child[into]]
    result = []
    for i, agent in enumerate(certificate.proof.agents):
        s = next_cells[:, i]
        met = agent.masks[certificate.proof.guard_mask[guard, i]][:, s] * following.factors[i][below[:, i]][:, s]
        met = met * ~outside[:, i]
        # Repeat how the tree united vertices: sums in the agent in which they differ, minima in all others.
        columns = (merges.into, merges.absorbed, merges.agent, merges.rests)
        for a, b, summed, rest in zip(*(column.tolist() for column in columns)):
            first, second = met[a].copy(), met[b].copy()
            least, kept = np.minimum(first, second), first if rest > 0 else second
            met[a] = first + second if summed == i else least
            if rest:
                met[b] = kept if summed == i else (kept - least if abs(rest) - 1 == i else least)
        result.append(met[kept_rows])
    return result


def _hybrids(claimed: list[NDArray[Any]], met: list[NDArray[Any]]) -> NDArray[Any]:
    """Return the sums of products whose first k factors are ``met`` and whose others are ``claimed``, k = 0 .. I."""
    # Running products from both ends: every H_k is then one product of three arrays.
    after = [np.ones(claimed[0].shape)]
    for factors in reversed(claimed):
        after.append(after[-1] * factors)
    before, sums = np.ones(claimed[0].shape), [after[-1].sum(axis=0)]
    for k, factors in enumerate(met, start=1):
        before = before * factors
        sums.append((before * after[len(met) - k]).sum(axis=0))
    return np.stack(sums)
