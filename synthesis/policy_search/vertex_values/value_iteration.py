"""Value iteration: at every vertex the input whose mean value is largest, and values by the checker's own backup.

Means are quadratic near the best of some inputs, whose place is read off a parabola. Where inputs make no difference
they stay as they are one step later, so that neighbours agree. Inputs are chosen anew at some times before the end,
ever more rarely: in between they hardly change, and what they lead to is computed once.
"""

from __future__ import annotations

import itertools
import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...certificates.controllers import interpolated
from ...certificates.proofs import Certificate, NotCanonicalError, Synthesis, VertexProof, canonical_problem
from ...checker import CheckedProblem, Refused, Unreadable, followed, read_problem, value_on
from ...extended_check.vertex_grids import Backups, Images, contracted, images_at, names_time, vertices_of
from ...relations.grids import FloatArray, RelationRefused
from ...trajectories.planning import CountedWork
from .axis_edges import grid_of, spreads_of

INPUTS = {1: 9, 2: 5, 3: 3}
"""Values of each input that are tried, by the number of inputs."""

MOST_STATES = 4
"""States up to which there is such a grid."""

FIRST = {1: 60, 2: 900, 3: 1500, 4: 1500}
"""Vertices of the first grid, by the number of states."""

FINER_STEPS, MOST_FINER = np.array([2.5, 2.2, 1.9, 1.7, 1.5]), 20_000
"""How many times as many vertices the next grid has, as the work allows, and the most."""

ANEW = 1.35
"""Inputs are chosen anew when so many times more steps are left than when they were chosen last."""

NO_DIFFERENCE = 1e-11
"""Differences of means that count as none, over the whole range of an input."""

WEIGHT, PRODUCT = 1.2e-6, 1e-10
"""Work of a weight of a plane or an interval, and of a weight times a number of a table, in core seconds."""

RUNS, QUANTILE, BESIDE = 300, 1e-3, 6.0
"""Runs that say where the next grid has narrow cells, the share of states that may lie beyond, and by how many
deviations it is wider than that."""

ENOUGH = 1e-6
"""Failure from which no finer grid is tried."""

WIDE = 1.5
"""Deviations from which on a cell is wide: values are continuous across it."""

CLAIMED = 1.0 + 1e-9
"""Factor on the failure that is claimed: other machines add in another order, and prove the same up to rounding."""

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
        Backups(checked, tuple(np.array(box) for box in checked.agents[0].state_box.T), (True,) * agent.n_states)
    except (Refused, Unreadable, NotCanonicalError) as reason:
        raise RelationRefused(str(reason)) from reason
    low, high = checked.agents[0].state_box
    cells = float(np.prod((high - low) / (NARROW * spreads_of(checked)).mean(axis=1)))
    if cells > MOST_NARROW:
        raise RelationRefused(f"the noise is small: {cells:.2g} cells of a grid would be as wide as it")


def work_of_grid(problem: Problem, vertices: float) -> float:
    """Return the work of a grid with so many vertices, in core seconds (see ``Effort``)."""
    agent, T = problem.agents[0], problem.horizon
    d, tried = agent.n_states, INPUTS.get(agent.n_inputs, 1) ** agent.n_inputs
    alive = int((~problem.automaton.absorbing).sum())
    laws = T if problem.names_time else len(_times_of_laws(T))
    # Weights of planes and intervals, and products of them with tables.
    weights = (laws * alive + tried * (laws if problem.names_time else 1)) * d * vertices ** (1.0 + 1.0 / d)
    products = alive * (laws * tried * 2.0**d + T * (2.0**d + 4.0 * d + 4.5 * d * (d - 1))) * vertices**2
    return float(WEIGHT * weights + PRODUCT * products)


def _times_of_laws(horizon: int) -> list[int]:
    """Return the numbers of steps that are left when inputs are chosen anew."""
    times = [0]
    while times[-1] < horizon:
        times.append(max(times[-1] + 1, round(ANEW * times[-1])))
    return times[:-1]


def vertex_grid_certificate(problem: Problem, work: CountedWork) -> Synthesis:
    """Return the certificate of the best grid that the work allows; RelationRefused where there is none."""
    refuse_vertex_grid(problem)
    began = time.perf_counter()
    checked = read_problem({"problem": canonical_problem(problem)})
    spreads, vertices = spreads_of(checked), float(FIRST[problem.agents[0].n_states])
    # Coarse values say where runs pass, and nothing is charged there.
    work.count(0.5 * work_of_grid(problem, vertices))
    edges = grid_of(checked, spreads, round(vertices), checked.agents[0].state_box)
    inputs, laws, _ = iterated(Uncharged(checked, edges, jumps_of(checked, edges)))
    best, levels = None, dict[str, float]()
    while True:
        work.count(work_of_grid(problem, vertices))
        window = _visited(checked, edges, inputs, laws, spreads)
        edges = grid_of(checked, spreads, round(vertices), window)
        jumps = jumps_of(checked, edges)
        steps = Backups(checked, edges, jumps)
        try:
            inputs, laws, failure = iterated(steps)
        except KeyboardInterrupt:
            if best is None or best.failure >= 1.0:
                raise
            work.is_interrupted = True
            break
        levels[" x ".join(str(len(axis) - 1) for axis in edges)] = 1.0 - failure
        last = 1.0 if best is None else best.failure
        if best is None or failure < best.failure:
            best = VertexProof(edges, inputs, laws, jumps, min(1.0, failure * CLAIMED))
            work.tell(failure)
        vertices = next((v for v in vertices * FINER_STEPS if work.allows(work_of_grid(problem, v))), math.inf)
        slow = last < 1.0 and failure > (1.0 - GAINS) * last
        if failure < ENOUGH or slow or vertices > MOST_FINER:
            break
    if best.failure >= 1.0:
        raise RelationRefused(f"nothing is proved on grids of {', '.join(levels)} cells; ask for more `effort`")
    settings = {"relation": "vertex grid", "levels": levels}
    certificate = Certificate(problem, best, settings)
    seconds = {"abstract": 0.0, "synthesize": time.perf_counter() - began}
    unknown = dict.fromkeys(("abstract_upper_bound", "continuous_upper_bound", "unilateral_gain"))
    stats: dict[str, Any] = {"seconds": seconds, "rank": 1, "sweeps": [], "starts": {}, "dropped": 0.0, **unknown}
    return Synthesis(certificate, certificate.controller, stats)


def jumps_of(problem: CheckedProblem, edges: tuple[FloatArray, ...]) -> tuple[bool, ...]:
    """Return along which axes cells are so narrow, for the noise there, that jumps of values cost little."""
    agent, at = problem.agents[0], vertices_of(edges)
    middle = np.repeat(agent.input_box.mean(axis=0)[None], at.shape[1], axis=0)
    sizes = np.abs(images_at(agent, at, middle, 0)[0][len(at) :])
    return tuple(
        bool(np.median(np.diff(axis)) < WIDE * np.nanmedian(own)) for axis, own in zip(edges, sizes, strict=True)
    )


def iterated(steps: Backups) -> tuple[FloatArray, NDArray[np.int64], float]:
    """Return inputs (L, Q, V, m), which of them at what time (T,), and the failure that the checker computes."""
    problem, agent = steps.problem, steps.agent
    choice = _Choice(steps)
    values, given_up = steps.at_end()
    laws, inputs = np.zeros(problem.horizon, dtype=np.int64), list[FloatArray]()
    anew, timed = {*_times_of_laws(problem.horizon)}, names_time(agent)
    for t in range(problem.horizon - 1, -1, -1):
        if problem.horizon - 1 - t in anew or timed:
            inputs.append(choice.of(values, given_up, t, inputs[-1] if inputs else None))
        laws[t] = len(inputs) - 1
        values, given_up = steps.backup(values, given_up, inputs[-1], t)
    return np.stack(inputs), laws, steps.failure(values, given_up)


class Uncharged(Backups):
    """Backups on a coarse grid that take nothing off: no bounds, but inputs to begin with."""

    def images_of(self, inputs: FloatArray, t: int) -> Images:
        """Return where inputs (V, m) lead from vertices alone."""
        key = t if names_time(self.agent) else 0, inputs.tobytes()
        if key not in self.images:
            self.images.clear()
            centre, _ = images_at(self.agent, vertices_of(self.edges), inputs, t)
            known = np.ones(int(np.prod(self.shape)), dtype=bool)
            self.images[key] = Images(self.hats(centre), 0.0, [], [], [], known)
        return self.images[key]

    def charge(self, W: FloatArray, images: Images) -> tuple[FloatArray, FloatArray]:
        """Return nothing (S,), and nothing along each axis (d, S)."""
        return np.zeros(len(images.known)), np.zeros((W.ndim, len(images.known)))


class _Choice:
    """The best inputs at all vertices of a grid, for values one step later."""

    def __init__(self, steps: Backups) -> None:
        self.steps, agent = steps, steps.agent
        self.at, m = vertices_of(steps.edges), len(agent.inputs)
        low, high = agent.input_box
        self.axes = np.linspace(low, high, INPUTS[m])  # (tried, m)
        self.tried = np.stack(np.meshgrid(*self.axes.T, indexing="ij"), axis=-1).reshape(-1, m)
        self.range = np.maximum(high - low, 1e-300)
        self.middle = np.repeat((0.5 * low + 0.5 * high)[None], self.at.shape[1], axis=0)
        self.tables: tuple[int, list[list[FloatArray]]] | None = None

    def of(self, values: FloatArray, given_up: NDArray[Any], t: int, later: FloatArray | None) -> FloatArray:
        """Return inputs (Q, V, m) at the vertices; where they make no difference those one step later."""
        automaton = self.steps.problem.automaton
        dead = automaton.dead()
        result = np.repeat(self.middle[None], len(values), axis=0) if later is None else later.copy()
        known = dict[bytes, FloatArray]()
        for q in range(len(values)):
            if dead[q] or (automaton.is_co_safe and automaton.accepting[q]):
                continue
            W = self.steps.after_letter(values, given_up, q, t + 1)
            if W.max() <= 0.0:
                continue
            key = W.tobytes()
            if key not in known:
                known[key] = self._best(W, t, result[q])
            result[q] = known[key]
        return result

    def _best(self, W: FloatArray, t: int, before: FloatArray) -> FloatArray:
        means = np.stack([contracted(W, own) for own in self._means(t)])  # (tried, V)
        off = ((self.tried[:, None] - before) / self.range) ** 2
        means = means - NO_DIFFERENCE * off.sum(axis=2)
        best, m, count = means.argmax(axis=0), self.tried.shape[1], len(self.axes)
        result, places = self.tried[best].copy(), np.unravel_index(best, [count] * m)
        at = np.arange(len(best))
        for j in range(m):
            # a parabola through the best of them and both neighbours along one input
            step = count ** (m - 1 - j)
            inner = (places[j] > 0) & (places[j] < count - 1)
            centre, low, high = means[best, at], means[np.where(inner, best - step, best), at], means[
                np.where(inner, best + step, best), at]  # fmt: skip
            bend = 2.0 * centre - low - high
            with np.errstate(all="ignore"):
                share = np.where(inner & (bend > 0.0), 0.5 * (high - low) / bend, 0.0)
            result[:, j] += np.clip(share, -0.5, 0.5) * (self.axes[1, j] - self.axes[0, j])
        return result

    def _means(self, t: int) -> list[list[FloatArray]]:
        """Return weights of hats (V, 2 n) along every axis, for each input that is tried."""
        steps = self.steps
        if self.tables is None or (names_time(steps.agent) and self.tables[0] != t):
            made = []
            for own in self.tried:
                centre, _ = images_at(steps.agent, self.at, np.repeat(own[None], self.at.shape[1], axis=0), t)
                made.append(steps.hats(centre))
            self.tables = t, made
        return self.tables[1]


def _visited(
    problem: CheckedProblem,
    edges: tuple[FloatArray, ...],
    inputs: FloatArray,
    laws: NDArray[np.int64],
    spreads: FloatArray,
) -> FloatArray:
    """Return a window (2, d) of states in which nearly all runs stay, under inputs on a grid (sampled, fixed seed)."""
    agent, automaton = problem.agents[0], problem.automaton
    rng, d = np.random.default_rng(20261127), len(agent.states)
    low, high = agent.state_box
    x = rng.uniform(agent.start[0][:, None], agent.start[1][:, None], (d, RUNS))
    q, seen = np.full(RUNS, automaton.initial), [x]
    q = _followed(problem, q, x, 0)
    for t in range(problem.horizon):
        u = interpolated(edges, inputs[laws[t]], x, q).T
        centre, _ = images_at(agent, x, u, t)
        x = np.clip(centre[:d] + np.abs(centre[d:]) * rng.standard_normal((d, RUNS)), low[:, None], high[:, None])
        q = _followed(problem, q, x, t + 1)
        seen.append(x)
    states = np.concatenate(seen, axis=1)
    ends = np.quantile(states, [QUANTILE, 1.0 - QUANTILE], axis=1)
    beside = BESIDE * np.median(spreads, axis=1)
    return np.stack([np.maximum(ends[0] - beside, low), np.minimum(ends[1] + beside, high)])


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
