"""Masses of cells, of hats and of nearness in balls: each number of a table is at most the true one."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from flint import arb
from numpy.typing import NDArray

from certigym.envs.systems.agents import AnyAgent
from certigym.synthesis.certificates.cell_probabilities import AgentRecord, axis_tables, kernel_key
from certigym.synthesis.relations.grids import CellAxis, FloatArray, MeanAxis, ScaleAxis, points_by_axis

from .ball_laws import ExactLaw
from .ball_memory import Memory, Proof
from .ball_spans import balls

LATEST = 10_000
"""Places whose tails are remembered."""


class Normal:
    """The normal law with a deviation that is a ball; tails near each other are read from one of them.

    With ``|h| <= 2^-31``, Q the tail and p the density, ``Q(c + h) = Q - p (h - c h^2 / 2)`` up to ``|D^2 p| |h|^3 /
    6`` in between, and ``p(c + h) = p (1 - c h + (c^2 - 1) h^2 / 2)`` up to ``|D^3 p| |h|^3 / 6``; p grows by less than
    twice.
    """

    def __init__(self, deviation: Any) -> None:
        self.deviation, self.known = deviation, dict[int, tuple[Any, Any, Any]]()
        self.latest = dict[int, tuple[Any, Any, Any]]()

    def _near(self, x: Any) -> tuple[Any, Any]:
        """Tail and density at ``|x|``, in deviations; the same ball is often asked about again."""
        if id(x) in self.latest:
            return self.latest[id(x)][1:]
        at = abs(x) / self.deviation
        number = round(math.ldexp(float(at), 30))
        if number not in self.known:
            c = arb(number) / 2**30
            self.known[number] = c, (c / arb(2).sqrt()).erfc() / 2, (-c * c / 2).exp() / (2 * arb.pi()).sqrt()
        c, tail, density = self.known[number]
        h = at - c
        square, end = h * h / 2, abs(h) + c
        off = (2 * density * abs(h) * square / 3).upper() * arb(0, 1)
        tail = tail - density * (h - c * square) + off * (end * end + 1)
        density = density * (1 - c * h + (c * c - 1) * square) + off * end * (end * end + 3)
        if len(self.latest) > LATEST:
            self.latest.clear()
        self.latest[id(x)] = x, tail, density  # x is kept, so that no other ball has its number
        return tail, density

    def sf_ball(self, x: Any) -> Any:
        """Probability of more than x."""
        tail = self._near(x)[0]
        if x > 0:
            return tail
        return 1 - tail if x < 0 else tail.union(1 - tail)

    def cdf_ball(self, x: Any) -> Any:
        """Probability of at most x."""
        return self.sf_ball(-x)

    def exact_mean(self, a: Any, b: Any) -> Any:
        """Expectation between a and b."""
        return self.deviation * (self._near(a)[1] - self._near(b)[1])


def _laws(agent: AnyAgent, part: AgentRecord) -> list[Any]:
    """The law of the noise along every grid axis; deviations of normal ones are balls."""
    if agent.laws is not None:
        return [ExactLaw(law) for law in agent.laws]
    return [Normal(variance.sqrt()) for variance in np.diag(balls(agent.noise_covariance))]


def masses(memory: Memory, agent: AnyAgent, part: AgentRecord, tables: Sequence[FloatArray]) -> Proof:
    """Masses of cells are below the truth, in all rows that a policy reads; how much rows lack is remembered."""
    key, used = kernel_key(agent, part), _used(part)
    points = points_by_axis(agent, part.lattice)
    total, failures = 0, []
    for k, (law, edges, table) in enumerate(zip(_laws(agent, part), part.grid.edges, tables, strict=True)):
        known = memory.rows.setdefault((key, k), set())
        asked = range(len(table)) if used is None else used[k].tolist()
        new = [row for row in asked if row not in known]
        known.update(new)
        if CellAxis(k) in points:
            wrong = [
                r for r in new if not np.array_equal(table[r], points[CellAxis(k)][r] == np.arange(len(edges) - 1))
            ]
            failures += ["a state without noise moves to another cell than its mean"] if wrong else []
            continue
        means = points[MeanAxis(k)].tolist()
        scales = [arb(x).exp() for x in points[ScaleAxis(k)].tolist()] if ScaleAxis(k) in points else [arb(1)]
        sides = [arb(edge) for edge in edges.tolist()]
        for row in new:
            scale, mean = scales[row // len(means)], arb(means[row % len(means)])
            count, deficit = _row(law, [(side - mean) / scale for side in sides], table[row].tolist())
            total += count
            if deficit is None:
                failures.append(f"a cell mass of agent `{agent.name}` along axis {k} was not proved")
                break
            memory.deficits[key, k] = max(memory.deficits.get((key, k), arb(0)), deficit.upper())
    return total, failures


def _used(part: AgentRecord) -> list[NDArray[np.int64]] | None:
    """Lattice points of every axis that policies read; None if they read between them."""
    if not part.is_additive:
        return None
    points = np.concatenate([np.unique(part.points(t, q)) for t in range(len(part.policy))
                             for q in range(part.policy.shape[1])])  # fmt: skip
    index = np.unravel_index(np.unique(points[points >= 0]), part.lattice_shape)
    return [np.unique(axis) for axis in index]


def _row(law: Any, x: Sequence[Any], row: Sequence[float]) -> tuple[int, Any]:
    """How many masses of a row are not 0, and what all of them lack; None if one may be above the truth."""
    tails, total, count = _Tails(law, x), arb(0), 0
    for s, mass in enumerate(row):
        if mass != 0.0:
            count, total = count + 1, total + mass
            if not mass <= tails.between(s, s + 1):
                return count, None
    return count, tails.between(0, len(x) - 1) - total


class _Tails:
    """Tails of a law at increasing places, computed when they are asked for, each on the side where it is small."""

    def __init__(self, law: Any, x: Sequence[Any]) -> None:
        self.law, self.x, self.known = law, x, dict[int, tuple[bool, Any]]()

    def _at(self, k: int) -> tuple[bool, Any]:
        if k not in self.known:
            right = bool(self.x[k] > 0)
            self.known[k] = right, self.law.sf_ball(self.x[k]) if right else self.law.cdf_ball(self.x[k])
        return self.known[k]

    def between(self, a: int, b: int) -> Any:
        """Probability between two places."""
        (first, left), (last, right) = self._at(a), self._at(b)
        if first == last:
            return left - right if first else right - left
        return 1 - left - right


def lost(memory: Memory, agent: AnyAgent, part: AgentRecord, value: float) -> Proof:
    """What rows of masses lack is no more than is said."""
    count, failures = masses(memory, agent, part, axis_tables(agent, part, {}))
    if not memory.missing(agent, part) <= value:
        failures.append(f"masses of agent `{agent.name}` lack more than is said")
    return count, failures


def hats(memory: Memory, agent: AnyAgent, part: AgentRecord, tables: Sequence[FloatArray], value: float) -> Proof:
    """Masses of both hats of every cell are below the truth, and rows lack no more than is said."""
    # Agents with equal noise and cells have equal tables.
    key = (kernel_key(agent, part), *(table.tobytes() for table in tables))
    if key in memory.hats:
        return 0, [] if memory.hats[key] <= value else [f"hats of agent `{agent.name}` lack more than is said"]
    count, missing = 0, arb(0)
    for law, edges, axis, table in zip(_laws(agent, part), part.grid.edges, part.lattice, tables, strict=True):
        sides, worst = [arb(edge) for edge in edges.tolist()], arb(0)
        widths = [b - a for a, b in itertools.pairwise(sides)]
        for mean, row in zip(axis.tolist(), table.reshape(len(axis), -1, 2).tolist(), strict=True):
            tails, x = _Tails(law, [side - arb(mean) for side in sides]), [side - arb(mean) for side in sides]
            whole = tails.between(0, len(x) - 1)
            for s, (left, right) in enumerate(row):
                if left == 0.0 and right == 0.0:
                    continue
                mass = tails.between(s, s + 1)
                above = (law.exact_mean(x[s], x[s + 1]) - x[s] * mass) / widths[s]
                count, whole = count + 2, whole - left - right
                if not ((left == 0.0 or left <= mass - above) and (right == 0.0 or right <= above)):
                    return count, [f"a mass of a hat of agent `{agent.name}` was not proved"]
            worst = max(worst, whole.upper())
        missing += worst
    memory.deficits[kernel_key(agent, part), 0] = memory.hats[key] = missing
    return count, [] if missing <= value else [f"hats of agent `{agent.name}` lack more than is said"]


def near(memory: Memory, points: Any, variances: Any, box: Any, from_below: bool, bounds: FloatArray) -> Proof:
    """Probabilities that two agents are near, with room for the rounding of their states and of the difference."""
    (mine, theirs), (low, high) = points, box
    law = Normal(sum((arb(own) for own in variances), arb(0)).sqrt())
    size = float(np.abs(mine).max() + np.abs(theirs).max() + abs(low) + abs(high))
    wider = arb(1e-14) * size * (-1 if from_below else 1)
    for z, row in zip(mine.tolist(), bounds.tolist(), strict=True):
        for other, bound in zip(theirs.tolist(), row, strict=True):
            gap = arb(z) - arb(other)
            if bound == (0.0 if from_below else 1.0):
                continue
            truth = _Tails(law, [low - wider - gap, high + wider - gap]).between(0, 1)
            if not (bound <= truth if from_below else truth <= bound):
                return bounds.size, ["a probability that two agents are near was not proved"]
    return bounds.size, []
