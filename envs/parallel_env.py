"""The PettingZoo environment of a problem: a thin view of `dynamics` for one world.

Everything below holds for any problem; the pages of the suite (`reach_avoid_v0`, ...) add their numbers.

- **Actions**: one `Box` per agent, its input box, float64. Actions beyond it are clipped to it.
- **Observations**: the agent's own state (projected onto the workspace after an exit), the automaton state one-hot, the
  fraction of time left; float64.
- **Rewards**: cooperative: every agent gets 1 once, when the task is satisfied, else 0; the undiscounted return *is*
  satisfaction.
- **Episode ends**: (1) terminated when the task is satisfied early (co-safe), (2) terminated when an agent leaves its
  workspace, (3) terminated when the automaton can accept no more, (4) otherwise truncated at the horizon, where
  finite-trace tasks are judged. Where the start itself decides, the first step returns the verdict.
- **Infos**, per agent: `letter` (names of the propositions that hold; empty after a failure, when none is read),
  `automaton_state` (int), `satisfied` (bool), `state` (the agent's true state, float64), `time` (int).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils.conversions import parallel_to_aec

from . import dynamics as core
from .problem import Problem

Observations = dict[str, np.ndarray]
Infos = dict[str, dict[str, Any]]


class ProblemEnv(ParallelEnv):  # type: ignore[misc, type-arg, unused-ignore]
    """Parallel environment of a problem; see the module docstring for spaces, rewards and episode ends.

    Parameters
    ----------
    problem : Problem
    render_mode : None or "ansi"
        "ansi": `render` returns one line of text.
    """

    metadata: dict[str, Any]

    def __init__(self, problem: Problem, render_mode: str | None = None) -> None:
        self.metadata = {
            "name": problem.name.replace("-", "_"),
            "render_modes": ["ansi"],
            "render_fps": 4,
            "is_parallelizable": True,
        }
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"`render_mode`: expected None or 'ansi', got {render_mode!r}")
        self.problem = problem
        self.render_mode = render_mode
        self.possible_agents = list(problem.agent_names)
        self.agents: list[str] = []
        self._dynamics = core.Dynamics.of(problem)
        self._rng: np.random.Generator | None = None
        self._worlds: core.Worlds | None = None
        n_q = problem.automaton.n_states
        self._observation_spaces = {
            agent.name: _observation_box(agent.state_low, agent.state_high, n_q) for agent in problem.agents
        }
        self._action_spaces = {
            agent.name: spaces.Box(agent.input_low, agent.input_high, dtype=np.float64) for agent in problem.agents
        }
        self._low = np.concatenate([agent.state_low for agent in problem.agents])
        self._high = np.concatenate([agent.state_high for agent in problem.agents])
        ends = np.cumsum([0, *(agent.n_states for agent in problem.agents)])
        self._slices = [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:])]
        self.state_space = _observation_box(self._low, self._high, n_q)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of one agent's observations (the same object each time)."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of one agent's actions, its input box (the same object each time)."""
        return self._action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            Seeds a new generator; without it the present one goes on.
        options : dict, optional
            `initial_state`: a start instead of the problem's, in the forms that `Problem.replace` takes. Other keys
            are left alone.
        """
        if seed is not None or self._rng is None:
            self._rng, _ = seeding.np_random(seed)
        self.agents = list(self.possible_agents)
        given = (options or {}).get("initial_state")
        if given is None:
            self._worlds = core.initial(self._dynamics, self._rng, 1)
        else:
            start = self.problem.replace(initial_state=given)
            self._worlds = core.initial(core.Dynamics.of(start), self._rng, 1)
        return self._observations(), self._infos()

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Advance one control step; actions are clipped to the input boxes.

        Raises
        ------
        RuntimeError
            Before `reset`.
        ValueError
            If an action is missing, of the wrong shape or not finite.
        """
        if self._worlds is None or self._rng is None:
            raise RuntimeError("call `reset` before `step`")
        if not self.agents:
            return {}, {}, {}, {}, {}
        if not self._decided():
            normals = core.noise(self._dynamics, self._rng, 1)
            self._worlds = core.transition(self._dynamics, self._worlds, self._inputs(actions), normals)
        worlds = self._worlds
        terminated = self._decided()
        truncated = not terminated and worlds.time >= self.problem.horizon
        reward = float(core.satisfied(self._dynamics, worlds)[0])
        ended = self.agents
        result = (
            self._observations(),
            dict.fromkeys(ended, reward),
            dict.fromkeys(ended, terminated),
            dict.fromkeys(ended, truncated),
            self._infos(),
        )
        if terminated or truncated:
            self.agents = []
        return result

    def state(self) -> np.ndarray:
        """Return the joint state (projected onto the workspace), automaton state one-hot and fraction of time left."""
        joint = np.clip(core.joint(self._dynamics, self._current())[0], self._low, self._high)
        return np.concatenate([joint, self._shared()])

    def render(self) -> str | None:
        """Return one line of text in the render mode "ansi", else None."""
        if self.render_mode is None:
            return None
        worlds = self._current()
        states = ", ".join(f"{name} {np.round(x, 3).tolist()}" for name, x in zip(self.possible_agents, self._split()))
        name = self.problem.automaton.state_names[int(worlds.q[0])]
        verdict = " failed" if worlds.failed[0] else " satisfied" if core.satisfied(self._dynamics, worlds)[0] else ""
        return f"t={worlds.time}/{self.problem.horizon} q={name}{verdict}: {states}"

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def _current(self) -> core.Worlds:
        if self._worlds is None:
            raise RuntimeError("call `reset` first")
        return self._worlds

    def _decided(self) -> bool:
        """Whether nothing can change the verdict any more (a finite-trace task has none before the horizon)."""
        worlds = self._current()
        return bool(worlds.failed[0] or worlds.accepted[0] or self.problem.automaton.dead[worlds.q[0]])

    def _split(self) -> list[np.ndarray]:
        joint = core.joint(self._dynamics, self._current())[0]
        return [joint[part] for part in self._slices]

    def _shared(self) -> np.ndarray:
        worlds = self._current()
        shared = np.zeros(self.problem.automaton.n_states + 1)
        shared[worlds.q[0]] = 1.0
        shared[-1] = 1.0 - worlds.time / self.problem.horizon
        return shared

    def _observations(self) -> Observations:
        shared = self._shared()
        parts = zip(self.problem.agents, self._split())
        return {
            agent.name: np.concatenate([np.clip(x, agent.state_low, agent.state_high), shared]) for agent, x in parts
        }

    def _infos(self) -> Infos:
        worlds = self._current()
        holds = core.letters(self._dynamics, worlds.states)[:, 0] & ~worlds.failed[0]
        names = self.problem.automaton.propositions
        common = {
            "letter": tuple(names[i] for i in np.flatnonzero(holds)),
            "automaton_state": int(worlds.q[0]),
            "satisfied": bool(core.satisfied(self._dynamics, worlds)[0]),
            "time": worlds.time,
        }
        return {name: {**common, "state": x.copy()} for name, x in zip(self.possible_agents, self._split())}

    def _inputs(self, actions: dict[str, Any]) -> tuple[np.ndarray, ...]:
        inputs = []
        for block in self._dynamics.blocks:
            rows = []
            for i in block.agents:
                name = self.possible_agents[i]
                if name not in actions:
                    raise ValueError(f"`actions`: expected one for every agent, got none for {name!r}")
                rows.append(_action(actions[name], block.input_low.shape[0], name))
            inputs.append(np.clip(np.stack(rows, axis=1)[..., None], block.input_low, block.input_high))
        return tuple(inputs)


def parallel_env(problem: Problem | str, render_mode: str | None = None, **arguments: Any) -> ProblemEnv:
    """Return the PettingZoo parallel environment of a problem.

    Parameters
    ----------
    problem : Problem or str
        A problem, or the id of a suite problem.
    render_mode : None or "ansi"
    **arguments
        With an id: passed to `make_problem`.

    Examples
    --------
    >>> env = parallel_env("reach-avoid-v0", horizon=7)
    >>> observations, infos = env.reset(seed=0)
    >>> env.agents
    ['agent_0', 'agent_1']
    """
    if isinstance(problem, str):
        from .suite import make_problem

        problem = make_problem(problem, **arguments)
    elif arguments:
        raise ValueError(f"`{next(iter(arguments))}`: expected only with a problem id; use `problem.replace`")
    if not isinstance(problem, Problem):
        raise ValueError(f"`problem`: expected a Problem or the id of one, got {type(problem).__name__}")
    return ProblemEnv(problem, render_mode)


def aec_env(problem: Problem | str, render_mode: str | None = None, **arguments: Any) -> AECEnv:  # type: ignore[type-arg, unused-ignore]
    """Return the PettingZoo agent-environment-cycle form of `parallel_env` (same arguments)."""
    return parallel_to_aec(parallel_env(problem, render_mode, **arguments))


def _observation_box(low: np.ndarray, high: np.ndarray, n_q: int) -> spaces.Box:
    extra = np.zeros(n_q + 1)
    return spaces.Box(np.concatenate([low, extra]), np.concatenate([high, extra + 1.0]), dtype=np.float64)


def _action(value: Any, n_inputs: int, name: str) -> np.ndarray:
    action = np.asarray(value, dtype=np.float64)
    if action.shape != (n_inputs,) or not np.isfinite(action).all():
        raise ValueError(f"`actions[{name!r}]`: expected finite numbers of shape ({n_inputs},), got {value!r}")
    return action
