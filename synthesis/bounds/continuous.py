"""An upper bound for *all* policies of the continuous system: nobody does better, with whatever controller.

Every agent is relaxed as in ``relaxation``, and everything that the finite model leaves open is decided in its favour:

- the mean of the next state may be any that *some* point of the cell and *some* admissible input lead to, and any in
  the smallest box around these, in noise coordinates;
- the letter is the best of all that occur in the cell, at the start as well; outside the workspace a run has failed.

The supremum over a box of means is taken over the points of a lattice with spacing h. With V between 0 and M, the
expectation ``g(m) = E[V(m + w)]`` has ``|d2g/dm_k^2| <= (M/2) E|z^2 - 1| / sigma_k^2``, since the density's second
derivative integrates to 0; E|z^2 - 1| = 4 phi(1) for standard normal z. Linear interpolation is off by at most h^2/8
times that, axis after axis, so that

    sup over the box of g  <=  max over the lattice points around it of g  +  M sum_k (phi(1) / 4) (h_k / sigma_k)^2 .

This is the lemma in docs/theory/bounds.md, "Upper bounds, and of what". It is of second order in the spacing, where a
bound by total variation would be of first order. By the induction of ``relaxation`` the product of the agents' values
bounds every joint policy, centralised ones with any memory included: ``continuous upper bound``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from ...envs.agents import LinearAgent
from ...envs.problem import Problem
from ..cells import FloatArray, in_grid_coordinates
from ..models import AgentModel, JointModel, Kernel, gaussian_table
from ..search import favourable_successors
from ..values import UNIT, Occupancy, to_host

CURVATURE = 0.0604927
"""phi(1) / 4, rounded up."""

FAR_DEVIATIONS = 9.0
"""Standard deviations beyond the grid at which a mean may as well be there: less than 1e-18 comes back."""

MOST_LATTICE_POINTS = 4_000_000
"""Most lattice points of an agent; with more of them there is no bound."""

MOST_MULTIPLICATIONS = 1e12
"""Most multiplications of one agent, some minutes; with more of them there is no bound."""


@dataclass(frozen=True, eq=False)
class Optimist:
    """The finite model of one agent in which everything goes as well as it can.

    Parameters
    ----------
    kernel : Kernel
        From the points of its own lattice to the cells.
    first : (S,) int array
        Flat lattice point at which the window of each cell begins.
    width : tuple of int
        Lattice points per axis of a window, the same for all cells.
    excess : float
        Upper bound on what the supremum over all means exceeds the maximum over a window by, per unit of the largest
        value.
    """

    kernel: Kernel
    first: NDArray[np.int64]
    width: tuple[int, ...]
    excess: float

    @classmethod
    def of(cls, agent: LinearAgent, model: AgentModel, rounds: int = 1) -> Optimist | None:
        """Return the optimistic model on the cells of ``model``; None if its lattice would be too large.

        ``rounds`` says how often it will be used: times the states of the automaton.
        """
        grid, coordinates = model.grid, model.relation.coordinates
        deviations = np.sqrt(np.diag(in_grid_coordinates(agent, coordinates).covariance))
        low, high = _means(agent, grid.centres, grid.half_widths, coordinates)
        axes, firsts, widths, counts = [], [], [], list[int]()
        for k, (edges, deviation) in enumerate(zip(grid.edges, deviations, strict=True)):
            # From farther out hardly any mass comes back: means there are taken to the end of the lattice.
            near = edges[0] - FAR_DEVIATIONS * deviation, edges[-1] + FAR_DEVIATIONS * deviation
            a, b = np.clip(low[:, k], *near), np.clip(high[:, k], *near)
            spacing = (edges[-1] - edges[0]) / (len(edges) - 1)
            origin = float(a.min()) - spacing
            count = math.ceil((float(b.max()) - origin) / spacing) + 2
            counts.append(count)
            if math.prod(counts) > MOST_LATTICE_POINTS:  # before any axis of that length is made
                return None
            # The lattice points around the means of each cell, rounded outwards.
            begin = np.floor((a - origin) / spacing * (1 - 4 * UNIT)).astype(np.int64)
            end = np.ceil((b - origin) / spacing * (1 + 4 * UNIT)).astype(np.int64)
            axes.append(origin + spacing * np.arange(count))
            firsts.append(begin)
            widths.append(int((end - begin).max()) + 1)
        shape = tuple(len(axis) for axis in axes)
        if rounds * math.prod(shape) * sum(grid.shape) > MOST_MULTIPLICATIONS:
            return None
        # The kernel is a lower bound; what it misses is part of the excess.
        tables = [gaussian_table(z, e, float(s)) for z, e, s in zip(axes, grid.edges, deviations, strict=True)]
        spacings = np.array([axis[1] - axis[0] for axis in axes])
        kernel = Kernel(tuple(table for table, _ in tables), sum(loss for _, loss in tables))
        excess = CURVATURE * float(np.sum((spacings / deviations) ** 2)) * (1 + 1e-12) + kernel.loss + 1e-15
        return cls(kernel, np.ravel_multi_index(tuple(firsts), shape), tuple(widths), excess)

    def back(self, arriving: FloatArray) -> FloatArray:
        """Return upper bounds (S,) on what a step leads to, from upper bounds (S,) on what arriving is worth."""
        best = self.kernel.smooth(arriving[None])[0].reshape(self.kernel.lattice_shape)
        # The maximum over a window is one over each axis in turn; the filter's origin makes windows begin at their
        # point instead of having it in their middle.
        for axis, width in enumerate(self.width):
            if width > 1:
                best = maximum_filter1d(best, width, axis=axis, mode="constant", cval=0.0, origin=-(width // 2))
        operations = sum(self.kernel.shape) + 8 * len(self.width)
        largest = float(arriving.max(initial=0.0))
        bounds = best.ravel()[self.first] * (1 + 2 * operations * UNIT) + self.excess * largest
        return np.asarray(np.minimum(bounds, largest))


def continuous_upper_bound(problem: Problem, joint: JointModel, start: Occupancy) -> float | None:
    """Return an upper bound on what any policy of the continuous system attains from the start (mean over a box).

    None if the lattice of an agent would be too large.
    """
    values: list[FloatArray] = []
    begins: list[FloatArray] = []
    optimists: dict[object, Optimist | None] = {}
    computed: dict[object, FloatArray] = {}
    for agent, model, follows in zip(problem.agents, joint.models, favourable_successors(problem), strict=True):
        # Agents with equal dynamics and cells share the optimistic model; with equal letters, too, the values.
        possible = _possible(model, follows)
        arrays = (agent.A, agent.B, agent.offset, agent.noise_covariance, agent.input_low, agent.input_high)
        alike = (id(model), *(array.tobytes() for array in arrays))
        if alike not in optimists:
            optimists[alike] = Optimist.of(agent, model, joint.horizon * joint.n_states)
        optimist = optimists[alike]
        if optimist is None:
            return None
        key = (alike, possible.tobytes())
        if key not in computed:
            computed[key] = _values(joint, optimist, possible)
        values.append(computed[key])
        begins.append(_arriving(computed[key], possible, problem.automaton.initial))
    # The product over agents bounds the joint value (Proposition 3); sum it over the mass at the start. The letter of a
    # point is known, that of a cell of a box only where it has one.
    point = _is_point(problem)
    known = [np.ones(model.grid.n_cells) if point else _has_one_letter(model) for model in joint.models]
    total = 0.0
    for q, rows in enumerate(start.terms.index):
        for row in rows:
            triples = zip(joint.models, start.terms.factors, row, strict=True)
            shares = [model.summed(to_host(factors)[k]) for model, factors, k in triples]
            worth = zip(shares, known, values, strict=True)
            total += math.prod(float((share * certain) @ value[q]) for share, certain, value in worth)
    unread = 0.0 if point else _unread(problem, joint, known, begins)
    n = sum(joint.n_cells) + len(values)
    return min(1.0, (total + unread) * (1.0 + 4.0 * n * UNIT) + 1e-12)


def _unread(problem: Problem, joint: JointModel, known: list[FloatArray], begins: list[FloatArray]) -> float:
    """Return an upper bound on what the start box is worth where some agent's letter is not known.

    There each agent reads the best letter of its cell. Of the agents whose letters are not known one is the first.
    """
    pairs = zip(problem.agents, joint.models, strict=True)
    shares = [model.summed(model.share(agent.initial.low, agent.initial.high)) for agent, model in pairs]
    everywhere = [float(share @ begin) for share, begin in zip(shares, begins, strict=True)]
    total, before = 0.0, 1.0
    for i, (share, certain, begin) in enumerate(zip(shares, known, begins, strict=True)):
        total += before * float((share * (1.0 - certain)) @ begin) * math.prod(everywhere[i + 1 :])
        before *= float((share * certain) @ begin)
    return total


def _has_one_letter(model: AgentModel) -> FloatArray:
    """Return 1 for cells (S,) whose points all have one class and lie inside the workspace, 0 for others."""
    labels = model.start_labels
    single = np.append(labels.sets.sum(axis=1) == 1, False)  # the last entry is read by cells with label -1
    return single[labels.number].astype(float)


def _arriving(value: FloatArray, possible: NDArray[np.bool_], q: int) -> FloatArray:
    """Return upper bounds (S,) on what the best letter of each cell is worth that is read in state q."""
    return np.asarray((possible[q].T * value).max(axis=0))


def _values(joint: JointModel, optimist: Optimist, possible: NDArray[np.bool_]) -> FloatArray:
    """Return upper bounds (Q, S) at time 0; ``possible[q, s, p]`` where a letter in cell s can lead from q to p."""
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


def _means(
    agent: LinearAgent, centres: FloatArray, halves: FloatArray, coordinates: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return corners (S, d), in grid coordinates, of boxes around all means that the points of each cell can reach."""
    moves = in_grid_coordinates(agent, coordinates)
    middle, reach = 0.5 * (agent.input_low + agent.input_high), 0.5 * (agent.input_high - agent.input_low)
    centre = centres @ moves.A.T + moves.offset + moves.B @ middle
    spread = halves @ np.abs(moves.A).T + np.abs(moves.B) @ reach
    slack = 1e-12 * (np.abs(centre) + spread + np.abs(centres) @ np.abs(moves.A).T)
    return centre - spread - slack, centre + spread + slack


def _is_point(problem: Problem) -> bool:
    """Return whether every agent starts at a point."""
    return all(np.array_equal(agent.initial.low, agent.initial.high) for agent in problem.agents)
