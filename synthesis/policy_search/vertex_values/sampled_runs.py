"""Runs under inputs on a grid: where cells have to be narrow, and where it matters which inputs there are."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.simulation import Dynamics, batch_simulator, joint
from ....envs.systems.agents import TURN
from ....envs.tasks.problem import Problem
from ...certificates.controllers import interpolated
from ...checker import CheckedProblem, followed, value_on
from ...extended_check.vertex_grids import ROOM, images_at, numbers_in, vertices_of
from ...relations.grids import FloatArray
from .axis_edges import spreads_in
from .counted_backups import Counted

RUNS, QUANTILE, BESIDE = 3000, 1e-3, 6.0
"""Runs that say where the next grid has narrow cells, the share of states that may lie beyond, and by how many
deviations it is wider than that."""

STRETCHED = 0.6
"""Share by which windows that move are wider than what nearly all runs keep to: along axes without noise of their own
runs stray further than a few deviations."""

FEW = 30
"""Undecided runs from which on a time has a window of its own."""

UNSEEN = 3
"""Failures that runs may have missed: so many are expected at most where none is seen, with a probability of 95 %."""

MANY = 10
"""Times as many runs that say how much a controller fails."""

WORSE = 1.5
"""Times as much failure that later runs may have."""


@dataclass(eq=False)
class Runs:
    """Runs under inputs (sampled, fixed seed): states (T + 1, d, M), automaton states, and the failure hoped for."""

    states: FloatArray
    q: NDArray[np.int64]
    failure: float

    @classmethod
    def of(cls, steps: Counted, inputs: FloatArray, laws: NDArray[np.int64], failure: float, batch: int = 0) -> Runs:
        """Return runs of tables of inputs (L, V, m), of which ``laws`` (T, Q) act.

        Hoped for is a failure, or what is seen in runs, if that is less: values of coarse grids are too low. Other
        numbers of the ``batch`` make other runs. Disturbances are those that are worst at the nearest vertex.
        """
        problem = steps.problem
        agent, automaton = problem.agents[0], problem.automaton
        rng, d = np.random.default_rng([20261127, batch] if batch else 20261127), len(agent.states)
        low, high = walls_of(problem)
        x = rng.uniform(agent.start[0][:, None], agent.start[1][:, None], (d, RUNS))
        q = _followed(problem, np.full(RUNS, automaton.initial), x, 0)
        states, each = [x], [q]
        for t in range(problem.horizon):
            u = interpolated(steps.edges_at(t), inputs[laws[t]], x, q).T
            centre, _ = images_at(agent, x, u, t, _worst_at(steps, x, q, t))
            drawn = [
                own if noise is None else noise.drawn(own)
                for noise, own in zip(steps.noises, rng.standard_normal((d, RUNS)), strict=True)
            ]
            x = np.clip(centre[:d] + np.abs(centre[d:]) * drawn, low[:, None], high[:, None])
            q = _followed(problem, q, x, t + 1)
            states.append(x)
            each.append(q)
        missed = int(np.sum(~np.array(automaton.accepting)[q]))
        return cls(np.stack(states), np.stack(each), min(failure, (missed + UNSEEN) / RUNS))

    @classmethod
    def least_failure(cls, steps: Counted, inputs: FloatArray, laws: NDArray[np.int64]) -> float:
        """Return by how much a controller fails in many runs, less two deviations of that estimate."""
        batches = range(1, MANY + 1)
        missed = sum((cls.of(steps, inputs, laws, 1.0, k).failure * RUNS - UNSEEN) for k in batches)
        return float(missed - 2.0 * np.sqrt(max(missed, 0.0))) / (MANY * RUNS)

    def or_better(self, other: Runs) -> Runs:
        """Return other runs, unless they fail much more often: those of grids that are too wide lead elsewhere."""
        if other.failure > WORSE * self.failure:
            return self
        return Runs(other.states, other.q, min(self.failure, other.failure))

    @classmethod
    def under(cls, problem: Problem, controller: Any) -> Runs:
        """Return runs under a controller, of all agents together, with the failure that is seen in them.

        Disturbances, if there are any, swing from one end to the other.
        """
        behaviour = "periodic" if any(agent.disturbances for agent in problem.agents) else "zero"
        dynamics, rng = Dynamics.of(problem, behaviour), np.random.default_rng(20261128)
        policy, worlds = controller.batch(dynamics), batch_simulator.initial(dynamics, rng, RUNS)
        memory, states, each = policy.begin(worlds, np.random.default_rng(20261129)), list[Any](), list[Any]()
        for t in range(problem.horizon + 1):
            states.append(joint(dynamics, worlds).T)
            each.append(worlds.q)
            if t < problem.horizon:
                inputs, memory = policy.act(worlds, memory)
                noise = batch_simulator.noise(dynamics, rng, RUNS)
                worlds = batch_simulator.transition(dynamics, worlds, inputs, noise)
        runs = np.stack(states)
        turning = np.concatenate([agent.wrapped_axes for agent in problem.agents])
        # angles as numbers that go on where a turn ends
        runs[:, turning] = np.unwrap(runs[:, turning], axis=0)
        return cls(runs, np.stack(each), 1.0 - float(batch_simulator.satisfied(dynamics, worlds).mean()))

    def of_agent(self, columns: slice) -> Runs:
        """Return the same runs of one agent, whose states are these of the joint states."""
        return replace(self, states=self.states[:, columns])

    def seen_by(self, matrix: FloatArray | None) -> Runs:
        """Return the same runs in other coordinates (None: those that they have)."""
        return self if matrix is None else replace(self, states=np.einsum("ij,tjm->tim", matrix, self.states))

    def window(self, problem: CheckedProblem, spreads: FloatArray) -> FloatArray:
        """Return a window (2, d) of states in which nearly all runs stay."""
        low, high = problem.agents[0].state_box
        ends = np.quantile(self.states, [QUANTILE, 1.0 - QUANTILE], axis=(0, 2))
        beside = BESIDE * np.median(spreads, axis=1)
        return np.stack([np.maximum(ends[0] - beside, low), np.minimum(ends[1] + beside, high)])

    def windows(self, problem: CheckedProblem, spreads: FloatArray) -> FloatArray:
        """Return windows (T + 1, 2, d) of states to which nearly all runs come that were undecided one step before."""
        (low, high), automaton, ends = walls_of(problem), problem.automaton, list[FloatArray]()
        done = np.array(automaton.accepting) & automaton.is_co_safe
        is_open = ~(done | np.array(automaton.dead()))
        for t, states in enumerate(self.states):
            some = states[:, is_open[self.q[max(t - 1, 0)]]]
            some = some if some.shape[1] >= FEW else states if not ends else np.zeros((len(low), 0))
            ends.append(np.quantile(some, [QUANTILE, 1.0 - QUANTILE], axis=1) if some.size else ends[-1])
        result = np.stack(ends)
        beside = np.maximum(BESIDE * spreads_in(problem, spreads, result), STRETCHED * 0.5 * np.ptp(result, axis=1))
        result = np.stack([np.maximum(result[:, 0] - beside, low), np.minimum(result[:, 1] + beside, high)], axis=1)
        return within_a_turn(problem, result)


def within_a_turn(problem: CheckedProblem, windows: FloatArray) -> FloatArray:
    """Return windows (T + 1, 2, d) that are narrower than a turn along angles."""
    middle, half = windows.mean(axis=1), 0.5 * TURN - ROOM
    turning = np.isinf(walls_of(problem)[0])
    first = np.where(turning, np.maximum(windows[:, 0], middle - half), windows[:, 0])
    last = np.where(turning, np.minimum(windows[:, 1], middle + half), windows[:, 1])
    return np.stack([first, last], axis=1)


def walls_of(problem: CheckedProblem) -> FloatArray:
    """Return ends (2, d) of the workspace, which angles have none of."""
    agent = problem.agents[0]
    turning = np.array([state in agent.angles for state in agent.states])
    return np.where(turning, np.array([[-np.inf], [np.inf]]), agent.state_box)


def nearest_vertices(edges: tuple[FloatArray, ...], x: FloatArray) -> NDArray[np.int64]:
    """Return the places (M,) of the vertices nearest to states x (d, M)."""
    each = [np.rint(np.interp(own, axis, np.arange(len(axis)))).astype(int) for own, axis in zip(x, edges, strict=True)]
    return np.ravel_multi_index(each, tuple(len(axis) for axis in edges))


def _worst_at(steps: Counted, x: FloatArray, q: NDArray[np.int64], t: int) -> FloatArray | None:
    """Return disturbances (k, M) that are worst for the values at states x (d, M); None where there are none."""
    if not steps.agent.disturbances:
        return None
    places, nodes = nearest_vertices(steps.edges_at(t), x), vertices_of(steps.nodes)
    which = np.zeros(x.shape[1], dtype=int)
    for state in np.unique(q).tolist():
        here = q == state
        # where a task is decided it does not matter
        if (t, state) in steps.worst:
            which[here] = steps.worst[t, state][places[here]]
    return nodes[:, which]


def _followed(problem: CheckedProblem, q: NDArray[Any], x: FloatArray, t: int) -> NDArray[Any]:
    """Return automaton states (M,) after the letters of states x (d, M)."""
    agent, automaton = problem.agents[0], problem.automaton
    turning = np.isinf(walls_of(problem)[0])[:, None]
    x = np.where(turning, numbers_in(x, agent.state_box.mean(axis=0)[:, None]), x)
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
