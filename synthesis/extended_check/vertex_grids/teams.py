"""Teams on grids whose vertices have inputs: a tree of products, one multilinear factor for each agent.

At time t and in automaton state q the value is a sum of products of factors f_i(x_i), each multilinear on the cells of
one agent, at least 0, and 0 outside of its grid. A factor is cut to the set of cells that a guard names, and taken one
step back by the agent's own backup (``backups``).

**Theorem.** Let guards and vertices be those of the checker's tree (``checker.tree``), and let no noise be shared. Then
the value at the start is at most the probability that the team satisfies the task, whatever disturbances do. *Proof.*
Given the joint state, and disturbances that may depend on all of it, next states of different agents are independent,
so the mean of a product is the product of the means. Each is at least what the backup of its factor leaves, which is at
least 0. Sums, guards and unions are those of the tree: ends of intervals take the place of cells, since least numbers
at corners, interpolated, are below the least function, and what is left of a factor is what is left at its corners.
Grids may be others at each time, outside of which factors are 0. QED

Guards name sets of *kinds*: rows of labels that cells have at any time, in the order of numbers.

Factors are scaled by powers of 2, so that the largest number of each is about 1: bounds on bends are in single
precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.distributions import Law
from ...checker import CheckedAgent, CheckedProblem, Refused
from ...checker.cells import spread, start_weights
from ...checker.expressions import names_in
from ...checker.intervals import up
from ...checker.motions import cell_labels
from ...checker.rigorous import Array, Truth, Whole
from ...checker.tree import Guards, Team, Tree, check_guards, value_at_start
from .backups import Backups, at_time, has_moving_regions, refuse_to_begin

SMALLEST = 2.0**-900  # factors that are nowhere larger count as 0


class Grid(Protocol):
    """The grid of one agent of a team (``VertexGrid``)."""

    @property
    def edges(self) -> tuple[Array, ...]:
        """Edges along each axis."""

    @property
    def inputs(self) -> Array:
        """Inputs (L, V, m) at vertices."""

    @property
    def laws(self) -> Whole:
        """Which of them acts (T, Q)."""

    @property
    def jumps(self) -> tuple[bool, ...]:
        """Along which axes values may jump."""

    @property
    def near(self) -> float:
        """Deviations that are looked at."""

    @property
    def window(self) -> Array | None:
        """Ends of a lattice, if there is one."""

    @property
    def matrix(self) -> Array | None:
        """Other coordinates, which teams have none of."""


def team_failure(
    problem: CheckedProblem,
    grids: Sequence[Grid],
    sets: tuple[Sequence[Truth], Sequence[Truth]],
    guards: tuple[Sequence[Whole], Sequence[Whole]],
    tree: Sequence[Whole],
    noise_laws: Sequence[Sequence[Law] | None],
) -> float:
    """Return an upper bound on the probability that a team fails; ``Refused`` if none follows.

    ``sets`` of kinds of cells (K, n) of each agent are those that guards name, of all steps and of time 0. ``guards``
    are tables of sources, targets and sets, of time 0 without sources; ``tree`` has vertices, unions, and what is kept.
    ``noise_laws`` are those of the sources of each agent, None where they are normal.
    """
    refuse_to_begin(problem)
    each = zip(grids, noise_laws, strict=True)
    steps = [steps_of(problem, i, grid, laws) for i, (grid, laws) in enumerate(each)]
    return float(up(1.0 - team_value(problem, steps, grids, sets, guards, tree)))


def steps_of(problem: CheckedProblem, i: int, grid: Grid, laws: Sequence[Law] | None) -> Backups:
    """Return backups of agent i on its grid; ``Refused`` where a team has none."""
    if grid.matrix is not None:
        raise Refused("grids of teams are of the states themselves")
    return Backups(alone(problem, i), grid.edges, grid.jumps, grid.near, laws, grid.window)


def alone(problem: CheckedProblem, i: int) -> CheckedProblem:
    """Return a problem that has agent i alone, and the regions that are its own; its automaton is that of the team.

    ``Refused`` where what others do matters to the agent, where it turns, or where pairs matter.
    """
    agent: CheckedAgent = problem.agents[i]
    if problem.pairs:
        raise Refused("the task is about pairs of agents, and grids of vertices are of single agents")
    if names_in((*agent.dynamics, *agent.scale)) & (agent.states_of_others.keys() | agent.inputs_of_others.keys()):
        raise Refused(f"the dynamics of `{agent.name}` name other agents")
    if agent.angles:
        raise Refused(f"`{agent.name}` has an angle, and grids of teams do not turn")
    mine = tuple(replace(region, agents=(0,)) for region in problem.regions if region.agents == (i,))
    return replace(problem, agents=(agent,), regions=mine)


def team_value(
    problem: CheckedProblem,
    steps: Sequence[Backups],
    grids: Sequence[Grid],
    sets: tuple[Sequence[Truth], Sequence[Truth]],
    guards: tuple[Sequence[Whole], Sequence[Whole]],
    tree: Sequence[Whole],
) -> float:
    """Return a lower bound on the probability that a team satisfies its task, by backups of each agent."""
    if not len(problem.agents) == len(grids) == len(sets[0]) == len(sets[1]):
        raise Refused("it has another number of grids than there are agents")
    every = problem.horizon, len(problem.automaton.accepting)
    for grid in grids:
        if grid.laws.shape != every or np.any((grid.laws < 0) | (grid.laws >= len(grid.inputs))):
            raise Refused("it does not say which law acts at every time and in every automaton state")
    # numbers below 0 would count from the end: of another state, or twice
    if any(np.any(own < 0) for own in (*guards[0], *guards[1], tree[0], tree[1][:, :5], tree[2])):
        raise Refused("a table of the tree, or of its guards, holds a number below 0")
    known = [kinds_of(problem, i, own) for i, own in enumerate(steps)]
    initial = np.full(len(guards[1][0]), problem.automaton.initial)
    both = Guards(*guards[0]), Guards(initial, *guards[1])
    for some, own in zip(both, sets, strict=True):
        if any(table.shape[1:] != (len(each.labels),) for table, each in zip(own, known, strict=True)):
            raise Refused("a set is none of the kinds of cells that an agent has")
        check_guards(problem.automaton, some, own, [(each.propositions, each.labels) for each in known])
    cells: list[Any] = []
    for agent, kinds, own, grid, now, first in zip(problem.agents, known, steps, grids, *sets, strict=True):
        kernel = VertexKernel(own, grid.inputs)
        start = kernel.spread(first[:, kinds.at(0)]) * start_weights(agent.start, own.edges_at(0), True)
        cells.append(VertexCells(kernel, now, kinds, grid.laws, start))
    return value_at_start(Team(problem.automaton, problem.horizon, cells, *both), Tree(*tree))


@dataclass(frozen=True, eq=False)
class Kinds:
    """Rows of labels (n, P) of some propositions that cells of an agent have, and which (T + 1 or 1, S) they have."""

    propositions: list[int]
    labels: NDArray[np.int8]
    which: Whole

    def at(self, t: int) -> Whole:
        """Return the kind (S,) of each cell at a time."""
        return self.which[min(t, len(self.which) - 1)]


def kinds_of(problem: CheckedProblem, i: int, steps: Backups) -> Kinds:
    """Return the kinds of cells of agent i."""
    mine, each = list[int](), list[NDArray[np.int8]]()
    for t in range(problem.horizon + 1 if steps.moves or has_moving_regions(problem) else 1):
        mine, labels = cell_labels(at_time(problem, t), i, steps.edges_at(t))
        each.append(labels)
    kinds, which = np.unique(np.concatenate(each), axis=0, return_inverse=True)
    return Kinds(mine, kinds, which.reshape(len(each), -1))


@dataclass(frozen=True, eq=False)
class VertexCells:
    """The cells of one agent, as the checker's tree asks for them."""

    kernel: VertexKernel
    sets: Truth
    kinds: Kinds
    laws: Whole
    start: Array

    def sets_at(self, t: int) -> Truth:
        """Return the sets (K, S) of cells at a time."""
        return np.asarray(self.sets[:, self.kinds.at(t)])

    def policy_at(self, t: int, q: int) -> Whole:
        """Return the time, and the law that acts in an automaton state."""
        return np.array([t, self.laws[t, q]])


@dataclass(frozen=True, eq=False)
class VertexKernel:
    """Backups of one agent, as the checker's tree asks for them: factors have numbers at both ends of all intervals."""

    steps: Backups
    tables: Array

    corners = True
    inputs = 1
    """Steps are not additive: of what is left of factors, a little less counts."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of cells along the axes."""
        return self.steps.shape

    @property
    def places(self) -> int:
        """How many numbers a factor has."""
        return int(np.prod([2 * n for n in self.shape]))

    def spread(self, sets: Truth) -> Truth:
        """Return sets (n, S) of cells at the places of factors."""
        own: Any = self
        return spread(sets, own)

    def values(self, factors: Array) -> Array:
        """Return the factors (n, places) themselves."""
        return factors

    def backup(self, values: Array, largest: Array, policy: Whole) -> Array:
        """Return factors (n, places) one step earlier, at most the truth; ``policy`` is a time and a law."""
        images = self.steps.images_of(self.tables[policy[1]], int(policy[0]))
        result = np.zeros_like(values)
        for row, factor, most in zip(result, values, largest.tolist(), strict=True):
            if most > SMALLEST:
                unit = 2.0 ** np.frexp(most)[1]
                below, nothing = self.steps.below((factor / unit).reshape([2 * n for n in self.shape]), images)
                row[:] = unit * self.steps.on_cells(below, nothing).ravel()
        return result
