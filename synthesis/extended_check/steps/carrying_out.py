"""Controllers of certificates, run: whether they do what the check has derived that they may be off by at most.

Controllers without memory are run at random points of the workspace, those with a memory along episodes; their inputs
and means are compared with the lattice points, maps or boxes that the certificate rests on.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent, LinearAgent, with_expressions
from ...certificates.cell_probabilities import AgentRecord
from ...certificates.controllers import AgentController
from ...relations.grids import FloatArray, linear_agent
from ...relations.kinds import CoupledRelation
from .execution import Execution
from .geometry import cell_boxes
from .network_enclosures import network_maps

PROBES = 20_000
"""Points at which a controller without memory is run, over all times."""

NETWORKED = 64
"""Points of each time and automaton state at which a network is run: enclosures take longer than networks."""

EPISODES, MOST_STEPS = 256, 25
"""Episodes, and steps of each, in which the memory of a coupled controller is followed."""

NEAR = 1e-9
"""Points are passed over that are nearer than this, in cells, to an edge that decides, or draws to what they decide."""


def wrong_actions(agent: AnyAgent, part: AgentRecord, controller: AgentController, execution: Execution) -> list[str]:
    """What a controller is seen to do otherwise than its certificate says, on points of every kind.

    Parameters
    ----------
    agent : LinearAgent
    part : AgentPart
    controller : AgentController
        The very object that is deployed.
    execution : Execution
        What it may be off by.
    """
    rng, relation = np.random.default_rng(0), controller.relation
    if relation.has_memory:
        return _wrong_memory(agent, part, controller, relation, execution, rng)  # type: ignore[arg-type]
    for t in range(len(part.policy)):
        failures = _wrong_means(agent, part, controller, execution, t, rng)
        if failures:
            return failures
    return []


def _wrong_means(
    agent: AnyAgent, part: AgentRecord, controller: AgentController, execution: Execution, t: int, rng: Generator
) -> list[str]:
    """Inputs at time t outside their box, or means of the next state off the lattice point of the policy."""
    count = max(64, PROBES // len(part.policy))
    cells, q = rng.integers(part.grid.n_cells, size=count), rng.integers(part.policy.shape[1], size=count)
    # inside the cells; a quarter of the numbers on their lower faces
    share = NEAR + rng.random((len(part.grid.shape), count)) * (1.0 - 2.0 * NEAR)
    share[rng.random(share.shape) < 0.25] = 0.0
    index = np.unravel_index(cells, part.grid.shape)
    axes = zip(part.grid.edges, index, share, strict=True)
    # Where a cell is a few units of rounding wide, its highest point is the one below the next edge.
    points = [np.minimum(e[k] + r * (e[k + 1] - e[k]), np.nextafter(e[k + 1], e[k])) for e, k, r in axes]
    states = np.stack(points)
    beside = _anywhere(agent, count, rng)
    inputs = controller.act(states[:, None], q, t, None, None, None if beside is None else beside[:, None])[0][:, 0]
    if not np.all((agent.input_box.low[:, None] <= inputs) & (inputs <= agent.input_box.high[:, None])):
        return ["its controller was seen to ask for inputs beyond its input box"]
    # Where cells are so narrow that they cannot be told apart, all that is claimed is charged for misread cells.
    if execution.loss >= 1.0:
        return []
    choice = part.policy[t, q, cells]
    if not agent.is_affine:
        agent = with_expressions(agent)
        mean_targets = choice - first_target(part)
        if np.any(mean_targets >= 0):
            off = np.abs(agent.mean(states, inputs, None, beside) - _lattice_points(part, np.maximum(mean_targets, 0)))
            if np.any(~(off <= execution.mean[:, None]) & (mean_targets >= 0)):
                return ["its controller was seen to steer elsewhere than its policy says"]
        if part.relation["kind"] == "exact":
            return []
        fixed = (choice >= 0) & (mean_targets < 0)
        input_set = np.array(part.relation["menu"], dtype=float)
        if np.any((inputs != input_set[np.where(fixed, choice, 0)].T) & fixed):
            return ["its controller was seen to do something else than its policy says"]
        return []
    agent = linear_agent(agent, part.relation["kind"])
    means = agent.A @ states + agent.B @ inputs + agent.offset[:, None]
    if "network" in part.relation:
        return _wrong_networked(agent, part, (cells, choice), states, means, execution)
    off = np.abs(means - _asked_means(agent, part, np.maximum(choice, 0), states))
    if np.any((off > execution.mean[:, None]) & (choice >= 0)):
        return ["its controller was seen to steer elsewhere than its policy says"]
    return []


def first_target(part: AgentRecord) -> int:
    """The first choice that is a target, less its lattice point; beyond all choices where there are none."""
    if part.relation["kind"] == "exact":
        return 0
    return len(part.relation["menu"]) if "aims" in part.relation else int(np.iinfo(np.int32).max)


def _wrong_networked(
    agent: LinearAgent,
    part: AgentRecord,
    chosen: tuple[NDArray[np.int64], NDArray[Any]],
    states: FloatArray,
    means: FloatArray,
    execution: Execution,
) -> list[str]:
    """Means (d, M) under modes of a network from states (d, M) in cells that are off the maps of these cells."""
    cells, choice = chosen
    low, high = cell_boxes(part)
    for mode in np.unique(choice[choice >= 0]).tolist():
        here = np.flatnonzero(choice == mode)[:NETWORKED]
        first, last = low[cells[here]], high[cells[here]]
        z, gain, rho = network_maps(agent, part, cells[here], mode)
        offsets = states[:, here].T - 0.5 * (first + last)
        asked = z + np.einsum("ckj,cj->ck", gain, offsets)
        off = np.abs(means[:, here].T - asked)
        if np.any(off > rho + execution.mean):
            return ["its network was seen to lead beyond the means that it can lead to"]
    return []


def _anywhere(agent: AnyAgent, count: int, rng: Generator) -> FloatArray | None:
    """States of others (l, count) that dynamics name, anywhere in their workspaces; None if there are none."""
    if not agent.others:
        return None
    low, high = np.array(list(agent.unknowns.values())[len(agent.disturbances) :]).T[..., None]
    return np.asarray(low + (high - low) * rng.random((len(low), count)))


def _asked_means(agent: LinearAgent, part: AgentRecord, choice: NDArray[Any], states: FloatArray) -> FloatArray:
    """Means (d, M) that choices ask for at states (d, M)."""
    if part.relation["kind"] not in ("boxes", "linear"):
        return _lattice_points(part, choice)
    input_set = np.array(part.relation["menu"], dtype=float)
    if part.relation["kind"] == "boxes":
        return np.asarray(agent.A @ states + agent.B @ input_set[choice].T + agent.offset[:, None])
    first = first_target(part)
    inputs = input_set[np.minimum(choice, len(input_set) - 1)].T
    means = agent.A @ states + agent.B @ inputs + agent.offset[:, None]
    return np.where(choice >= first, _lattice_points(part, np.maximum(choice - first, 0)), means)


def _wrong_memory(
    agent: LinearAgent,
    part: AgentRecord,
    controller: AgentController,
    relation: CoupledRelation,
    execution: Execution,
    rng: Generator,
) -> list[str]:
    """Inputs, abstract states or errors that differ from those of episodes that are followed here."""
    assert part.input_set is not None
    K, F = relation.feedback, relation.coupling
    deviations = np.sqrt(np.diag(agent.noise_covariance))[:, None]
    low, high = (np.array([edges[k] for edges in part.grid.edges])[:, None] for k in (0, -1))
    points = low + rng.random((len(low), EPISODES)) * (high - low)
    cells, error, sure = _placed(part, points, points)
    mean = target = points
    memory, alive, lost = controller.begin(points[:, None]), np.ones(EPISODES, dtype=bool), ~sure
    for t in range(MOST_STEPS if len(part.policy) == 1 else min(MOST_STEPS, len(part.policy))):
        q, uniform = rng.integers(part.policy.shape[1], size=EPISODES), rng.random(EPISODES)
        if t > 0:
            noise = (points - mean) / deviations
            move = F @ error / deviations
            ratio = np.exp(-np.sum((noise + 0.5 * move) * move, axis=0))
            length = np.where(np.any(move, axis=0), np.sum(move**2, axis=0), 1.0)
            mirrored = noise - 2.0 * move * np.sum(move * noise, axis=0) / length
            landed = target + deviations * np.where(uniform <= ratio, noise + move, mirrored)
            cells, error, sure = _placed(part, landed, points)
            sure &= np.abs(uniform - ratio) > NEAR
        inputs, memory = controller.act(points[:, None], q, t, memory, uniform[None])
        assert memory is not None
        # what is outside, or was not told from the next cell, is not followed any more
        alive &= np.all((points > low) & (points < high), axis=0) & ~lost
        told = alive & sure & ~memory.lost[0]
        chosen = part.policy[min(t, len(part.policy) - 1), q, cells]
        choice = np.maximum(chosen, 0)
        asked = relation.inputs[choice].T + K @ error
        box = (agent.input_box.low[:, None] <= inputs[:, 0]) & (inputs[:, 0] <= agent.input_box.high[:, None])
        if np.any(alive & ~memory.lost[0] & ~np.all(box, axis=0)):
            return ["its controller was seen to ask for inputs beyond its input box"]
        wrong = np.any(np.abs(inputs[:, 0] - asked) > 2.0 * execution.inputs[:, None] + 1e-300, axis=0)
        if np.any(told & ((memory.cells[0] != cells) | wrong)):
            return ["its controller was seen to remember or to do something else than its relation says"]
        if relation.delta == 0.0 and np.any(alive & sure & memory.lost[0]):
            return ["its controller was seen to lose a relation that is never lost"]
        alive &= told & (chosen >= 0)  # where nothing is chosen nothing is promised
        target = _lattice_points(part, np.take_along_axis(part.input_set[cells], choice[:, None], axis=1)[:, 0])
        mean = agent.A @ points + agent.B @ inputs[:, 0] + agent.offset[:, None]
        points = mean + deviations * rng.standard_normal(points.shape)
    return []


def _lattice_points(part: AgentRecord, flat: NDArray[np.integer]) -> FloatArray:
    """Lattice points (d, n) by their numbers (n,)."""
    index = np.unravel_index(flat, tuple(len(axis) for axis in part.lattice))
    return np.stack([axis[k] for axis, k in zip(part.lattice, index, strict=True)])


def _placed(
    part: AgentRecord, landed: FloatArray, points: FloatArray
) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.bool_]]:
    """Cells (n,) of abstract states that land on points (d, n), ``x - xhat`` (d, n), and where no rounding decides."""
    cells, error, sure = np.zeros(landed.shape[1], dtype=np.int64), [], np.ones(landed.shape[1], dtype=bool)
    for edges, to, x in zip(part.grid.edges, landed, points, strict=True):
        place = np.clip(np.searchsorted(edges, to, side="right") - 1, 0, len(edges) - 2)
        width = edges[place + 1] - edges[place]
        sure &= (edges[place] + NEAR * width < to) & (to < edges[place + 1] - NEAR * width)
        error.append(x - 0.5 * (edges[place] + edges[place + 1]))
        cells = cells * (len(edges) - 1) + place
    return cells, np.stack(error), sure
