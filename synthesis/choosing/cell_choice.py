"""Cells chosen within a budget: finer and finer runs, until memory or what there is to gain is used up.

What a value function takes depends on its terms, which nobody knows beforehand. So the first run is coarse, its peak is
measured (what Python and numpy allocate), and the peaks of finer ones are predicted from it: tables and policies by
their shapes, the rest in proportion to the cells and lattice points. Every certificate on the way is valid, the largest
is kept. That the bound changed by less than ``accuracy`` from one run to the next is an observation, no proof that
still finer cells would gain as little.
"""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...envs.problem import Problem
from ..cells import RelationRefused
from ..certificates import Synthesis
from .cell_budget import MOST, AgentCells, base_bytes, cells_at, snapping_loss

Run = Callable[[Mapping[str, tuple[int, ...]]], Synthesis]


@dataclass(frozen=True)
class Budget:
    """What the choice of cells may take.

    Parameters
    ----------
    memory : float or None
        Bytes that a run may take at its peak; None for ``DEFAULT_MEMORY``.
    accuracy : float or None
        If given, cells are made finer until the bound changes by less than this from one run to the next.

    Raises
    ------
    ValueError
        If one of them is no positive number.
    """

    memory: float | None = None
    accuracy: float | None = None

    def __post_init__(self) -> None:
        for name, what in (("memory", "bytes"), ("accuracy", "a probability")):
            value = getattr(self, name)
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if value is not None and not (number and 0 < value < math.inf):
                raise ValueError(f"`{name}`: expected a positive number ({what}), got {value!r}")


DEFAULT_MEMORY = 2**31
"""Bytes that may be used when only an accuracy is asked for."""

COARSEST = 1.0
"""Cells per standard deviation of the first run, where memory allows."""

GROWTH = 1.6
"""Factor between the resolutions of two runs; with one axis and no accuracy to compare, its square."""

LEAST_GROWTH = 1.15
"""Finer runs are not worth their time below this factor."""

SOLVED = 1e-6
"""Distance of the bound from 1 at which there is nothing left to gain, unless ``accuracy`` is larger."""

LEAST_SHARE = 0.5
"""Tables and policies are never expected to take less than this share of the estimate."""

MORE_TERMS = 1.5
"""Most that the value function is expected to grow per cell from one run to the next."""

OWN = 1_000_000
"""Bytes of everything small."""


@dataclass
class _Search:
    """What the runs so far have shown."""

    problem: Problem
    kinds: tuple[str, ...]
    memory: float
    tried: list[dict[str, Any]] = field(default_factory=list)
    terms: float = 0.0
    """Bytes per cell and lattice point, beyond tables and policies, to be expected of the next run."""
    seen: float = 0.0
    """The same of the last run."""
    share: float = 1.0
    """Share of the estimate for tables and policies that the last run did take."""

    def predicted(self, cells: Mapping[str, AgentCells]) -> float:
        """Peak of a run, in bytes (an estimate)."""
        points = sum(own.points for own in cells.values())
        return OWN + self.share * base_bytes(self.problem, cells) + self.terms * points

    def finest(self, low: float, high: float) -> tuple[float, dict[str, AgentCells]] | None:
        """The largest resolution from ``low`` to ``high`` that fits, to a twentieth; None if none does."""
        steps = math.ceil(math.log(high / low) / math.log(1.05))
        for k in range(steps + 1):
            resolution = max(low, high / 1.05**k)
            cells = cells_at(self.problem, resolution, self.kinds)
            if self.predicted(cells) <= self.memory:
                return resolution, cells
        return None


def refine(problem: Problem, run: Run, kinds: Sequence[str], budget: Budget) -> tuple[Synthesis, dict[str, Any]]:
    """The best of several runs, and a record of how its cells were chosen (plain values).

    Parameters
    ----------
    problem : Problem
    run : callable
        Synthesis with given cells per agent and axis.
    kinds : sequence of str
        Relation of each agent.
    budget : Budget

    Raises
    ------
    ValueError
        If not even the coarsest cells fit, or no run gives a certificate.
    """
    accuracy = budget.accuracy
    search = _Search(problem, tuple(kinds), float(budget.memory or DEFAULT_MEMORY))
    first = search.finest(COARSEST / 64, COARSEST)
    if first is None:
        least = search.predicted(cells_at(problem, COARSEST / 64, kinds))
        raise ValueError(
            f"`memory`: expected at least {least:.3g} bytes, what the coarsest cells need, got {search.memory:.3g}"
        )
    best: Synthesis | None = None
    last, reason = -1.0, ""
    resolution, cells = first
    while not reason:
        found = _attempt(search, run, cells, resolution)
        if found is not None:
            bound = found.certificate.lower_bound
            if best is None or bound > best.certificate.lower_bound:
                best, chosen = found, len(search.tried) - 1
            if accuracy is not None and last >= 0 and abs(bound - last) < accuracy:
                reason = f"the bound changed by less than {accuracy:g}"
            elif bound >= 1.0 - max(SOLVED, accuracy or 0.0):
                reason = "the bound leaves no more to gain"
            last = bound
        finer = None if reason else _finer(search, resolution, accuracy)
        if finer is not None:
            resolution, cells = finer
        elif not reason:
            largest = max(max(own.shape) for own in cells.values())
            reason = "finer cells are not offered" if largest >= MOST / GROWTH else "finer cells need more memory"
    if best is None:
        last_words = search.tried[-1]["refused"]
        raise ValueError(f"`memory`: no cells within {search.memory:.3g} bytes gave a certificate: {last_words}")
    record: dict[str, Any] = {
        **search.tried[chosen], "stopped": reason, "memory": search.memory, "accuracy": accuracy, "tried": search.tried
    }  # fmt: skip
    return best, record


def _finer(search: _Search, resolution: float, accuracy: float | None) -> tuple[float, dict[str, AgentCells]] | None:
    """The next resolution and its cells; None if nothing finer fits."""
    scalar = all(agent.n_states == 1 for agent in search.problem.agents)
    growth = GROWTH**2 if scalar and accuracy is None else GROWTH
    found = search.finest(resolution * LEAST_GROWTH, resolution * growth)
    if found is None or found[1] == cells_at(search.problem, resolution, search.kinds):
        return None
    return found


def _attempt(search: _Search, run: Run, cells: Mapping[str, AgentCells], resolution: float) -> Synthesis | None:
    """One run with its peak measured; None where the relation asks for finer cells."""
    expected = search.predicted(cells)
    entry: dict[str, Any] = {
        "cells": [list(shape) for shape in sorted({own.shape for own in cells.values()})],
        "cells_per_deviation": resolution,
        "snapping_costs_at_most": snapping_loss(search.problem, cells),
        "predicted_bytes": expected,
    }
    search.tried.append(entry)
    tracing = tracemalloc.is_tracing()
    if not tracing:
        tracemalloc.start()
    tracemalloc.reset_peak()
    before = tracemalloc.get_traced_memory()[0]
    try:
        found = run({name: own.shape for name, own in cells.items()})
        peak = float(tracemalloc.get_traced_memory()[1] - before)
    except RelationRefused as error:
        entry["refused"] = " ".join(str(error).split())
        return None
    finally:
        if not tracing:
            tracemalloc.stop()
    entry |= {"measured_bytes": peak, "lower_bound": found.certificate.lower_bound}
    base = base_bytes(search.problem, cells)
    seen = max(0.0, peak - OWN - base) / sum(own.points for own in cells.values())
    # finer cells mean more terms, as many more as the last time
    search.terms = seen * float(np.clip(seen / search.seen, 1.0, MORE_TERMS)) if search.seen else seen * MORE_TERMS
    search.seen = seen
    search.share = min(1.0, max(LEAST_SHARE, peak / (OWN + base)))
    return found
