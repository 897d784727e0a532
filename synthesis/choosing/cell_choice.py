"""Cells chosen within a budget: finer and finer runs, until memory or what there is to gain is used up.

What a value function takes depends on its terms, which nobody knows beforehand. So the first run is coarse, its peak is
measured (what Python and numpy allocate), and the peaks of finer ones are predicted from it: tables and policies by
their shapes, the rest in proportion to the cells and lattice points. Every certificate on the way is valid, and the
largest is kept. That the bound changed by less than ``accuracy`` from one run to the next is an observation, no proof
that still finer cells would gain as little.
"""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...envs.problem import Problem
from ..cells import RelationRefused
from ..certificates import Synthesis
from .cell_budget import MOST_CELLS_PER_AXIS, AgentCells, base_bytes, cells_at, snapping_loss
from .ways import with_settings

RunAtCells = Callable[[Mapping[str, tuple[int, ...]]], Synthesis]
"""Synthesis with given cells per agent and axis."""

DEFAULT_MEMORY = 2**31
"""Bytes that may be used when only an accuracy is asked for."""

COARSEST = 1.0
"""Cells per standard deviation of the first run, where memory allows."""

FINENESS_STEP = 1.05
"""Factor between the resolutions that are tried when the finest one that fits is looked for."""

GROWTH = 1.6
"""Factor between the resolutions of two runs; with one axis and no accuracy to compare, its square."""

LEAST_GROWTH = 1.15
"""Finer runs are not worth their time below this factor."""

NOTHING_TO_GAIN = 1e-6
"""Distance of the bound from 1 at which there is nothing left to gain, unless ``accuracy`` is larger."""

LEAST_SHARE = 0.5
"""Tables and policies are never expected to take less than this share of the estimate."""

MORE_TERMS = 1.5
"""Most that the value function is expected to grow per cell from one run to the next."""

SMALL_BYTES = 1_000_000
"""Bytes of everything small."""


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
        If one of them is not a positive number.
    """

    memory: float | None = None
    accuracy: float | None = None

    def __post_init__(self) -> None:
        for name, what in (("memory", "bytes"), ("accuracy", "a probability")):
            value = getattr(self, name)
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if value is not None and not (number and 0 < value < math.inf):
                raise ValueError(f"`{name}`: expected a positive number ({what}), got {value!r}")


@dataclass
class _RunsSoFar:
    """What the runs so far have shown."""

    problem: Problem
    kinds: tuple[str, ...]
    memory: float
    tried: list[dict[str, Any]] = field(default_factory=list)
    terms: float = 0.0
    """Bytes per cell and lattice point, beyond tables and policies, to be expected of the next run."""
    last_terms: float = 0.0
    """Those bytes in the last run."""
    share: float = 1.0
    """Share of the estimate for tables and policies that the last run did take."""

    def predicted(self, cells: Mapping[str, AgentCells]) -> float:
        """Return the peak of a run, in bytes (an estimate)."""
        points = sum(agent_cells.points for agent_cells in cells.values())
        return SMALL_BYTES + self.share * base_bytes(self.problem, cells) + self.terms * points

    def finest(self, low: float, high: float) -> tuple[float, dict[str, AgentCells]] | None:
        """Return the largest resolution from ``low`` to ``high`` that fits, to ``FINENESS_STEP``; None if none does."""
        steps = math.ceil(math.log(high / low) / math.log(FINENESS_STEP))
        for k in range(steps + 1):
            resolution = max(low, high / FINENESS_STEP**k)
            cells = cells_at(self.problem, resolution, self.kinds)
            if self.predicted(cells) <= self.memory:
                return resolution, cells
        return None


def refine(problem: Problem, run: RunAtCells, kinds: Sequence[str], budget: Budget) -> Synthesis:
    """Return the best of several runs; ``stats["cells"]`` and its certificate record how its cells were chosen.

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
    runs = _RunsSoFar(problem, tuple(kinds), float(budget.memory or DEFAULT_MEMORY))
    # Begin with coarse cells, coarser ones where not even these fit.
    first = runs.finest(COARSEST / 64, COARSEST)
    if first is None:
        least = runs.predicted(cells_at(problem, COARSEST / 64, kinds))
        raise ValueError(
            f"`memory`: expected at least {least:.3g} bytes, what the coarsest cells need, got {runs.memory:.3g}"
        )
    best: Synthesis | None = None
    last, reason = -1.0, ""
    resolution, cells = first
    while not reason:
        result = _attempt(runs, run, cells, resolution)
        # Stop if the bound hardly changed, or leaves nothing to gain.
        if result is not None:
            bound = result.certificate.lower_bound
            if best is None or bound > best.certificate.lower_bound:
                best, chosen = result, len(runs.tried) - 1
            if accuracy is not None and last >= 0 and abs(bound - last) < accuracy:
                reason = f"the bound changed by less than {accuracy:g}"
            elif bound >= 1.0 - max(NOTHING_TO_GAIN, accuracy or 0.0):
                reason = "the bound leaves no more to gain"
            last = bound
        # Else take finer cells, as long as they fit into memory by what the last run has shown.
        finer = None if reason else _finer(runs, resolution, accuracy)
        if finer is not None:
            resolution, cells = finer
        elif not reason:
            largest = max(max(agent_cells.shape) for agent_cells in cells.values())
            is_finest = largest >= MOST_CELLS_PER_AXIS / GROWTH
            reason = "finer cells are not offered" if is_finest else "finer cells need more memory"
    if best is None:
        last_words = runs.tried[-1]["refused"]
        raise ValueError(f"`memory`: no cells within {runs.memory:.3g} bytes gave a certificate: {last_words}")
    stop = {"stopped": reason, "memory": runs.memory, "accuracy": accuracy, "tried": runs.tried}
    return with_chosen_cells(best, {**runs.tried[chosen], **stop})


def with_chosen_cells(result: Synthesis, record: Any) -> Synthesis:
    """Return a synthesis whose certificate records how its cells were chosen (plain values)."""
    return replace(with_settings(result, {"cells_chosen": record}), stats={**result.stats, "cells": record})


def _finer(runs: _RunsSoFar, resolution: float, accuracy: float | None) -> tuple[float, dict[str, AgentCells]] | None:
    """Return the next resolution and its cells; None if nothing finer fits."""
    scalar = all(agent.n_states == 1 for agent in runs.problem.agents)
    growth = GROWTH**2 if scalar and accuracy is None else GROWTH
    finer = runs.finest(resolution * LEAST_GROWTH, resolution * growth)
    if finer is None or finer[1] == cells_at(runs.problem, resolution, runs.kinds):
        return None
    return finer


def _attempt(runs: _RunsSoFar, run: RunAtCells, cells: Mapping[str, AgentCells], resolution: float) -> Synthesis | None:
    """Make one run, its peak measured, and enter it in the record; None where the relation asks for finer cells."""
    expected = runs.predicted(cells)
    entry: dict[str, Any] = {
        "cells": [list(shape) for shape in sorted({agent_cells.shape for agent_cells in cells.values()})],
        "cells_per_deviation": resolution,
        "snapping_costs_at_most": snapping_loss(runs.problem, cells),
        "predicted_bytes": expected,
    }
    runs.tried.append(entry)
    # Measure what this run allocates, also while a caller traces memory.
    tracing = tracemalloc.is_tracing()
    if not tracing:
        tracemalloc.start()
    tracemalloc.reset_peak()
    before = tracemalloc.get_traced_memory()[0]
    try:
        result = run({name: agent_cells.shape for name, agent_cells in cells.items()})
        peak = float(tracemalloc.get_traced_memory()[1] - before)
    except RelationRefused as error:
        entry["refused"] = " ".join(str(error).split())
        return None
    finally:
        if not tracing:
            tracemalloc.stop()
    entry |= {"measured_bytes": peak, "lower_bound": result.certificate.lower_bound}
    # What is beyond tables and policies is the value function's, per cell and lattice point. Finer cells mean more
    # terms: as many more as the last time.
    base = base_bytes(runs.problem, cells)
    terms = max(0.0, peak - SMALL_BYTES - base) / sum(agent_cells.points for agent_cells in cells.values())
    growth = float(np.clip(terms / runs.last_terms, 1.0, MORE_TERMS)) if runs.last_terms else MORE_TERMS
    runs.terms = terms * growth
    runs.last_terms = terms
    runs.share = min(1.0, max(LEAST_SHARE, peak / (SMALL_BYTES + base)))
    return result
