"""Independent verification of a certificate, from its policies and its tree alone.

Nothing of the search is used: guards are verified against the automaton instead of compiled, admissible inputs against
the input box, and the value tree is grown again vertex by vertex with a kernel of its own. Whatever vertices a tree
keeps, its sum is a lower bound; so a certificate is right if

1. its grids tile the workspaces and its noise coordinates make the noise independent;
2. every relation holds (``verify_relation``), and every choice can be commanded from every related state;
3. guards out of one state are disjoint, and every letter of the states related to a guard's cells leads to its target
   (or, for co-safe tasks, to acceptance);
4. the regrown value at the start, less what lost relations can cost, is at least ``lower_bound``, and no stored factor
   exceeds its regrown one.

United terms are regrown soundly for any choice: ``a x b + a' x b' >= min(a, a') x (b + b')``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..envs.agent import LinearAgent
from ..envs.box import Box
from ..envs.problem import Problem
from .certificate import AgentPart, Certificate, checked_certificate
from .checked_kernel import axis_tables, grid_noise
from .grid import start_share
from .product import ProductCertificate
from .regrow import BrokenTreeError, regrow
from .regrow_trains import BrokenTrainError, regrow_trains
from .relation_coupled import CoupledRelation
from .terms import Terms
from .train_value import Trains
from .verify_relation import verify_relation

FloatArray = NDArray[Any]

CORRELATION = 1e-11
"""Largest correlation of the noises of two grid axes that passes for rounding."""


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


def check(certificate: Certificate | ProductCertificate, problem: Problem | None = None) -> CheckReport:
    """Verify a certificate against a problem (by default the one inside it).

    Parameters
    ----------
    certificate : Certificate or ProductCertificate
    problem : Problem, optional
        The certificate must have been made for exactly this problem (fingerprint).

    Returns
    -------
    CheckReport
        Truthy if the lower bounds of the certificate were verified: at its start and, factor by factor, elsewhere. The
        upper end of an exact claim (``gap``) is not verified here; rollouts test it (``certigym.validate``).
    """
    if isinstance(certificate, ProductCertificate):
        return _check_product(certificate, certificate.problem if problem is None else problem)
    problem = checked_certificate(certificate).problem if problem is None else problem
    failures: list[str] = []
    recomputed = float("nan")
    if certificate.fingerprint != problem.fingerprint:
        failures.append("it was made for another problem (the fingerprints differ)")
    else:
        for step in (_check_form, _check_grids, _check_relations, _check_guards):
            failures += step(certificate)
            if failures:
                break
        else:
            try:
                value = regrow(certificate) if certificate.rounding is None else regrow_trains(certificate)
            except (BrokenTreeError, BrokenTrainError) as error:
                failures.append(str(error))
            else:
                recomputed = _start_value(certificate, value)
                failures += _check_values(certificate, value, recomputed)
    return CheckReport(not failures, certificate.lower_bound, recomputed, tuple(failures))


def _check_product(product: ProductCertificate, problem: Problem) -> CheckReport:
    """Every part is of the task it stands for, and holds; what their product claims follows."""
    if product.fingerprint != problem.fingerprint:
        failures = ["it was made for another problem (the fingerprints differ)"]
        return CheckReport(False, product.lower_bound, float("nan"), tuple(failures))
    failures, recomputed = [], 1.0
    if [part.fingerprint for part in product.parts] != [task.fingerprint for task in problem.tasks]:
        failures.append("its parts are not the independent tasks of its problem")
    for same in product.alike:
        report = check(part := product.parts[same[0]])
        recomputed *= report.recomputed ** len(same)
        failures += [f"{part.problem.name}: {failure}" for failure in report.failures]
    return CheckReport(not failures, product.lower_bound, recomputed, tuple(failures))


def _check_form(certificate: Certificate) -> list[str]:
    """The value function covers the horizon, and what is said about the bound is right."""
    failures = []
    point = all(np.array_equal(agent.initial.low, agent.initial.high) for agent in certificate.problem.agents)
    if certificate.start != ("point" if point else "mean"):
        failures.append(f"its start is called {certificate.start!r}, which it is not")
    if any((part.relation["kind"] == "exact") != (part.menu is None) for part in certificate.agents):
        failures.append("a relation and its choices do not belong together")
    tree = certificate.rounding is None
    if tree and len(certificate.skeleton) != certificate.problem.horizon:
        failures.append("its tree does not cover its horizon")
    if certificate.bound not in (("nominal", "a-posteriori", "robust tree") if tree else ("nominal", "a-posteriori")):
        failures.append(f"its bound {certificate.bound!r} is none that is known for its value function")
    return failures


def _check_grids(certificate: Certificate) -> list[str]:
    """Grids cover the workspaces and, in their coordinates, the noise is independent and positive."""
    failures = []
    for agent, part in zip(certificate.problem.agents, certificate.agents, strict=True):
        low = np.array([edges[0] for edges in part.grid.edges])
        high = np.array([edges[-1] for edges in part.grid.edges])
        if not _is_inverted(part.coordinates):
            failures.append(f"the grid coordinates of agent `{agent.name}` cannot be inverted")
            continue
        identity = np.array_equal(part.coordinates, np.eye(agent.n_states))
        if identity and not (np.array_equal(low, agent.workspace.low) and np.array_equal(high, agent.workspace.high)):
            failures.append(f"the grid of agent `{agent.name}` does not tile its workspace")
        if not identity and not _covers(agent.workspace, part.coordinates, low, high):
            failures.append(f"the grid of agent `{agent.name}` does not cover its workspace")
        noise = grid_noise(agent.noise_covariance, part.coordinates)
        variances = np.diag(noise)
        off = np.abs(noise - np.diag(variances))
        if np.any(variances <= 0) or np.any(off > CORRELATION * np.sqrt(np.outer(variances, variances))):
            failures.append(f"the noise of agent `{agent.name}` is not independent along its grid axes")
        if any(np.any(np.diff(axis) <= 0) for axis in part.lattice):
            failures.append(f"the lattice of agent `{agent.name}` is not increasing")
    return failures


def _is_inverted(coordinates: FloatArray) -> bool:
    """Whether the inverse of grid coordinates, which everything else takes, is one."""
    try:
        inverse = np.linalg.inv(coordinates)
    except np.linalg.LinAlgError:
        return False
    return bool(np.all(np.abs(coordinates @ inverse - np.eye(len(coordinates))) <= 1e-9))


def _covers(workspace: Box, coordinates: FloatArray, low: FloatArray, high: FloatArray) -> bool:
    """Whether the grid ``[low, high]`` holds the workspace in its coordinates (up to rounding)."""
    inverse = np.linalg.inv(coordinates)
    middle = inverse @ (0.5 * (workspace.low + workspace.high))
    reach = np.abs(inverse) @ (0.5 * (workspace.high - workspace.low))
    slack = 1e-12 * (np.abs(middle) + reach)
    return bool(np.all(low <= middle - reach + slack) and np.all(high >= middle + reach - slack))


def _cell_boxes(agent: LinearAgent, part: AgentPart, starting: bool) -> tuple[FloatArray, FloatArray]:
    """Boxes in state space around the states related to each cell; for ``starting`` around the cell itself."""
    relation = part.relation_of(agent)
    if isinstance(relation, CoupledRelation) and not relation.is_cell and not starting:
        epsilon = relation.state_reach
        centre = part.grid.centres @ part.coordinates.T
        return centre - epsilon - 1e-12, np.nextafter(centre + epsilon + 1e-12, np.inf)
    if np.array_equal(part.coordinates, np.eye(len(part.coordinates))):
        return part.grid.low, part.grid.high
    centre, reach = part.grid.centres @ part.coordinates.T, part.grid.half_widths @ np.abs(part.coordinates).T
    return centre - reach * (1 + 1e-12) - 1e-12, centre + reach * (1 + 1e-12) + 1e-12


def _check_relations(certificate: Certificate) -> list[str]:
    """The relation of every agent holds, and its policy asks for nothing beyond the input box."""
    failures = []
    seen: set[object] = set()
    for agent, part in zip(certificate.problem.agents, certificate.agents, strict=True):
        arrays = [agent.A, agent.B, agent.offset, agent.noise_covariance, agent.input_box.low, agent.input_box.high]
        arrays += [part.coordinates, part.law, *part.lattice, *([] if part.menu is None else [part.menu])]
        key = (id(part.grid), json.dumps(part.relation, sort_keys=True), *(own.tobytes() for own in arrays))
        if key not in seen:
            seen.add(key)
            failures += [f"agent `{agent.name}`: {text}" for text in verify_relation(agent, part)]
    return failures


def _check_guards(certificate: Certificate) -> list[str]:
    """Guards are disjoint, stay inside the workspace, and every letter of their states leads where they say."""
    initial = np.full(len(certificate.start_target), certificate.problem.automaton.initial)
    arriving = [part.masks for part in certificate.agents], certificate.guard_source, certificate.guard_target
    starting = [part.start_masks for part in certificate.agents], initial, certificate.start_target
    failures = _check_guard_set(certificate, *arriving, certificate.guard_mask, starting=False)
    return failures or _check_guard_set(certificate, *starting, certificate.start_mask, starting=True)


def _check_guard_set(
    certificate: Certificate, masks: list[NDArray], source: NDArray, target: NDArray, mask: NDArray, starting: bool
) -> list[str]:  # fmt: skip
    """What is wrong with one set of guards."""
    problem, automaton = certificate.problem, certificate.problem.automaton
    co_safe = automaton.semantics == "co-safe"
    meets, letters = [], []
    for i, (part, own) in enumerate(zip(certificate.agents, masks, strict=True)):
        meets.append((own.astype(np.int64) @ own.T.astype(np.int64)) > 0)
        agent = problem.agents[i]
        low, high = _cell_boxes(agent, part, starting)
        possible = problem.labeling.box_classes(i, low, high)
        outside = np.any((low < agent.workspace.low) | (high > agent.workspace.high), axis=1)
        if own[:, outside].any():
            return [f"a guard uses cells of agent `{agent.name}` that reach beyond its workspace"]
        classes = problem.labeling.classes[i]
        letters.append([classes[possible[cells].any(axis=0)] for cells in own])
    for q in np.unique(source):
        rows = np.flatnonzero(source == q)
        overlap = np.ones((len(rows), len(rows)), dtype=bool)
        for i, both in enumerate(meets):
            overlap &= both[np.ix_(mask[rows, i], mask[rows, i])]
        if np.any(overlap & ~np.eye(len(rows), dtype=bool)):
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


def _start_value(certificate: Certificate, terms: Terms | Trains) -> float:
    """Regrown value at the problem's start, less what lost relations can cost."""
    delta = certificate.delta if certificate.bound == "a-posteriori" else 0.0
    if certificate.bound == "nominal" and certificate.delta > 0:
        return float("nan")  # the nominal value proves nothing then
    stored = terms if isinstance(terms, Terms) else None
    plain = replace(certificate, terms=stored, relative_rounding=0.0, bound="nominal")
    if isinstance(terms, Trains):
        plain.__dict__["value"] = terms  # what its cached property would grow once more
    boxes = [agent.initial for agent in certificate.problem.agents]
    low, high = (np.concatenate([getattr(b, side) for b in boxes]) for side in ("low", "high"))
    value = float(plain.at(low)[0]) if np.array_equal(low, high) else plain.mean(low, high)
    if not delta:
        return value
    steps = certificate.problem.horizon if isinstance(terms, Trains) else _undecided(certificate)
    return max(0.0, value - delta * steps * (1 + 1e-9))


def _undecided(certificate: Certificate) -> float:
    """Upper bound on the expected number of undecided steps: alive mass pushed forward, dropped mass in full."""
    problem, agents = certificate.problem, certificate.agents
    tables: dict[tuple[bytes, ...], list[FloatArray]] = {}
    kernels = [axis_tables(a.noise_covariance, p, tables) for a, p in zip(problem.agents, agents, strict=True)]
    settled = problem.automaton.dead.copy()
    if problem.automaton.semantics == "co-safe":
        settled |= problem.automaton.accepting
    pairs = zip(problem.agents, agents, strict=True)
    shares = [start_share(p.grid, p.coordinates, a.initial.low, a.initial.high) for a, p in pairs]
    alive: list[tuple[int, list[FloatArray]]] = []
    if all(np.array_equal(a.initial.low, a.initial.high) for a in problem.agents):
        alive = [(problem.initial_q, shares)] if problem.initial_q is not None else []
    else:
        for target, masks in zip(certificate.start_target, certificate.start_mask, strict=True):
            alive.append((int(target), [p.start_masks[m] * s for p, m, s in zip(agents, masks, shares, strict=True)]))
    dropped, total = 0.0, 0.0
    for t in range(problem.horizon):
        alive = [(q, f) for q, f in alive if not settled[q]]
        masses = np.array([np.prod([own.sum() for own in f]) for _, f in alive])
        small = np.zeros(len(alive), dtype=bool)
        order = np.argsort(masses)
        small[order[np.cumsum(masses[order]) <= 1e-9 * masses.sum()]] = True
        dropped += float(masses[small].sum())
        total += min(1.0, float(masses.sum()) + dropped + 1e-9)
        alive = _step([pair for pair, out in zip(alive, small, strict=True) if not out], certificate, kernels, t)
    return total


def _step(
    alive: list[tuple[int, list[FloatArray]]], certificate: Certificate, kernels: list[list[FloatArray]], t: int
) -> list[tuple[int, list[FloatArray]]]:
    """Alive products one step later."""
    following = []
    for q, factors in alive:
        moved = []
        for part, own, axes in zip(certificate.agents, factors, kernels, strict=True):
            points = part.points(t, q)
            shape = tuple(len(table) for table in axes)
            on_lattice = np.bincount(points[points >= 0], weights=own[points >= 0], minlength=int(np.prod(shape)))
            spread = on_lattice.reshape(shape)
            for axis, table in enumerate(axes):
                spread = np.moveaxis(np.tensordot(spread, table, axes=(axis, 0)), -1, axis)
            moved.append(spread.ravel())
        for g in np.flatnonzero(certificate.guard_source == q):
            masks = (part.masks[m] for part, m in zip(certificate.agents, certificate.guard_mask[g], strict=True))
            product = [own * mask for own, mask in zip(moved, masks, strict=True)]
            if all(own.any() for own in product):
                following.append((int(certificate.guard_target[g]), product))
    return following


def _check_values(certificate: Certificate, terms: Terms | Trains, recomputed: float) -> list[str]:
    """The claims are not larger than what was regrown."""
    failures = []
    n = certificate.problem.horizon * sum(p.grid.n_cells + 1 for p in certificate.agents) + len(certificate.agents)
    counted = max((len(kept) for step in certificate.skeleton for kept in step.kept), default=0)
    rounding = (n + max(certificate.rank, counted) + 2) * 2.0**-53
    if not certificate.lower_bound <= recomputed * (1.0 - rounding):
        failures.append(f"the bound {certificate.lower_bound:.12g} exceeds the recomputed value {recomputed:.12g}")
    elif any(not value <= recomputed * (1.0 - rounding) for value in certificate.bounds.values()):
        failures.append(f"it lists a bound that exceeds the recomputed value {recomputed:.12g}")
    if not rounding + 1e-11 * len(certificate.agents) <= certificate.relative_rounding <= 1.0:
        failures.append("its reserve for rounding is too small")
    tolerance = 1.0 + 1e-11
    stored, regrown = certificate.terms, terms
    if stored is None or isinstance(regrown, Trains):
        return failures if stored is None else [*failures, "it stores a value tree beside its tensor trains"]
    if any(len(a) != len(b) for a, b in zip(stored.index, regrown.index, strict=True)):
        return [*failures, "the stored value function has other terms than the tree"]
    if any(not np.all(own >= 0.0) for own in stored.factors):
        return [*failures, "the stored value function has factors that are negative or no numbers"]
    for i, (mine, yours) in enumerate(zip(stored.factors, regrown.factors, strict=True)):
        for q, rows in enumerate(stored.index):
            if np.any(mine[rows[:, i]] > yours[regrown.index[q][:, i]] * tolerance + 1e-250):
                failures.append(
                    f"a stored factor of agent `{certificate.problem.agents[i].name}` exceeds its regrown value"
                )
                break
    return failures
