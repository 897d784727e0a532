"""Spaces, observations and actions of environments, for one world and for batches alike.

An observation is a list of states, each projected onto its workspace, then the automaton state one-hot, then the
fraction of time left. Spaces are bounded, because the projection stays in them; the true state is in the info.

- "local": the state of the agent itself;
- "full": the state of the agent itself, then the states of the other agents in order;
- "relative": the state of the agent itself, then the states of the other agents in order, each less its own (as many
  components as both have);
- joint (the centralised environment, and `state()`): the states of all agents in order.

Actions are inputs as the dynamics take them ("input": the input box), or scaled to [-1, 1] ("unit", float32). Either
way they are clipped. The dynamics are float64 for every precision of observations.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np
from gymnasium import spaces

from ..agents import AnyAgent, shown
from ..dynamics import Dynamics, Worlds, joint
from ..problem import Problem

SCOPES = ("local", "full", "relative")
PRECISIONS = ("float64", "float32")
ACTIONS = ("input", "unit")
INFOS = ("numbers", "words")

RESET_OPTIONS = ("initial_state",)
"""Keys that `reset(options=...)` takes."""

PLACEHOLDER = "options"
"""A key that means nothing: PettingZoo's conformance tests pass `{"options": 1}` to every environment."""


def checked_option(value: Any, argument: str, choices: Sequence[str]) -> str:
    """Return an option if it is one of the choices, or raise ValueError."""
    if value not in choices:
        raise ValueError(f"`{argument}`: expected {' or '.join(map(repr, choices))}, got {shown(value)}")
    return str(value)


def checked_reset(options: dict[str, Any] | None, known: Sequence[str] = RESET_OPTIONS) -> dict[str, Any]:
    """Return the options of a `reset` if all keys are known, or raise ValueError."""
    options = dict(options or {})
    for name in options:
        if name not in (*known, PLACEHOLDER):
            raise ValueError(f"`options`: expected the keys {' and '.join(map(repr, known))}, got {shown(name)}")
    return options


def observation_space(problem: Problem, agents: Sequence[AnyAgent], dtype: str) -> spaces.Box:
    """Return the space of observations that list the states of `agents`."""
    # The automaton state one-hot and the fraction of time left lie between 0 and 1.
    zeros = np.zeros(problem.automaton.n_states + 1)
    low = np.concatenate([*(agent.state_low for agent in agents), zeros])
    high = np.concatenate([*(agent.state_high for agent in agents), zeros + 1.0])
    return spaces.Box(low.astype(dtype), high.astype(dtype), dtype=np.dtype(dtype).type)


def relative_space(problem: Problem, agent: AnyAgent, dtype: str) -> spaces.Box:
    """Return the space of observations of an agent that sees the others from its own place."""
    zeros = np.zeros(problem.automaton.n_states + 1)
    lows, highs = [agent.state_low], [agent.state_high]
    for other in problem.agents:
        if other is not agent:
            d = min(agent.n_states, other.n_states)
            lows.append(other.state_low[:d] - agent.state_high[:d])
            highs.append(other.state_high[:d] - agent.state_low[:d])
    low, high = np.concatenate([*lows, zeros]), np.concatenate([*highs, zeros + 1.0])
    return spaces.Box(low.astype(dtype), high.astype(dtype), dtype=np.dtype(dtype).type)


def action_space(agents: Sequence[AnyAgent], actions: str) -> spaces.Box:
    """Return the space of the inputs of `agents`, one after the other."""
    if actions == "unit":
        return spaces.Box(-1.0, 1.0, (sum(agent.n_inputs for agent in agents),), dtype=np.float32)
    low = np.concatenate([agent.input_low for agent in agents])
    return spaces.Box(low, np.concatenate([agent.input_high for agent in agents]), dtype=np.float64)


def projected(states: Any, agents: Sequence[Any]) -> list[float]:
    """Return the numbers of several states, each moved into its agent's workspace; NaN becomes the lower edge."""
    result = []
    for x, agent in zip(states, agents):
        for value, low, high in zip(x, agent.state_low, agent.state_high):
            result.append(low if value < low else high if value > high else value if value == value else low)
    return result


def shared(problem: Problem, q: int, time: int) -> list[float]:
    """Return the automaton state one-hot and the fraction of time left."""
    result = [0.0] * (problem.automaton.n_states + 1)
    result[q] = 1.0
    result[-1] = 1.0 - time / problem.horizon
    return result


def joint_observations(dynamics: Dynamics, worlds: Worlds, dtype: str) -> np.ndarray:
    """Return the joint observations of a batch, shape (M, D + Q + 1)."""
    problem = dynamics.problem
    n, n_q = problem.n_states, problem.automaton.n_states
    result = np.zeros((worlds.n_worlds, n + n_q + 1))
    low = np.concatenate([agent.state_low for agent in problem.agents])
    high = np.concatenate([agent.state_high for agent in problem.agents])
    states = joint(dynamics, worlds)
    # The same projection as `projected`.
    np.clip(np.where(np.isnan(states), low, states), low, high, out=result[:, :n])
    result[np.arange(worlds.n_worlds), n + worlds.q] = 1.0
    result[:, -1] = 1.0 - worlds.time / problem.horizon
    return result.astype(dtype, copy=False)


def input_of(action: Any, agent: Any, actions: str, name: str) -> list[float]:
    """Return the input for an action of one agent, clipped to the input box.

    Raises
    ------
    ValueError
        If the action has another length or is not finite.
    """
    # Plain numbers, as a single world computes on them.
    numbers = np.asarray(action).tolist()
    size = len(agent.input_low)
    if size == 1 and not isinstance(numbers, list):  # some learners drop an axis of length 1
        numbers = [numbers]
    if not isinstance(numbers, list) or len(numbers) != size or not all(map(_is_number, numbers)):
        raise ValueError(f"`{name}`: expected finite numbers of shape ({size},), got {shown(action)}")
    result = []
    for value, low, high in zip(numbers, agent.input_low, agent.input_high):
        if actions == "unit":  # centre plus half width, as `batch_inputs` computes it: the same bits
            value = (0.5 * low + 0.5 * high) + (0.5 * high - 0.5 * low) * min(max(value, -1.0), 1.0)
        result.append(low if value < low else high if value > high else float(value))
    return result


def batch_inputs(dynamics: Dynamics, action: Any, actions: str) -> tuple[np.ndarray, ...]:
    """Return the inputs (m, n, M) per block for joint actions (M, sum of m_i), clipped to the input boxes.

    Raises
    ------
    ValueError
        If the actions have another shape or are not finite.
    """
    problem = dynamics.problem
    joint_actions = np.asarray(action, dtype=np.float64)
    if joint_actions.ndim == 1 and problem.n_inputs == 1:  # some learners drop an axis of length 1
        joint_actions = joint_actions[:, None]
    is_table = joint_actions.ndim == 2 and joint_actions.shape[1] == problem.n_inputs
    if not is_table or not np.isfinite(joint_actions).all():
        raise ValueError(
            f"`actions`: expected finite numbers of shape (number of worlds, {problem.n_inputs}), got shape "
            f"{joint_actions.shape}"
        )
    # Columns of the joint action for each component and agent of a block: (m, n).
    starts = np.array([columns.start for columns in problem.input_columns])
    result = []
    for block in dynamics.blocks:
        columns = starts[block.agents] + np.arange(block.input_low.shape[0])[:, None]
        u = np.ascontiguousarray(joint_actions.T[columns])
        if actions == "unit":
            centre, half = (
                0.5 * block.input_low + 0.5 * block.input_high,
                0.5 * block.input_high - 0.5 * block.input_low,
            )
            u = centre + half * np.minimum(np.maximum(u, -1.0), 1.0)
        result.append(np.minimum(np.maximum(u, block.input_low), block.input_high))
    return tuple(result)


def _is_number(value: Any) -> bool:
    return isinstance(value, float | int) and isfinite(value)
