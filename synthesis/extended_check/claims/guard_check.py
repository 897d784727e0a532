"""Guards of a certificate, verified against the automaton: they are disjoint, and lead where they say.

A guard is a product of sets of cells. The letters of its states are products of classes, so that the automaton is asked
agent by agent, through its decision diagram; letters are never listed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.automata import followed
from ....envs.tasks.problem import Problem
from ...certificates.cell_probabilities import AgentRecord
from ...certificates.proofs import OnGrid
from ...relations.grids import FloatArray
from ..steps import OUTWARD, cell_boxes, classes_in_boxes


def wrong_guards(certificate: OnGrid, margins: Sequence[FloatArray | None]) -> list[str]:
    """Guards are disjoint, stay inside the workspace, and every letter of their states leads where they say.

    ``margins`` (d,) say how far related states are from the centres of their cells (see ``label_margin``).
    """
    initial = np.full(len(certificate.proof.start_target), certificate.problem.automaton.initial)
    agents, none = certificate.proof.agents, [None] * len(margins)
    arriving = [part.masks for part in agents], certificate.proof.guard_source, certificate.proof.guard_target
    starting = [part.start_masks for part in agents], initial, certificate.proof.start_target
    failures = _wrong_guards(certificate, *arriving, certificate.proof.guard_mask, margins)
    return failures or _wrong_guards(certificate, *starting, certificate.proof.start_mask, none)


def cell_classes(
    problem: Problem, agent: int, part: AgentRecord, margin: FloatArray | None
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Classes (K, P), which of them (S, K) the states related to each cell may have, and which cells (S,) stay inside.

    ``margin`` as for ``wrong_guards``; None for the states of the cell itself. Where exits are read as letters, what is
    beyond the workspace has one class more, in which nothing holds, and every cell counts as inside.
    """
    low, high = cell_boxes(part)
    workspace = problem.agents[agent].workspace
    half_open = margin is None
    if margin is not None:
        centre = 0.5 * (low + high)
        slack = OUTWARD * np.abs(centre)
        low, high = centre - slack - margin, centre + slack + margin
    inside = np.all((workspace.low <= low) & (high <= workspace.high), axis=1)
    if not problem.labeling.reads_exits:
        classes, possible = classes_in_boxes(problem, agent, low, high, closed=not half_open)
        return classes, possible, inside
    # A half-open cell that ends at the next number after the upper face holds nothing beyond it.
    last = np.nextafter(workspace.high, np.inf) if half_open else workspace.high
    beyond = np.any((low < workspace.low) | (high > last), axis=1)
    outside = np.any((high <= workspace.low if half_open else high < workspace.low) | (low > workspace.high), axis=1)
    low, high = (np.clip(end, workspace.low, workspace.high) for end in (low, high))
    classes, possible = classes_in_boxes(problem, agent, low, high, closed=not half_open)
    possible = np.hstack([possible & ~outside[:, None], beyond[:, None]])
    return np.vstack([classes, np.zeros_like(classes[:1])]), possible, np.ones_like(inside)


def _wrong_guards(
    certificate: OnGrid,
    masks: list[NDArray],
    source: NDArray,
    target: NDArray,
    mask: NDArray,
    margins: Sequence[FloatArray | None],
) -> list[str]:
    """What is wrong with one set of guards."""
    problem, automaton = certificate.problem, certificate.problem.automaton
    # numpy would count numbers below 0 from the end, which is nobody's guard
    sizes = np.array([len(own) for own in masks])
    if np.any((mask < 0) | (mask >= sizes)):
        return ["a guard names a set of cells that is not in the certificate"]
    if any(np.any((states < 0) | (states >= automaton.n_states)) for states in (source, target)):
        return ["a guard names an automaton state that there is not"]
    meets, letters = [], []
    for i, (part, own, margin) in enumerate(zip(certificate.proof.agents, masks, margins, strict=True)):
        meets.append((own.astype(np.int64) @ own.T.astype(np.int64)) > 0)
        classes, possible, inside = cell_classes(problem, i, part, margin)
        if own[:, ~inside].any():
            return [f"a guard uses cells of agent `{problem.agents[i].name}` that reach beyond its workspace"]
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
