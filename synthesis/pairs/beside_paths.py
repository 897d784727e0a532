"""How likely agents on grids are near agents along paths, or not near: upper bounds, one for each step and pair.

The position of an agent along a path is its nominal value, plus a normal number, plus a drift. So the difference of
both, at the lattice point z of the agent on a grid, is normal up to the drift, by which the box of the pair is made
wider. Where noise along the outputs that are compared is correlated, the density is below that of independent noise
which is larger, times the root of the quotient of the determinants; or the least of all outputs alone is taken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ...envs.agents import PairRegion
from ...envs.problem import Problem
from ..cells import FloatArray, RelationRefused
from ..models import JointModel
from .compared_states import compared_axes, marginal

WIDER = 1e-6
"""Share of itself by which a drift is made wider, and of a deviation by which a box is, for what the check rounds."""

LEAST_SHARE = 1e-6
"""Least determinant, as a share of the product of the variances, for which noise along outputs is taken together."""


@dataclass(frozen=True, eq=False)
class Marginals:
    """Outputs of an agent along its path: nominal values and drifts (S + 1, p), covariances (S + 1, p, p)."""

    outputs: FloatArray
    drifts: FloatArray
    covariances: FloatArray


@dataclass(frozen=True, eq=False)
class _Between:
    """A pair of agent i on a grid (its number there) and one along a path; ``sign`` 1 where the former is first."""

    number: int
    i: int
    sign: float
    axes: list[int]
    outputs: list[int]
    along: Marginals
    low: FloatArray
    high: FloatArray
    usual: bool


class BesidePaths:
    """Charges for pairs of agents on grids and agents along paths, for any policies on grids.

    Parameters
    ----------
    problem : Problem
        The whole problem.
    on_grids : tuple of int
        Agents on grids.
    marginals : mapping from agent to Marginals
        Of all others.
    usual : (number of pairs,) bool array
    asked : (Q, number of pairs) bool array
        Which pairs may be asked for in each state of the task on grids.
    """

    def __init__(
        self,
        problem: Problem,
        on_grids: Sequence[int],
        marginals: dict[int, Marginals],
        usual: NDArray[np.bool_],
        asked: NDArray[np.bool_],
    ) -> None:
        self.problem, self.asked, self.pairs = problem, asked, list[_Between]()
        for k, pair in enumerate(problem.labeling.pairs):
            first_on_grid, second_on_grid = pair.first in on_grids, pair.second in on_grids
            if first_on_grid == second_on_grid:
                continue
            self.pairs.append(_between(problem, on_grids, marginals, (k, pair), bool(usual[k])))
        self._tables: dict[tuple[int, int], FloatArray] = {}

    def charge(self, time: int, states: NDArray[np.int64], masses: Sequence[FloatArray], joint: JointModel) -> float:
        """Return an upper bound on the mass of a term in which pairs are not as usual at a time.

        Parameters
        ----------
        time : int
            Time after the step.
        states : array of int
            Automaton states of the term.
        masses : sequence of (Z_i,) arrays
            Mass of each agent on the lattice points that it moves to.
        joint : JointModel
        """
        totals = np.array([own.sum() for own in masses])
        asked = np.any(self.asked[states], axis=0)
        if not np.all(totals > 0.0):
            return 0.0
        total = 0.0
        for place, pair in enumerate(self.pairs):
            if asked[pair.number]:
                model = joint.models[pair.i]
                if (place, time) not in self._tables:
                    lattices = [model.lattice[a] for a in pair.axes]
                    self._tables[place, time] = self._table(pair, time, lattices, noisy=True)
                own = marginal(masses[pair.i], model.lattice, pair.axes)
                near = float(np.sum(own * self._tables[place, time]))
                total += near * float(np.prod(totals)) / totals[pair.i]
        return total

    def thinned(self, i: int, joint: JointModel, usual: FloatArray | None) -> FloatArray | None:
        """Return the chance (T + 1, S) that pairs of agent i are as usual, times that for others, if there is one."""
        model = joint.models[i]
        for pair in (pair for pair in self.pairs if pair.i == i):
            usual = np.ones((joint.horizon + 1, model.n_cells)) if usual is None else usual
            middles = [0.5 * (edges[1:] + edges[:-1]) for edges in model.grid.edges]
            for time in range(1, joint.horizon + 1):
                table = self._table(pair, time, [middles[a] for a in pair.axes], noisy=False)
                order = np.argsort(pair.axes)
                shape = [n if k in pair.axes else 1 for k, n in enumerate(model.grid.shape)]
                spread = np.broadcast_to(table.transpose(order).reshape(shape), model.grid.shape)
                usual[time] *= np.maximum(0.0, 1.0 - spread.reshape(-1))
        return usual

    def _table(self, pair: _Between, time: int, places: Sequence[FloatArray], noisy: bool) -> FloatArray:
        """Return upper bounds (Z_1, ..) on being near, or not, from places of the agent on a grid."""
        covariance = pair.along.covariances[time][np.ix_(pair.outputs, pair.outputs)]
        centre, drift = pair.along.outputs[time, pair.outputs], pair.along.drifts[time, pair.outputs]
        if noisy:
            agent = self.problem.agents[self._agent(pair)]
            covariance = covariance + np.diag([agent.noise_covariance[a, a] for a in pair.axes])
        else:  # the agent on a grid is somewhere in its cell
            covariance = covariance + np.diag([np.var([x[0], x[1]]) / 3.0 if len(x) > 1 else 0.0 for x in places])
            covariance = covariance + 1e-18 * np.eye(len(drift))
        p, ends = len(places), []
        std = np.sqrt(np.diag(covariance))
        for k, x in enumerate(places):
            gap = pair.sign * (x - centre[k])
            wider = drift[k] * (1.0 + WIDER) + WIDER * std[k] + 1e-12 * (np.abs(x).max() + abs(centre[k]) + 1.0)
            wider = -wider if pair.usual else wider
            ends.append((pair.low[k] - wider - gap, pair.high[k] + wider - gap))
        shapes = [[-1 if k == j else 1 for j in range(p)] for k in range(p)]
        alone = [_inside(a / s, b / s).reshape(shape) for (a, b), s, shape in zip(ends, std, shapes, strict=True)]
        if pair.usual:  # not near along one of the outputs
            return np.minimum(1.0, sum((1.0 - np.minimum(part, 1.0) for part in alone), np.zeros(()))) * np.ones(
                [len(x) for x in places]
            )
        least = alone[0]
        for part in alone[1:]:
            least = np.minimum(least, part)
        above = np.diag(covariance) + np.sum(np.abs(covariance), axis=1) - np.diag(covariance)
        share = float(np.linalg.det(covariance)) / float(np.prod(np.diag(covariance)))
        if share > LEAST_SHARE:
            together = np.full((), math.sqrt(float(np.prod(above)) / (share * float(np.prod(np.diag(covariance))))))
            for (a, b), s, shape in zip(ends, np.sqrt(above), shapes, strict=True):
                together = together * _inside(a / s, b / s).reshape(shape)
            least = np.minimum(least, together)
        return np.asarray(np.minimum(1.0, least))

    def _agent(self, pair: _Between) -> int:
        """Return the number of the agent on a grid in the whole problem."""
        region = self.problem.labeling.pairs[pair.number]
        return region.first if pair.sign > 0.0 else region.second


def _between(
    problem: Problem,
    on_grids: Sequence[int],
    marginals: dict[int, Marginals],
    numbered: tuple[int, PairRegion],
    usual: bool,
) -> _Between:
    """Return a pair with what is known of its agents; raise RelationRefused where the bound does not know it."""
    k, pair = numbered
    first = pair.first in on_grids
    side, i, j = (0, pair.first, pair.second) if first else (1, pair.second, pair.first)
    if not problem.agents[i].initial.is_point or not problem.agents[j].initial.is_point:
        raise RelationRefused("pairs of a mixed team need known starts, got one drawn from a box")
    if problem.agents[j].laws is not None or not problem.agents[j].has_plain_noise:
        raise RelationRefused(f"agent `{problem.agent_names[j]}`: pairs of a mixed team need noise by its covariance")
    axes = compared_axes(problem, pair, (side,))[side]
    if len({*axes}) < len(axes):
        raise RelationRefused("a pair of a mixed team compares a state twice")
    low, high = pair.inner_box if usual else (pair.low, pair.high)
    outputs = list(pair.outputs[1 - side])
    return _Between(k, list(on_grids).index(i), 1.0 if first else -1.0, axes, outputs, marginals[j], low, high, usual)


def _inside(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the probability that a standard normal number lies between two numbers; 0 where there is none."""
    mass = np.where(low > 0.0, ndtr(-low) - ndtr(-high), ndtr(high) - ndtr(low))
    return np.asarray(np.maximum(mass, 0.0))
