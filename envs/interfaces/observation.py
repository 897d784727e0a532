"""Spaces, observations and actions of environments, for one world and for batches alike.

An observation is a list of states as they are, then the automaton state, then the fraction of time left. A state may
leave its workspace, by any amount where noise is unbounded, and is seen where it is: so spaces do not bound states.
Only `scale="unit"`, for learners that need a finite range, is bounded: there states outside count as the edge.

- "local": the state of the agent itself;
- "full": the state of the agent itself, then the states of the other agents in order;
- "relative": the state of the agent itself, then the states of the other agents in order, each less its own (as many
  components as both have);
- "neighbours": the state of the agent itself, then where the nearest other agents are (see `nearest`);
- joint (the centralised environment, and `state()`): the states of all agents in order.

How numbers stand in an observation is its `Form`: states as they are ("raw") or with the range of each component mapped
to [-1, 1] ("unit"); the automaton state "one-hot", as a "number", or "hidden". Sensors may be noisy (see `sensors`).

Actions are inputs as the dynamics take them ("input": the input box), or scaled to [-1, 1] ("unit", float32). Either
way they are clipped. The dynamics are float64 for every precision of observations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from typing import Any

import numpy as np
from gymnasium import spaces

from ..simulation import Dynamics, Worlds
from ..systems.agents import AnyAgent
from ..systems.arguments import read_only, shown
from ..systems.backends import double, is_host, namespace
from ..tasks.problem import Problem

SCOPES = ("local", "full", "relative", "neighbours")
SCALES = ("raw", "unit")
AUTOMATON = ("one-hot", "number", "hidden")
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


Bounds = tuple[np.ndarray, np.ndarray]
"""Lower and upper ends of the numbers that tell states."""


@dataclass(frozen=True)
class Form:
    """How numbers stand in an observation: `SCALES`, `AUTOMATON`, `PRECISIONS`."""

    scale: str = "raw"
    automaton: str = "one-hot"
    dtype: str = "float64"

    def __post_init__(self) -> None:
        checked_option(self.scale, "scale", SCALES)
        checked_option(self.automaton, "automaton", AUTOMATON)
        checked_option(self.dtype, "dtype", PRECISIONS)


def joint_bounds(agents: Sequence[AnyAgent]) -> Bounds:
    """Return between which numbers the workspaces of `agents` lie, one after the other; states may leave them."""
    return np.concatenate([agent.state_low for agent in agents]), np.concatenate([agent.state_high for agent in agents])


def relative_bounds(problem: Problem, agent: AnyAgent) -> Bounds:
    """Return between which numbers the others are, seen from an agent's own place, while all are in workspaces."""
    lows, highs = [np.zeros(0)], [np.zeros(0)]
    for other in problem.agents:
        if other is not agent:
            d = min(agent.n_states, other.n_states)
            lows.append(other.state_low[:d] - agent.state_high[:d])
            highs.append(other.state_high[:d] - agent.state_low[:d])
    return np.concatenate(lows), np.concatenate(highs)


def observation_space(problem: Problem, bounds: Bounds, form: Form) -> spaces.Box:
    """Return the space of observations: states of any size, or those between `bounds` mapped to [-1, 1]."""
    most = 1.0 if form.scale == "unit" else np.inf
    low, high = (np.full_like(end, sign * most) for end, sign in zip(bounds, (-1.0, 1.0)))
    # The automaton state one-hot and the fraction of time left lie between 0 and 1.
    states = problem.automaton.n_states
    rest = {"one-hot": [1.0] * states, "number": [states - 1.0], "hidden": []}[form.automaton] + [1.0]
    low, high = np.concatenate([low, np.zeros(len(rest))]), np.concatenate([high, rest])
    return spaces.Box(low.astype(form.dtype), high.astype(form.dtype), dtype=np.dtype(form.dtype).type)


def action_space(agents: Sequence[AnyAgent], actions: str) -> spaces.Box:
    """Return the space of the inputs of `agents`, one after the other."""
    if actions == "unit":
        return spaces.Box(-1.0, 1.0, (sum(agent.n_inputs for agent in agents),), dtype=np.float32)
    low = np.concatenate([agent.input_low for agent in agents])
    return spaces.Box(low, np.concatenate([agent.input_high for agent in agents]), dtype=np.float64)


def in_form(numbers: Any, bounds: Bounds | None, form: Form) -> np.ndarray:
    """Return numbers that tell states, (k,) or (..., k), in the form that was asked for; "raw" needs no bounds.

    Where a state is not defined (NaN, after which an episode has ended) it counts as below everything: -inf.
    """
    told = np.asarray(numbers, dtype=np.float64)
    unknown = np.isnan(told)
    if np.count_nonzero(unknown):
        told = np.where(unknown, -np.inf, told)
    if form.scale == "unit":
        assert bounds is not None
        low, high = bounds
        told = np.clip((told - low) * (2.0 / (high - low)) - 1.0, -1.0, 1.0)
    if form.dtype == "float64":
        return told
    with np.errstate(over="ignore"):  # what is too large for float32 is infinite there
        return told.astype(form.dtype)


def shared(problem: Problem, q: int, time: int, automaton: str = "one-hot") -> list[float]:
    """Return the automaton state and the fraction of time left."""
    left = 1.0 - time / problem.horizon
    if automaton != "one-hot":
        return [float(q), left] if automaton == "number" else [left]
    result = [0.0] * (problem.automaton.n_states + 1)
    result[q] = 1.0
    result[-1] = left
    return result


def shared_rows(problem: Problem, worlds: Worlds, automaton: str) -> np.ndarray:
    """Return the same of a batch: (k, M), one column per world."""
    if not is_host(worlds.q):  # whose places cannot be counted without sending them there
        left = 1.0 - double(worlds.time) / problem.horizon
        seen = {"one-hot": [worlds.q == q for q in range(problem.automaton.n_states)], "number": [worlds.q]}
        rows: np.ndarray = namespace(left).stack([*map(double, seen.get(automaton, [])), left])
        return rows
    result = np.empty((tail_size(problem, automaton), worlds.n_worlds))
    write_shared(problem, worlds, automaton, result)
    return result


def tail_size(problem: Problem, automaton: str) -> int:
    """Return how many numbers tell the automaton state and the fraction of time left."""
    return 1 + (problem.automaton.n_states if automaton == "one-hot" else automaton == "number")


def write_shared(problem: Problem, worlds: Worlds, automaton: str, rows: np.ndarray) -> None:
    """Write what `shared_rows` returns into rows (k, M) of any precision."""
    if automaton == "one-hot":
        rows[:-1] = worlds.q == state_numbers(len(rows) - 1)
    elif automaton == "number":
        rows[0] = worlds.q
    rows[-1] = time_left(problem.horizon).take(worlds.time)


@lru_cache(maxsize=64)
def state_numbers(count: int) -> np.ndarray:
    """Return the numbers of automaton states, (Q, 1), of their type in `Worlds`: others would have to be converted."""
    return read_only(np.arange(count, dtype=np.int32)[:, None])


@lru_cache(maxsize=64)
def time_left(horizon: int) -> np.ndarray:
    """Return the fraction of time left at the times 0 to T, float64, read-only."""
    return read_only(1.0 - np.arange(horizon + 1) / horizon)


def joint_observations(problem: Problem, worlds: Worlds, states: np.ndarray, form: Form) -> np.ndarray:
    """Return the joint observations of a batch, shape (M, D + Q + 1) if the automaton state is one-hot.

    `states` (M, D) is what sensors read of the worlds. The worlds are the last axis in memory: the result is a turned
    view of an array that is written row by row, which is many times faster.
    """
    d = problem.n_states
    rows = np.empty((d + tail_size(problem, form.automaton), worlds.n_worlds), dtype=form.dtype)
    rows[:d] = in_form(states, joint_bounds(problem.agents) if form.scale == "unit" else None, form).T
    write_shared(problem, worlds, form.automaton, rows[d:])
    return rows.T


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
    joint_actions = np.asarray(action)
    if joint_actions.ndim == 1 and problem.n_inputs == 1:  # some learners drop an axis of length 1
        joint_actions = joint_actions[:, None]
    is_table = joint_actions.ndim == 2 and joint_actions.shape[1] == problem.n_inputs
    rows = np.array(joint_actions.T, dtype=np.float64, order="C")
    if not is_table or not all_finite(rows):
        raise ValueError(
            f"`actions`: expected finite numbers of shape (number of worlds, {problem.n_inputs}), got shape "
            f"{joint_actions.shape}"
        )
    result = []
    for block, columns in zip(dynamics.blocks, dynamics.input_columns):
        # One block whose inputs stand in order has all of the rows, and they are new: no copy is needed.
        u = rows.reshape(*columns.shape, rows.shape[1]) if dynamics.inputs_stand else rows[columns]
        clip_in_place(u, block, actions == "unit")
        result.append(u)
    return tuple(result)


def all_finite(numbers: np.ndarray) -> bool:
    """Return whether all numbers are finite; to count is faster than to ask `all`."""
    return np.count_nonzero(np.isfinite(numbers)) == numbers.size


def clip_in_place(u: np.ndarray, block: Any, is_unit: bool) -> None:
    """Make actions (m, n, M) of a block inputs in its boxes, without new arrays."""
    for row, (low, high, middle, half) in zip(u, block.input_rows):
        if is_unit:
            row.clip(-1.0, 1.0, out=row)
            row *= half
            row += middle
        if not (is_unit and block.middle_stays_inside):
            row.clip(low, high, out=row)


def _is_number(value: Any) -> bool:
    return isinstance(value, float | int) and isfinite(value)
