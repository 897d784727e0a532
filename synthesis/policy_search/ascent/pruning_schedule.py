"""Ladders: terms united from below before they are smoothed, so that fewer edges are smoothed at all.

Under the relation ``linear`` every term pays for how its factors bend, and a value that guards cut in two bends at
the cut, on both sides. Two terms may be united from below in the factor of one agent i,

    a x b + a' x b'  >=  (a + a') x m  +  remainder,        m = min(b, b'),

where the remainder ``a x (b - m)`` or ``a' x (b' - m)`` takes the place of the second term. A ladder starts with the
heaviest term and climbs down the others by weight, as long as the weight of the union grows, in the factor of one
agent after the other; then the next ladder starts. With terms of more than two agents, m is the minimum in every other
factor, and the remainder differs in one of them (docs/theory/linear.md, "Uniting from below"). Whatever is united, the
sum is a lower bound; weights, from the mass that arrives, only say what pays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ...certificates.value_functions import IndexArray, Merges

NEGLIGIBLE = 1e-5
"""Share of the weight of all terms below which a term neither starts a ladder nor joins one."""

MOST_LOST = 1e-6
"""Share of the weight of all terms that uniting two of them may lose."""

MOST_LADDERS = 12
"""Ladders per automaton state and time: the first few hold nearly all of the weight."""

REST = 1.0 - 1e-9
"""Share of a factor of which a minimum is taken off: what is left has few digits, and must not be too large."""

MOST_STEPS = 48
"""Terms that a ladder looks at: the heaviest ones."""

MOST_TURNS = 3
"""Ladders of one head in the factor of each agent, on average."""

Arrivals = Callable[[int], Sequence[NDArray]]
"""Mass (S_i,) of every agent that arrives from an automaton state, a heuristic weight."""


def pruning_schedules(
    factors: list[NDArray],
    rows: IndexArray,
    remaining: IndexArray,
    source: IndexArray,
    arrivals: Arrivals,
    spent: float,
) -> Merges:
    """Unite terms from below, state by state; ``factors`` and ``rows`` are changed in place.

    Parameters
    ----------
    factors : list of (n_i, S_i) arrays
        Extended by what is united.
    rows : (N, I) array
        Factor indices of the terms.
    remaining : (L,) array
        Rows that stand for terms; all of them still do afterwards.
    source : (N,) array
        Automaton state of each row.
    arrivals : callable
    spent : float
        Share of the lighter of two terms that uniting them may lose: where guards cut them they may lose more apart.
    """
    history: list[tuple[int, int, int, int]] = []
    for q in np.unique(source[remaining]):
        here = remaining[source[remaining] == q]
        if len(here) > 1:
            _climb(factors, rows, here, arrivals(int(q)), history, spent)
    if not history:
        return Merges.none()
    columns = np.array(history, dtype=np.int64).T
    return Merges(columns[0], columns[1], columns[2], columns[3])


def _climb(
    factors: list[NDArray],
    rows: IndexArray,
    here: IndexArray,
    masses: Sequence[NDArray],
    history: list[tuple[int, int, int, int]],
    spent: float,
) -> None:
    """Unite the terms ``here`` of one automaton state; what is done is added to the history."""
    n_agents = rows.shape[1]
    terms = [factor[rows[here, i]] for i, factor in enumerate(factors)]
    masses_of = _padded(masses)
    shares = np.stack([term @ mass for term, mass in zip(terms, masses, strict=True)])
    changed = np.zeros((len(here), n_agents), dtype=bool)
    done = np.zeros(len(here), dtype=bool)
    for _ in range(MOST_LADDERS):
        weights = shares.prod(axis=0)
        heavy = weights > NEGLIGIBLE * weights.sum()
        order = [int(k) for k in np.argsort(-weights, kind="stable") if heavy[k] and not done[k]][:MOST_STEPS]
        if len(order) < 2:
            break
        head, others = order[0], order[1:]
        done[head] = True
        left = set(range(n_agents))
        for _ in range(MOST_TURNS * n_agents):
            if not left:
                break
            # Try the sum in the factor of each agent and take the ladder that gathers most.
            factors_of = _padded([term[[head, *others]] for term in terms])
            tried = {i: _joined(factors_of, masses_of, i) for i in sorted(left)}
            best = max(tried, key=lambda i: tried[i][0])
            left.remove(best)
            united = False
            for k in (others[member] for member in tried[best][1]):
                pair = [head, k]
                before, weight = [term[pair] for term in terms], float(shares[:, pair].prod(axis=0).sum())
                rest = _unite(terms, masses, best, head, k)
                after = np.stack([term[pair] @ mass for term, mass in zip(terms, masses, strict=True)])
                lost, lighter = weight - float(after.prod(axis=0).sum()), float(shares[:, pair].prod(axis=0).min())
                if lost > MOST_LOST * weights.sum() + spent * lighter:
                    # What is lost here is certain, what bends less is small: leave the two as they were.
                    for term, factors_before in zip(terms, before, strict=True):
                        term[pair] = factors_before
                    continue
                history.append((int(here[head]), int(here[k]), best, rest))
                shares[:, pair], changed[pair], united = after, True, True
            if united:  # often makes way for unions in the factors of the others
                left = set(range(n_agents)) - {best}
    for i in range(n_agents):
        moved = np.flatnonzero(changed[:, i])
        rows[here[moved], i] = len(factors[i]) + np.arange(len(moved))
        factors[i] = np.concatenate([factors[i], terms[i][moved]])


def _joined(terms: NDArray, masses: NDArray, i: int) -> tuple[float, list[int]]:
    """Return the weight of the ladder that sums in the factor of agent i, and the terms that join it.

    ``terms`` (I, K, S) are those of the head, and after it of the others, which are numbered from 0 on.
    """
    union = terms[:, 0]
    weight, members = float(np.einsum("is,is->i", union, masses).prod()), list[int]()
    for k in range(1, terms.shape[1]):
        larger = np.minimum(union, terms[:, k])
        larger[i] = union[i] + terms[i, k]
        heavier = float(np.einsum("is,is->i", larger, masses).prod())
        if heavier > weight:
            union, weight, members = larger, heavier, [*members, k - 1]
    return weight, members


def _padded(arrays: Sequence[NDArray]) -> NDArray:
    """Return arrays (.., S) of several agents as one (I, .., S), with zeros where agents have fewer cells."""
    size = max(array.shape[-1] for array in arrays)
    result = np.zeros((len(arrays), *arrays[0].shape[:-1], size))
    for row, array in zip(result, arrays, strict=True):
        row[..., : array.shape[-1]] = array
    return result


def _unite(terms: Sequence[NDArray], masses: Sequence[NDArray], i: int, head: int, k: int) -> int:
    """Unite term k into the head in the factor of agent i and put the heavier remainder in its place.

    Returns ``j + 1`` if it is that of the head, ``-(j + 1)`` if it is that of term k, with j the other agent in whose
    factor it differs; 0 if there is only one agent.
    """
    others = [j for j in range(len(terms)) if j != i]
    least = {j: np.minimum(terms[j][head], terms[j][k]) for j in others}
    rest, most = 0, -1.0
    for j in others:
        for sign, row in ((1, head), (-1, k)):
            weight = float(terms[i][row] @ masses[i]) * float((terms[j][row] - least[j]) @ masses[j])
            weight *= float(np.prod([least[n] @ masses[n] for n in others if n != j]))
            if weight > most:
                rest, most = sign * (j + 1), weight
    apply_rest(terms, i, head, k, rest)
    return rest


def apply_rest(terms: Sequence[NDArray], i: int, head: int, k: int, rest: int) -> None:
    """Unite row k into row ``head`` in the factor of agent i, and put the remainder ``rest`` in row k (in place)."""
    for j, term in enumerate(terms):
        first, second = term[head].copy(), term[k].copy()
        if j == i:
            term[head] = first + second
            term[k] = first if rest > 0 else second
        else:
            least = np.minimum(first, second)
            term[head] = least
            kept = first if rest > 0 else second
            term[k] = np.maximum(kept * REST - least, 0.0) if j == abs(rest) - 1 else least
