"""Boxes of starts, cut into cells from which policies are certified along their run: most where most is lost."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....envs.tasks.problem import Problem
from ...certificates.proofs import (
    AlongPath,
    Certificate,
    Cut,
    GivenPolicy,
    OfStarts,
    PathProof,
    StartsProof,
    changed,
    verdict_of,
)
from ...relations.grids import FloatArray, RelationRefused
from .policy_paths import networks_along, states_along

AS_IT_IS = {"relation": "path", "policy": "as it is"}
"""Settings of certificates of given policies along their run."""

LITTLE = 1e-6
"""Probability of failing from a cell of starts below which it is not cut any more."""

GAIN = 0.8
"""Share of what a cell loses that both of its halves may lose, or else they are not cut again."""

MOST_CELLS, FEW_CELLS, HOPELESS = 128, 12, 12
"""Cells that are looked at, of up to ``FEW_STATES`` states and of more, and how many without a certificate end it."""

FEW_STATES = 3
"""States up to which it pays to cut a box along all of them."""


@dataclass(eq=False)
class _Cell:
    """A cell of starts: corners (2, D), its share of the volume, a certificate or why there is none, and its parts."""

    box: FloatArray
    share: float
    found: PathProof | None
    why: str
    cut: tuple[int, float, _Cell, _Cell] | None = None

    @property
    def lost(self) -> float:
        """What fails from it, times its share."""
        return self.share * (1.0 if self.found is None else self.found.failure)


def networks_from(problem: Problem, policies: Sequence[GivenPolicy]) -> AlongPath | OfStarts:
    """Return the best certificate of networks as they are, from a start or from a box that is cut where it pays.

    Raises
    ------
    RelationRefused
        If nothing is proved; the message says why.
    """
    if all(agent.initial.is_point for agent in problem.agents):
        return networks_along(problem, policies)
    corners = np.stack([np.concatenate([getattr(a.initial, side) for a in problem.agents]) for side in ("low", "high")])
    whole = _cell(problem, policies, corners, 1.0)
    if whole.found is not None and whole.lost <= LITTLE:
        return Certificate(problem, whole.found, dict(AS_IT_IS))
    divided = _of_cells(problem, policies, whole)
    if divided is not None and divided.proof.failure <= LITTLE:
        return divided
    # Radii are chosen with more care where cells do not help.
    try:
        undivided = networks_along(problem, policies)
    except RelationRefused:
        if divided is None:
            raise
        return divided
    return undivided if divided is None or undivided.proof.failure <= divided.proof.failure else divided


def _of_cells(problem: Problem, policies: Sequence[GivenPolicy], whole: _Cell) -> OfStarts | None:
    """Return the certificate from the cells of a box of starts; None if nothing is proved from any of them."""
    cells = _divided(problem, policies, whole)
    root = _written(problem, whole)
    if not isinstance(root, Cut) or all(cell.found is None for cell in cells):
        return None
    proof = StartsProof(root, tuple(policies), 1.0, 1.0)
    certificate = Certificate(problem, proof, {**AS_IT_IS, "cells": len(cells)})
    verdict = verdict_of(certificate)
    worst = max((failure for failure, *_ in verdict.steps), default=1.0)
    failure = min(1.0, verdict.recomputed * (1.0 + 1e-9))
    return changed(certificate, failure=failure, worst=min(1.0, worst * (1.0 + 1e-9)))


def _divided(problem: Problem, policies: Sequence[GivenPolicy], whole: _Cell) -> list[_Cell]:
    """Cut cells that lose most, in the middle of one side, until little is lost; return those that are not cut."""
    count, order, last = 1, itertools.count(), [whole]
    most = MOST_CELLS if problem.n_states <= FEW_STATES else FEW_CELLS
    waiting = [(-whole.lost, next(order), whole)]
    while waiting and count < most:
        cell = heapq.heappop(waiting)[2]
        cell.cut = _halves(problem, policies, cell)
        last = [one for one in last if one is not cell] + list(cell.cut[2:])
        count += 2
        if cell.found is not None and sum(half.lost for half in cell.cut[2:]) > GAIN * cell.lost:
            continue  # what is lost is not lost by how wide the cell is
        for half in cell.cut[2:]:
            if half.lost > LITTLE * half.share:
                heapq.heappush(waiting, (-half.lost, next(order), half))
        if len(last) >= HOPELESS and all(one.found is None for one in last):
            break
    return last


def _halves(problem: Problem, policies: Sequence[GivenPolicy], cell: _Cell) -> tuple[int, float, _Cell, _Cell]:
    """Return where a cell is cut, and both parts."""
    k = _most_felt(problem, policies, cell.box)
    middle = float(0.5 * cell.box[0, k] + 0.5 * cell.box[1, k])
    boxes = cell.box.copy(), cell.box.copy()
    boxes[0][1, k] = boxes[1][0, k] = middle
    below, above = (_cell(problem, policies, box, 0.5 * cell.share) for box in boxes)
    return k, middle, below, above


def _most_felt(problem: Problem, policies: Sequence[GivenPolicy], box: FloatArray) -> int:
    """Return the joint state by whose ends in a cell runs without noise differ most, as shares of the workspace."""
    low, high = (np.concatenate([getattr(a, side) for a in problem.agents]) for side in ("state_low", "state_high"))
    wide = np.flatnonzero(box[0] < box[1])
    apart = []
    for k in wide if len(wide) > 1 else ():
        starts = 0.5 * box.sum(axis=0), 0.5 * box.sum(axis=0)
        for start, end in zip(starts, box, strict=True):
            start[k] = end[k]
        runs = [states_along(problem, policies, start) for start in starts]
        steps = min(map(len, runs))
        apart.append(
            float(np.sum(np.max(np.abs(runs[0][:steps] - runs[1][:steps])[1:] / (high - low), axis=1))) / steps
        )
    return int(wide[np.argmax(apart)] if apart else wide[0])


def _cell(problem: Problem, policies: Sequence[GivenPolicy], box: FloatArray, share: float) -> _Cell:
    """Return a cell with its certificate, if there is one."""
    part = problem.replace(initial_low=box[0].tolist(), initial_high=box[1].tolist())
    try:
        return _Cell(box, share, networks_along(part, policies, LITTLE).proof, "")
    except RelationRefused as refused:
        return _Cell(box, share, None, str(refused))


def _written(problem: Problem, cell: _Cell) -> Cut | PathProof | None:
    """Return a cell as proofs hold it."""
    if cell.cut is None:
        return cell.found
    k, at, below, above = cell.cut
    i = next(i for i, columns in enumerate(problem.columns) if columns.start <= k < columns.stop)
    return Cut(i, k - problem.columns[i].start, at, _written(problem, below), _written(problem, above))
