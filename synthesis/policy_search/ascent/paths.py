"""Starting policies for the ascent: the best single paths through the value tree.

Coordinate ascent finds person-by-person optima, and coordinated jumps over a region edge must happen at the same time:
no single agent gains by jumping first. A *path* fixes one guard per time, ``g_0, .., g_{T-1}``. Given a path, every
agent's best policy is a dynamic program of one agent, ``v_i,t = max_u P_i^u [mask_{g_t},i v_i,t+1]``, and the product
of the ``v_i`` is one vertex of the tree under the best policies for that vertex. Paths are grown backward from
acceptance with a beam; a vertex is scored by what it promises at cells that the agents can have reached by then. The
policies are synchronised by construction and make good starts (docs/theory/tree.md, "Policies: occupancy-weighted
ascent").
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...abstraction.models import AgentModel, JointModel, Policies, best_offered
from ...certificates.value_functions import Occupancy
from ...relations.grids import FloatArray

MOST_BEAM_POINTS, NARROWEST_BEAM = 8_000_000, 4
"""Lattice points, of all agents times vertices of a beam, to which a beam is narrowed, and its least width."""

REACHED_SHARE = 1e-3
"""Share of the largest mass of a step above which a cell counts as reached."""


LONGEST_SHIFT = 2
"""Most steps by which a perturbed start advances or delays the plan of an agent."""


@dataclass(frozen=True, eq=False)
class GuardPath:
    """One guard per time, and the probability of following it under the best policies for it.

    Parameters
    ----------
    guards : tuple of int
        Guard of each time step; shorter than the horizon if the task is accepted before.
    value : float
        Probability, from the start, that the run follows the path (up to rounding).
    """

    guards: tuple[int, ...]
    value: float


@dataclass(frozen=True, eq=False)
class _Beam:
    """Vertices with some number of steps to go: state, guards still to come, and one factor index per agent."""

    state: NDArray[np.int64]
    guards: list[tuple[int, ...]]
    rows: NDArray[np.int64]
    factors: list[FloatArray]


def best_paths(joint: JointModel, start: Occupancy, width: int = 64, count: int = 4) -> list[GuardPath]:
    """Return the most promising paths from the start to acceptance, best first (a heuristic).

    The beam has ``width`` vertices per state, or fewer where agents have so many lattice points that it would take too
    long.
    """
    points = sum(math.prod(model.kernel.lattice_shape) for model in joint.models)
    width = int(np.clip(MOST_BEAM_POINTS // points, NARROWEST_BEAM, width))
    reached = _reached(joint, start)
    beam = _terminal(joint)
    for t in reversed(range(joint.horizon)):
        beam = _extend(joint, beam, reached[t], width, t)
    scores = _from_start(beam, start)
    order = np.argsort(-scores, kind="stable")[:count]
    return [GuardPath(beam.guards[k], float(scores[k])) for k in order if scores[k] > 0 and beam.guards[k]]


def staged_paths(joint: JointModel, path: GuardPath) -> list[GuardPath]:
    """Return the path itself, and paths through the same guards in the same order with other times of the jumps.

    The value of a path is the probability of following it exactly, not what the policy is worth when runs deviate from
    it; agents that dwell longer have settled when they jump. Every stage but the last two lasts d steps, the last one
    a step, and the one before it takes the steps that are left.
    """
    order = [g for g, before in zip(path.guards, (-1, *path.guards), strict=False) if g != before]
    paths = [path]
    for dwell in range(2, joint.horizon // max(1, len(order)) + 1):
        steps_left = joint.horizon - 1 - dwell * (len(order) - 2)
        if len(order) < 2 or steps_left < 1:
            break
        times = [dwell] * (len(order) - 2) + [steps_left, 1]
        paths.append(GuardPath(tuple(g for g, n in zip(order, times, strict=True) for _ in range(n)), 0.0))
    return paths


def path_policies(joint: JointModel, path: GuardPath, otherwise: Policies) -> Policies:
    """Return every agent's best policy for a path, and ``otherwise`` where the run has left it."""
    policies = tuple(policy.copy() for policy in otherwise)
    for i, model in enumerate(joint.models):
        value = np.ones((1, model.n_cells))
        for t in reversed(range(len(path.guards))):
            guard = path.guards[t]
            backed_up = model.kernel.backup(joint.masks[i][[joint.guards.mask[guard, i]]] * value)
            q = int(joint.guards.source[guard])
            policy = _best(model, backed_up, policies[i][t, q], t)
            policies[i][t, q] = policy
            value = model.choices.read(backed_up, policy)
    return policies


def _best(model: AgentModel, backed_up: FloatArray, incumbent: NDArray[np.int32], time: int) -> NDArray[np.int32]:
    """Return the best choices of a step for a single objective."""
    return best_offered(model.offered(time), np.ones((1, 1)), backed_up, incumbent)


def _terminal(joint: JointModel) -> _Beam:
    """Return the beam with no step to go: acceptance."""
    states = np.flatnonzero(joint.accepting)
    rows = np.zeros((len(states), len(joint.models)), dtype=np.int64)
    return _Beam(states, [()] * len(states), rows, [np.ones((1, n)) for n in joint.n_cells])


def _extend(joint: JointModel, beam: _Beam, reached: Sequence[NDArray[np.bool_]], width: int, time: int) -> _Beam:
    """Return the ``width`` most promising vertices of each state one step further back; acceptance itself stays."""
    guards, models = joint.guards, joint.models
    pairs = [(g, v) for g, target in enumerate(guards.target) for v in np.flatnonzero(beam.state == target)]
    guard, child = (np.array(column, dtype=np.int64) for column in (zip(*pairs, strict=True) if pairs else ((), ())))
    rows = np.zeros((len(pairs), len(models)), dtype=np.int64)
    values, promise = [], np.ones(len(pairs))
    computed: dict[tuple[int, int], dict[bytes, FloatArray]] = {}
    for i, model in enumerate(models):
        # Each distinct pair of a mask and a factor once; agents alike share what was computed for the others.
        key = guards.mask[guard, i].astype(np.int64) * len(beam.factors[i]) + beam.rows[child, i]
        distinct, rows[:, i] = np.unique(key, return_inverse=True)
        mask, factor = np.divmod(distinct, len(beam.factors[i]))
        masked = joint.masks[i][mask] * beam.factors[i][factor]
        agent_values = _best_values(model, masked, computed.setdefault((id(model.kernel), id(model.choices)), {}), time)
        values.append(agent_values)
        # A vertex promises the product of what it is worth at the best reached cell of each agent.
        promise *= agent_values[:, reached[i]].max(axis=1, initial=0.0)[rows[:, i]]
    chosen = _most_promising(guards.source[guard], promise, width)
    state = guards.source[guard[chosen]].astype(np.int64)
    paths = [(int(guard[k]), *beam.guards[child[k]]) for k in chosen]
    rows = rows[chosen]
    # A run may be accepted early: acceptance of co-safe tasks ends a path at every time.
    goals = np.flatnonzero(joint.accepting & joint.absorbing)
    for i, model in enumerate(models):
        values[i] = np.concatenate([values[i], np.ones((1, model.n_cells))])
    ends = np.array([[len(v) - 1 for v in values]] * len(goals), dtype=np.int64).reshape(-1, len(models))
    return _Beam(np.concatenate([state, goals]), paths + [()] * len(goals), np.concatenate([rows, ends]), values)


def _best_values(model: AgentModel, masked: FloatArray, computed: dict[bytes, FloatArray], time: int) -> FloatArray:
    """Return the value (n, S) of each masked factor (n, S) under the best choices of a step for it.

    What is ``computed`` already is taken from there, and what is new is added.
    """
    names = [row.tobytes() for row in masked]
    new = {name: k for k, name in enumerate(names) if name not in computed}
    backed_up = model.kernel.backup(masked[list(new.values())])
    for k, name in enumerate(new):
        if (most := model.choices.largest(backed_up[k])) is not None:
            computed[name] = most
            continue
        policy = _best(model, backed_up[[k]], model.resting_at(time), time)
        computed[name] = model.choices.read(backed_up[[k]], policy)[0]
    return np.array([computed[name] for name in names]).reshape(len(names), model.n_cells)


def _most_promising(state: NDArray[Any], promise: FloatArray, width: int) -> NDArray[np.int64]:
    """Return the rows with the largest promise, at most ``width`` per automaton state, in order of promise."""
    order = np.argsort(-promise, kind="stable")
    order = order[promise[order] > 0]
    per_state = [order[state[order] == q][:width] for q in np.unique(state)]
    rows = np.concatenate(per_state) if per_state else np.zeros(0, dtype=np.int64)
    return np.asarray(rows[np.argsort(-promise[rows], kind="stable")], dtype=np.int64)


def _from_start(beam: _Beam, start: Occupancy) -> FloatArray:
    """Return the value of each vertex from the start."""
    scores = np.zeros(len(beam.state))
    for q, mass_rows in enumerate(start.terms.index):
        here = np.flatnonzero(beam.state == q)
        for row in mass_rows:
            product = np.ones(len(here))
            for i, factors in enumerate(beam.factors):
                product *= (factors @ start.terms.factors[i][row[i]])[beam.rows[here, i]]
            scores[here] += product
    return scores


def _reached(joint: JointModel, start: Occupancy) -> list[list[NDArray[np.bool_]]]:
    """Return, per time and agent, the cells that some policy reaches with more than ``REACHED_SHARE`` in a step."""
    now: list[NDArray[Any]] = []
    for factors, model in zip(start.terms.factors, joint.models, strict=True):
        cells: NDArray[Any] = np.asarray(np.any(factors > 0, axis=0))
        now.append(cells if cells.any() else np.ones(model.n_cells, dtype=bool))
    result = [now]
    for time in range(joint.horizon - 1):
        now = [_spread(model, cells, time) for model, cells in zip(joint.models, now, strict=True)]
        result.append(now)
    return result


def _spread(model: AgentModel, cells: NDArray[np.bool_], time: int) -> NDArray[np.bool_]:
    """Return the cells reached in a step by extreme and resting choices, and everything between them."""
    indicator = cells.astype(float)[None]
    shape = tuple(len(axis) for axis in model.lattice)
    n_lattice = math.prod(shape)
    # The best choices for a constant stay where they are; those for a ramp go as far up, or down, an axis as they can.
    ramps = [np.ones(n_lattice)]
    for axis, size in enumerate(shape):
        ramp = np.linspace(1.0, 2.0, size).reshape([-1 if k == axis else 1 for k in range(len(shape))])
        ramp = np.broadcast_to(ramp, shape).ravel()
        ramps += [ramp, 3.0 - ramp]
    reached = cells.copy()
    for ramp in ramps:
        policy = _best(model, ramp[None], model.resting_at(time), time)
        mass = model.kernel.propagate(indicator, model.choices.points(policy))[0]
        reached |= mass > REACHED_SHARE * mass.max(initial=0.0)
    return _hull(reached, model.kernel.shape)


def _hull(cells: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the bounding box of a set of cells."""
    tensor = cells.reshape(shape)
    box = np.ones(shape, dtype=bool)
    for axis in range(len(shape)):
        along = np.flatnonzero(tensor.any(axis=tuple(k for k in range(len(shape)) if k != axis)))
        inside = np.zeros(shape[axis], dtype=bool)
        if len(along):
            inside[along[0] : along[-1] + 1] = True
        box &= inside.reshape([-1 if k == axis else 1 for k in range(len(shape))])
    return box.ravel()


def staged_starts(joint: JointModel, start: Occupancy, naive: Policies) -> Iterator[tuple[str, Policies]]:
    """Return policies that take the most likely way through the task, one staging after the other (see ``paths``).

    They are made when they are asked for: on fine cells each may take a quarter of a gigabyte.
    """
    number = 0
    for likely in best_paths(joint, start, width=32, count=1):
        for path in staged_paths(joint, likely):
            number += 1
            yield f"staged start {number}", path_policies(joint, path, naive)


def perturbed(policies: Policies, rng: np.random.Generator) -> Policies:
    """Return policies whose plans are advanced or delayed from a random step on, another one for each agent."""
    shifted = []
    for policy in policies:
        times = np.arange(len(policy))
        shift = np.where(times >= rng.integers(len(policy)), rng.integers(-LONGEST_SHIFT, LONGEST_SHIFT + 1), 0)
        shifted.append(policy[np.clip(times + shift, 0, len(policy) - 1)])
    return tuple(shifted)
