"""Policies that are written as expressions, of all agents of a problem: textbook feedback."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Dynamics
from ...envs.tasks.problem import Problem
from ..relations.kinds import SymbolicPolicy
from .local_policies import LocalBatch


@dataclass(frozen=True, eq=False)
class SymbolicPolicies:
    """Expressions of the own states of every agent, and the time: a decentralised policy.

    Parameters
    ----------
    problem : Problem
    policies : tuple of WrittenPolicy
        One for each agent.
    """

    problem: Problem
    policies: tuple[SymbolicPolicy, ...]

    information = "own state, time"

    def inputs(self, agent: int, states: NDArray[Any], q: NDArray[Any], time: int) -> NDArray[Any]:
        """Return the inputs (m, N) of one agent at states (d, N) and a time."""
        return self.policies[agent].inputs(states, np.asarray(q), time)

    def agent_policy(self, agent: int) -> SymbolicPolicy:
        """Return the policy of one agent."""
        return self.policies[agent]

    def batch(self, dynamics: Dynamics) -> LocalBatch:
        """Return the policy for batched rollouts."""
        return LocalBatch(self, dynamics)


def is_written(model: Any, problem: Problem) -> bool:
    """Return whether a mapping says expressions of inputs: by agents, or of a single agent by its inputs."""
    if not isinstance(model, Mapping) or not model:
        return False
    if problem.n_agents == 1 and not set(model) & set(problem.agent_names):
        return all(isinstance(own, str) or _are_texts(own) for own in model.values())
    return all(_are_texts(own) for own in model.values())


def _are_texts(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(text, str) for text in value)


def symbolic_policies(model: Mapping[str, Any], problem: Problem) -> SymbolicPolicies:
    """Return the policies that a mapping says.

    Raises
    ------
    ValueError
        If agents or inputs are missing or unknown, or an expression cannot be read.
    """
    by_agent = dict(model)
    if problem.n_agents == 1 and not set(model) & set(problem.agent_names):
        (agent,) = problem.agents
        names = list(getattr(agent, "inputs", None) or [f"u{k}" for k in range(agent.n_inputs)])
        if set(model) == {"u"} and _are_texts(model["u"]):
            texts = list(model["u"])
        elif set(model) == set(names):
            texts = [own if isinstance(own, str) else " ".join(own) for own in (model[name] for name in names)]
        else:
            raise ValueError(f"`policy`: expected an expression for each of {', '.join(names)}, got {', '.join(model)}")
        by_agent = {agent.name: texts}
    if set(by_agent) != set(problem.agent_names):
        raise ValueError(
            f"`policy`: expected lists of expressions for each of {', '.join(problem.agent_names)}, got some for "
            f"{', '.join(by_agent)}"
        )
    made = (SymbolicPolicy.of(agent, by_agent[agent.name]) for agent in problem.agents)
    return SymbolicPolicies(problem, tuple(made))
