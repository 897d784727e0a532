"""Value iteration: at every vertex a good input that is much like its neighbours', and values by the checker's backup.

Inputs are chosen for values that nothing is taken off from. Bounds themselves are no guide: where they are low for what
is charged, inputs would lead away on either side, and between both sides more is charged.

What is charged grows with the square of how far inputs of neighbours move the next state, in deviations of the noise.
So inputs maximise mean values less such squares. They stay as they are one step later where that loses little: what
they lead to is computed once.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.distributions import Law
from ....envs.tasks.problem import Problem
from ...certificates.controllers import interpolated
from ...certificates.proofs import Certificate, NotCanonicalError, Synthesis, VertexProof, canonical_problem
from ...checker import CheckedProblem, Refused, Unreadable, followed, read_problem, value_on
from ...extended_check.vertex_grids import (
    FARTHEST,
    NEAR,
    Backups,
    Images,
    Noise,
    corners_of,
    hats_at,
    images_at,
    names_time,
    vertices_of,
)
from ...relations.grids import FloatArray, RelationRefused
from ...trajectories.planning import CountedWork
from .axis_edges import grid_of, spreads_of

INPUTS = {1: 9, 2: 5, 3: 3}
"""Values of each input that are tried, by the number of inputs; between them means are interpolated."""

APART = 0.1
"""What inputs of neighbours cost that lead one deviation of the noise apart: the square of it, in probability."""

SWEEPS = 20
"""How often inputs are adjusted to those of their neighbours."""

FINE_SIZES = 0.4
"""Logarithm of the ratio of sizes of the noise between which means are interpolated, at most."""

FINE_CELLS = 0.7
"""Deviations that cells are wide at least where means are interpolated between the middle of a cell and its ends."""

ONCE = 1e-3
"""Work of anything that is done once in an automaton state and a step, however few vertices there are."""

READ = 6e-7
"""Work of a mean that is read, in core seconds."""

SAME = 5e-3
"""A law that is known acts where new inputs take off at most this share of the failure at any vertex."""

SAME_PASSING = 0.1
"""The same where runs that pass there lose at most this share of the failure that is hoped for, over all steps."""

AIMS = 0.01, 1e-3
"""Failure that the first grid aims at, unless no more is hoped for: laws that lose little beside it are not made anew.
Later ones aim at a share of what the grid before failed by."""

LEFT_OUT, LEAST_NEAR = 1e-3, 4.0
"""Share of the failure that noise may have which is not looked at, in all steps, and deviations that always are."""

MOST_TRIED = 40
"""Known laws that are tried, the newest ones."""

MOST_STATES = 4
"""States up to which there is such a grid."""

FIRST = {1: 60, 2: 400, 3: 1200, 4: 2000}
"""Vertices of the first grid, by the number of states."""

FINER_STEPS, MOST_FINER, POOR = np.array([5.0, 4.2, 3.5, 3.0, 2.5, 2.2, 1.9, 1.7, 1.5]), 3e4, 0.03
"""How many times as many vertices the next grid has, as the work allows: the most, and 2.5 below a failure of POOR."""

NO_DIFFERENCE = 1e-11
"""Differences of means that count as none."""

GROWS = 1.45
"""Power of the number of vertices with which work grows, about."""

WEIGHT, PRODUCT = 6e-8, 4.5e-11
"""Work of a weight of a plane or an interval, and of a weight times a number of a table, in core seconds."""

RUNS, QUANTILE, BESIDE = 3000, 1e-3, 6.0
"""Runs that say where the next grid has narrow cells, the share of states that may lie beyond, and by how many
deviations it is wider than that."""

COARSE = 1.0, 2.5
"""How many times as many vertices as the first grid coarse ones have."""

MOST_ADJUSTED = 0.5, 2.0
"""By how much the share of cells of an axis changes from one grid to the next, at most."""

ENOUGH = 1e-6
"""Failure from which no finer grid is tried."""

WIDE = 1.5
"""Deviations from which on a cell is wide: values are continuous across it."""

CLAIMED = 1.0 + 1e-5
"""Factor on the failure that is claimed: other machines add in another order, in single precision where values bend."""

NARROW, MOST_NARROW = 2.0, 5e4
"""Deviations of the noise that a cell is as wide as, and the most cells so wide that a workspace may have."""

GAINS = 0.02
"""Share of the failure that the last grid has to have taken off for a finer one to be tried, once there is a bound."""


def refuse_vertex_grid(problem: Problem) -> None:
    """Raise RelationRefused where there is no such grid: several agents, more states, other noise."""
    agent = problem.agents[0]
    if problem.n_agents > 1:
        raise RelationRefused("grids of vertices are of one agent")
    if agent.n_states > MOST_STATES or agent.n_inputs not in INPUTS:
        raise RelationRefused(f"grids of vertices have {MOST_STATES} states and {max(INPUTS)} inputs at most")
    try:
        checked = read_problem({"problem": canonical_problem(problem)})
        steps = Backups(
            checked,
            tuple(np.array(box) for box in checked.agents[0].state_box.T),
            (True,) * agent.n_states,
            NEAR,
            agent.laws,
        )
        len(steps.noises)
    except (Refused, Unreadable, NotCanonicalError) as reason:
        raise RelationRefused(str(reason)) from reason
    low, high = checked.agents[0].state_box
    cells = float(np.prod((high - low) / (NARROW * spreads_of(checked)).mean(axis=1)))
    if cells > MOST_NARROW:
        raise RelationRefused(f"the noise is small: {cells:.2g} cells of a grid would be as wide as it")


def _per_cell(d: int) -> float:
    """Return products of a cell with another one: its mean and all that F may bend."""
    return 2.0**d * (1.0 + 4.0 * d + 4.5 * d * (d - 1))


def vertex_grid_certificate(problem: Problem, work: CountedWork) -> Synthesis:
    """Return the certificate of the best grid that the work allows; RelationRefused where there is none."""
    refuse_vertex_grid(problem)
    began = time.perf_counter()
    best, levels = _refined(problem, work)
    certificate = Certificate(problem, best, {"relation": "vertex grid", "levels": levels})
    seconds = {"abstract": 0.0, "synthesize": time.perf_counter() - began}
    unknown = dict.fromkeys(("abstract_upper_bound", "continuous_upper_bound", "unilateral_gain"))
    stats: dict[str, Any] = {"seconds": seconds, "rank": 1, "sweeps": [], "starts": {}, "dropped": 0.0, **unknown}
    return Synthesis(certificate, certificate.controller, stats)


def _refined(problem: Problem, work: CountedWork) -> tuple[VertexProof, dict[str, float]]:
    """Return the best proof on finer and finer grids, and the bound of each of them."""
    checked, noise_laws = read_problem({"problem": canonical_problem(problem)}), problem.agents[0].laws
    spreads, vertices = spreads_of(checked), float(FIRST[problem.agents[0].n_states])
    alive = _alive(checked, grid_of(checked, spreads, round(vertices), checked.agents[0].state_box))
    best, levels, finer = None, dict[str, float](), np.ones(len(spreads))
    try:
        runs = _coarse(checked, noise_laws, vertices, alive, work)
        hoped, aim = runs.failure, AIMS[0]
        while True:
            window = _within(alive, runs.window(checked, spreads))
            edges = grid_of(checked, spreads, round(vertices), window, finer)
            runs.failure = max(hoped, aim)
            steps = Counted(checked, edges, jumps_of(checked, edges), NEAR, noise_laws).within(work)
            steps.near = _near(steps, runs.failure)
            inputs, laws, failure = iterated(steps, runs)
            levels[" x ".join(str(len(axis) - 1) for axis in edges)] = 1.0 - failure
            # Axes along which more is charged get more cells: what is charged falls with the square of their number.
            finer *= np.clip(np.sqrt(steps.bent / np.exp(np.log(steps.bent).mean())), *MOST_ADJUSTED)
            runs, aim = _Runs.of(steps, inputs, laws, hoped), min(aim, AIMS[1] * failure)
            slow = best is not None and best.failure < 1.0 and failure > (1.0 - GAINS) * best.failure
            if best is None or failure < best.failure:
                best = VertexProof(edges, inputs, laws, steps.jumps, steps.near, min(1.0, failure * CLAIMED))
                work.tell(failure)
            each = FINER_STEPS if failure > POOR else FINER_STEPS[FINER_STEPS <= 2.5]
            more = next(
                (own for own in each if work.allows(steps.spent * min(own, MOST_FINER / vertices) ** GROWS)), None
            )
            if failure < ENOUGH or slow or more is None or vertices >= MOST_FINER:
                break
            vertices = min(vertices * float(more), MOST_FINER)
    except KeyboardInterrupt:
        if best is None or best.failure >= 1.0:
            raise
        work.is_interrupted = True
    except BrokenOff:
        pass
    if best is None or best.failure >= 1.0:
        raise RelationRefused(
            f"nothing is proved on grids of {', '.join(levels) or 'few'} cells; ask for more `effort`"
        )
    return best, levels


def _coarse(
    problem: CheckedProblem, noise_laws: Sequence[Law] | None, vertices: float, alive: FloatArray, work: CountedWork
) -> _Runs:
    """Return runs under coarse values, which nothing is charged for."""
    spreads, window, runs = spreads_of(problem), alive, None
    for more in COARSE:
        edges = grid_of(problem, spreads, round(vertices * more), window)
        steps = Counted(problem, edges, jumps_of(problem, edges), NEAR, noise_laws).within(work)
        inputs, laws, failure = iterated(steps, runs, is_coarse=True)
        if failure >= 1.0:
            raise RelationRefused("no inputs lead anywhere on coarse grids: is the task out of reach?")
        runs = _Runs.of(steps, inputs, laws, failure)
        window = _within(alive, runs.window(problem, spreads))
    assert runs is not None
    return runs


def _near(steps: Backups, failure: float) -> float:
    """Return how many deviations of the noise are looked at: what is left out is little beside a failure."""
    problem = steps.problem
    sides = 4.0 * len(problem.agents[0].states) * problem.horizon
    reach = [noise.reach(LEFT_OUT * failure / sides) for noise in steps.noises if noise is not None]
    return float(np.clip(max(reach, default=NEAR), LEAST_NEAR, FARTHEST))


def jumps_of(problem: CheckedProblem, edges: tuple[FloatArray, ...]) -> tuple[bool, ...]:
    """Return along which axes cells are so narrow, for the noise there, that jumps of values cost little."""
    agent, at = problem.agents[0], vertices_of(edges)
    middle = np.repeat(agent.input_box.mean(axis=0)[None], at.shape[1], axis=0)
    sizes = np.abs(images_at(agent, at, middle, 0)[0][len(at) :])
    return tuple(
        bool(np.median(np.diff(axis)) < WIDE * np.nanmedian(own)) for axis, own in zip(edges, sizes, strict=True)
    )


def iterated(
    steps: Counted, runs: _Runs | None, is_coarse: bool = False
) -> tuple[FloatArray, NDArray[np.int64], float]:
    """Return tables of inputs (L, V, m), which one acts at what time and automaton state (T, Q), and the failure.

    ``runs`` say where inputs matter. ``is_coarse``: nothing is charged, and the failure is hoped for.
    """
    problem, choice = steps.problem, _Choice(steps, runs)
    bounds, given_up = steps.at_end()
    values, nowhere = steps.at_end()
    laws = np.zeros((problem.horizon, len(values)), dtype=np.int64)
    for t in range(problem.horizon - 1, -1, -1):
        laws[t], values = choice.of(values, t, laws[min(t + 1, problem.horizon - 1)])
        if not is_coarse:
            bounds, given_up = steps.backup(bounds, given_up, np.stack([choice.laws[k] for k in laws[t]]), t)
    failure = steps.failure(*((values, nowhere) if is_coarse else (bounds, given_up)))
    return np.stack(choice.laws), laws, failure


class BrokenOff(Exception):
    """Seconds are over in the middle of a grid."""


class Counted(Backups):
    """Backups that count their work, in core seconds."""

    spent = 0.0
    work = CountedWork()

    def within(self, work: CountedWork) -> Self:
        """Count for a search."""
        self.work = work
        return self

    def count(self, work: float) -> None:
        """Count work; raise BrokenOff where what was found so far has to do."""
        self.spent += work
        self.work.count(work)
        if self.work.is_broken_off():
            raise BrokenOff

    def __post_init__(self) -> None:
        super().__post_init__()
        self.bent = np.full(len(self.edges), 1e-300)  # what is charged along each axis where values are high

    def image_of(self, inputs: FloatArray, t: int) -> Images:
        """Return where inputs (V, m) lead at a time."""
        images = super().image_of(inputs, t)
        self.count(WEIGHT * images.size)
        return images

    def below(self, W: FloatArray, images: Images) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return numbers at vertices of a function that is at most F, and the cells on which it is 0."""
        self.count(ONCE + PRODUCT * (images.vertices.products + _per_cell(W.ndim) * images.products))
        values, nothing = super().below(W, images)
        here = np.where(nothing, 0.0, corners_of(values, W.ndim).reshape(*nothing.shape, -1).mean(axis=-1)).ravel()
        self.bent = self.bent + self._bends @ here
        return values, nothing

    def charge(self, W: FloatArray, images: Images) -> tuple[FloatArray, FloatArray]:
        """Return what is taken off all corners of each cell (S,), and what F may bend along each axis (d, S)."""
        always, self._bends = super().charge(W, images)
        return always, self._bends


class _Choice:
    """Inputs at all vertices of a grid, in shares of their ranges, and values under them: good guesses, no bounds.

    Means around points of a lattice are sums along one axis after the other, for some sizes of the noise; in between
    they are interpolated.
    """

    def __init__(self, steps: Counted, runs: _Runs | None) -> None:
        self.steps, self.runs, agent = steps, runs, steps.agent
        self.at, self.m = vertices_of(steps.edges), len(agent.inputs)
        self.low, high = agent.input_box
        self.range, self.count = np.maximum(high - self.low, 1e-300), INPUTS[self.m]
        self.axis = np.linspace(0.0, 1.0, self.count)
        tried = np.stack(np.meshgrid(*[self.axis] * self.m, indexing="ij"), axis=-1).reshape(-1, self.m)
        self.tried = self.low + tried * (high - self.low)
        # laws (V, m) so far, the first one in the middle, and of which inputs that are tried they are means
        self.laws, self.between = list[FloatArray](), list[tuple[NDArray[np.int64], FloatArray]]()
        self._add(np.full((self.at.shape[1], self.m), 0.5))
        self.known: tuple[int, tuple[_Reading, FloatArray]] | None = None
        # Every vertex and the next one along each axis, both ways, and how many neighbours it has.
        axes, every = range(len(steps.edges)), slice(None)
        ways = [tuple(side if j == k else every for j in axes) for k in axes for side in (slice(1, None), slice(-1))]
        self.beside = [(ways[i], ways[i ^ 1]) for i in range(len(ways))]
        count = np.zeros([len(axis) for axis in steps.edges])
        for _, here in self.beside:
            count[here] += 1.0
        self.neighbours = count.ravel()
        # Widths of the cells beside a vertex.
        widths = [np.diff(axis) for axis in steps.edges]
        beside = [np.concatenate([own[:1], np.maximum(own[1:], own[:-1]), own[-1:]]) for own in widths]
        self.widths = np.stack(np.meshgrid(*beside, indexing="ij")).reshape(len(beside), -1)

    def of(self, values: FloatArray, t: int, later: NDArray[np.int64]) -> tuple[NDArray[np.int64], FloatArray]:
        """Return which law acts in each automaton state (Q,), from those a step later, and values (Q, n_1 + 1, ..)."""
        automaton = self.steps.problem.automaton
        which, result = later.copy(), np.zeros_like(values)
        alike, nothing = dict[bytes, list[int]](), np.zeros((len(values), *self.steps.shape), bool)
        for q in np.flatnonzero(self.steps.reached[t]).tolist():
            if automaton.is_co_safe and automaton.accepting[q]:
                result[q] = 1.0
            else:
                W = self.steps.after_letter(values, nothing, q, t + 1)
                alike.setdefault(W.tobytes(), []).append(q)
        shape = tuple(2 * n for n in self.steps.shape)
        for numbers, states in alike.items():
            W = np.frombuffer(numbers).reshape(shape)
            law, means = self._adjusted(W, t, later[states], self._passing(t, states))
            which[states], result[states] = law, means.reshape(values.shape[1:])
        return which, result

    def _passing(self, t: int, states: Sequence[int]) -> FloatArray:
        """Return the share of runs that pass by each vertex (V,) at a time, in some automaton states."""
        result = np.zeros(self.at.shape[1])
        if self.runs is not None:
            here = self.runs.states[t][:, np.isin(self.runs.q[t], states)]
            each = [
                np.rint(np.interp(x, axis, np.arange(len(axis))))
                for x, axis in zip(here, self.steps.edges, strict=True)
            ]
            places = np.ravel_multi_index([own.astype(int) for own in each], [len(axis) for axis in self.steps.edges])
            np.add.at(result, places, 1.0 / RUNS)
        return result

    def _adjusted(self, W: FloatArray, t: int, later: NDArray[np.int64], passing: FloatArray) -> tuple[int, FloatArray]:
        """Return a law for values one step later, and means under it: a known one where that loses little."""
        reading, apart = self._images(t)
        table = reading.means(W).reshape(*[self.count] * self.m, -1)
        self.steps.count(READ * table.size + ONCE)
        known = list(dict.fromkeys([*later.tolist(), *range(len(self.laws))[:-MOST_TRIED:-1]]))
        means = self._under(table, known)
        # The best inputs of all vertices without regard to neighbours are no worse than those that are looked for.
        law = self._alike(table.reshape(-1, table.shape[-1]).max(axis=0), means, passing)
        if law is None:
            shares = self._best(table)
            for _ in range(SWEEPS):
                shares = 0.5 * shares + 0.5 * self._swept(table, shares, APART * apart)
            worth = self._read(table, shares)
            law = self._alike(worth, means, passing)
        if law is None:
            self._add(shares)
            return len(self.laws) - 1, worth
        return known[law], means[law]

    def _alike(self, worth: FloatArray, means: FloatArray, passing: FloatArray) -> int | None:
        """Return which of some means (K, V) loses least, if that is little."""
        loss = worth - means
        # what is lost everywhere, and what runs lose that pass there, with those that none of them has seen
        little = np.all(loss <= SAME * (1.0 - worth) + NO_DIFFERENCE, axis=1)
        lost = loss @ passing + loss.max(axis=1) / RUNS
        if self.runs is not None:
            failure = max(self.runs.failure, SAME_PASSING * ENOUGH)
            little |= lost <= SAME_PASSING * failure / self.steps.problem.horizon
        return int(np.where(little, lost, np.inf).argmin()) if little.any() else None

    def _add(self, shares: FloatArray) -> None:
        """Add a law, and where it is between inputs that are tried."""
        self.laws.append(np.clip(self.low + shares * self.range, *self.steps.agent.input_box))
        place = np.minimum((shares * (self.count - 1)).astype(int), self.count - 2)
        part, index, weight = shares * (self.count - 1) - place, [], []
        for corner in itertools.product((0, 1), repeat=self.m):
            index.append(np.ravel_multi_index((place + corner).T, (self.count,) * self.m))
            weight.append(np.prod(np.where(corner, part, 1.0 - part), axis=1))
        self.between.append((np.stack(index), np.stack(weight)))

    def _under(self, table: FloatArray, laws: Sequence[int]) -> FloatArray:
        """Return means (K, V) under some of the laws."""
        flat, at = table.reshape(-1, table.shape[-1]), np.arange(table.shape[-1])
        each = [np.sum(weight * flat[index, at], axis=0) for index, weight in (self.between[k] for k in laws)]
        return np.stack(each)

    def _best(self, table: FloatArray) -> FloatArray:
        places = np.unravel_index(table.reshape(-1, table.shape[-1]).argmax(axis=0), table.shape[:-1])
        return np.stack([self.axis[own] for own in places], axis=1)

    def _read(self, table: FloatArray, shares: FloatArray, but: int = -1) -> FloatArray:
        """Return means (V,), or (count, V) for all values of one input, interpolated at the others' shares (V, m)."""
        table = table if but < 0 else np.moveaxis(table, but, -2)
        for j in range(self.m):
            if j != but:
                place = np.minimum((shares[:, j] * (self.count - 1)).astype(int), self.count - 2)
                part, at = shares[:, j] * (self.count - 1) - place, np.arange(len(place))
                # the axis of this input is the first that is left
                table = (1.0 - part) * table[place, ..., at].T + part * table[place + 1, ..., at].T
        return table

    def _swept(self, table: FloatArray, shares: FloatArray, cost: FloatArray) -> FloatArray:
        """Return the best shares (V, m) beside those of neighbours, each input on its own; squares cost (V, m)."""
        shape, result = tuple(len(axis) for axis in self.steps.edges), np.empty_like(shares)
        step = self.axis[1]
        for j in range(self.m):
            means, own = self._read(table, shares, j), shares[:, j].reshape(shape)
            total = np.zeros(shape)
            for there, here in self.beside:
                total[here] += own[there]
            total, count = total.ravel(), self.neighbours
            # Means are linear between inputs that are tried: on each piece a parabola, whose top is known.
            slopes = np.diff(means, axis=0) / step
            with np.errstate(all="ignore"):
                top = (total + 0.5 * slopes / cost[:, j]) / count
            top = np.where(np.isfinite(top), top, shares[:, j])
            best = np.clip(top, self.axis[:-1, None], self.axis[1:, None])
            worth = means[:-1] + slopes * (best - self.axis[:-1, None])
            worth = worth - cost[:, j] * (count * best**2 - 2.0 * total * best)
            result[:, j] = np.take_along_axis(best, worth.argmax(axis=0)[None], axis=0)[0]
        return result

    def _images(self, t: int) -> tuple[_Reading, FloatArray]:
        """Return readings at images of all inputs that are tried, and squares (V, m) of how far inputs lead apart."""
        steps, agent, n = self.steps, self.steps.agent, self.at.shape[1]
        if self.known is None or (names_time(agent) and self.known[0] != t):
            images = [images_at(agent, self.at, np.repeat(own[None], n, axis=0), t)[0] for own in self.tried]
            d, apart = len(self.at), np.zeros((n, self.m))
            sizes = np.maximum(np.abs(np.nan_to_num(images[len(images) // 2][d:])), self.widths)
            for j in range(self.m):
                moved = self.count ** (self.m - 1 - j) * (self.count - 1)
                way = np.abs(images[moved][:d] - images[0][:d]) / sizes
                apart[:, j] = np.nan_to_num(way.max(axis=0)) ** 2
            self.known = t, (_Reading(np.concatenate(images, axis=1), steps.edges, steps.noises), apart)
        return self.known[1]


class _Reading:
    """Means of values around images (2 d, N), means first and sizes after: no bounds."""

    def __init__(self, images: FloatArray, edges: tuple[FloatArray, ...], noises: Sequence[Noise | None]) -> None:
        d, noisy = len(edges), [noise is not None for noise in noises]
        y, sizes = np.nan_to_num(images[:d]), np.nan_to_num(np.abs(images[d:]))
        self.smoothing, places, parts = list[FloatArray](), list[NDArray[np.int64]](), list[FloatArray]()
        for k, axis in enumerate(edges):
            # Sizes of the noise, as many as their range asks for, and points of a lattice, beyond the edges, too.
            least, most = max(sizes[k].min(), 1e-9), max(sizes[k].max(), 1e-9)
            levels = np.geomspace(least, most, 1 + math.ceil(math.log(most / least) / FINE_SIZES))
            away = np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0]) * most * noisy[k]
            # where cells are wide, in the middle of them, too
            middles = (0.5 * axis[1:] + 0.5 * axis[:-1])[np.diff(axis) > FINE_CELLS * least]
            lattice = np.unique(np.concatenate([axis[0] - away, axis, middles, axis[-1] + away]))
            self.smoothing.append(np.stack([_hats(lattice, axis, own, noises[k]) for own in levels]))
            for numbers, points in ((np.log(np.maximum(sizes[k], 1e-9)), np.log(levels)), (y[k], lattice)):
                below = np.clip(np.searchsorted(points, numbers, side="right") - 1, 0, max(len(points) - 2, 0))
                above = np.minimum(below + 1, len(points) - 1)
                width = np.maximum(points[above] - points[below], 1e-300)
                places.append(np.stack([below, above]))
                share = np.clip((numbers - points[below]) / width, 0.0, 1.0) * (above > below)
                parts.append(np.stack([1.0 - share, share]))
            # without noise what is beyond the edges is lost
            parts[-1] *= noisy[k] | ((axis[0] <= y[k]) & (y[k] <= axis[-1]))
        self.shape = tuple(n for own in self.smoothing for n in own.shape[:2])
        # Of all corners those that any image has a share of.
        self.corners = []
        for corner in itertools.product((0, 1), repeat=2 * d):
            weight = math.prod(part[c] for part, c in zip(parts, corner, strict=True))
            if np.any(weight):
                place = np.ravel_multi_index([own[c] for own, c in zip(places, corner, strict=True)], self.shape)
                self.corners.append((place, weight))

    def means(self, W: FloatArray) -> FloatArray:
        """Return means (N,) of numbers (2 n_1, ..) at both ends of all intervals."""
        table = W
        for k, own in enumerate(self.smoothing):
            # (.., 2 n_k, ..) -> (.., sizes, points, ..)
            table = np.moveaxis(np.tensordot(own, table, axes=(2, 2 * k)), (0, 1), (2 * k, 2 * k + 1))
        flat = table.ravel()
        return np.sum([weight * flat[place] for place, weight in self.corners], axis=0)


def _hats(points: FloatArray, axis: FloatArray, size: float, noise: Noise | None) -> FloatArray:
    """Return weights (N, 2 n) of both ends of all intervals: those of noise, or of the cell a point is in."""
    if noise is not None:
        return hats_at(points, np.full(len(points), size), axis, noise)[0]
    # at an edge both cells count
    either = [hats_at(own, own, axis, None)[0] for own in (points, np.nextafter(points, -np.inf))]
    return 0.5 * either[0] + 0.5 * either[1]


@dataclass(eq=False)
class _Runs:
    """Runs under inputs (sampled, fixed seed): states (T + 1, d, M), automaton states, and a failure to aim at."""

    states: FloatArray
    q: NDArray[np.int64]
    failure: float

    @classmethod
    def of(cls, steps: Backups, inputs: FloatArray, laws: NDArray[np.int64], failure: float) -> _Runs:
        problem, edges = steps.problem, steps.edges
        agent, automaton = problem.agents[0], problem.automaton
        rng, d = np.random.default_rng(20261127), len(agent.states)
        low, high = agent.state_box
        x = rng.uniform(agent.start[0][:, None], agent.start[1][:, None], (d, RUNS))
        q = _followed(problem, np.full(RUNS, automaton.initial), x, 0)
        states, each = [x], [q]
        for t in range(problem.horizon):
            u = interpolated(edges, inputs[laws[t]], x, q).T
            centre, _ = images_at(agent, x, u, t)
            drawn = [
                own if noise is None else noise.drawn(own)
                for noise, own in zip(steps.noises, rng.standard_normal((d, RUNS)), strict=True)
            ]
            x = np.clip(centre[:d] + np.abs(centre[d:]) * drawn, low[:, None], high[:, None])
            q = _followed(problem, q, x, t + 1)
            states.append(x)
            each.append(q)
        return cls(np.stack(states), np.stack(each), failure)

    def window(self, problem: CheckedProblem, spreads: FloatArray) -> FloatArray:
        """Return a window (2, d) of states in which nearly all runs stay."""
        low, high = problem.agents[0].state_box
        ends = np.quantile(self.states, [QUANTILE, 1.0 - QUANTILE], axis=(0, 2))
        beside = BESIDE * np.median(spreads, axis=1)
        return np.stack([np.maximum(ends[0] - beside, low), np.minimum(ends[1] + beside, high)])


def _within(outer: FloatArray, inner: FloatArray) -> FloatArray:
    return np.stack([np.maximum(outer[0], inner[0]), np.minimum(outer[1], inner[1])])


def _alive(problem: CheckedProblem, edges: tuple[FloatArray, ...]) -> FloatArray:
    """Return the least box (2, d) with all cells whose letters do not lose the task at once."""
    steps, dead = Backups(problem, edges, (True,) * len(edges)), problem.automaton.dead()
    values, nothing = steps.at_end()
    values[:] = np.reshape(~np.array(dead), (-1, *(1,) * len(edges)))
    moves = any(np.any(end != end[0]) for own in problem.regions for end in (own.low, own.high))
    times, states = range(problem.horizon + 1 if moves else 1), np.flatnonzero(~np.array(dead)).tolist()
    each = [steps.after_letter(values, nothing, q, t) for q in states for t in times]
    held, box = np.max(each, axis=0) > 0.0, problem.agents[0].state_box.copy()
    for k, axis in enumerate(edges):
        some = np.flatnonzero(np.any(held, axis=tuple(j for j in range(len(edges)) if j != k)))
        if len(some):
            box[:, k] = axis[some[0] // 2], axis[some[-1] // 2 + 1]
    return box


def _followed(problem: CheckedProblem, q: NDArray[Any], x: FloatArray, t: int) -> NDArray[Any]:
    """Return automaton states (M,) after the letters of states x (d, M)."""
    agent, automaton = problem.agents[0], problem.automaton
    names = {name: np.stack([row, row]) for name, row in zip(agent.states, x, strict=True)}
    held = np.ones((len(problem.regions), x.shape[1]), dtype=bool)
    for p, region in enumerate(problem.regions):
        for column, output in enumerate(region.outputs[0]):
            y = value_on(agent.outputs[output], names)[0]
            held[p] &= (region.low[t, column] <= y) & (y < region.high[t, column])
    result = q.copy()
    for letter, state in itertools.product(np.unique(held, axis=1).T, np.unique(q)):
        here = (q == state) & np.all(held == letter[:, None], axis=0)
        if here.any():
            (result[here],) = followed(automaton, [int(state)], dict(enumerate(letter.tolist())))
    return result
