"""A team as one agent, for plans: agents that move alike are stepped together.

Dynamics are block-diagonal but for agents that name states of others: those are where the plan has them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ....envs.systems.agents import AnyAgent
from ...relations.grids import FloatArray
from .nonlinear_model import NonlinearModel


class Tie(NamedTuple):
    """What an agent names: its unknown k is a state of agent j."""

    k: int
    agent: int
    state: int


@dataclass(frozen=True, eq=False)
class Box:
    """Corners of the starts of all agents."""

    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, eq=False)
class TeamBounds:
    """Ranges of states, inputs and starts of all agents, one after another."""

    state_low: FloatArray
    state_high: FloatArray
    input_low: FloatArray
    input_high: FloatArray
    initial: Box


@dataclass(frozen=True, eq=False)
class _Alike:
    """Agents with the same dynamics and outputs: one model, and where each stands among states, inputs and outputs."""

    model: NonlinearModel
    states: NDArray[np.int64]
    inputs: NDArray[np.int64]
    outputs: NDArray[np.int64]
    named: tuple[tuple[int, int], ...] = ()
    """What the agent names, which is alone then: its variable k is a state of the team."""

    def variables(self, x: FloatArray, u: FloatArray, time: ArrayLike) -> FloatArray:
        """Return the variables (v, n k) of the model for states (D, n) and inputs (M, n) of the team at steps."""
        values = self.model.variables(_flat(x, self.states), _flat(u, self.inputs), time)
        for k, column in self.named:
            values[k] = x[column]
        return values


class TeamOutputs:
    """Outputs of all agents."""

    def __init__(self, alike: Sequence[_Alike], size: int) -> None:
        self.alike, self.size = alike, size

    def values(self, states: FloatArray) -> FloatArray:
        """Return outputs (P, n) at states (D, n)."""
        result = np.empty((self.size, states.shape[1]))
        for part in self.alike:
            result[part.outputs] = _each(part.model.output.values(_flat(states, part.states)), len(part.states))
        return result


class TeamModel:
    """Steps, derivatives and outputs of a team, as ``NonlinearModel`` has them of one agent."""

    def __init__(self, models: Sequence[NonlinearModel], ties: Sequence[Sequence[Tie]]) -> None:
        agents = [model.agent for model in models]
        sizes = [(agent.n_states, agent.n_inputs, agent.n_outputs) for agent in agents]
        first = np.concatenate([np.zeros((1, 3), dtype=int), np.cumsum(sizes, axis=0)])
        self.sizes = tuple(int(n) for n in first[-1])
        groups: dict[object, list[int]] = {}
        for i, model in enumerate(models):
            groups.setdefault(i if ties[i] else key_of(model.agent), []).append(i)
        self.alike = []
        for members in groups.values():
            states, inputs, outputs = (
                np.array([first[i, k] + np.arange(sizes[i][k]) for i in members]) for k in range(3)
            )
            d, m, _ = sizes[members[0]]
            named = tuple((d + m + k, int(first[j, 0]) + state) for k, j, state in ties[members[0]])
            self.alike.append(_Alike(models[members[0]], states, inputs, outputs, named))
        self.agent = TeamBounds(
            np.concatenate([agent.state_low for agent in agents]),
            np.concatenate([agent.state_high for agent in agents]),
            np.concatenate([agent.input_low for agent in agents]),
            np.concatenate([agent.input_high for agent in agents]),
            Box(np.concatenate([agent.initial.low for agent in agents]),
                np.concatenate([agent.initial.high for agent in agents])),
        )  # fmt: skip

    @cached_property
    def output(self) -> TeamOutputs:
        """Outputs, of states alone."""
        return TeamOutputs(self.alike, self.sizes[2])

    def step(self, x: FloatArray, u: FloatArray, time: int) -> FloatArray:
        """Return the means (D, n) of the next states for states (D, n) and inputs (M, n) at a step."""
        result = np.empty_like(x)
        for part in self.alike:
            moved = part.model.motion.values(part.variables(x, u, time))
            result[part.states] = _each(moved, len(part.states))
        return result

    def linear(self, states: FloatArray, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return Jacobians (S, D, D) and (S, D, M) along states (S, D) and inputs (S, M)."""
        s, (d, m, _) = len(states), self.sizes
        A, B = np.zeros((s, d, d)), np.zeros((s, d, m))
        for part in self.alike:
            k, own = part.states.shape
            times = np.tile(np.arange(s), k)
            _, slopes = part.model.motion.slopes(part.variables(states.T, inputs.T, times))
            both = np.moveaxis(np.broadcast_to(slopes, (*slopes.shape[:2], s * k)), 2, 0).reshape(k, s, own, -1)
            both, ends = both.swapaxes(0, 1), own + part.inputs.shape[1]
            A[:, part.states[:, :, None], part.states[:, None, :]] = both[..., :own]
            B[:, part.states[:, :, None], part.inputs[:, None, :]] = both[..., own:ends]
            for place, column in part.named:
                A[:, part.states[0], column] += both[:, 0, :, place]
        return A, B

    def outputs(self, states: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return outputs (S, P) and their Jacobians (S, P, D) along states (S, D)."""
        s, (d, _, p) = len(states), self.sizes
        values, matrices = np.empty((s, p)), np.zeros((s, p, d))
        for part in self.alike:
            k, own = part.states.shape
            y, C = part.model.outputs(states[:, part.states].reshape(s * k, own))
            values[:, part.outputs] = y.reshape(s, k, -1)
            matrices[:, part.outputs[:, :, None], part.states[:, None, :]] = C.reshape(s, k, -1, own)
        return values, matrices


def key_of(agent: AnyAgent) -> object:
    """Return what agents have in common that move alike, whatever their starts are."""
    noise = agent.laws, agent.noise_axes.tobytes(), agent.timed_scale_trees, agent.noise_covariance.tobytes()
    return noise, (agent.states, agent.inputs, tuple(agent.unknowns.items()), agent.timed_trees, agent.output_trees)


def _flat(values: FloatArray, places: NDArray[np.int64]) -> FloatArray:
    """Return values (D, n) of k agents as (d, k n)."""
    k, own = places.shape
    return np.ascontiguousarray(values[places.T].reshape(own, k * values.shape[1]))


def _each(values: FloatArray, k: int) -> FloatArray:
    """Return values (d, k n) as (k, d, n)."""
    return values.reshape(len(values), k, -1).swapaxes(0, 1)
