"""Controllers of problems that name the time, from those of the same problems written out without it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.simulation import Dynamics, Worlds, joint, split_joint
from ....envs.systems.arguments import tree_text
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from .communicated import told_of_all
from .predicting import Predicting


@dataclass(frozen=True, eq=False, repr=False)
class TimedController(Predicting):
    """Controllers of all agents: each sees its own state, the automaton state and the time.

    Parameters
    ----------
    problem : Problem
        The problem that names the time.
    inner : Controller
        Of the problem written out. Where an agent has a clock, its last input is the time and moves nothing here.
    states : (T + 1, Q) int array
        Automaton states of the problem written out, by time and automaton state; -1 for none.
    """

    problem: Problem
    inner: Any
    states: NDArray[np.int64]

    def __repr__(self) -> str:
        rows = [("agents", self.problem.n_agents), ("automaton states", self.inner.problem.automaton.n_states)]
        return tree_text(f"TimedController of {self.problem.name!r}", rows)

    def reset(
        self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None, seed: int | None = None
    ) -> None:
        """Begin an episode with the observations of ``env.reset``; ``seed`` fixes the auxiliary draws.

        Raises
        ------
        ValueError
            If the agents are not those of the problem, or the environment has noisy sensors.
        """
        self.inner.reset(observations, infos, seed)

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, FloatArray]:
        """Return the action of every agent observed: name -> (m,) float64.

        The state is read from ``infos[agent]`` (keys ``state``, ``automaton_state``, ``time``) if that is given, else
        from the observation.
        """
        found = told_of_all(self.problem, observations, infos, self.states.shape[1])
        asked = {
            name: {"state": state, "automaton_state": int(self._state_at(time, q)), "time": time}
            for name, (state, q, time) in found.items()
        }
        sizes = {agent.name: agent.n_inputs for agent in self.problem.agents}
        inputs = self.inner.act(dict.fromkeys(asked), asked)
        return {name: inputs[name][: sizes[name]] for name in observations}

    def _state_at(self, time: Any, q: Any) -> NDArray[np.int64]:
        """Return states of the problem written out; any one where none goes with a time and a state."""
        last = len(self.states) - 1
        return np.asarray(np.maximum(self.states[np.minimum(time, last), q], 0))

    def batch(self, dynamics: Dynamics) -> BatchTimed:
        """Return the same controllers for batched rollouts of ``dynamics``."""
        base = Dynamics.of(self.inner.problem)
        return BatchTimed(self, dynamics, base, self.inner.batch(base))


@dataclass(frozen=True, eq=False)
class BatchTimed:
    """A controller in time arranged for batches."""

    controller: TimedController
    dynamics: Dynamics
    base: Dynamics
    inner: Any

    def begin(self, worlds: Worlds, rng: Any) -> Any:
        """Return the memory at time 0."""
        return self.inner.begin(self._written_out(worlds), rng)

    def selected(self, memory: Any, which: NDArray[Any]) -> Any:
        """Return the memory of the worlds ``which`` alone."""
        return self.inner.selected(memory, which)

    def act(self, worlds: Worlds, memory: Any) -> tuple[tuple[FloatArray, ...], Any]:
        """Return inputs (m, n, M) per block, and the memory for the next step."""
        inputs, memory = self.inner.act(self._written_out(worlds), memory)
        blocks = []
        for block in self.dynamics.blocks:
            places = (self.base.position[i] for i in block.agents.tolist())
            blocks.append(np.stack([inputs[b][: block.n_inputs, k] for b, k in places], axis=1))
        return tuple(blocks), memory

    def _written_out(self, worlds: Worlds) -> Worlds:
        """Return the worlds as those of the problem written out."""
        states = split_joint(self.base, joint(self.dynamics, worlds))
        q = self.controller._state_at(worlds.time, worlds.q).astype(worlds.q.dtype)
        return replace(worlds, states=states, q=q)
