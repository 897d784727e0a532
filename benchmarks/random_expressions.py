"""Random problems whose agents are written as expressions: random linear agents, bent by terms of every kind."""

from __future__ import annotations

import numpy as np

from random_problems import Spec, random_spec
from tuple_expressions import Expression, text_of


def written_spec(seed: int) -> Spec:
    """A random problem whose agents are written as expressions; further keys are ``written`` and ``tuples``."""
    spec = random_spec(seed, "boxes")
    rng = np.random.default_rng([20261122, seed])
    for agent in spec["agents"]:
        agent.pop("output_matrix", None)
        _write(rng, agent)
    # Regions of outputs that are no states any more are those of the states instead.
    sizes = {agent["name"]: len(agent["state_low"]) for agent in spec["agents"]}
    if any(len(region["low"]) != sizes[region["agent"]] for region in spec["propositions"].values()):
        return written_spec(seed + 1_000_003)
    spec["options"] = {"cells": spec["options"]["cells"], "max_sweeps": spec["options"]["max_sweeps"]}
    return spec


def aimed_spec(seed: int) -> Spec:
    """A random problem of agents with expressions whose inputs reach every mean, for the relation ``exact``."""
    spec = random_spec(seed, "exact")
    rng = np.random.default_rng([20261123, seed])
    for agent in spec["agents"]:
        agent.pop("output_matrix", None)
        agent["noise_covariance"] = np.diag(np.diag(agent["noise_covariance"])).tolist()
        _write_aimed(rng, agent)
    sizes = {agent["name"]: len(agent["state_low"]) for agent in spec["agents"]}
    if any(len(region["low"]) != sizes[region["agent"]] for region in spec["propositions"].values()):
        return aimed_spec(seed + 1_000_003)
    spec["options"] = {"cells": spec["options"]["cells"], "relation": "exact"}
    return spec


def uneven_spec(seed: int) -> Spec:
    """A random problem of agents with expressions whose noise has scales, or that have states without noise.

    Further keys are ``scales`` (nested tuples) and ``law``, a pair of names of laws and their numbers.
    """
    spec = random_spec(seed, "boxes")
    rng = np.random.default_rng([20261124, seed])
    for agent in spec["agents"]:
        agent.pop("output_matrix", None)
        _write(rng, agent)
        _make_uneven(rng, agent)
    sizes = {agent["name"]: len(agent["state_low"]) for agent in spec["agents"]}
    if any(len(region["low"]) != sizes[region["agent"]] for region in spec["propositions"].values()):
        return uneven_spec(seed + 1_000_003)
    spec["options"] = {"cells": spec["options"]["cells"], "relation": "boxes"}
    return spec


def _make_uneven(rng: np.random.Generator, agent: Spec) -> None:
    """Give noise of an agent scales of state and input, and take it away from some states."""
    d = len(agent["state_low"])
    low, high = np.array(agent["state_low"]), np.array(agent["state_high"])
    scaled: list[Expression] = [
        ("/", ("-", f"x{k}", float(c)), float(h))
        for k, (c, h) in enumerate(zip(0.5 * (high + low), 0.5 * (high - low)))
    ]
    push = np.maximum(np.abs(agent["input_low"]), np.abs(agent["input_high"]))
    deviations = np.sqrt(np.diag(agent.pop("noise_covariance")))
    still = rng.random(d) < 0.3
    if still.all() and d > 1:
        still[int(rng.integers(d))] = False
    scales: list[Expression] = []
    for k in range(d):
        kind = int(rng.integers(4))
        a = scaled[int(rng.integers(d))]
        forms: list[Expression] = [
            ("+", 0.6, ("*", 0.4, ("abs", a))),
            ("exp", ("*", 0.3, a)),
            ("+", 1.0, ("*", 0.3 / float(push[0]), ("abs", "u0"))),
            ("max", 0.7, a),
        ]
        scales.append(1.0 if still[k] else forms[kind])
    names = [
        "gaussian" if rng.random() < 0.5 else str(rng.choice(["laplace", "uniform", "logistic"])) for _ in range(d)
    ]
    laws = []
    for name, deviation, none in zip(names, deviations.tolist(), still):
        size = 0.0 if none else deviation
        if none or name == "gaussian":
            laws.append({"law": "gaussian", "std": size})
        elif name == "uniform":
            laws.append({"law": name, "low": -(3.0**0.5) * size, "high": 3.0**0.5 * size})
        else:
            laws.append({"law": name, "scale": size / (2.0**0.5 if name == "laplace" else np.pi / 3.0**0.5)})
    agent["scales"], agent["laws"] = scales, laws
    written = agent["written"]
    del written["noise_covariance"]
    written |= {"noise": laws, "noise_scale": [text_of(scale) if scale != 1.0 else "1" for scale in scales]}


def _write_aimed(rng: np.random.Generator, agent: Spec) -> None:
    """Means ``a(x) + B(x) v``: inputs v one by one or tied, in the plane sometimes as size and angle."""
    d, m = len(agent["A"]), len(agent["B"][0])
    low, high = np.array(agent["state_low"]), np.array(agent["state_high"])
    half, centre = 0.5 * (high - low), 0.5 * (high + low)
    states, inputs = [f"x{k}" for k in range(d)], [f"u{j}" for j in range(m)]
    scaled: list[Expression] = [("/", ("-", x, float(c)), float(h)) for x, c, h in zip(states, centre, half)]
    moved: list[Expression] = list(inputs)
    if d == 2 and m == 2 and rng.random() < 0.4:
        size = float(max(np.abs(agent["input_high"]).max(), np.abs(agent["input_low"]).max()))
        agent["input_low"] = [float(rng.choice([0.0, 0.2])) * size, -3.2]
        agent["input_high"] = [size, 3.2]
        moved = [("*", "u0", ("cos", "u1")), ("*", "u0", ("sin", "u1"))]
    dynamics: list[Expression] = []
    for k in range(d):
        total: Expression = float(agent["offset"][k])
        for j, x in enumerate(states):
            if agent["A"][k][j] != 0.0:
                total = ("+", total, ("*", float(agent["A"][k][j]), x))
        for j, v in enumerate(moved):
            gain: Expression = float(agent["B"][k][j])
            if gain != 0.0 and rng.random() < 0.5:  # inputs push harder in some places
                gain = ("*", gain, ("+", 1.0, ("*", 0.3, ("cos", ("*", 2.0, scaled[int(rng.integers(d))])))))
            total = total if gain == 0.0 else ("+", total, ("*", gain, v))
        for _ in range(int(rng.integers(0, 3))):
            total = ("+", total, ("*", float(half[k] * rng.uniform(-0.1, 0.1)), _term(rng, scaled)))
        dynamics.append(total)
    agent["tuples"], agent["winds"] = dynamics, {}
    keys = ("name", "state_low", "state_high", "input_low", "input_high", "noise_covariance")
    starts = [key for key in agent if key.startswith("initial_")]
    texts = [text_of(expression) for expression in dynamics]
    agent["written"] = {key: agent[key] for key in (*keys, *starts)} | {
        "states": states,
        "inputs": inputs,
        "dynamics": texts,
    }


def _write(rng: np.random.Generator, agent: Spec) -> None:
    """Bend the linear dynamics of an agent: the same matrices, and terms of every kind."""
    d, m = len(agent["A"]), len(agent["B"][0])
    low, high = np.array(agent["state_low"]), np.array(agent["state_high"])
    half, centre = 0.5 * (high - low), 0.5 * (high + low)
    states, inputs = [f"x{k}" for k in range(d)], [f"u{j}" for j in range(m)]
    # Coordinates between -1 and 1, whatever the units are.
    scaled: list[Expression] = [("/", ("-", x, float(c)), float(h)) for x, c, h in zip(states, centre, half)]
    winds = {"v0": [-0.05, 0.08]} if rng.random() < 0.3 else {}
    dynamics: list[Expression] = []
    for k in range(d):
        total: Expression = float(agent["offset"][k])
        for j, x in enumerate(states):
            if agent["A"][k][j] != 0.0:
                total = ("+", total, ("*", float(agent["A"][k][j]), x))
        for j, u in enumerate(inputs):
            gain: Expression = float(agent["B"][k][j])
            if gain != 0.0:
                if rng.random() < 0.4:  # inputs push harder in some places
                    gain = ("*", gain, ("+", 1.0, ("*", 0.3, ("cos", ("*", 2.0, scaled[int(rng.integers(d))])))))
                total = ("+", total, ("*", gain, u) if rng.random() < 0.8 else ("*", gain, ("sin", u)))
        for _ in range(int(rng.integers(0, 3))):
            total = ("+", total, ("*", float(half[k] * rng.uniform(-0.15, 0.15)), _term(rng, scaled)))
        if winds and rng.random() < 0.6:
            total = ("+", total, ("*", float(half[k]), "v0"))
        dynamics.append(total)
    agent["tuples"], agent["winds"] = dynamics, winds
    keys = ("name", "state_low", "state_high", "input_low", "input_high", "noise_covariance")
    starts = [key for key in agent if key.startswith("initial_")]
    agent["written"] = {key: agent[key] for key in (*keys, *starts)} | {
        "states": states,
        "inputs": inputs,
        "dynamics": [text_of(expression) for expression in dynamics],
        "disturbances": winds,
    }


def _term(rng: np.random.Generator, scaled: list[Expression]) -> Expression:
    """A bent term of coordinates between -1 and 1."""
    a, b = (scaled[int(rng.integers(len(scaled)))] for _ in range(2))
    terms: list[Expression] = [
        ("sin", ("*", float(rng.uniform(1, 6)), a)),
        ("tanh", ("*", 3.0, a)),
        ("*", a, b),
        ("**", a, 3.0),
        ("abs", ("-", a, b)),
        ("min", a, ("*", 0.5, b)),
        ("clip", ("*", 2.0, a), -0.7, 0.6),
        ("exp", ("-", 0.0, ("*", a, a))),
        ("/", a, ("+", 1.5, ("*", b, b))),
        ("sqrt", ("+", 0.2, ("abs", a))),
        ("atan", ("*", 4.0, b)),
        ("log", ("+", 1.3, a)),  # not defined a little beyond the workspace, and nearly not inside of it
        ("tan", a),
        ("max", ("**", ("abs", a), 1.5), b),
    ]
    return terms[int(rng.integers(len(terms)))]
