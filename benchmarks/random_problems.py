"""Random problems of every kind: agents, units, noise, starts, regions, formulas, relations and cells.

They are plain dictionaries (see ``independent``), so that the simulator beside need not read the package's records.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from independent import Formula, names_in, text_of

Spec = dict[str, Any]


def random_spec(seed: int, relation: str | None = None) -> Spec:
    """A problem, and under ``options`` what to synthesize it with; ``relation`` takes the place of a drawn one."""
    rng = np.random.default_rng([20261121, seed])
    n_agents = int(rng.choice([1, 2, 3], p=[0.45, 0.42, 0.13]))
    agents = [_agent(rng, f"agent_{i}", n_agents) for i in range(n_agents)]
    correlated = bool(sum(agent.pop("correlated") for agent in agents))
    propositions: dict[str, dict[str, Any]] = {}
    for agent in agents:
        for k in range(int(rng.integers(1, 3 if n_agents > 1 else 4))):
            region = _region(rng, agent)
            if region is not None:
                propositions[f"p{k}_{agent['name']}"] = region
    if not propositions:
        return random_spec(seed + 1_000_003, relation)
    semantics = str(rng.choice(["co-safe", "finite-trace"]))
    formula = _formula(rng, list(propositions), semantics, int(rng.integers(1, 4)))
    horizon = int(rng.choice([1, 2, 3, 4, 5, 6, 8], p=[0.12, 0.1, 0.2, 0.2, 0.18, 0.1, 0.1]))
    for agent in agents:
        _start(rng, agent, propositions, correlated)
    used = names_in(formula)
    kept = {name: region for name, region in propositions.items() if name in used or rng.random() < 0.3}
    options = _options(rng, agents)
    if relation is not None:
        others = {name: value for name, value in options.items() if name != "delta"}
        # Agents whose steps are not additive have no tensor trains.
        options = {
            name: value for name, value in others.items() if name != "value" or relation not in ("boxes", "linear")
        }
        options["relation"] = relation
    if options.get("relation") != "path":
        make_independent(agents)
    return {
        "agents": agents,
        "propositions": kept,
        "formula": formula,
        "text": text_of(formula),
        "semantics": semantics,
        "horizon": horizon,
        "options": options,
    }


def make_independent(agents: list[Spec]) -> None:
    """Leave agents their variances only: cells need noise that is independent along the states."""
    for agent in agents:
        if "noise_covariance" in agent:
            agent["noise_covariance"] = np.diag(np.diag(agent["noise_covariance"])).tolist()


def _agent(rng: np.random.Generator, name: str, n_agents: int) -> Spec:
    """An agent on [-1, 1]^d, then in units of its own."""
    d = int(rng.choice([1, 2, 3], p=[0.68, 0.27, 0.05] if n_agents == 1 else [0.8, 0.2, 0.0]))
    full = d == 1 or rng.random() < 0.6
    m = d + int(rng.random() < 0.1) if full else int(rng.integers(1, d))
    A = np.diag(rng.choice([0.5, 0.8, 0.9, 1.0, 1.0, 1.05, 1.3], d)) + 0.15 * rng.standard_normal((d, d)) * (
        rng.random((d, d)) < 0.5
    ) * (1 - np.eye(d))
    if rng.random() < 0.05:
        A = 0.9 * rng.standard_normal((d, d))
    B = rng.uniform(0.1, 0.8, (d, m)) * (rng.random((d, m)) < 0.9)
    if full and rng.random() < 0.6:
        B = np.zeros((d, m))
        B[np.arange(d), rng.permutation(m)[:d]] = rng.uniform(0.1, 0.8, d) * rng.choice([-1, 1], d)
    if not full:  # the last axis is pushed, the others follow
        A = np.triu(A) + np.diag(rng.uniform(0.1, 0.5, d - 1), 1)
        B = np.zeros((d, m))
        B[d - m :, :] = np.diag(rng.uniform(0.2, 0.8, m))
    deviation = 10.0 ** rng.uniform(-2.3, -0.3, d)
    if rng.random() < 0.06:
        deviation *= 10.0 ** rng.uniform(-6, 1)
    correlated = d > 1 and rng.random() < 0.15
    shape = np.eye(d)
    if correlated:
        mixed = rng.standard_normal((d, d)) + np.eye(d)
        shape = mixed @ mixed.T
        shape /= np.sqrt(np.outer(np.diag(shape), np.diag(shape)))
    # units: of the states, one by one or all alike, and of the inputs
    unit = np.ones(d)
    if rng.random() < 0.3:
        unit = 10.0 ** rng.uniform(-7, 8, d)
    elif rng.random() < 0.5:
        unit = np.full(d, float(rng.choice([1.0, 10.0, 4.0, 0.01])))
    push = 10.0 ** rng.uniform(-7, 8, m) if rng.random() < 0.25 else np.ones(m)
    width = rng.uniform(0.2, 1.5, m)
    middle = rng.uniform(-1, 1, m) * width * (rng.random() < 0.3)
    offset = 0.05 * rng.standard_normal(d) * (rng.random() < 0.3)
    if rng.random() < 0.03:  # a large drift that the inputs have to hold against
        drift = 10.0 ** rng.uniform(3, 12)
        middle, offset = middle + drift, offset - B @ np.full(m, drift)
    centre = np.zeros(d) if rng.random() < 0.7 else rng.uniform(-3, 3, d)
    agent: Spec = {
        "name": name,
        "A": (unit[:, None] * A / unit).tolist(),
        "B": (unit[:, None] * B / push).tolist(),
        "state_low": _rounded(unit * (centre - 1.0)),
        "state_high": _rounded(unit * (centre + 1.0)),
        "input_low": (push * (middle - width)).tolist(),
        "input_high": (push * (middle + width)).tolist(),
        "offset": (unit * (offset + centre - A @ centre)).tolist(),
        "correlated": correlated,
    }
    scaled = unit * deviation
    covariance = shape * np.outer(scaled, scaled)
    agent["noise_covariance"] = (0.5 * (covariance + covariance.T)).tolist()
    if rng.random() < 0.1:
        agent["output_matrix"] = (rng.standard_normal((int(rng.integers(1, d + 1)), d)) / unit).tolist()
    return agent


def _rounded(values: np.ndarray) -> list[float]:
    """Numbers of three digits, so that their decimals are short and seldom binary fractions."""
    return [float(f"{value:.3g}") for value in values]


def _region(rng: np.random.Generator, agent: Spec) -> Spec | None:
    """A box that meets the workspace, or sticks out of it."""
    low, high = np.array(agent["state_low"]), np.array(agent["state_high"])
    C = agent.get("output_matrix")
    if C is not None:
        corners = np.abs(np.array(C)) @ (0.5 * (high - low))
        middle = np.array(C) @ (0.5 * (high + low))
        low, high = middle - 0.6 * corners, middle + 0.6 * corners
    ends = np.sort(low + (high - low) * rng.uniform(-0.1, 1.1, (2, len(low))), axis=0)
    if rng.random() < 0.3:
        ends[1] = high
    if rng.random() < 0.2:
        ends[0] = low
    a, b = np.array(_rounded(ends[0])), np.array(_rounded(ends[1]))
    if np.any(b - a < 0.08 * (high - low)) or np.any(a >= high) or np.any(b <= low):
        return None
    return {"agent": agent["name"], "low": a.tolist(), "high": b.tolist()}


def _start(rng: np.random.Generator, agent: Spec, propositions: dict[str, Spec], correlated: bool) -> None:
    """A point, a point on the edge of a region, or a box."""
    low, high = np.array(agent["state_low"]), np.array(agent["state_high"])
    point = low + (high - low) * rng.uniform(0.1, 0.9, len(low))
    kind = rng.random()
    if kind < 0.15 and not correlated:
        other = low + (high - low) * rng.uniform(0.1, 0.9, len(low))
        agent["initial_low"] = np.minimum(point, other).tolist()
        agent["initial_high"] = np.maximum(point, other).tolist()
        return
    own = [region for region in propositions.values() if region["agent"] == agent["name"]]
    if kind < 0.3 and own and "output_matrix" not in agent:
        edge = np.array(own[0][str(rng.choice(["low", "high"]))])
        axis = int(rng.integers(len(point)))
        point[axis] = np.clip(edge[axis], low[axis], high[axis])
    elif kind < 0.34:
        point = np.where(rng.random(len(low)) < 0.5, low, high)
    agent["initial_state"] = point.tolist()


def _formula(rng: np.random.Generator, names: list[str], semantics: str, depth: int) -> Formula:
    """A formula; without operators that ask for all time if it is co-safe."""
    if depth == 0 or rng.random() < 0.08:
        return ("is" if rng.random() < 0.7 else "not", str(rng.choice(names)))
    kinds = ["F", "F", "Fab", "U", "and", "or", "X", "Gab"] + ["G", "G", "N", "R"] * (semantics == "finite-trace")
    kind = str(rng.choice(kinds))

    def part() -> Formula:
        return _formula(rng, names, semantics, depth - 1)

    if kind in ("and", "or", "U", "R"):
        return (kind, part(), part())
    if kind in ("X", "N"):
        return (kind, part())
    if len(kind) == 3:
        first = int(rng.integers(0, 3))
        return (kind[0], first, first + int(rng.integers(0, 4)), part())
    return (kind, 0, None, part())


def _options(rng: np.random.Generator, agents: list[Spec]) -> Spec:
    """Cells, relation and form of the value function."""
    cells = {}
    for agent in agents:
        d = len(agent["A"])
        most = {1: 60, 2: 14, 3: 5}[d] if len(agents) < 3 else {1: 24, 2: 8, 3: 4}[d]
        cells[agent["name"]] = [int(rng.integers(most // 3, most + 1)) for _ in range(d)]
    options: Spec = {"cells": cells, "max_sweeps": int(rng.integers(0, 3))}
    relation = str(rng.choice(["auto", "auto", "quick", "exact", "linear", "boxes", "paper"]))
    if relation != "auto":
        options["relation"] = relation
    if relation == "paper":
        options["delta"] = float(rng.choice([0.001, 0.01, 0.05]))
    if rng.random() < 0.2:
        options["value"] = str(rng.choice(["tree", "train"]))
    if rng.random() < 0.1:
        options["stationary"] = True
    return options
