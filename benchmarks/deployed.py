"""Controllers of certificates as the independent simulator runs them, and the package's records of random problems."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import certigym as cg
from certigym.synthesis.certificates.proofs import ProductProof
from random_problems import Spec


def agent_of(agent: Spec) -> cg.LinearAgent | cg.Agent:
    """The package's record of a random agent."""
    return cg.Agent(**agent["written"]) if "written" in agent else cg.LinearAgent(**agent)


def arguments_of(spec: Spec) -> dict[str, Any]:
    """Arguments of `synthesize` from the options of a random problem, which are flat, as its text is."""
    flat = dict(spec["options"])
    names = [name for name in ("cells", "relation", "horizon", "effort", "above") if name in flat]
    arguments = {name: flat.pop(name) for name in names}
    return {**arguments, "search": cg.SearchOptions(**flat)}


def problem_of(spec: Spec) -> cg.Problem:
    """The package's record of a random problem."""
    return cg.Problem(
        name="random",
        horizon=spec["horizon"],
        agents=[agent_of(agent) for agent in spec["agents"]],
        propositions={
            name: (cg.Pair if "agents" in region else cg.Proposition)(**region)
            for name, region in spec["propositions"].items()
        },
        specification=cg.Specification(spec["text"], spec["semantics"]),
    )


class Deployed:
    """The controllers of a certificate, their automaton states kept by letters that the simulator read."""

    def __init__(self, certificate: Any, episodes: int, seed: int) -> None:
        self.problem = certificate.problem
        parts: Any = certificate.proof.parts if isinstance(certificate.proof, ProductProof) else (certificate,)
        names = self.problem.agent_names
        self.parts = [(part, [names.index(name) for name in part.problem.agent_names]) for part in parts]
        self.q = [np.full(episodes, part.problem.automaton.initial) for part, _ in self.parts]
        self.memory: dict[int, Any] = {}
        self.rng = np.random.default_rng([seed, 1])

    def __call__(self, states: list[np.ndarray], held: list[dict[str, np.ndarray]], t: int) -> list[np.ndarray]:
        inputs: list[Any] = [None] * len(states)
        for k, (part, members) in enumerate(self.parts):
            own = {name: value for i in members for name, value in held[i].items()}
            empty = np.zeros((0, len(self.q[k])), dtype=bool)
            letters = np.stack([own[name] for name in part.problem.propositions]) if own else empty
            self.q[k] = part.problem.automaton.next_state(self.q[k], letters)
            if not hasattr(part.controller, "agents"):  # along a path
                follow: Any = part.controller
                for j, i in enumerate(members):
                    inputs[i] = follow._inputs(j, states[i], t)
                continue
            for i, agent in zip(members, part.controller.agents, strict=True):
                x = states[i][:, None]
                if t == 0:
                    self.memory[i] = agent.begin(x)
                uniform = self.rng.random((1, x.shape[-1])) if agent.draws else None
                beside = self._beside(i, states)
                u, self.memory[i] = agent.act(x, self.q[k], t, self.memory[i], uniform, beside)
                inputs[i] = u[:, 0]
        return inputs

    def _beside(self, i: int, states: list[np.ndarray]) -> np.ndarray | None:
        """States of others (l, 1, M) that an agent's dynamics name; their inputs are no numbers."""
        names = getattr(self.problem.agents[i], "others", ())
        rows = []
        for name in names:
            other, what = name.split(".")
            x = states[self.problem.agent_names.index(other)]
            rows.append(x[int(what[1:])] if what[0] == "x" else np.full(x.shape[1], np.nan))
        return np.array(rows)[:, None] if rows else None


class Followed:
    """``u = ubar + K (x - xbar)`` within the input box, from plain arrays; after its end a path's last input."""

    def __init__(self, spec: Spec, paths: Sequence[Any]) -> None:
        self.paths, self.agents = paths, spec["agents"]

    def __call__(self, states: list[np.ndarray], held: list[dict[str, np.ndarray]], t: int) -> list[np.ndarray]:
        inputs = []
        for agent, path, x in zip(self.agents, self.paths, states):
            k = min(t, len(path.inputs) - 1)
            wanted = path.inputs[k][:, None] + path.gains[k] @ (x - path.states[k][:, None])
            low, high = (np.array(agent[side])[:, None] for side in ("input_low", "input_high"))
            inputs.append(np.clip(wanted, low, high))
        return inputs


class Networked:
    """A network for all agents, its actions computed here in single precision."""

    def __init__(self, spec: Spec, problem: cg.Problem, network: Any, episodes: int) -> None:
        self.spec, self.problem, self.network = spec, problem, network
        self.q = np.full(episodes, problem.automaton.initial)
        self.width = max(len(agent["A"]) for agent in spec["agents"])

    def __call__(self, states: list[np.ndarray], held: list[dict[str, np.ndarray]], t: int) -> list[np.ndarray]:
        own = {name: value for each in held for name, value in each.items()}
        letters = np.stack([own[name] for name in self.problem.propositions])
        self.q = self.problem.automaton.next_state(self.q, letters)
        n_states, n_agents, inputs = self.problem.automaton.n_states, len(states), []
        for i, (agent, x) in enumerate(zip(self.spec["agents"], states)):
            low, high = (np.array(agent[side])[:, None] for side in ("state_low", "state_high"))
            rows = np.zeros((x.shape[1], self.width + n_states + 1 + n_agents), dtype=np.float32)
            rows[:, : len(x)] = (2.0 * (np.clip(x, low, high) - low) / (high - low) - 1.0).T
            rows[np.arange(len(rows)), self.width + self.q] = 1.0
            rows[:, self.width + n_states] = 1.0 - t / self.spec["horizon"]
            rows[:, self.width + n_states + 1 + i] = 1.0
            last = len(self.network.weights) - 1
            for k, (weight, bias) in enumerate(zip(self.network.weights, self.network.biases)):
                rows = rows @ weight.T + bias
                if k < last:
                    rows = np.tanh(rows) if self.network.activation == "tanh" else np.maximum(rows, 0)
            action = np.tanh(rows) if self.network.squashed else np.clip(rows, -1.0, 1.0)
            bottom, top = (np.array(agent[side])[:, None] for side in ("input_low", "input_high"))
            share = 0.5 * (action.T[: len(bottom)].astype(float) + 1.0)
            inputs.append(np.clip(bottom + share * (top - bottom), bottom, top))
        return inputs
