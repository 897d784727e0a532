"""The search for good policies: several starts, coordinate ascent from each, the best kept.

Starts: *naive* (every cell and every team-mate counts alike), *relaxed* (each agent as if the team would follow, see
``relaxation``), *staged* (jumps over region edges at the same time, see ``seeds``). Where the value tree grows more
than ``MANY_TERMS`` terms, the value function is held as tensor trains instead, and the ascent goes on with them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..envs.problem import Problem
from .ascent import Laws, Limits, Sweep, resting_laws, sweep
from .joint import JointModel, start_of
from .occupancy import Occupancy
from .relaxation import Relaxation, relax, relaxed_laws, upper_bound
from .seeds import best_paths, path_laws, staged_paths
from .train_ascent import TrainSweep, sweep_trains

FINAL = Limits(contribution=1e-10, elsewhere=1e-4, mass=1e-11, rank=1500)
"""What the last pass over a tree, with frozen policies, may leave out."""

MANY_TERMS = 64
"""Terms of a naive value tree from which tensor trains are used instead, unless the caller decides."""

SOLVED = 0.9
"""Share of the upper bound from which a start is good enough and no further ones are tried."""

SAME = 1e-5
"""Relative difference up to which two starts have led to the same value, and further ones are left out."""

COARSE, FINE, PAIR = 1e-2, 1e-4, 1e-7
"""What rounding of trains may change, as a share of the value: during the search, for what is reported, and that for
two agents, whose rank is that of a matrix."""

VISITED = 1e-2
"""Share of the mass of each step that may lie on cells which trains leave out, as a share of the tolerance."""

Progress = Callable[[str, float], None]


def improve(
    problem: Problem,
    joint: JointModel,
    limits: Limits,
    max_sweeps: int,
    progress: Progress | None = None,
    value: str = "auto",
) -> tuple[Sweep | TrainSweep, list[float], tuple[Relaxation, ...]]:
    """Best policies found, evaluated with frozen laws; the value after each sweep; and the relaxations.

    Parameters
    ----------
    problem : Problem
    joint : JointModel
    limits : Limits
        Pruning of trees during the search.
    max_sweeps : int
        Most sweeps from one start.
    progress : callable, optional
        Called with the name of a start and the best value so far.
    value : str
        ``"tree"``, ``"train"``, or ``"auto"`` (see the module's text).
    """
    start = start_of(problem, joint)
    relaxations = relax(problem, joint)
    most = upper_bound(joint, start, relaxations)
    first = limits if value == "tree" else Limits(**{**vars(limits), "rank": min(limits.rank, MANY_TERMS)})
    naive = sweep(joint, resting_laws(joint), None, first, improve=True)
    values: list[float] = []
    if value == "train" or (value == "auto" and naive.rank >= MANY_TERMS):
        starts = {"relaxed start": relaxed_laws(relaxations), "naive start": naive.laws}
        return _with_trains(joint, start, starts, most, max_sweeps, values, progress), values, relaxations
    best = _with_trees(joint, start, naive.laws, relaxations, most, limits, max_sweeps, values, progress)
    laws = naive.laws if best is None else best.laws
    return sweep(joint, laws, start, FINAL, improve=False), values, relaxations


def _with_trees(
    joint: JointModel, start: Occupancy, naive: Laws, relaxations: tuple[Relaxation, ...], most: float, limits: Limits,
    max_sweeps: int, values: list[float], progress: Progress | None,
) -> Sweep | None:  # fmt: skip
    """The best sweep from several starts; the best policies are kept, whatever pruning did to a later sweep."""

    def run(laws: Laws, sweeps: int, best: Sweep | None, name: str) -> Sweep | None:
        """Sweep from ``laws`` until nothing improves; the better of what comes out and ``best``."""
        last = -1.0
        for _ in range(sweeps):
            found = sweep(joint, laws, start, limits, improve=True)
            values.append(found.value)
            best = found if best is None or found.value > best.value else best
            if progress is not None:
                progress(name, best.value)
            if found.value <= last * (1 + 1e-7) or found.value >= most * (1 - 1e-9):
                break
            last, laws = found.value, found.laws
        return best

    best = run(naive, max_sweeps, None, "naive start")
    if best is None or best.value >= SOLVED * most or max_sweeps < 2:
        return best
    relaxed = run(relaxed_laws(relaxations), 1, None, "relaxed start")
    if relaxed is not None and abs(relaxed.value - best.value) <= SAME * best.value:
        return max(best, relaxed, key=lambda one: one.value)  # two starts that differ have come to the same
    tried = [relaxed]
    for path in best_paths(joint, start, width=32, count=1):
        tried += [run(path_laws(joint, p, naive), 1, None, "staged start") for p in staged_paths(joint, path)]
    for found in sorted((f for f in tried if f is not None), key=lambda f: -f.value)[:2]:
        best = run(found.laws, max_sweeps - 1, max(best, found, key=lambda f: f.value), "best start again")
    return best


def _with_trains(
    joint: JointModel, start: Occupancy, starts: dict[str, Laws], most: float, max_sweeps: int, values: list[float],
    progress: Progress | None,
) -> TrainSweep:  # fmt: skip
    """The best policies from several starts, evaluated with a fine rounding."""
    best: TrainSweep | None = None
    tolerance = _tolerance(COARSE * most)
    for name, laws in starts.items():
        last = 0.0
        for _ in range(max_sweeps):
            found = sweep_trains(joint, laws, start, tolerance, improve=True, margin=1)
            values.append(found.value)
            best = found if best is None or found.value > best.value else best
            if progress is not None:
                progress(name, best.value)
            if found.value <= last + tolerance or found.value >= (1 - COARSE) * most:
                break
            last, laws = found.value, found.laws
        if best is not None and best.value >= SOLVED * most:
            break
    laws = next(iter(starts.values())) if best is None else best.laws
    scale = most if best is None else max(best.value, 1e-6)
    fine = FINE if len(joint.models) > 2 else PAIR
    return sweep_trains(joint, laws, start, _tolerance(fine * scale), improve=False, share=fine * VISITED)


def _tolerance(wanted: float) -> float:
    """A tolerance that floating point can keep."""
    return float(np.clip(wanted, 1e-9, 0.5))
