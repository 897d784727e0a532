"""The PettingZoo environment of a problem that decomposes into independent tasks (see `problem.groups`).

Every agent lives in the environment of the task it belongs to. All tasks share time, reward and end. Spaces and options
are those of `parallel_env`, with these differences:

- **Observations**: the automaton state, here and in the info, is that of the agent's task; other agents that are shown
  are those of the task.
- **Rewards**: every agent gets 1 once, when the *whole* is satisfied, else 0; the undiscounted return is satisfaction.
  `reward="shaped"` adds the differences of the mean of the tasks' potentials.
- **Episode ends**: terminated as soon as any task has failed; terminated when a co-safe whole is satisfied, which is
  the first time at which all tasks have been accepted; truncated at the horizon.
- **Infos**: `satisfied` refers to the whole.
- **Pictures**: lines of text only; `parallel_env(task, "rgb_array")` shows a task of `problem.tasks`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from ..tasks.problem import Problem
from .observation import checked_reset
from .problem_env import Infos, Observations, ProblemEnv
from .sensors import checked_noise


class TasksEnv(ParallelEnv):  # type: ignore[misc, type-arg, unused-ignore]
    """Parallel environment of a problem with independent tasks; see the module docstring.

    Parameters
    ----------
    problem : Problem
        A problem that has `groups`.
    render_mode : None or "ansi"
    discount : float
        Discount factor of the learner, for the shaped reward.
    **options
        As for `ProblemEnv`.

    Raises
    ------
    ValueError
        If the problem is a single task, or an option is unknown.
    """

    metadata: dict[str, Any]

    def __init__(
        self, problem: Problem, render_mode: str | None = None, *, discount: float = 1.0, **options: Any
    ) -> None:
        if not problem.groups:
            raise ValueError(f"`problem`: expected independent tasks, got the single task of {problem.name!r}")
        if render_mode not in (None, "ansi"):
            raise ValueError(
                f'`render_mode`: expected None or "ansi" for {len(problem.groups)} independent tasks, got '
                f"{render_mode!r}; show one of `problem.tasks`"
            )
        self.metadata = {
            "name": problem.name.replace("-", "_"),
            "render_modes": ["ansi"],
            "is_parallelizable": True,
        }
        self.problem = problem
        self.render_mode = render_mode
        self.discount = discount
        self.options = {"discount": discount, **options}
        # Sensors are told for the whole; each task takes the components of its agents.
        deviations = checked_noise(problem, options.pop("sensor_noise", 0.0))
        by_agent = {name: deviations[columns] for name, columns in zip(problem.agent_names, problem.columns)}
        self.tasks = tuple(
            ProblemEnv(
                task,
                render_mode,
                discount=discount,
                sensor_noise=np.concatenate([by_agent[name] for name in task.agent_names]),
                **options,
            )
            for task in problem.tasks
        )
        self._task_of = {name: task for task in self.tasks for name in task.possible_agents}
        self.possible_agents = list(problem.agent_names)
        self.agents: list[str] = []
        low, high = ([getattr(task.state_space, side) for task in self.tasks] for side in ("low", "high"))
        dtype = self.tasks[0].state_space.dtype
        assert dtype is not None
        self.state_space = spaces.Box(np.concatenate(low), np.concatenate(high), dtype=dtype.type)
        self._is_co_safe = problem.specification.is_co_safe
        self._seeds: np.random.SeedSequence | None = None
        self._last_observations: dict[ProblemEnv, Observations] = {}
        self._last_infos: dict[ProblemEnv, Infos] = {}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of one agent's observations (the same object each time)."""
        return self._task_of[agent].observation_space(agent)

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of one agent's actions (the same object each time)."""
        return self._task_of[agent].action_space(agent)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Begin an episode: the generator of each task is seeded from `seed`; see `ProblemEnv.reset`."""
        # Without a seed the generators of the tasks continue, except in the first episode.
        is_fresh = seed is not None or self._seeds is None
        if is_fresh:
            self._seeds = np.random.SeedSequence(seed)
        assert self._seeds is not None
        seeds = self._seeds.generate_state(len(self.tasks)).tolist() if is_fresh else [None] * len(self.tasks)
        for task, task_seed, start in zip(self.tasks, seeds, self._starts(options), strict=True):
            self._last_observations[task], self._last_infos[task] = task.reset(task_seed, start)
        self.agents = list(self.possible_agents)
        return self._joined(self._last_observations), self._infos()

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Advance one control step of all tasks; see `ProblemEnv.step`."""
        if self._seeds is None:
            raise RuntimeError("call `reset` before `step`")
        if not self.agents:
            return {}, {}, {}, {}, {}
        strangers = [name for name in actions if name not in self._task_of]
        if strangers:
            raise ValueError(f"`actions`: expected agents of the problem, got {strangers[0]!r}; leave it out")
        # Rewards and ends of the single tasks are ignored: they are those of the whole.
        before, ended = self._potential(), self.agents
        if not self._is_settled():
            for task in self.tasks:
                task_actions = {name: actions[name] for name in task.possible_agents if name in actions}
                self._last_observations[task], _, _, _, self._last_infos[task] = task.step(task_actions)
        terminated = self._is_settled()
        truncated = not terminated and self._time() >= self.problem.horizon
        if terminated or truncated:
            self.agents = []
        after = 0.0 if terminated or truncated else self._potential()
        reward = float(self._is_satisfied()) + self.discount * after - before
        return (
            self._joined(self._last_observations),
            dict.fromkeys(ended, reward),
            dict.fromkeys(ended, terminated),
            dict.fromkeys(ended, truncated),
            self._infos(),
        )

    def state(self) -> np.ndarray:
        """Return the states of all tasks, one after the other (see `ProblemEnv.state`)."""
        return np.concatenate([task.state() for task in self.tasks])

    def render(self) -> str | None:
        """Return one line of text per task ("ansi"), or None."""
        return "\n".join(str(task.render()) for task in self.tasks) if self.render_mode == "ansi" else None

    def close(self) -> None:
        """Do nothing: there is no window to close."""

    def _potential(self) -> float:
        """Return the mean of the tasks' potentials; 0 with sparse rewards."""
        return float(np.mean([task.potential for task in self.tasks]))

    def _time(self) -> int:
        """Return the control steps taken, the same in all tasks."""
        return int(self._last_infos[self.tasks[0]][self.tasks[0].possible_agents[0]]["time"])

    def _is_settled(self) -> bool:
        """Return whether the verdict on the whole is final."""
        return any(task.is_settled for task in self.tasks) or (self._is_co_safe and self._is_satisfied())

    def _is_satisfied(self) -> bool:
        """Return whether all tasks accept: at any time for co-safe tasks, else at the horizon."""
        # The tasks are judged at the horizon, so a task settles early only by failing (see `problem.groups`).
        if any(task.is_settled for task in self.tasks) or not (
            self._is_co_safe or self._time() >= self.problem.horizon
        ):
            return False
        # The automaton states of all tasks, as their agents were told them.
        states = (self._last_infos[task][task.possible_agents[0]]["automaton_state"] for task in self.tasks)
        return all(task.problem.automaton.accepting[q] for task, q in zip(self.tasks, states, strict=True))

    def _starts(self, options: dict[str, Any] | None) -> list[dict[str, Any] | None]:
        """Return the options of each task: its share of a start in `options`."""
        start = checked_reset(options).get("initial_state")
        if start is None:
            return [None] * len(self.tasks)
        # The problem checks the start and splits it by agents.
        agents = self.problem.replace(initial_state=start).agents
        states = {agent.name: agent.initial.low for agent in agents}
        return [{"initial_state": [states[name] for name in task.possible_agents]} for task in self.tasks]

    def _joined(self, by_task: dict[ProblemEnv, dict[str, Any]]) -> dict[str, Any]:
        """Return the entries of all tasks for their agents, in the order of the problem."""
        return {name: by_task[self._task_of[name]][name] for name in self.possible_agents}

    def _infos(self) -> Infos:
        satisfied = self._is_satisfied()
        return {name: {**info, "satisfied": satisfied} for name, info in self._joined(self._last_infos).items()}
