"""An upper bound for *all* policies of the continuous system: nobody does better, with whatever controller.

Every agent is relaxed as in ``relaxation``, and everything that the finite model leaves open is decided in its favour:
the mean of the next state may be any in the smallest box around those that some admissible input
leads to; the letter is the best of all that occur in the cell, at the start as well; outside the workspace a run has
failed.

Values are multilinear in every cell, from above, with numbers at its corners (*places*, see ``corners``). With g(m) =
E V(m + w) and M(x) the box of means from x, the value one step earlier is f(x) = sup g over M(x). If m* is the best
mean from x, then ``m* + A (c_j - x)`` is one from the corner c_j of its cell, and interpolation between these means is
off by at most the *bend* of g around m* (``second_derivatives``, for -g). So with the largest bend B around each point,

    f(x)  <=  sum_j lambda_j sup over M(c_j) of (g + B) ,

which is of second order in the size of cells. The supremum over a box is taken over the points of a lattice around it;
its steps are among those that g bends along. Where the supremum over all means of a cell, a constant, has the smaller
mean, that is taken (docs/theory/bounds.md, "Upper bounds, and of what"). By the induction of ``relaxation`` the product
of the agents' values bounds every joint policy, centralised ones with any memory included: ``continuous upper bound``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from ....envs.systems.agents import AnyAgent, LinearAgent, with_matrices
from ....envs.tasks.problem import Problem
from ...abstraction.kernels import Kernel, SecondDerivativeBounds, hat_table
from ...abstraction.models import AgentModel, JointModel
from ...certificates.value_functions import UNIT, Occupancy
from ...relations.grids import FloatArray, Grid, corner_sides, hat_share, spread, to_places
from ..ascent import favourable_successors

FAR_DEVIATIONS = 9.0
"""Standard deviations beyond the grid at which a mean may as well be there: less than 1e-18 comes back."""

MOST_LATTICE_POINTS = 4_000_000
"""Most lattice points of an agent; with more of them there is no bound."""

MOST_MULTIPLICATIONS, MOST_READ = 5e10, 2e7
"""Most multiplications of one agent, and most points of its lattice times steps: some ten core seconds each. With more
of them there is no bound: a task of hundreds of steps would wait for minutes for what its search has no use for."""

POINTS_PER_CELL = (2, 1)
"""Lattice points per cell and axis: the first number for which the lattice is not too large."""

NEGLIGIBLE = 1e-15
"""Share of the largest value that covers what comes back from far away, and the loss of the last sums."""


@dataclass(frozen=True, eq=False)
class Windows:
    """Boxes of lattice points: the flat index (N,) at which each begins, and the points per axis of all of them."""

    first: NDArray[np.int64]
    width: tuple[int, ...]

    def largest(self, table: FloatArray) -> FloatArray:
        """Return the largest number (N,) of a table (Z_1, ...) in each box."""
        # The maximum over a window is one over each axis in turn; the filter's origin makes windows begin at their
        # point instead of having it in their middle.
        for axis, width in enumerate(self.width):
            if width > 1:
                table = maximum_filter1d(table, width, axis=axis, mode="constant", cval=0.0, origin=-(width // 2))
        return np.asarray(table.ravel()[self.first])


@dataclass(frozen=True, eq=False)
class Optimist:
    """The finite model of one agent in which everything goes as well as it can.

    Parameters
    ----------
    grid : Grid
    kernel : Kernel
        From the points of its own lattice to the corners of cells.
    of_cells, of_corners : Windows
        Lattice points around all means from the points of each cell, and from each of its corners.
    between, across : Bends
        What suprema between lattice points may exceed those on them by, and, besides, values inside a cell the
        interpolation of those at its corners.
    around : tuple of int
        Lattice steps along each axis from a mean to those from the corners of the same cell.
    """

    grid: Grid
    kernel: Kernel
    of_cells: Windows
    of_corners: Windows
    between: SecondDerivativeBounds
    across: SecondDerivativeBounds
    around: tuple[int, ...]

    @classmethod
    def of(cls, agent: LinearAgent, model: AgentModel, rounds: int = 1) -> Optimist | None:
        """Return the optimistic model on the cells of ``model``; None if its lattice would be too large.

        ``rounds`` says how often it will be used: times the states of the automaton that are not settled.
        """
        for per_cell in POINTS_PER_CELL:
            optimist = cls._with(agent, model, rounds, per_cell)
            if optimist is not None:
                return optimist
        return None

    @classmethod
    def _with(cls, agent: LinearAgent, model: AgentModel, rounds: int, per_cell: int) -> Optimist | None:
        """Return the same with that many lattice points per cell and axis; None if they are too many."""
        grid = model.grid
        deviations = np.sqrt(np.diag(agent.noise_covariance))
        cells = _means(agent, grid.centres, grid.half_widths)
        sides = 2.0 * corner_sides(len(grid.shape)) - 1.0
        corners = (grid.centres[:, None] + grid.half_widths[:, None] * sides).reshape(-1, len(grid.shape))
        points = _means(agent, corners, np.zeros_like(corners))
        spacing = np.array([(e[-1] - e[0]) / ((len(e) - 1) * per_cell) for e in grid.edges])
        # From farther out hardly any mass comes back: means there are taken to the end of the lattice.
        near = [(e[0] - FAR_DEVIATIONS * s, e[-1] + FAR_DEVIATIONS * s) for e, s in zip(grid.edges, deviations)]
        low, high = np.array(near).T
        first = np.minimum(np.clip(cells[0], low, high).min(axis=0), low) - 2.0 * spacing
        counts = np.ceil((np.clip(cells[1], low, high).max(axis=0) - first) / spacing) + 3.0
        if np.prod(counts) > MOST_LATTICE_POINTS:  # before any axis of that length is made
            return None
        shape = tuple(int(count) for count in counts)
        read = rounds * math.prod(shape)
        if read > MOST_READ or read * 2.0 * sum(grid.shape) > MOST_MULTIPLICATIONS:
            return None
        lattice = tuple(a + h * np.arange(n) for a, h, n in zip(first.tolist(), spacing.tolist(), shape, strict=True))
        axes = zip(lattice, grid.edges, deviations.tolist(), strict=True)
        tables, losses = zip(*(hat_table(*axis) for axis in axes), strict=True)
        loss = float(sum(losses))
        steps = (agent.A * np.max([2.0 * half for half in grid.half_widths], axis=0)).T
        of_cells, of_corners = (
            _windows(np.clip(a, low, high), np.clip(b, low, high), first, spacing, shape) for a, b in (cells, points)
        )
        between, across = (
            SecondDerivativeBounds(rows, lattice, grid.edges, deviations, loss)
            for rows in (np.diag(spacing), np.concatenate([steps, np.diag(spacing)]))
        )
        around = tuple(int(n) + 1 for n in np.ceil(np.abs(steps).sum(axis=0) / spacing))
        return cls(grid, Kernel(tables, loss), of_cells, of_corners, between, across, around)

    def back(self, arriving: FloatArray) -> FloatArray:
        """Return upper bounds (2^d S,) on what a step leads to, from upper bounds (2^d S,) on what arriving is worth.

        Both are numbers at places: between them, bounds are multilinear in every cell.
        """
        values, most = self.kernel.backup(arriving[None]), float(arriving.max(initial=0.0))
        shape = self.kernel.lattice_shape
        bent = np.empty((2, 1, values.shape[1]))
        for second_derivatives, result in zip((self.between, self.across), bent, strict=True):
            second_derivatives.add_to(result, -values, arriving[None])
        across = bent[1].reshape(shape)
        for axis, reach in enumerate(self.around):
            across = maximum_filter1d(across, 2 * reach + 1, axis=axis, mode="nearest")
        operations = sum(self.kernel.shape) + 8 * len(shape)
        larger, more = 1.0 + 2 * operations * UNIT, (self.kernel.loss + NEGLIGIBLE) * most
        table = values.reshape(shape)
        constant = self.of_cells.largest(table + bent[0].reshape(shape)) * larger + more
        constant = np.minimum(constant, most)[:, None]
        corners = self.of_corners.largest(table + across).reshape(len(constant), -1) * larger + more
        # Single corners must not be lowered: the interpolation would fall below f inside the cell.
        best = np.where(corners.mean(axis=1, keepdims=True) <= constant, corners, constant)
        return to_places(best, self.grid.shape)


def _windows(
    low: FloatArray, high: FloatArray, first: FloatArray, spacing: FloatArray, shape: tuple[int, ...]
) -> Windows:
    """Return the lattice points around boxes of means (N, d), rounded outwards."""
    begin = np.floor((low - first) / spacing * (1 - 4 * UNIT)).astype(np.int64)
    end = np.ceil((high - first) / spacing * (1 + 4 * UNIT)).astype(np.int64)
    widths = (end - begin).max(axis=0) + 1
    return Windows(np.ravel_multi_index(tuple(begin.T), shape), tuple(int(width) for width in widths))


def continuous_upper_bound(problem: Problem, joint: JointModel, start: Occupancy) -> float | None:
    """Return an upper bound on what any policy of the continuous system attains from the start (mean over a box).

    None if the lattice of an agent would be too large, its dynamics are expressions, or its noise is not Gaussian.
    """
    values: list[FloatArray] = []
    begins: list[FloatArray] = []
    optimists: dict[object, Optimist | None] = {}
    computed: dict[object, FloatArray] = {}
    for agent, model, follows in zip(problem.agents, joint.models, favourable_successors(problem), strict=True):
        # Agents with equal dynamics and cells share the optimistic model; with equal letters, too, the values.
        possible = _possible(model, follows)
        if not agent.is_linear_gaussian or not agent.has_plain_noise:
            return None
        arrays = (agent.noise_covariance, agent.input_low, agent.input_high)
        alike = (id(model), *agent.motion_key, *(array.tobytes() for array in arrays))
        if alike not in optimists:
            optimists[alike] = Optimist.of(with_matrices(agent), model, joint.horizon * int(np.sum(~joint.absorbing)))
        optimist = optimists[alike]
        if optimist is None:
            return None
        key = (alike, possible.tobytes())
        if key not in computed:
            computed[key] = _values(joint, optimist, _at_places(possible, model.grid.shape))
        values.append(computed[key])
        at_places = _at_places(possible, model.grid.shape)
        begins.append(_arriving(computed[key], at_places, problem.automaton.initial))
    # The product over agents bounds the joint value (Proposition Bounds.3); sum it over the mass at the start. The
    # letter of a point is known, that of a cell of a box only where it has one.
    point = _is_point(problem)
    known = [np.ones(model.grid.n_cells) if point else _has_one_letter(model) for model in joint.models]
    hats = [_hats(*pair) for pair in zip(problem.agents, joint.models, strict=True)]
    total = 0.0
    for q, rows in enumerate(start.terms.index):
        for row in rows:
            triples = zip(joint.models, start.terms.factors, row, strict=True)
            # A point has one row, whatever side of a face its cell is looked up on.
            masses = [model.summed(factors[k]) for model, factors, k in triples]
            shares = [(mass > 0.0) | point for mass in masses]
            worth = zip(joint.models, shares, known, hats, values, strict=True)
            total += math.prod(
                float((spread(share * certain, model.grid.shape) * hat) @ value[q])
                for model, share, certain, hat, value in worth
            )
    unread = 0.0 if point else _unread(joint, known, hats, begins)
    n = sum(map(len, hats)) + len(values)
    return min(1.0, (total + unread) * (1.0 + 4.0 * n * UNIT) + 1e-12)


def _hats(agent: AnyAgent, model: AgentModel) -> FloatArray:
    """Return the mean hat of every place (2^d S,) of an agent's grid at its start."""
    return hat_share(model.grid, agent.initial.low, agent.initial.high)


def _at_places(possible: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return possible successors (Q, P, Q) of places from those of cells (Q, S, Q)."""
    return np.moveaxis(spread(np.moveaxis(possible, 1, 2), shape), 2, 1)


def _unread(joint: JointModel, known: list[FloatArray], hats: list[FloatArray], begins: list[FloatArray]) -> float:
    """Return an upper bound on what the start box is worth where some agent's letter is not known.

    There each agent reads the best letter of its cell. Of the agents whose letters are not known one is the first.
    """
    everywhere = [float(hat @ begin) for hat, begin in zip(hats, begins, strict=True)]
    sure = [spread(certain, model.grid.shape) for certain, model in zip(known, joint.models, strict=True)]
    total, before = 0.0, 1.0
    for i, (hat, certain, begin) in enumerate(zip(hats, sure, begins, strict=True)):
        total += before * float((hat * (1.0 - certain)) @ begin) * math.prod(everywhere[i + 1 :])
        before *= float((hat * certain) @ begin)
    return total


def _has_one_letter(model: AgentModel) -> FloatArray:
    """Return 1 for cells (S,) whose points all have one class and lie inside the workspace, 0 for others."""
    labels = model.start_labels
    single = np.append(labels.sets.sum(axis=1) == 1, False)  # the last entry is read by cells with label -1
    return single[labels.number].astype(float)


def _arriving(value: FloatArray, possible: NDArray[np.bool_], q: int) -> FloatArray:
    """Return upper bounds (P,) on what the best letter of each cell is worth that is read in state q, at places."""
    return np.asarray((possible[q].T * value).max(axis=0))


def _values(joint: JointModel, optimist: Optimist, possible: NDArray[np.bool_]) -> FloatArray:
    """Return upper bounds (Q, P) at time 0; ``possible[q, s, p]`` where a letter at place s can lead from q to p."""
    value = np.repeat(joint.accepting.astype(float)[:, None], possible.shape[1], axis=1)
    settled = value.copy()
    for _ in range(joint.horizon):
        # The best letter of each cell, inside the expectation.
        arriving = [_arriving(value, possible, q) for q in range(joint.n_states)]
        for q in range(joint.n_states):
            value[q] = settled[q] if joint.absorbing[q] else optimist.back(arriving[q])
    return value


def _possible(model: AgentModel, follows: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return successors (Q, S, Q) by the letters of the points of each cell; all of them where a cell is not known."""
    labels = model.start_labels
    # Cells with label -1 read the last set: every class.
    sets = np.concatenate([labels.sets, np.ones((1, labels.sets.shape[1]), dtype=bool)])
    return np.asarray(np.einsum("nc,qcp->qnp", sets.astype(np.int64), follows.astype(np.int64)) > 0)[:, labels.number]


def _means(agent: LinearAgent, centres: FloatArray, halves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return corners (S, d) of boxes around all means that the points of each cell can reach."""
    middle, reach = 0.5 * (agent.input_low + agent.input_high), 0.5 * (agent.input_high - agent.input_low)
    centre = centres @ agent.A.T + agent.offset + agent.B @ middle
    spread = halves @ np.abs(agent.A).T + np.abs(agent.B) @ reach
    slack = 1e-12 * (np.abs(centre) + spread + np.abs(centres) @ np.abs(agent.A).T)
    return centre - spread - slack, centre + spread + slack


def _is_point(problem: Problem) -> bool:
    """Return whether every agent starts at a point."""
    return all(np.array_equal(agent.initial.low, agent.initial.high) for agent in problem.agents)
