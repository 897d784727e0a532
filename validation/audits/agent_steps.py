"""One step of the value function, agent after agent: which agent's kernel, or which guard, is to blame for a fall.

In state q at time t the tree claims ``V_t(q, s) = sum_r prod_i (P_i h_r,i)(s_i)``, where ``h_r,i`` is a masked
factor of the next time. Replace the expectations by what happened, one agent after the other:

    H_k = sum_r  prod_{i <= k} h_r,i(s'_i)  prod_{i > k} (P_i h_r,i)(s_i),        H_0 = V_t(q, s).

Agents move independently, so ``E[H_k - H_{k-1} | the past, s'_1 .. s'_{k-1}] >= 0`` if agent k moves as its kernel
says: the fall of the value is split among the agents, and each part is a test of its own. What is left needs no
statistics: ``V_{t+1}(q', s') >= H_I`` in every single episode, unless guards overlap or a cell carries a label that
some of its points do not have. This holds for controllers without memory, whose cells are those of the states.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.dynamics import Dynamics, Worlds
from ...synthesis.certificates import Certificate
from ...synthesis.values import Terms
from .value_at import PRODUCTS


def terminal_values(certificate: Certificate) -> Terms:
    """Value function at the horizon: 1 in accepting automaton states."""
    n = len(certificate.agents)
    ones = tuple(np.ones((1, part.grid.n_cells)) for part in certificate.agents)
    rows = (np.zeros((int(yes), n), dtype=np.int64) for yes in certificate.problem.automaton.accepting)
    return Terms(ones, tuple(rows))


def agents_outside(dynamics: Dynamics, worlds: Worlds) -> NDArray[np.bool_]:
    """Which agents (M, I) are outside their workspaces."""
    result = np.zeros((worlds.n_worlds, len(dynamics.position)), dtype=bool)
    for block, x in zip(dynamics.blocks, worlds.states, strict=True):
        result[:, block.agents] = (~((block.state_low <= x) & (x <= block.state_high))).any(axis=0).T
    return result


def tree_fits(certificate: Certificate, time: int, now: Terms, following: Terms) -> bool:
    """Whether the terms of two times are those of the certificate's tree, vertex by vertex."""
    step = certificate.skeleton[time]
    final = certificate.problem.automaton.finished
    for q in np.flatnonzero(~final):
        guard, child = step.origin[q].T
        sizes = np.array([len(rows) for rows in following.index])[certificate.guard_target[guard]]
        if len(now.index[q]) != len(step.kept[q]) or np.any(child >= sizes):
            return False
    return True


def levels_by_agent(
    certificate: Certificate, time: int, now: Terms, following: Terms, q: NDArray[Any], cells: NDArray[Any],
    next_cells: NDArray[Any], outside: NDArray[np.bool_],
) -> NDArray[Any]:  # fmt: skip
    """``H_0 .. H_I`` (I + 1, n) of the module's text.

    Parameters
    ----------
    certificate : Certificate
    time : int
    now, following : Terms
        Value functions at ``time`` and one step later.
    q : (n,) int array
        Automaton states before the step.
    cells, next_cells : (n, I) int arrays
        Joint cells before and after it.
    outside : (n, I) bool array
        Which agents left their workspaces.
    """
    result = np.zeros((cells.shape[1] + 1, len(q)))
    for state in np.unique(q):
        here = np.flatnonzero(q == state)
        size = max(1, len(certificate.skeleton[time].origin[state]))
        for rows in np.array_split(here, max(1, -(-len(here) * size // PRODUCTS))):
            claimed = _factors_now(now, int(state), cells[rows])
            met = _factors_met(certificate, time, int(state), following, next_cells[rows], outside[rows])
            result[:, rows] = _hybrids(claimed, met)
    return result


def _factors_now(now: Terms, q: int, cells: NDArray[Any]) -> list[NDArray[Any]]:
    """Per agent (R, n): factors of the terms of state q at the cells."""
    rows = now.index[q]
    return [own[rows[:, i]][:, cells[:, i]] for i, own in enumerate(now.factors)]


def _factors_met(
    certificate: Certificate, time: int, q: int, following: Terms, next_cells: NDArray[Any], outside: NDArray[np.bool_]
) -> list[NDArray[Any]]:
    """Per agent (R, n): the masked next-step factors behind those terms, at the cells that were met."""
    step = certificate.skeleton[time]
    origin, merges, kept = step.origin[q], step.merges[q], step.kept[q]
    guard, child = origin[:, 0], origin[:, 1]
    target = certificate.guard_target[guard]
    below = np.zeros((len(guard), next_cells.shape[1]), dtype=np.int64)
    for state in np.unique(target):
        own = target == state
        below[own] = following.index[state][child[own]]
    result = []
    for i, part in enumerate(certificate.agents):
        s = next_cells[:, i]
        met = part.masks[certificate.guard_mask[guard, i]][:, s] * following.factors[i][below[:, i]][:, s]
        met = met * ~outside[:, i]
        for a, b, is_sum in zip(merges.into.tolist(), merges.absorbed.tolist(), (merges.agent == i).tolist()):
            met[a] = met[a] + met[b] if is_sum else np.minimum(met[a], met[b])
        result.append(met[kept])
    return result


def _hybrids(claimed: list[NDArray[Any]], met: list[NDArray[Any]]) -> NDArray[Any]:
    """Sums of products whose first k factors are ``met`` and whose others are ``claimed``, for k = 0 .. I."""
    after = [np.ones(claimed[0].shape)]
    for factors in reversed(claimed):
        after.append(after[-1] * factors)
    before, sums = np.ones(claimed[0].shape), [after[-1].sum(axis=0)]
    for k, factors in enumerate(met, start=1):
        before = before * factors
        sums.append((before * after[len(met) - k]).sum(axis=0))
    return np.stack(sums)
