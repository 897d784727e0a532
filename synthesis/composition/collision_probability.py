"""How likely pairs of agents are to be near each other, or not near, under policies on grids: upper bounds.

For agents with the relation ``exact`` the next state is ``z + w``, z the lattice point of the cell and w the noise,
both agents' noises independent and Gaussian. So the difference of two agents at lattice points z, z' is near with the
probability of a box under a normal law of variance ``sigma^2 + sigma'^2``, one table per axis: cells enter nowhere.

The mass of the undecided runs is a sum of products over agents, one term per way through the *modes*: automaton states
among which no agent's policy makes a difference. A mode goes on to another by the products of everything that may lead
there, so nothing is left out (docs/theory/pairs.md, "The mass of undecided runs").
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ...envs.systems.arguments import counted
from ...envs.tasks.problem import Problem
from ...envs.tasks.regions import PairRegion
from ..abstraction.models import JointModel, Policies
from ..certificates.value_functions import Guards
from ..relations.grids import FloatArray, RelationRefused
from .compared_states import compared_axes, marginal

Ends = tuple[float, float]
"""Ends of a box along one axis."""

MOST_TERMS = 300
"""Products of the mass at one time beyond which the bound would take too long."""

WIDER = 1e-9
"""By how many deviations boxes are made wider: far more than the rounding of differences, far less than matters."""

TABLE_ERROR = 1e-14
"""Added to every entry of a table of probabilities: above the error of the special function by far."""

DIFFERENCE_ERROR = 1e-13
"""Added where a mass is the difference of two: far above their rounding."""

INFLATION, SPARE = 1.0 + 1e-7, 1e-10
"""Factor on the whole, and what is added per pair, so that a second evaluation that rounds otherwise finds no more."""


@dataclass(frozen=True, eq=False, repr=False)
class Term:
    """A product of the mass of undecided runs at one time.

    Parameters
    ----------
    mode : int
    cells : tuple of (S_i,) arrays
        Mass of each agent in its cells.
    """

    mode: int
    cells: tuple[FloatArray, ...]

    def __repr__(self) -> str:
        return f"Term({counted(len(self.cells), 'agent')} in mode {self.mode})"


class CollisionProbability:
    """Masses and pair probabilities of one problem, for any policies.

    Parameters
    ----------
    problem : Problem
        The problem with its pairs.
    base : Problem
        The same without them (``base.without_pairs``).
    joint : JointModel
        Finite models of ``base``.
    relevant : (Q, number of pairs) bool array
        Which pairs the automaton asks about in each state.
    usual : (number of pairs,) bool array
        What each proposition is taken to be in ``base``: the mass is that of all runs in which one is otherwise.
    """

    def __init__(
        self,
        problem: Problem,
        base: Problem,
        joint: JointModel,
        relevant: NDArray[np.bool_],
        usual: NDArray[np.bool_],
    ) -> None:
        self.problem, self.base, self.joint, self.relevant, self.usual = problem, base, joint, relevant, usual
        self.pairs = problem.labeling.pairs
        for pair in self.pairs:
            compared_axes(problem, pair)  # refuses what the tables could not say
        self._tables: dict[object, list[FloatArray]] = {}

    @cached_property
    def alive(self) -> NDArray[np.int64]:
        """Automaton states in which something is left to decide."""
        return np.flatnonzero(~self.joint.absorbing)

    def modes(self, policies: Policies) -> list[NDArray[np.int64]]:
        """Return the undecided automaton states in groups among which no policy makes a difference."""
        groups: dict[tuple[bytes, ...], list[int]] = {}
        for q in self.alive:
            groups.setdefault(tuple(policy[:, q].tobytes() for policy in policies), []).append(int(q))
        return [np.array(states) for states in groups.values()]

    def start(self, modes: Sequence[NDArray[np.int64]]) -> list[Term]:
        """Return the mass at time 0, the first letter read without pairs; none if the task is decided then."""
        q, agents = self.base.initial_q, zip(self.joint.models, self.base.agents, strict=True)
        shares = [model.share(agent.initial.low, agent.initial.high) for model, agent in agents]
        if q is not None:
            return [Term(m, tuple(shares)) for m, states in enumerate(modes) if q in states]
        # Starts of several letters, or none inside: each mode has the cells that some guard of the start leads to.
        initial, terms = np.array([self.base.automaton.initial]), []
        for m, states in enumerate(modes):
            way = self.passage(initial, states, (self.joint.start_guards, self.joint.start_masks))
            if way is not None:
                factors = tuple(np.where(open_, own, 0.0) for own, open_ in zip(shares, way, strict=True))
                terms += [Term(m, factors)] if all(own.any() for own in factors) else []
        return terms

    def passage(
        self, source: NDArray[np.int64], target: NDArray[np.int64], reading: tuple[Guards, Any] | None = None
    ) -> list[NDArray[np.bool_]] | None:
        """Return, per agent, the cells of which some may lead from one mode to another; None if no guard does.

        ``reading`` has the guards and their masks: those of arriving if it is not given.
        """
        guards, all_masks = (self.joint.guards, self.joint.masks) if reading is None else reading
        used = np.flatnonzero(np.isin(guards.source, source) & np.isin(guards.target, target))
        if not len(used):
            return None
        passages = []
        for masks, rows in zip(all_masks, guards.mask[used].T, strict=True):
            passages.append(np.asarray(np.any(masks[np.unique(rows)] != 0, axis=0)))
        return passages

    def course(self, policies: Policies) -> tuple[list[list[Term]], list[list[list[FloatArray]]]]:
        """Return the terms of the mass at times 0 .. T - 1, and where each of them moves: lattice points (Z_i,).

        Raises
        ------
        RelationRefused
            If there are too many terms.
        """
        modes, models = self.modes(policies), self.joint.models
        ways = {(m, n): self.passage(modes[m], modes[n]) for m in range(len(modes)) for n in range(len(modes))}
        terms, all_terms, all_points = self.start(modes), [], []
        for t in range(self.joint.horizon):
            following, points = [], list[list[FloatArray]]()
            for term in terms:
                q = int(modes[term.mode][0])
                steps = [model.choices.points(policy[t, q]) for model, policy in zip(models, policies, strict=True)]
                known = list(zip(models, term.cells, steps, strict=True))
                points.append([_gathered(model.lattice, own, to) for model, own, to in known])
                propagated = [model.kernel.propagate(own[None], to)[0] for model, own, to in known]
                for n in range(len(modes)):
                    if (way := ways[term.mode, n]) is not None:
                        masked = tuple(np.where(open_, own, 0.0) for own, open_ in zip(propagated, way))
                        following += [Term(n, masked)] if all(own.any() for own in masked) else []
            all_terms.append(terms)
            all_points.append(points)
            if len(following) > MOST_TERMS:
                raise RelationRefused(f"the mass of undecided runs has more than {MOST_TERMS} products")
            terms = following
        return all_terms, all_points

    def bound(self, policies: Policies) -> float:
        """Return an upper bound on the probability that a pair is not as usual while the task is open and asks for it.

        Open is a task that was undecided at the step before. The sum over steps and pairs may exceed 1.
        """
        if self.unusual_at_start >= 1.0:
            return 1.0
        modes = self.modes(policies)
        asked = [self.relevant[states].any(axis=0) for states in modes]
        near = self.unusual_at_start
        for terms, points in zip(*self.course(policies), strict=True):
            for term, lattice_masses in zip(terms, points, strict=True):
                near += self._near(np.flatnonzero(asked[term.mode]), lattice_masses)
        # What kernels lost on the way may be near, once for each agent.
        lost = self.joint.horizon * sum(model.kernel.loss for model in self.joint.models)
        return float(near) * INFLATION + SPARE * len(self.pairs) + lost * INFLATION

    @cached_property
    def unusual_at_start(self) -> float:
        """Upper bound on the probability that a pair that the initial state asks about is not as usual at the start."""
        starts = [agent.initial for agent in self.problem.agents]
        asked = np.flatnonzero(self.relevant[self.problem.automaton.initial])
        if all(start.is_point for start in starts):
            letter = self.problem.labeling.letter([start.low for start in starts])
            return float(np.any((letter[self.problem.labeling.first_pair :] != self.usual)[asked]))
        total = 0.0
        for k in asked:
            pair = self.pairs[k]
            first, second = starts[pair.first], starts[pair.second]
            box, sign = (pair.inner_box, -1.0) if self.usual[k] else ((pair.low, pair.high), 1.0)
            near = 1.0
            for a, b, low, high in zip(*compared_axes(self.problem, pair), *box, strict=True):
                ends = (first.low[a], first.high[a]), (second.low[b], second.high[b])
                near *= _uniformly_between(*ends, float(low), float(high), sign)
            total += 1.0 - near if self.usual[k] else near
        return total

    def _near(self, asked: NDArray[np.int64], masses: Sequence[FloatArray]) -> float:
        """Return the sum over the pairs ``asked`` of the mass of a term in which they are not as usual after a step."""
        totals = np.array([own.sum() for own in masses])
        if not np.all(totals > 0.0):
            return 0.0
        total = 0.0
        spread: dict[object, FloatArray] = {}
        for k in asked:
            pair = self.pairs[k]
            i, j = pair.first, pair.second
            tables = self.tables(pair, bool(self.usual[k]))
            # Equal agents have one table, by which the second agent is spread once for all of its pairs that compare
            # the same of its states.
            axes_i, axes_j = compared_axes(self.problem, pair)
            key = (j, id(tables), tuple(axes_j))
            if key not in spread:
                spread[key] = _along(tables, marginal(masses[j], self.joint.models[j].lattice, axes_j))
            own = marginal(masses[i], self.joint.models[i].lattice, axes_i)
            near = float(np.sum(own * spread[key]))
            if self.usual[k]:  # whatever is not surely near is charged
                near = max(0.0, float(totals[i] * totals[j]) - near) + DIFFERENCE_ERROR
            total += near * float(np.prod(np.delete(totals, [i, j])))
        return total

    def tables(self, pair: PairRegion, from_below: bool = False) -> list[FloatArray]:
        """Return bounds (Z_i, Z_j), per axis, on the probability that the agents are near from lattice points.

        They are upper bounds, or lower ones if they are asked for.
        """
        i, j = pair.first, pair.second
        agents = self.problem.agents
        axes = compared_axes(self.problem, pair)
        lattices = [
            (self.joint.models[i].lattice[a], self.joint.models[j].lattice[b]) for a, b in zip(*axes, strict=True)
        ]
        spreads = [
            math.sqrt(agents[i].noise_covariance[a, a] + agents[j].noise_covariance[b, b]) for a, b in zip(*axes)
        ]
        low, high = pair.inner_box if from_below else (pair.low, pair.high)
        box = (from_below, low.tobytes(), high.tobytes(), tuple(spreads))
        key = (*box, *(x.tobytes() for both in lattices for x in both))
        if key not in self._tables:
            boxes = zip(lattices, spreads, zip(low.tolist(), high.tolist(), strict=True), strict=True)
            table = _surely_near_table if from_below else _near_table
            self._tables[key] = [table(a, b, std, ends) for (a, b), std, ends in boxes]
        return self._tables[key]


def _uniformly_between(
    first: tuple[float, float], second: tuple[float, float], low: float, high: float, sign: float
) -> float:
    """Return ``P(low <= x - y <= high)`` for x and y uniform on two intervals, up to rounding.

    The box is made wider (``sign`` 1) or narrower (-1) by what the rounding of a difference can move.
    """
    wider = sign * WIDER * (sum(map(abs, (*first, *second))) + abs(low) + abs(high))
    low, high = low - wider, high + wider
    (a, b), (c, d) = first, second
    if d - c < b - a:  # turn the difference round: the second interval is the wider one
        (a, b), (c, d) = (-d, -c), (-b, -a)
    if c == d:
        return float(low <= a - c <= high)

    def below(z: float) -> float:
        # The share of x below y + z grows with y, from 0 at a - z to 1 at b - z.
        left, right = np.clip([a - z, b - z], c, d)
        rising = np.clip((np.array([left, right]) + (z - a)) / (b - a), 0.0, 1.0).mean() if right > left else 0.0
        return float((d - right) + (right - left) * rising) / (d - c)

    return max(0.0, below(high) - below(low))


def _near_table(first: FloatArray, second: FloatArray, std: float, box: Ends) -> FloatArray:
    """Return upper bounds (Z, Z') on ``P(low <= z - z' + w < high)``, w of deviation ``std``."""
    mass = _between(first, second, std, box)
    return np.asarray(np.minimum(1.0, np.maximum(mass, 0.0) * (1.0 + 1e-12) + TABLE_ERROR))


def _surely_near_table(first: FloatArray, second: FloatArray, std: float, box: Ends) -> FloatArray:
    """Return lower bounds (Z, Z') on the same."""
    mass = _between(first, second, std, box, -1.0)
    return np.asarray(np.maximum(0.0, np.minimum(mass, 1.0) * (1.0 - 1e-12) - TABLE_ERROR))


def _between(first: FloatArray, second: FloatArray, std: float, box: Ends, sign: float = 1.0) -> FloatArray:
    """Return the probability (Z, Z') of a box made wider (``sign`` 1) or narrower (-1) by a little."""
    low, high = box
    gap = first[:, None] - second[None]
    wider = sign * (WIDER * std + 1e-14 * (np.abs(first).max() + np.abs(second).max() + abs(low) + abs(high)))
    upper, lower = (high + wider - gap) / std, (low - wider - gap) / std
    # The difference of the tails that are small: of the upper ones where the box lies above the mean.
    return np.asarray(np.where(lower > 0.0, ndtr(-lower) - ndtr(-upper), ndtr(upper) - ndtr(lower)))


def _gathered(lattice: Sequence[FloatArray], masses: FloatArray, points: NDArray[Any]) -> FloatArray:
    """Return the mass (Z,) on lattice points of masses (S,) that move to ``points`` (S,), -1 for none."""
    here = np.flatnonzero((points >= 0) & (masses > 0.0))
    size = math.prod(len(axis) for axis in lattice)
    return np.bincount(points[here], weights=masses[here], minlength=size)


def _along(tables: Sequence[FloatArray], tensor: FloatArray) -> FloatArray:
    """Return a tensor multiplied, along each axis, by a table (rows become the new axis)."""
    for axis, table in enumerate(tables):
        tensor = np.moveaxis(np.tensordot(table, tensor, axes=(1, axis)), 0, axis)
    return tensor
