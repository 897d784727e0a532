"""Cells made finer level by level, each level begun with the policies of the last.

Under the relation ``linear`` the first cells are some standard deviations of the noise wide: a rough search is quick
there. Under other relations the first level is a synthesis on default cells, among whose relations the best was taken.
Each level halves the cells, as long as an estimate of its work allows for that; then they are made finer once more by
as much as it does. Policies are carried over, so that a fine level needs one or two sweeps instead of a search. Work is
counted from sizes, not taken from a clock: the same problem gives the same certificate on every machine.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ....envs.systems.agents import Agent, AnyAgent
from ....envs.tasks.problem import Problem
from ...abstraction.kernels import MOST_SCALED, MOST_SCALES, points_per_cell
from ...abstraction.models import (
    Abstraction,
    BoxChoices,
    Policies,
    Settings,
    abstraction_of,
    count_of_decisions,
    reaches_every_mean,
)
from ...certificates.proofs import Synthesis
from ...relations.grids import MOST_CELLS, RelationRefused, agent_grid, deviations_of, grid_laws, region_boundaries
from ..ascent import RELAXED
from .carrying import carried_over
from .cell_numbers import axis_weights, cells_at, equal_parts
from .effort import Effort, OutOfTime
from .strategies import SOLVED

FIRST_WIDTH = 2.5
"""Width of the first cells, in standard deviations of the noise."""

FIRST_BOX_WIDTH = 2.0
"""The same for agents with expressions whose inputs do not reach every mean: boxes need narrower cells."""

WIDER, MOST_FIRST_WORK = 1.25, 40.0
"""By how much these first cells are widened until they take no more work than this: where noise is small against the
workspace they would be many, and certify nothing, either."""

MOST_WIDENINGS = 16
"""How often they are made wider: beyond, cells are as few as can be, and long horizons take what they take."""

FINER = (2.0, 1.5, 1.25)
"""By how much cells are made finer: the most that time allows for; less than the first is tried only once."""

LAST = (3.0, 2.5, 2.0, 1.5, 1.25)
"""The same for a level that is surely the last one."""

MOST_FINER = 2.5
"""By how much linear cells are made finer at most: few sweeps do not mend policies of cells that are much larger."""

MOST_LEVELS = 7
"""Levels, at most: cells of the last are a twentieth of a standard deviation wide, and nothing is left to gain."""

NO_HOPE = "skipped: finer cells gave nothing, either, and no run without noise was found"
"""Why no further levels are made where all bounds are 0."""

LEAST_GAIN = 5e-4
"""Gain, as a share of the bound, from which a level is worth its time, as far as it can be foreseen. A share, because
bounds of large teams are products: they are next to 0 on rough cells, and may end near 1."""

MOST_PARTS = 400
"""Most equal cells of an axis that are asked for to have region boundaries on their edges."""

FEWEST, MOST_PER_AXIS = 8, 2000
"""Fewest and most cells per axis."""

MULTIPLICATIONS_PER_SECOND = 1.5e9
"""Multiplications of smoothing, with what goes with it."""

DIFFERENCES_PER_SECOND, MAPS_PER_SECOND = 4e6, 1.1e5
"""Lattice points whose differences are found, and cells that are read and decided, of linear cells."""

TEAM_SWEEPS = 1.5
"""How often linear cells of teams are swept in a level, as work of one agent goes, which needs no ascent."""

PER_AXIS = 1.6
"""By how much each axis beyond two slows linear cells: one more side to look beyond, and tables beyond any cache."""

LATTICE_PER_SECOND = 1.3e7
"""Lattice points whose charge and window minima are found, under boxes."""

READINGS, TERMS_OF_A_READING = 4, 30.0
"""How often cells are read in a level, and the terms that double the time of a reading."""

PAIR = 2
"""Agents that are alike for which reading is counted one by one: pairs may have to stay together, or apart."""

SURELY = 0.7
"""Share of the work, scaled from coarser cells, that a level takes at least: cells are rounded to fit regions."""

MOST_COUNTED = 4_000
"""Cells of an agent up to which models are made to know the work of a level."""

CHEAP = 0.5
"""Work below which a level is begun whatever the last one gained."""

GUESSED_RANK, MOST_GUESSED_RANK, GUESSED_LINEAR = 10, 20, 2
"""Terms that the first level of two agents is expected to have, and further ones at most: sweeps have few. The last is
for linear cells, of which the first level takes next to no time."""

LEAST_SHARE, SOLVED_LINEAR = 0.1, 0.9999
"""That gain as a share of what is left, where that is less, and the bound that is enough, for linear cells."""

Run = Callable[[Abstraction, Policies | None], Synthesis]
"""Synthesis on finite models, from given policies or from the usual starts."""

CellsOfWidth = Callable[[float], dict[str, tuple[int, ...]]]
"""Cells of every agent that are about as wide as this, in standard deviations of the noise."""

Record = list[dict[str, Any]]
"""Cells and bound of every level."""


def linear_levels(problem: Problem, settings: Settings, run: Run, effort: Effort) -> tuple[Synthesis, Record]:
    """Return the best synthesis on linear cells, and the bound of every level; the first is made in any case.

    Raises
    ------
    RelationRefused
        If an agent has no linear cells.
    """
    levels = _linear(problem, settings, run, effort)
    levels.climb(FIRST_WIDTH)
    assert levels.best is not None
    return levels.best, levels.record


def linear_work(problem: Problem, settings: Settings, run: Run) -> float:
    """Return the work of the first level of linear cells, from that of fewer cells where there are very many.

    Raises
    ------
    RelationRefused
        If an agent has no linear cells.
    """
    levels = _linear(problem, settings, run, Effort())

    def count(width: float) -> int:
        return max(math.prod(shape) for shape in levels.cells(width).values())

    axes, width = max(agent.n_states for agent in problem.agents), FIRST_WIDTH
    if count(width) > MOST_COUNTED:
        width *= (count(width) / MOST_COUNTED) ** (1.0 / axes)
    return levels.work(levels.models(width)) * count(FIRST_WIDTH) / count(width)


def _linear(problem: Problem, settings: Settings, run: Run, effort: Effort) -> _Levels:
    """Return levels of linear cells."""
    kinds = ["linear"] * problem.n_agents
    return _Levels(problem, settings, kinds, lambda width: level_cells(problem, width), run, effort)


def finer_levels(
    problem: Problem, settings: Settings, first: Synthesis, run: Run, effort: Effort
) -> tuple[Synthesis, Record]:
    """Return the best of a synthesis and of those on finer cells under its relations, and the bound of every level."""
    parts = first.certificate.proof.agents
    kinds = [part.relation["kind"] for part in parts]
    shapes = {agent.name: part.grid.shape for agent, part in zip(problem.agents, parts, strict=True)}

    def cells_of(width: float) -> dict[str, tuple[int, ...]]:
        return cells_at(problem, 1.0 / width)

    levels = _Levels(problem, settings, kinds, cells_of, run, effort)
    try:
        before = abstraction_of(problem, shapes, kinds, settings)
    except RelationRefused:  # relations with delta > 0 depend on more than their kinds
        return first, []
    levels.begin(before, first)
    levels.climb(_widest(problem, shapes))
    assert levels.best is not None
    return levels.best, levels.record


def first_cells(problem: Problem) -> dict[str, tuple[int, ...]] | None:
    """Return cells to begin with for agents with expressions whose inputs do not reach every mean; None without such.

    Default cells suit no axis of theirs.
    """
    reached: dict[object, bool] = {}
    for agent in problem.agents:
        if agent.model_key not in reached:
            reached[agent.model_key] = not isinstance(agent, Agent) or reaches_every_mean(agent)
    if all(reached.values()):
        return None
    cells: dict[str, tuple[int, ...]] = {}
    for number in range(MOST_WIDENINGS + 1):
        fitting = cells_at(problem, 1.0 / (FIRST_BOX_WIDTH * WIDER**number))
        cells = {
            agent.name: fitting[agent.name]
            for agent in problem.agents
            if not reached[agent.model_key]
            and math.prod(fitting[agent.name]) <= MOST_CELLS  # others have default cells, which always fit
        }
        if box_work(problem, cells) <= MOST_FIRST_WORK:
            break
    return cells or None


def box_work(problem: Problem, cells: Mapping[str, tuple[int, ...]]) -> float:
    """Return an estimate of the work of boxes on the cells of some agents, before any model is made."""
    total = 0.0
    for agent in problem.agents:
        if agent.name in cells and isinstance(agent, Agent):
            grid = agent_grid(problem, problem.agent_names.index(agent.name), cells[agent.name])
            points = points_per_cell(grid, grid_laws(agent))
            lattice = math.prod(n * count for n, count in zip(grid.shape, points, strict=True))
            if agent.noise_scale is not None:
                lattice = max(lattice, min(lattice * MOST_SCALES, MOST_SCALED))
                total += lattice * max(grid.shape) / MULTIPLICATIONS_PER_SECOND
            total += lattice / LATTICE_PER_SECOND + grid.n_cells / BoxChoices.read_per_second
    # Counting decisions of large automata takes long: nothing is asked about no cells.
    return READINGS * count_of_decisions(problem) * total if total else 0.0


class _Levels:
    """Levels of cells under given relations, the best of them, and what the next one begins with."""

    def __init__(
        self,
        problem: Problem,
        settings: Settings,
        kinds: Sequence[str],
        cells_of: CellsOfWidth,
        run: Run,
        effort: Effort,
    ) -> None:
        self.problem, self.settings, self.kinds, self.cells_of, self.run = problem, settings, kinds, cells_of, run
        self.effort = effort
        self.best: Synthesis | None = None
        self.record: Record = []
        self.before: tuple[Abstraction, Policies] | None = None
        self.rank = 1 if problem.n_agents == 1 else GUESSED_LINEAR if self.is_linear else GUESSED_RANK
        self.undecided = int((~problem.automaton.absorbing).sum())
        self.follows = False

    def begin(self, abstraction: Abstraction, result: Synthesis) -> None:
        """Take note of a level."""
        certificate = result.certificate
        self.rank = min(self.terms_of(result), MOST_GUESSED_RANK)
        self.record.append(
            {
                "cells": [list(part.grid.shape) for part in certificate.proof.agents],
                "lower_bound": float(certificate.lower_bound),
            }
        )
        self.before = abstraction, tuple(part.policy for part in certificate.proof.agents)
        # Where agents that trust the team lose nothing on coarse cells they do so on finer ones: no sweep is needed.
        self.follows = result.stats["starts"].keys() == {RELAXED}  # type: ignore[attr-defined]
        self.effort.has_result = True
        if self.best is None or certificate.lower_bound > self.best.certificate.lower_bound:
            self.best = result

    def terms_of(self, result: Synthesis) -> int:
        """Return the terms that a state is expected to have: of linear cells those of all steps in the mean.

        Linear cells are read in all states, those of other relations only where there is something to decide.
        """
        proof = result.certificate.proof
        if proof.terms is None:
            return int(proof.rank)
        steps = [step.kept for step in proof.merge_log] if self.is_linear else [proof.terms.index]
        terms = sum(len(rows) for step in steps for rows in step)
        return math.ceil(terms / max(1, self.undecided * len(steps)))

    def climb(self, width: float) -> None:
        """Make levels from cells of this width on, until they gain little, or take too much work."""
        gained, taken = None, 0.0
        for _ in range(MOST_LEVELS):
            found = self.next(width, self.effort.for_levels(self.bound, taken), gained)
            if found is None:
                return
            abstraction, finer, work = found
            if self.has_cells_of(abstraction):
                width /= finer  # boundaries of regions, or the fewest cells, ask for as many as there are
                continue
            # Boundaries of regions may leave fewer cells than were wanted.
            grown = finer if self.before is None else min(finer, self.grows_by(abstraction))
            if gained is not None and expected_gain(*gained, grown) < self.least_gain and work > CHEAP:
                return
            if self.is_hopeless:
                self.effort.left_out[self.rest] = NO_HOPE
                return
            is_first, bound = self.before is None, self.bound
            carried = self.carried_to(abstraction)
            taken += work
            self.effort.spent += work
            try:
                with self.effort.until_broken_off():
                    self.effort.tell(f"{'/'.join(dict.fromkeys(self.kinds))}, {_cells_text(abstraction)}", self.bound)
                    result = self.run(abstraction, carried)
            except OutOfTime:
                if self.best is None:
                    raise
                self.effort.left_out[self.rest] = self.effort.given_up
                return
            self.begin(abstraction, result)
            # Terms were guessed: those that were not there have taken nothing.
            unused = max(0.0, work - self.work(abstraction))
            taken -= unused
            self.effort.spent -= unused
            # Where little is to be gained, further levels are made only if they cost next to nothing.
            gained = None if is_first or result.certificate.lower_bound <= 0.0 else (self.bound - bound, grown)
            bound = result.certificate.lower_bound
            if bound >= self.solved or self.effort.suffices(bound) or (not is_first and finer < FINER[0]):
                return
            width /= finer

    def carried_to(self, abstraction: Abstraction) -> Policies | None:
        """Return the policies of the last level on finer cells, if sweeps are to begin with them."""
        if self.before is None or self.follows:
            return None
        return carried_over(self.before[0], abstraction, self.before[1])

    @property
    def is_hopeless(self) -> bool:
        """Whether finer cells gave nothing, either, and no run is known that they could follow."""
        return bool(self.effort.no_run) and len(self.record) > 1 and self.bound <= 0.0

    @property
    def rest(self) -> str:
        """What further levels are called in the record."""
        return f"{'/'.join(dict.fromkeys(self.kinds))}, finer cells"

    @property
    def is_linear(self) -> bool:
        """Whether cells are linear: levels are quick, and lose little of what is left."""
        return "linear" in self.kinds

    def has_cells_of(self, abstraction: Abstraction) -> bool:
        """Return whether the last level had as many cells."""
        if self.before is None:
            return False
        pairs = zip(self.before[0].models, abstraction.models, strict=True)
        return all(one.grid.shape == other.grid.shape for one, other in pairs)

    def grows_by(self, abstraction: Abstraction) -> float:
        """Return how many times as many cells there are along an axis, at most, as on the last level."""
        assert self.before is not None
        pairs = zip(self.before[0].models, abstraction.models, strict=True)
        return max(m / n for one, other in pairs for n, m in zip(one.grid.shape, other.grid.shape, strict=True))

    @property
    def solved(self) -> float:
        """The bound from which no finer level is worth its time."""
        return SOLVED_LINEAR if self.is_linear else SOLVED

    @property
    def least_gain(self) -> float:
        """Gain of a level from which the next one is worth its time."""
        gain = LEAST_GAIN * self.bound
        return min(gain, LEAST_SHARE * (1.0 - self.bound)) if self.is_linear else gain

    @property
    def bound(self) -> float:
        """The largest bound so far."""
        return 0.0 if self.best is None else float(self.best.certificate.lower_bound)

    def next(
        self, width: float, most: float, gained: tuple[float, float] | None
    ) -> tuple[Abstraction, float, float] | None:
        """Return finite models twice as fine, or as fine as pays and the effort allows, by how much, and their work."""
        if self.before is None:
            abstraction = self.models(width)
            return abstraction, 1.0, self.work(abstraction)
        # Work grows with the cells at least, so that most levels that take too much need not be built to know it.
        d = min(agent.n_states for agent in self.problem.agents)
        least = SURELY * self.work(self.before[0])
        # Where there is room for two more levels, one of them now; else the finest cells that there is room for.
        goes_on = least * (FINER[0] ** d + FINER[0] ** (2 * d)) <= most
        work = least * FINER[-1] ** d
        for finer in FINER if goes_on else LAST:
            if least * finer**d > most:
                continue
            try:
                abstraction = self.models(width / finer)
            except RelationRefused:
                return None
            if self.is_linear and finer > FINER[0] and self.grows_by(abstraction) > MOST_FINER:
                continue
            work = self.work(abstraction)
            if work > most:
                continue
            if gained is not None and not goes_on:
                # What the finest cells gain beside a few less need not be worth their time, either.
                gain = max(expected_gain(*gained, finer) - self.least_gain, self.least_gain)
                enough = min(fewer for fewer in LAST if fewer == finer or expected_gain(*gained, fewer) > gain)
                if enough < finer:
                    abstraction = self.models(width / enough)
                    return abstraction, enough, self.work(abstraction)
            return abstraction, finer, work
        self.effort.left_out[self.rest] = self.effort.too_much(work, most)
        return None

    def models(self, width: float) -> Abstraction:
        """Return finite models with cells of about this width; refuse more than an agent may have."""
        return abstraction_of(self.problem, self.cells(width), self.kinds, self.settings)

    def cells(self, width: float) -> dict[str, tuple[int, ...]]:
        """Return cells of about this width; refuse more than an agent may have."""
        cells = self.cells_of(width)
        for name, shape in cells.items():
            if math.prod(shape) > MOST_CELLS:
                raise RelationRefused(
                    f"agent `{name}`: cells {width:g} standard deviations wide are {math.prod(shape):.2g} in all, and "
                    f"grids hold {MOST_CELLS:.2g} at most"
                )
        return cells

    def work(self, abstraction: Abstraction) -> float:
        """Return an estimate of the work of a level."""
        return work_of(abstraction, self.problem, self.rank)


def expected_gain(gain: float, finer: float, next_finer: float) -> float:
    """Return what a level will gain, ``next_finer`` times as fine as the last, which gained this ``finer`` than before.

    What cells lose goes with the square of their width.
    """
    return gain * (1.0 - next_finer**-2) / (finer**2 - 1.0)


def _cells_text(abstraction: Abstraction) -> str:
    """Return the cells of the agents, in words."""
    shapes = dict.fromkeys(" x ".join(map(str, model.grid.shape)) for model in abstraction.models)
    return f"{', '.join([*shapes][:MOST_SHAPES])}{', ...' if len(shapes) > MOST_SHAPES else ''} cells"


MOST_SHAPES = 3
"""Shapes of cells that are told."""


def _widest(problem: Problem, shapes: dict[str, tuple[int, ...]]) -> float:
    """Return the width of the widest cells, in standard deviations of the noise and as axes are weighted."""
    widths = []
    for agent in problem.agents:
        deviations = deviations_of(agent)
        cell = (agent.state_high - agent.state_low) / np.array(shapes[agent.name]) / deviations
        widths.append(np.max(cell * axis_weights(agent)))
    return float(max(widths))


def level_cells(problem: Problem, width: float) -> dict[str, tuple[int, ...]]:
    """Return the cells of every agent, about ``width`` standard deviations wide."""
    return {agent.name: _cells(problem, i, agent, width) for i, agent in enumerate(problem.agents)}


def _cells(problem: Problem, i: int, agent: AnyAgent, width: float) -> tuple[int, ...]:
    """Return cells per axis of about ``width`` standard deviations; equal ones, if boundaries allow for them."""
    span, deviations = agent.state_high - agent.state_low, deviations_of(agent)
    numbers = []
    for k in range(agent.n_states):
        wanted = max(FEWEST, float(span[k]) / (width * float(deviations[k])))
        low, high = float(agent.state_low[k]), float(agent.state_high[k])
        inside = sorted({b for b in region_boundaries(problem, i, k) if low < b < high})
        unit = equal_parts(low, high, inside, MOST_PARTS)
        if unit is None:
            number = max(len(inside) + 1, round(wanted))
        else:
            number = unit * max(1, round(wanted / unit))
        numbers.append(min(MOST_PER_AXIS, number))
    return tuple(numbers)


def work_of(abstraction: Abstraction, problem: Problem, rank: int | None = None) -> float:
    """Return an estimate of the work of a level: two sweeps, and an evaluation, in units of ``Effort``.

    It is counted from sizes alone, so that it is the same on every machine. ``rank`` is the number of terms of the
    value function; left out, what two agents are expected to have.
    """
    if rank is None:
        rank = 1 if problem.n_agents == 1 else GUESSED_RANK
    n_states = int((~problem.automaton.absorbing).sum())
    sweeps = 1.0 if problem.n_agents == 1 or n_states == 1 else TEAM_SWEEPS
    total, seen = 0.0, Counter[int]()
    for model in abstraction.models:
        places, points = model.kernel.shape, model.kernel.lattice_shape
        # Smoothing: one axis after the other, each lattice point meeting the cells within reach of the noise.
        size, smoothing = float(math.prod(places)), 0.0
        for axis, table in enumerate(model.kernel.tables):
            stored = sum(entries.size for *_, entries in table.blocks)
            size = size / places[axis] * points[axis]
            smoothing += size * stored / points[axis]
        reading = model.grid.n_cells * (1.0 + rank / TERMS_OF_A_READING)
        if model.choices.has_corners:
            # Agents that are alike have equal factors as a rule, which are smoothed once.
            lattice = 0.0 if seen[id(model)] else math.prod(points) / DIFFERENCES_PER_SECOND
            # Each further axis has more neighbours of lattice points and cells; rates are those of two axes.
            more = PER_AXIS ** max(0, len(points) - 2)
            # Where trees have a single term they are read once, too; that does not change what pairs get.
            if n_states > 1 or rank > 1 or seen[id(model)] < PAIR:
                total += more * sweeps * rank * (lattice + model.grid.n_cells / MAPS_PER_SECOND)
            seen[id(model)] += 1
            continue
        if not model.is_additive:
            total += READINGS * rank * math.prod(points) / LATTICE_PER_SECOND
        total += rank * smoothing / MULTIPLICATIONS_PER_SECOND + READINGS * reading / model.choices.read_per_second
    return count_of_decisions(problem) * total
