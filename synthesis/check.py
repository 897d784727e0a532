"""Independent verification of a certificate, from its policies and its tree alone.

Nothing of the search is used: guards are verified against the automaton instead of compiled, admissible inputs against
the input box, and the value tree is grown again vertex by vertex with a kernel of its own. Whatever vertices a tree
keeps, its sum is a lower bound; so a certificate is right if

1. its grids tile the workspaces and its noise coordinates make the noise independent;
2. guards out of one state are disjoint, and every letter of a guard's cells leads to its target (or, for co-safe
   tasks, to acceptance);
3. every target can be commanded from every point of its cell;
4. the regrown value at the start is at least ``lower_bound``, and no stored factor exceeds its regrown one.

United terms are regrown soundly for any choice: ``a x b + a' x b' >= min(a, a') x (b + b')``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from ..envs.problem import Problem
from .certificate import AgentPart, Certificate
from .terms import Terms

FloatArray = NDArray[Any]


@dataclass(frozen=True)
class CheckReport:
    """Outcome of ``check``: truthy if the certificate holds.

    Parameters
    ----------
    valid : bool
    claimed : float
        The certificate's lower bound.
    recomputed : float
        Value at the start computed again (NaN if it was not reached); a lower bound up to rounding.
    failures : tuple of str
        What is wrong, in words.
    """

    valid: bool
    claimed: float
    recomputed: float
    failures: tuple[str, ...]

    def __bool__(self) -> bool:
        return self.valid

    def __str__(self) -> str:
        if self.valid:
            return f"valid: lower bound {self.claimed:.9g}, recomputed {self.recomputed:.9g}"
        return "NOT valid: " + "; ".join(self.failures)


class BrokenTreeError(ValueError):
    """A certificate's tree is not a tree of its guards."""


def check(certificate: Certificate, problem: Problem | None = None) -> CheckReport:
    """Verify a certificate against a problem (by default the one inside it).

    Parameters
    ----------
    certificate : Certificate
    problem : Problem, optional
        The certificate must have been made for exactly this problem (fingerprint).

    Returns
    -------
    CheckReport
        Truthy if every claim of the certificate was verified.
    """
    problem = certificate.problem if problem is None else problem
    failures: list[str] = []
    recomputed = float("nan")
    if certificate.fingerprint != problem.fingerprint:
        failures.append("it was made for another problem (the fingerprints differ)")
    else:
        for step in (_check_grids, _check_guards, _check_inputs):
            failures += step(certificate)
            if failures:
                break
        else:
            try:
                terms = regrow(certificate)
            except BrokenTreeError as error:
                failures.append(str(error))
            else:
                recomputed = _start_value(certificate, terms)
                failures += _check_values(certificate, terms, recomputed)
    return CheckReport(not failures, certificate.lower_bound, recomputed, tuple(failures))


def _check_grids(certificate: Certificate) -> list[str]:
    """Grids cover the workspaces and, in their coordinates, the noise is independent and positive."""
    failures = []
    for agent, part in zip(certificate.problem.agents, certificate.agents, strict=True):
        low = np.array([edges[0] for edges in part.grid.edges])
        high = np.array([edges[-1] for edges in part.grid.edges])
        identity = np.array_equal(part.coordinates, np.eye(agent.n_states))
        if identity and not (np.array_equal(low, agent.workspace.low) and np.array_equal(high, agent.workspace.high)):
            failures.append(f"the grid of agent `{agent.name}` does not tile its workspace")
        noise = _grid_noise(agent.noise_covariance, part.coordinates)
        off = noise - np.diag(np.diag(noise))
        if np.any(np.diag(noise) <= 0) or np.max(np.abs(off)) > 1e-12 * np.max(np.diag(noise)):
            failures.append(f"the noise of agent `{agent.name}` is not independent along its grid axes")
        if any(np.any(np.diff(axis) <= 0) for axis in part.lattice):
            failures.append(f"the lattice of agent `{agent.name}` is not increasing")
    return failures


def _grid_noise(covariance: FloatArray, coordinates: FloatArray) -> FloatArray:
    inverse = np.linalg.inv(coordinates)
    return np.asarray(inverse @ covariance @ inverse.T)


def _cell_boxes(part: AgentPart) -> tuple[FloatArray, FloatArray]:
    """Boxes in state space around the cells (the cells themselves in state coordinates)."""
    if np.array_equal(part.coordinates, np.eye(len(part.coordinates))):
        return part.grid.low, part.grid.high
    centre, reach = part.grid.centres @ part.coordinates.T, part.grid.half_widths @ np.abs(part.coordinates).T
    return centre - reach * (1 + 1e-12) - 1e-12, centre + reach * (1 + 1e-12) + 1e-12


def _check_guards(certificate: Certificate) -> list[str]:
    """Guards are disjoint, stay inside the workspace, and every letter of their cells leads where they say."""
    problem, automaton = certificate.problem, certificate.problem.automaton
    source, target, mask = certificate.guard_source, certificate.guard_target, certificate.guard_mask
    co_safe = automaton.semantics == "co-safe"
    meets, letters = [], []
    for i, part in enumerate(certificate.agents):
        meets.append((part.masks.astype(np.int64) @ part.masks.T.astype(np.int64)) > 0)
        low, high = _cell_boxes(part)
        possible = problem.labeling.box_classes(i, low, high)
        agent = problem.agents[i]
        outside = np.any((low < agent.workspace.low) | (high > agent.workspace.high), axis=1)
        if part.masks[:, outside].any():
            return [f"a guard uses cells of agent `{agent.name}` that reach beyond its workspace"]
        classes = problem.labeling.classes[i]
        letters.append([classes[possible[own].any(axis=0)] for own in part.masks])
    for q in np.unique(source):
        own = np.flatnonzero(source == q)
        overlap = np.ones((len(own), len(own)), dtype=bool)
        for i, both in enumerate(meets):
            overlap &= both[np.ix_(mask[own, i], mask[own, i])]
        if np.any(overlap & ~np.eye(len(own), dtype=bool)):
            return [f"guards out of automaton state {q} overlap"]
        if co_safe and automaton.accepting[q]:
            return [f"guards leave the accepting state {q}"]
    for g in range(len(source)):
        reached = _targets(problem, int(source[g]), [letters[i][mask[g, i]] for i in range(len(letters))])
        allowed = {int(target[g])} | ({int(a) for a in np.flatnonzero(automaton.accepting)} if co_safe else set())
        if not reached <= allowed:
            return [f"guard {g} out of automaton state {source[g]} does not always lead to state {target[g]}"]
    return []


def _targets(problem: Problem, q: int, classes: list[NDArray[np.bool_]]) -> set[int]:
    """Automaton states reached from q by the letters of a product of class sets (a superset of them, never less)."""
    automaton, labeling = problem.automaton, problem.labeling
    frontier = {int(automaton.root[q])}
    for own, rows in zip(labeling.agent_propositions, classes, strict=True):
        if len(own) == 0 or all(entry < 0 for entry in frontier):
            continue
        positions = {int(p): k for k, p in enumerate(own)}
        following = set()
        for entry in frontier:
            if entry < 0 or int(automaton.variable[entry]) not in positions:
                following.add(entry)
                continue
            for row in rows:
                e = entry
                while e >= 0 and (k := positions.get(int(automaton.variable[e]))) is not None:
                    e = int(automaton.high[e] if row[k] else automaton.low[e])
                following.add(e)
        frontier = following
    return {-1 - entry for entry in frontier}


def _check_inputs(certificate: Certificate) -> list[str]:
    """Every commanded target is reached by an admissible input from every point of its cell."""
    failures = []
    for agent, part in zip(certificate.problem.agents, certificate.agents, strict=True):
        inverse = np.linalg.inv(part.coordinates)
        A, B, offset = inverse @ agent.A @ part.coordinates, inverse @ agent.B, inverse @ agent.offset
        middle = 0.5 * (agent.input_box.low + agent.input_box.high)
        to_input = np.linalg.pinv(B)
        if np.max(np.abs(B @ to_input - np.eye(len(B)))) > 1e-9:
            failures.append(f"the inputs of agent `{agent.name}` do not reach every mean")
            continue
        spread = part.grid.half_widths @ np.abs(to_input @ A).T
        rows = part.law.reshape(-1, part.law.shape[-1])
        for law in np.unique(rows, axis=0) if len(rows) > 1 else rows:
            index = np.unravel_index(np.maximum(law, 0), part.lattice_shape)
            goal = np.stack([axis[k] for axis, k in zip(part.lattice, index, strict=True)], axis=1)
            inputs = (goal - part.grid.centres @ A.T - offset - B @ middle) @ to_input.T + middle
            low, high = inputs - spread, inputs + spread
            if np.any(((low < agent.input_box.low) | (high > agent.input_box.high)) & (law >= 0)[:, None]):
                failures.append(f"agent `{agent.name}` is asked for inputs beyond its input box")
                break
    return failures


def regrow(certificate: Certificate, each: Callable[[int, Terms], None] | None = None) -> Terms:
    """Grow the value tree again from the policies and the list of its vertices: value function at time 0.

    ``each(t, terms)`` is called with the value function at every time t = T - 1 .. 0 as it is grown.
    """
    accepting = certificate.problem.automaton.accepting
    co_safe = certificate.problem.automaton.semantics == "co-safe"
    goals = np.flatnonzero(accepting)
    n_agents = len(certificate.agents)
    tables: dict[tuple[bytes, ...], list[FloatArray]] = {}
    kernels = [
        _tables(a.noise_covariance, p, tables)
        for a, p in zip(certificate.problem.agents, certificate.agents, strict=True)
    ]
    ones = [np.ones((1, part.grid.n_cells)) for part in certificate.agents]
    factors, index = ones, [np.zeros((int(a), n_agents), dtype=np.int64) for a in accepting]
    for t, step in reversed(list(enumerate(certificate.skeleton))):
        stacks, rows = [list(ones) for ones in zip(ones, strict=True)], []
        for q, (origin, merges, kept) in enumerate(zip(step.origin, step.merges, step.kept, strict=True)):
            if co_safe and q in goals:
                rows.append(np.zeros((1, n_agents), dtype=np.int64))
                continue
            guard, child = origin[:, 0], origin[:, 1]
            if np.any(guard >= len(certificate.guard_source)) or np.any(certificate.guard_source[guard] != q):
                raise BrokenTreeError("its tree uses a guard of another automaton state")
            below = _children(index, certificate.guard_target[guard], child, n_agents)
            rows.append(np.zeros((len(kept), n_agents), dtype=np.int64))
            _check_merges(merges.into, merges.absorbed, kept)
            for i, part in enumerate(certificate.agents):
                keys = np.stack([certificate.guard_mask[guard, i], below[:, i]], axis=1)
                vertex = _unite(part.masks, factors[i], keys, merges.into, merges.absorbed, merges.agent == i)
                distinct, where = _distinct(vertex, kept)
                values = _smooth(distinct, kernels[i])[:, np.maximum(part.law[t, q], 0)] * (part.law[t, q] >= 0)
                rows[-1][:, i] = where + sum(len(s) for s in stacks[i])
                stacks[i].append(values)
        factors, index = [np.concatenate(s) for s in stacks], rows
        if each is not None:
            each(t, Terms(tuple(factors), tuple(index)))
    return Terms(tuple(factors), tuple(index))


def _children(index: list[NDArray[np.int64]], target: NDArray, child: NDArray, n_agents: int) -> NDArray[np.int64]:
    """Factor indices (N, I) of the terms ``child`` of the states ``target``."""
    below = np.zeros((len(child), n_agents), dtype=np.int64)
    for q in np.unique(target):
        here = target == q
        if np.any(child[here] >= len(index[q])) or np.any(child[here] < 0):
            raise BrokenTreeError("its tree names a vertex that is not there")
        below[here] = index[q][child[here]]
    return below


def _check_merges(into: NDArray, absorbed: NDArray, kept: NDArray) -> None:
    """No vertex may be counted twice: absorbed once at most, never used afterwards, kept once at most."""
    gone: set[int] = set()
    for a, b in zip(into.tolist(), absorbed.tolist(), strict=True):
        if a == b or a in gone or b in gone:
            raise BrokenTreeError("its tree counts a vertex twice")
        gone.add(b)
    if len(np.unique(kept)) != len(kept) or gone & set(kept.tolist()):
        raise BrokenTreeError("its tree counts a vertex twice")


def _unite(
    masks: NDArray[np.bool_], factors: FloatArray, keys: NDArray, into: NDArray, absorbed: NDArray, own: NDArray
) -> FloatArray:  # fmt: skip
    """One agent's factors (N, S) of the vertices before smoothing: masked, and united as the tree says."""
    vertex = masks[keys[:, 0]] * factors[keys[:, 1]]
    for a, b, is_sum in zip(into.tolist(), absorbed.tolist(), own.tolist(), strict=True):
        vertex[a] = vertex[a] + vertex[b] if is_sum else np.minimum(vertex[a], vertex[b])
    return vertex


def _distinct(vertex: FloatArray, kept: NDArray[np.int64]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Distinct rows among the kept ones, and which of them each is."""
    number: dict[bytes, int] = {}
    where = np.array([number.setdefault(vertex[k].tobytes(), len(number)) for k in kept], dtype=np.int64)
    first = np.zeros(len(number), dtype=np.int64)
    first[where[::-1]] = kept[::-1]
    return vertex[first], where


def _tables(
    covariance: FloatArray, part: AgentPart, known: dict[tuple[bytes, ...], list[FloatArray]]
) -> list[FloatArray]:
    """Cell masses around every lattice point, per axis, from the complementary error function of the smaller tail."""
    deviations = np.sqrt(np.diag(_grid_noise(covariance, part.coordinates)))
    key = (deviations.tobytes(), *(e.tobytes() for e in part.grid.edges), *(a.tobytes() for a in part.lattice))
    if key not in known:
        known[key] = []
        for edges, axis, deviation in zip(part.grid.edges, part.lattice, deviations, strict=True):
            x = (edges - axis[:, None]) / (deviation * np.sqrt(2.0))
            right, left = 0.5 * erfc(x), 0.5 * erfc(-x)
            upper_half = x[:, :-1] + x[:, 1:] > 0
            mass = np.where(upper_half, right[:, :-1] - right[:, 1:], left[:, 1:] - left[:, :-1])
            known[key].append(np.maximum(mass - 1e-15 * np.where(upper_half, right[:, :-1], left[:, 1:]), 0.0))
    return known[key]


def _smooth(factors: FloatArray, tables: list[FloatArray]) -> FloatArray:
    """Expected value (n, Z) of factors (n, S) around every lattice point."""
    tensor = factors.reshape(len(factors), *(table.shape[1] for table in tables))
    for axis, table in enumerate(tables, start=1):
        tensor = np.moveaxis(np.tensordot(tensor, table, axes=(axis, 1)), -1, axis)
    return tensor.reshape(len(factors), int(np.prod(tensor.shape[1:])))


def _start_value(certificate: Certificate, terms: Terms) -> float:
    """Regrown value at the problem's start."""
    regrown = _with_terms(certificate, terms)
    boxes = [agent.initial for agent in certificate.problem.agents]
    low, high = (np.concatenate([getattr(b, side) for b in boxes]) for side in ("low", "high"))
    value = float(regrown.at(low)[0]) if np.array_equal(low, high) else regrown.mean(low, high)
    return value


def _with_terms(certificate: Certificate, terms: Terms) -> Certificate:
    return replace(certificate, terms=terms, relative_rounding=0.0)


def _check_values(certificate: Certificate, terms: Terms, recomputed: float) -> list[str]:
    """The claims are not larger than what was regrown."""
    failures = []
    n = certificate.problem.horizon * sum(p.grid.n_cells + 1 for p in certificate.agents) + len(certificate.agents)
    rounding = (n + certificate.rank + 2) * 2.0**-53
    if not certificate.lower_bound <= recomputed * (1.0 - rounding):
        failures.append(f"the bound {certificate.lower_bound:.12g} exceeds the recomputed value {recomputed:.12g}")
    tolerance = 1.0 + 1e-11
    stored, regrown = certificate.terms, terms
    if any(len(a) != len(b) for a, b in zip(stored.index, regrown.index, strict=True)):
        return [*failures, "the stored value function has other terms than the tree"]
    for i, (mine, yours) in enumerate(zip(stored.factors, regrown.factors, strict=True)):
        for q, rows in enumerate(stored.index):
            if np.any(mine[rows[:, i]] > yours[regrown.index[q][:, i]] * tolerance + 1e-250):
                failures.append(
                    f"a stored factor of agent `{certificate.problem.agents[i].name}` exceeds its regrown value"
                )
                break
    return failures
