"""The same tasks by certigym, by interval models, by the paper's relation and by dense programming, in one run.

``python benchmarks/same_machine.py`` prints bound and CPU seconds of each, and the ratio of seconds to certigym's.

Interval models: cells of a scalar agent times a menu of inputs, and for each pair the least and the largest probability
to reach each other cell, over all states of the cell. Robust value iteration takes the worst distribution between them.
The ends of these intervals are exact up to rounding (means of a linear scalar agent are intervals, and the mass that a
cell receives rises and falls once along them). Where the extra `storm` is installed, Storm solves these interval models
and the joint model.
"""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

import certigym as cg
from certigym.synthesis.models.abstraction import abstract
from explicit_product import decision_process
from measuring import Rows, once, options, save, show
from storm_check import storm_intervals, storm_model, storm_reach_within, storm_robust_within

PARKING = Path(__file__).parent / "arch" / "car_park_1.toml"
MENU = 11
"""Inputs of the interval model, evenly spread."""

Array = NDArray[np.float64]


def intervals(problem: cg.Problem, cells: int) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return lower and upper probabilities (cells, inputs, cells), cells of the target, and cells that are lost."""
    agent: Any = problem.agents[0]
    edges = np.linspace(agent.state_low[0], agent.state_high[0], cells + 1)
    sigma = float(np.sqrt(agent.noise_covariance[0, 0]))
    inputs = np.linspace(agent.input_low[0], agent.input_high[0], MENU)
    moved = agent.A[0, 0] * edges[None, :] + agent.B[0, 0] * inputs[:, None]
    first, last = (side[..., None] for side in (moved[:, :-1].T, moved[:, 1:].T))

    def mass(mean: Array) -> Array:
        return np.asarray(ndtr((edges[1:] - mean) / sigma) - ndtr((edges[:-1] - mean) / sigma))

    # The mass of a cell is unimodal in the mean: least at an end, largest at its middle or at the nearer end.
    lower = np.minimum(mass(first), mass(last))
    upper = mass(np.clip(0.5 * (edges[1:] + edges[:-1]), first, last))
    target, lost = (_inside(problem, name, edges) for name in ("p1", "p2"))
    return lower, upper, target, lost


def _inside(problem: cg.Problem, name: str, edges: Array) -> NDArray[np.bool_]:
    """Return which cells lie in a region; its limits must be edges."""
    region = problem.propositions[name]
    if not all(np.any(np.isclose(edges, limit)) for limit in (region.low[0], region.high[0])):
        raise ValueError("`cells`: expected limits of regions among the edges; take another number")
    middle = 0.5 * (edges[1:] + edges[:-1])
    return np.asarray((region.low[0] < middle) & (middle < region.high[0]))


def robust_value(problem: cg.Problem, cells: int) -> float:
    """Return the lower bound of the interval model at the start, by robust value iteration."""
    lower, upper, target, lost = intervals(problem, cells)
    value = target.astype(float)
    for _ in range(problem.horizon):
        # What lower ends leave goes to the worst cells first; leaving the workspace, worth 0, takes what it may.
        order = np.argsort(value)
        left = 1.0 - lower.sum(axis=2)
        spare = np.clip(left - _leaving(problem, cells, left), 0.0, None)
        room = (upper - lower)[..., order]
        taken = np.minimum(room, np.maximum(0.0, spare[..., None] - (np.cumsum(room, axis=2) - room)))
        worth = lower @ value + taken @ value[order]
        value = np.where(target, 1.0, np.where(lost, 0.0, worth.max(axis=1)))
    agent: Any = problem.agents[0]
    low, high = float(agent.state_low[0]), float(agent.state_high[0])
    return float(value[int((agent.initial.low[0] - low) / (high - low) * cells)])


def _leaving(problem: cg.Problem, cells: int, most: Array) -> Array:
    """Return the largest probability (cells, inputs) to leave the workspace, no more than what lower ends leave."""
    agent: Any = problem.agents[0]
    edges = np.linspace(agent.state_low[0], agent.state_high[0], cells + 1)
    sigma = float(np.sqrt(agent.noise_covariance[0, 0]))
    inputs = np.linspace(agent.input_low[0], agent.input_high[0], MENU)
    moved = (agent.A[0, 0] * edges[None, :] + agent.B[0, 0] * inputs[:, None]) / sigma
    leaves = ndtr(edges[0] / sigma - moved) + ndtr(moved - edges[-1] / sigma)
    # Convex along the means of a cell as long as they stay inside of the workspace: largest at an end.
    return np.asarray(np.minimum(most, np.maximum(leaves[:, :-1], leaves[:, 1:]).T))


def parking() -> Rows:
    """Return bounds and seconds on the parking problem on a line."""
    problem: Any = cg.load(PARKING)
    assert problem.automaton
    base, found = once(lambda: cg.synthesize(problem, 80, relation="linear"))
    rows = [_row("certigym, linear, 80 cells", found.certificate.lower_bound, base, base)]
    seconds, found = once(lambda: cg.synthesize(problem))
    rows.append(_row("certigym, defaults", found.certificate.lower_bound, seconds, base))
    for cells in (80, 240, 720):
        seconds, value = once(partial(robust_value, problem, cells))
        rows.append(_row(f"interval model, {cells} cells, {MENU} inputs", value, seconds, base))
        if find_spec("stormpy") is not None:
            rows += by_storm(problem, cells, base)
    return rows


def by_storm(problem: cg.Problem, cells: int, base: float) -> Rows:
    """Return what Storm makes of that interval model: building it in Storm's storage, and solving it there."""
    lower, upper, target, lost = intervals(problem, cells)
    outside = np.minimum(1.0 - lower.sum(axis=2), _leaving(problem, cells, 1.0 - lower.sum(axis=2)))
    # Outside of the workspace is one more state, to which as little as nothing may lead: the worst case takes all.
    ends = np.zeros((2, cells + 1, MENU, cells + 1))
    ends[0, :cells, :, :cells], ends[1, :cells, :, :cells] = lower, upper
    ends[1, :cells, :, cells] = np.maximum(outside, 0.0)
    goal, stop = np.append(target, False), np.append(lost, True)
    building, model = once(lambda: storm_intervals(ends[0], ends[1], goal, stop))
    solving, values = once(lambda: storm_robust_within(model, problem.horizon))
    agent: Any = problem.agents[0]
    low, high = float(agent.state_low[0]), float(agent.state_high[0])
    value = float(values[int((agent.initial.low[0] - low) / (high - low) * cells)])
    return [
        _row(f"Storm, that interval model, {cells} cells, solving alone", value, solving, base),
        _row(f"Storm, that interval model, {cells} cells, built and solved", value, building + solving, base),
    ]


def two_agents() -> Rows:
    """Return bounds and seconds on two agents: tree, paper's relation, and the dense joint model of the same cells."""
    problem = cg.make_problem("reach-avoid-v0", horizon=4, initial_state=[[-4.0], [-3.0]])
    assert problem.automaton
    rows = []
    base, found = once(lambda: cg.synthesize(problem, 20, relation="exact"))
    rows.append(_row("certigym, exact, 20 cells", found.certificate.lower_bound, base, base))
    models = abstract(problem, 20, relation="exact").models
    seconds, value = once(lambda: decision_process(problem, models).reach_within(problem.horizon))
    rows.append(_row("dense joint model, 20 cells", None, seconds, base) | {"largest": float(value[:-1].max())})
    if find_spec("stormpy") is not None:
        model = storm_model(decision_process(problem, models))
        seconds, values = once(lambda: storm_reach_within(model, problem.horizon))
        rows.append(_row("Storm, that joint model, solving alone", None, seconds, base) | {"largest": max(values[:-1])})
    seconds, found = once(lambda: cg.synthesize(problem, 500, relation="paper"))
    rows.append(_row("relation of the paper, 500 cells", found.certificate.lower_bound, seconds, base))
    seconds, found = once(lambda: cg.synthesize(problem, 500, relation="exact"))
    rows.append(_row("certigym, exact, 500 cells", found.certificate.lower_bound, seconds, base))
    return rows


def _row(name: str, bound: float | None, seconds: float, base: float) -> dict[str, Any]:
    """Return what a method gives; the joint models have a largest value, and no one bound."""
    return {"method": name, "largest": None, "bound": bound, "seconds": seconds, "ratio": seconds / base}


if __name__ == "__main__":
    arguments = options(__doc__)
    results = {"parking": parking(), "two agents": two_agents()}
    for title, result in results.items():
        show(title, result)
    save(results, arguments.json)
