"""Controllers of mixed teams: some agents look their inputs up on grids, the others follow nominal paths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import tree_text
from ...envs.dynamics import Dynamics, Worlds
from ...envs.problem import Problem
from .controller import Controller
from .path_controller import PathController
from .told import told_of_all


@dataclass(frozen=True, eq=False, repr=False)
class MixedController:
    """Controllers of all agents: each sees its own state, the automaton state and the time.

    Parameters
    ----------
    problem : Problem
        The whole problem.
    grids : Controller
        Of the agents on grids, for a task with an automaton of its own.
    paths : PathController
        Of the others.
    states : (S + 1, Q) int array
        States of that automaton, by time and automaton state of the problem; -1 for none.
    """

    problem: Problem
    grids: Controller
    paths: PathController
    states: NDArray[np.int64]

    def __repr__(self) -> str:
        rows = [("on grids", self.grids.problem.n_agents), ("along paths", self.paths.problem.n_agents)]
        return tree_text(f"MixedController of {self.problem.name!r}", rows)

    def reset(
        self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None, seed: int | None = None
    ) -> None:
        """Begin an episode with the observations of ``env.reset``; ValueError for other agents or noisy sensors."""
        if strangers := sorted(set(observations) ^ set(self.problem.agent_names)):
            raise ValueError(
                f"`observations`: expected exactly the agents of problem {self.problem.name!r}, got a mismatch at "
                f"{', '.join(strangers[:5])}; reset the controller of this environment's own problem"
            )
        for part in (self.grids, self.paths):
            part.reset({name: observations[name] for name in part.problem.agent_names}, infos, seed)

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the action of every agent observed: name -> (m,) float64.

        State, automaton state and time are read from ``infos[agent]`` if that is given, else from the observation.
        """
        found = told_of_all(self.problem, observations, infos, self.states.shape[1])
        asked = {
            name: {"state": state, "automaton_state": int(self._state_at(time, q)), "time": time}
            for name, (state, q, time) in found.items()
        }
        # After the last step of the certificate nothing is claimed: policies go on with what they did last.
        last = self.grids.problem.horizon - 1
        on_grids = {
            name: {**asked[name], "time": min(asked[name]["time"], last)}
            for name in self.grids.problem.agent_names if name in asked
        }  # fmt: skip
        along = {name: asked[name] for name in self.paths.problem.agent_names if name in asked}
        inputs = self.grids.act(dict.fromkeys(on_grids), on_grids) | self.paths.act(dict.fromkeys(along), along)
        return {name: inputs[name] for name in observations}

    def _state_at(self, time: Any, q: Any) -> NDArray[np.int64]:
        """Return states of the automaton on grids; any one where none goes with a time and a state."""
        return np.asarray(np.maximum(self.states[np.minimum(time, len(self.states) - 1), q], 0))

    @cached_property
    def places(self) -> tuple[tuple[bool, int], ...]:
        """Of each agent whether it is on a grid, and its number there or among those along paths."""
        on_grids, along = self.grids.problem.agent_names, self.paths.problem.agent_names
        return tuple(
            (name in on_grids, (on_grids if name in on_grids else along).index(name))
            for name in self.problem.agent_names
        )

    def batch(self, dynamics: Dynamics) -> BatchMixed:
        """Return the same controllers for batched rollouts of ``dynamics``."""
        parts = tuple(Dynamics.of(part.problem) for part in (self.grids, self.paths))
        return BatchMixed(self, dynamics, parts, (self.grids.batch(parts[0]), self.paths.batch(parts[1])))


@dataclass(frozen=True, eq=False)
class BatchMixed:
    """Controllers of a mixed team arranged for batches; the memory is that of the agents on grids."""

    controller: MixedController
    dynamics: Dynamics
    parts: tuple[Dynamics, ...]
    batches: tuple[Any, ...]

    def begin(self, worlds: Worlds, rng: Any) -> Any:
        """Return the memory at time 0."""
        return self.batches[0].begin(self._part(worlds, 0), rng)

    def selected(self, memory: Any, which: NDArray[Any]) -> Any:
        """Return the memory of the worlds ``which`` alone."""
        return self.batches[0].selected(memory, which)

    def act(self, worlds: Worlds, memory: Any) -> tuple[tuple[NDArray[np.float64], ...], Any]:
        """Return inputs (m, n, M) per block, and the memory for the next step."""
        on_grids, memory = self.batches[0].act(self._part(worlds, 0), memory)
        along, _ = self.batches[1].act(self._part(worlds, 1), None)
        blocks = []
        for block in self.dynamics.blocks:
            each = []
            for i in block.agents.tolist():
                is_on_grid, number = self.controller.places[i]
                b, k = self.parts[0 if is_on_grid else 1].position[number]
                each.append((on_grids if is_on_grid else along)[b][: block.n_inputs, k])
            blocks.append(np.stack(each, axis=1))
        return tuple(blocks), memory

    def _part(self, worlds: Worlds, which: int) -> Worlds:
        """Return the worlds of the agents on grids (0) or along paths (1)."""
        names, own = self.controller.problem.agent_names, self.parts[which]
        states = []
        for block in own.blocks:
            each = []
            for i in block.agents.tolist():
                b, k = self.dynamics.position[names.index(own.problem.agent_names[i])]
                each.append(worlds.states[b][:, k])
            states.append(np.stack(each, axis=1))
        q = self.controller._state_at(worlds.time, worlds.q).astype(worlds.q.dtype)
        time = worlds.time if which else np.minimum(worlds.time, own.problem.horizon - 1)
        time = int(time) if np.ndim(time) == 0 else time
        return replace(worlds, states=tuple(states), q=q, time=time)
