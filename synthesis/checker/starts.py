"""Boxes of starts that are cut into cells, each of which has a trajectory of its own.

**Theorem.** If the task fails with a probability of at most f_i from every start in cell i, then with at most max f_i
from every start in the box, and with at most the mean of f_i by volumes from one that is drawn uniformly.

*Proof.* A cut, ``x_k <= a`` and ``x_k >= a``, covers the box by two, which share a face of volume 0. QED
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from . import trajectories
from .fields import Entry
from .file import Contents
from .problem import Problem
from .rigorous import Array, U

# Share of the volume, the problem with starts in the cell, and its proof; nothing is claimed where there is none.
Cell = tuple[float, Problem, trajectories.TrajectoryProof | None]


def read_proof(contents: Contents, problem: Problem) -> list[Cell]:
    """Return the cells of the box of starts in a file; raise ``Unreadable`` if there is no proof of this kind."""
    return [*_cells(contents, contents.entry("proof"), problem, 1.0)]


def _cells(contents: Contents, entry: Entry, problem: Problem, share: float) -> Iterator[Cell]:
    if entry.value is None or entry.entries_by_name().get("kind", entry).value != "starts":
        yield share, problem, None if entry.value is None else trajectories.read_proof(contents, problem, entry)
        return
    own = entry.table(("kind", "agent", "state", "cut", "below", "above"))
    i, cut, agents = own["agent"].whole(0, len(problem.agents)), own["cut"].number(), list(problem.agents)
    start, k = agents[i].start, own["state"].whole(0, len(agents[i].states))
    low, high = start[:, k].tolist()
    if not low < cut < high:
        raise own["cut"].wrong("it does not lie inside the box of starts")
    for side, key, width in ((1, "below", cut - low), (0, "above", high - cut)):
        box = start.copy()
        box[side, k] = cut
        agents[i] = replace(agents[i], start=box)
        part = replace(problem, agents=tuple(agents))
        yield from _cells(contents, own[key], part, share * width / (high - low) * (1.0 + 8.0 * U))


def failure_of(problem: Problem, cells: list[Cell]) -> tuple[float, str, list[tuple[float, str, Array]]]:
    """Return an upper bound on the probability that the task fails, its largest part, and what fails from each cell."""
    total, found = 0.0, list[tuple[float, str, Array]]()
    for share, part, own in cells:
        failure, worst = (1.0, "; nothing") if own is None else trajectories.failure_of(part, own)[:2]
        total += share * failure * (1.0 + 4.0 * U * len(cells))
        found.append((failure, worst, part.agents[0].start))
    return min(1.0, total), max(found, key=lambda one: one[0])[1], found
