"""Guards of a certificate, verified against the automaton: they are disjoint, and lead where they say.

A guard is a product of sets of cells. The letters of its states are products of classes, so that the automaton is asked
agent by agent, through its decision diagram; letters are never listed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import LinearAgent
from ...envs.logic import followed
from ...envs.problem import Problem
from ..cells import FloatArray
from ..certificates import AgentPart, Certificate
from ..relations import CoupledRelation


def wrong_guards(certificate: Certificate) -> list[str]:
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
        if automaton.finished[q]:
            return [f"guards leave the accepting state {q}"]
    for g in range(len(source)):
        reached = _targets(problem, int(source[g]), [letters[i][mask[g, i]] for i in range(len(letters))])
        allowed = {int(target[g])} | {*np.flatnonzero(automaton.finished).tolist()}
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
                following.add(followed(automaton, entry, positions, row))
        frontier = following
    return {-1 - entry for entry in frontier}


def joint_cells_by_target(problem: Problem, q: int, classes: Sequence[NDArray[np.bool_]]) -> dict[int, int]:
    """How many joint cells, of agents with the given classes (S_i, P_i), lead from q to each of its successors."""
    automaton, counts = problem.automaton, {int(problem.automaton.root[q]): 1}
    for own, table in zip(problem.labeling.agent_propositions, classes, strict=True):
        positions = {int(p): k for k, p in enumerate(own)}
        rows, numbers = np.unique(table, axis=0, return_counts=True)
        following: dict[int, int] = {}
        for entry, count in counts.items():
            for row, number in zip(rows, numbers.tolist(), strict=True):
                e = followed(automaton, entry, positions, row)
                following[e] = following.get(e, 0) + count * number
        counts = following
    return {-1 - entry: count for entry, count in counts.items()}


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
