"""A simulator written from the canonical problem alone: dynamics, noise, boxes and letters as the format says them."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

FUNCTIONS = {
    "abs": np.abs,
    "atan": np.arctan,
    "clip": np.clip,
    "cos": np.cos,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "sqrt": np.sqrt,
    "tan": np.tan,
    "tanh": np.tanh,
    "max": lambda *values: np.maximum.reduce(np.broadcast_arrays(*values)),
    "min": lambda *values: np.minimum.reduce(np.broadcast_arrays(*values)),
    "pi": np.pi,
}


class Simulator:
    """Runs of a canonical problem: states are lists of arrays (d_i, n), one for each agent."""

    def __init__(self, problem: dict[str, Any]) -> None:
        self.problem, self.agents = problem, problem["agents"]
        self.programs = [
            [compile(_python(text), "dynamics", "eval") for text in agent.get("dynamics", [])] for agent in self.agents
        ]
        self.outputs = [
            [compile(_python(text), "outputs", "eval") for text in agent["outputs"]] for agent in self.agents
        ]

    def means(self, x: list[np.ndarray], u: list[np.ndarray], v: list[dict[str, Any]], t: int) -> list[np.ndarray]:
        """The next states without noise."""
        named: dict[str, np.ndarray] = {}
        for agent, state, inputs in zip(self.agents, x, u, strict=True):
            values = [*zip(agent["states"], state, strict=True), *zip(agent["inputs"], inputs, strict=True)]
            named |= {f"{agent['name']}__of__{key}": value for key, value in values}
        result = []
        for i, agent in enumerate(self.agents):
            n = x[i].shape[1]
            if "A" in agent:
                drift = np.array(agent["A"]) @ x[i] + np.array(agent["B"]).reshape(len(x[i]), -1) @ u[i]
                result.append(drift + np.array(agent["c"])[:, None])
                continue
            local = {**FUNCTIONS, **named, "t": float(t), **agent.get("parameters", {}), **v[i]}
            local |= dict(zip(agent["states"], x[i], strict=True)) | dict(zip(agent["inputs"], u[i], strict=True))
            with np.errstate(all="ignore"):
                rows = [np.broadcast_to(eval(code, {}, local), n) for code in self.programs[i]]
            result.append(np.array(rows, dtype=float).reshape(-1, n))
        return result

    def noise(
        self, rng: np.random.Generator, x: list[np.ndarray], u: list[np.ndarray], t: int, v: list[dict[str, Any]]
    ) -> list[np.ndarray]:
        """Noise of one step, which may depend on states, inputs and disturbances."""
        n = x[0].shape[1]
        common = rng.standard_normal((np.array(self.agents[0].get("shared_noise", [[]])).shape[-1], n))
        result = []
        for i, agent in enumerate(self.agents):
            factor = np.array(agent["noise"]).reshape(len(agent["states"]), -1)
            laws = agent.get("distributions", [{"law": "gaussian", "std": 1.0}] * factor.shape[1])
            own = factor @ np.array([_drawn(law, rng, n) for law in laws]).reshape(-1, n)
            if agent.get("noise_scale"):
                local = {**FUNCTIONS, "t": float(t), **agent.get("parameters", {}), **v[i]}
                local |= dict(zip(agent["states"], x[i], strict=True)) | dict(zip(agent["inputs"], u[i], strict=True))
                own = own * np.array([eval(_python(text), {}, local) + np.zeros(n) for text in agent["noise_scale"]])
            result.append(own)
            if "shared_noise" in agent:
                result[-1] = result[-1] + np.array(agent["shared_noise"]) @ common
        return result

    def wrapped(self, x: list[np.ndarray]) -> list[np.ndarray]:
        """States with angles reduced into their turn."""
        for agent, state in zip(self.agents, x, strict=True):
            for angle in agent.get("angles", []):
                k = agent["states"].index(angle)
                low, high = agent["state_low"][k], agent["state_high"][k]
                state[k] = low + np.mod(state[k] - low, high - low)
        return x

    def letters(self, x: list[np.ndarray], t: int) -> np.ndarray:
        """Which propositions hold, bool (P, n)."""
        n, outputs = x[0].shape[1], []
        for agent, state, codes in zip(self.agents, x, self.outputs, strict=True):
            local = {**FUNCTIONS, **agent.get("parameters", {}), **dict(zip(agent["states"], state, strict=True))}
            with np.errstate(all="ignore"):
                outputs.append([np.broadcast_to(eval(code, {}, local), n) for code in codes])
        rows = []
        for region in self.problem["regions"]:
            rows.append(_inside(outputs[region["agent"]], region, t, n))
        for pair in self.problem["pairs"]:
            (a, b), (first, second) = pair["agents"], pair["outputs"]
            difference = [outputs[a][k] - outputs[b][m] for k, m in zip(first, second, strict=True)]
            if "radius" in pair:
                radius = pair["radius"][t] if isinstance(pair["radius"], list) else pair["radius"]
                rows.append((sum(y * y for y in difference) < radius * radius) & (radius > 0))
            else:
                rows.append(_inside(difference, pair, t, n))
        return np.array(rows, dtype=bool).reshape(-1, n)

    def in_workspace(self, x: list[np.ndarray]) -> np.ndarray:
        """Whether all agents are in their workspaces, bool (n,)."""
        inside = np.ones(x[0].shape[1], dtype=bool)
        for agent, state in zip(self.agents, x, strict=True):
            low, high = (np.array(agent[key])[:, None] for key in ("state_low", "state_high"))
            inside &= np.all((low <= state) & (state <= high), axis=0)
        return inside

    def failures(
        self, proof: dict[str, Any], arrays: list[np.ndarray], rng: np.random.Generator, n: int, extreme: float = 1.0
    ) -> int:
        """How many of n runs of the controllers in a file fail; disturbances are at one end of their ranges."""
        # a start of -0.0 is one of 0.0
        x = [rng.uniform(a["start_low"], np.add(a["start_high"], 0.0), (n, len(a["states"]))).T for a in self.agents]
        v = [
            {k: low + (high - low) * extreme for k, (low, high) in a.get("disturbances", {}).items()}
            for a in self.agents
        ]
        task = self.problem["task"]
        q = np.full(n, task["automaton"]["initial"])
        accepting = np.array(task["automaton"]["accepting"])
        alive = np.ones(n, dtype=bool)
        for t in range(self.problem["horizon"] + 1):
            done = accepting[q] if task["semantics"] == "co-safe" else np.zeros(n, dtype=bool)
            alive &= self.in_workspace(x) | done if t else True
            q = np.where(done | ~alive, q, _read(task["automaton"], q, self.letters(x, t)))
            if t == self.problem["horizon"]:
                break
            u = []
            for agent, entry, state in zip(self.agents, proof["agents"], x, strict=True):
                choose = _on_cells if proof["kind"] == "cells" else _along_trajectory
                chosen = choose(agent, entry, arrays, state, q, t)
                u.append(np.clip(chosen, np.array(agent["input_low"])[:, None], np.array(agent["input_high"])[:, None]))
            means, noise = self.means(x, u, v, t), self.noise(rng, x, u, t, v)
            x = self.wrapped([mean + own for mean, own in zip(means, noise, strict=True)])
        return int(n - np.sum(alive & accepting[q]))


def _drawn(law: dict[str, Any], rng: np.random.Generator, n: int) -> np.ndarray:
    """Draw n numbers of a distribution."""
    if law["law"] == "gaussian":
        return law["std"] * rng.standard_normal(n)
    if law["law"] == "uniform":
        return rng.uniform(law["low"], law["high"], n)
    if law["law"] == "triangular":
        return rng.triangular(law["low"], law["mode"], law["high"], n)
    if law["law"] in ("laplace", "logistic"):
        return getattr(rng, law["law"])(0.0, law["scale"], n)
    if law["law"] == "student-t":
        return law["scale"] * rng.standard_t(law["df"], n)
    if law["law"] == "truncated-gaussian":
        drawn = law["spread"] * rng.standard_normal((64, n))
        inside = (law["low"] <= drawn) & (drawn <= law["high"])
        return np.asarray(drawn[inside.argmax(axis=0), np.arange(n)])
    weights = np.array([part["weight"] for part in law["parts"]])
    each = np.array([part["mean"] + _drawn(part, rng, n) for part in law["parts"]])
    return np.asarray(each[rng.choice(len(each), n, p=weights / weights.sum()), np.arange(n)])


def _along_trajectory(
    agent: dict[str, Any], entry: dict[str, Any], arrays: list[np.ndarray], state: np.ndarray, q: np.ndarray, t: int
) -> np.ndarray:
    """Inputs (m, n) of an agent along a trajectory; anything after it."""
    if t >= len(arrays[entry["inputs"]]):
        return np.zeros((len(agent["inputs"]), state.shape[1]))
    gain, nominal = arrays[entry["gains"]][t], arrays[entry["states"]][t]
    error = state - nominal[:, None]
    for angle in agent.get("angles", []):
        k = agent["states"].index(angle)
        error[k] = np.mod(error[k] + np.pi, 2.0 * np.pi) - np.pi
    return np.asarray(arrays[entry["inputs"]][t][:, None] + gain @ error)


def _on_cells(
    agent: dict[str, Any], entry: dict[str, Any], arrays: list[np.ndarray], state: np.ndarray, q: np.ndarray, t: int
) -> np.ndarray:
    """Inputs (m, n) of an agent on cells, whose dynamics are matrices where it has targets."""
    edges, lattice = ([arrays[k] for k in entry[key]] for key in ("edges", "lattice"))
    places = [
        np.clip(np.searchsorted(e, x, side="right") - 1, 0, len(e) - 2) for e, x in zip(edges, state, strict=True)
    ]
    cell = np.ravel_multi_index(places, [len(axis) - 1 for axis in edges])
    policy = arrays[entry["policy"]]
    choice = policy[min(t, len(policy) - 1), q, cell]
    inputs = arrays[entry["inputs"]]
    aimed = np.maximum(choice - len(inputs), 0)
    targets = np.stack([axis[k] for axis, k in zip(lattice, np.unravel_index(aimed, [len(axis) for axis in lattice]))])
    A, c = np.array(agent["A"]), np.array(agent["c"])[:, None]
    inverse = np.zeros((len(agent["inputs"]), len(state))) if entry["inverse"] is None else arrays[entry["inverse"]]
    toward = inverse @ (targets - A @ state - c)
    if not len(inputs):
        return np.where(choice < 0, 0.0, toward)
    return np.where(
        choice >= len(inputs), toward, np.where(choice < 0, 0.0, inputs[np.clip(choice, 0, len(inputs) - 1)].T)
    )


def _python(text: str) -> str:
    """An expression as Python reads it; names of other agents become plain ones."""
    return re.sub(r"([A-Za-z_]\w*)\.([A-Za-z_]\w*)", r"\1__of__\2", text.replace("^", "**"))


def _inside(values: list[np.ndarray], region: dict[str, Any], t: int, n: int) -> np.ndarray:
    low, high = (
        corner[t] if corner and isinstance(corner[0], list) else corner for corner in (region["low"], region["high"])
    )
    inside = np.ones(n, dtype=bool)
    for y, a, b in zip(values, low, high, strict=True):
        inside &= (y >= (-np.inf if a is None else a)) & (y < (np.inf if b is None else b))
    return inside


def _read(automaton: dict[str, Any], q: np.ndarray, letters: np.ndarray) -> np.ndarray:
    """The states after a letter, for many runs."""
    entry, runs = np.array(automaton["root"])[q], np.arange(len(q))
    variable, low, high = (np.array(automaton[key], dtype=int) for key in ("variable", "low", "high"))
    while np.any(entry >= 0):
        node = np.maximum(entry, 0)
        after = np.where(letters[variable[node], runs], high[node], low[node]) if len(variable) else entry
        entry = np.where(entry >= 0, after, entry)
    return -1 - entry
