"""What a learner sees and does: rows of observations and actions for the worlds of a batch.

``SharedView``   one row per world and agent: the agent's state, the automaton state, the time left, and which agent it
                 is (one-hot), so that one network serves all agents. Certified policies have the same information.
``TeamView``     the same rows, followed by the states of all agents, which only a critic may see.
``CentralView``  one row per world: the states of all agents, the automaton state, the time left.

States are moved into the workspace and scaled to [-1, 1]; the states of agents with fewer components are filled up with
zeros. Actions lie in [-1, 1] and stand for the input box.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.tasks.problem import Problem
from ...synthesis.certificates.controllers import LOCAL
from ...synthesis.relations.kinds import OwnView, scaled, write_task

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class SharedView:
    """The view with one row per world and agent; the agents of a world stand side by side."""

    problem: Problem

    information = LOCAL

    @property
    def rows(self) -> int:
        """Rows per world."""
        return self.problem.n_agents

    @property
    def width(self) -> int:
        """Most state components of an agent."""
        return max(agent.n_states for agent in self.problem.agents)

    @property
    def size(self) -> int:
        """Numbers per observation."""
        return self.width + self.problem.automaton.n_states + 1 + self.problem.n_agents

    @property
    def n_actions(self) -> int:
        """Numbers per action."""
        return max(agent.n_inputs for agent in self.problem.agents)

    def agent_rows(self, agent: int, states: Array, q: Array, time: Any) -> NDArray[np.float32]:
        """Return observations (N, size) of one agent at states (d, N), automaton states (N,) and times, one or (N,)."""
        return self.of_agent(agent).rows(self.problem.agents[agent].workspace, states, q, time)

    def of_agent(self, agent: int) -> OwnView:
        """Return what the agent with this number sees."""
        problem = self.problem
        return OwnView(agent, problem.n_agents, self.width, problem.automaton.n_states, problem.horizon)

    def observations(self, joint: Array, q: Array, time: Array) -> NDArray[np.float32]:
        """Return observations (M * agents, size) at joint states (M, D)."""
        result = np.empty((len(joint), self.rows, self.size), dtype=np.float32)
        for i, columns in enumerate(self.problem.columns):
            result[:, i] = self.agent_rows(i, joint[:, columns].T, q, time)
        return result.reshape(-1, self.size)

    def joint_actions(self, actions: Array) -> Array:
        """Return joint actions (M, sum of m_i) from rows (M * agents, n_actions); surplus numbers are dropped."""
        rows = np.asarray(actions).reshape(-1, self.rows, self.n_actions)
        return np.concatenate([rows[:, i, : agent.n_inputs] for i, agent in enumerate(self.problem.agents)], axis=1)

    def row_actions(self, joint_actions: Array) -> Array:
        """Return rows (M * agents, n_actions) for joint actions (M, sum of m_i), filled up with zeros."""
        rows = np.zeros((len(joint_actions), self.rows, self.n_actions))
        for i, (agent, columns) in enumerate(zip(self.problem.agents, self.problem.input_columns, strict=True)):
            rows[:, i, : agent.n_inputs] = joint_actions[:, columns]
        return rows.reshape(-1, self.n_actions)

    @property
    def used_actions(self) -> NDArray[np.bool_]:
        """Which components of its action each agent has: bool (agents, n_actions)."""
        return np.array([np.arange(self.n_actions) < agent.n_inputs for agent in self.problem.agents])


@dataclass(frozen=True, eq=False)
class CentralView:
    """The view with one row per world."""

    problem: Problem

    information = "states of all agents, automaton state, time"
    rows = 1

    @property
    def size(self) -> int:
        """Numbers per observation."""
        return self.problem.n_states + self.problem.automaton.n_states + 1

    @property
    def n_actions(self) -> int:
        """Numbers per action."""
        return sum(agent.n_inputs for agent in self.problem.agents)

    def observations(self, joint: Array, q: Array, time: Any) -> NDArray[np.float32]:
        """Return observations (M, size) at joint states (M, D)."""
        rows = np.zeros((len(joint), self.size), dtype=np.float32)
        for agent, columns in zip(self.problem.agents, self.problem.columns, strict=True):
            rows[:, columns] = scaled(agent.workspace, joint[:, columns].T).T
        left = 1.0 - np.asarray(time) / self.problem.horizon
        write_task(rows, self.problem.n_states, self.problem.automaton.n_states, q, left)
        return rows

    def joint_actions(self, actions: Array) -> Array:
        """Return the actions, which are joint already."""
        return np.asarray(actions)

    def row_actions(self, joint_actions: Array) -> Array:
        """Return the joint actions: a world has one row."""
        return np.asarray(joint_actions)

    @property
    def used_actions(self) -> NDArray[np.bool_]:
        """All components of the one row of a world: bool (1, n_actions)."""
        return np.ones((1, self.n_actions), dtype=bool)


@dataclass(frozen=True, eq=False)
class TeamView(SharedView):
    """The rows of ``SharedView``, each followed by the states of all agents: these are for the critic alone."""

    @property
    def seen(self) -> int:
        """Numbers at the beginning of a row that the actor sees."""
        return SharedView(self.problem).size

    @property
    def size(self) -> int:
        """Numbers per row."""
        return self.seen + self.problem.n_states

    def observations(self, joint: Array, q: Array, time: Array) -> NDArray[np.float32]:
        """Return rows (M * agents, size) at joint states (M, D)."""
        own = SharedView(self.problem).observations(joint, q, time)
        states = CentralView(self.problem).observations(joint, q, time)[:, : self.problem.n_states]
        return np.concatenate([own, np.repeat(states, self.rows, axis=0)], axis=1)


View = SharedView | CentralView
"""Of a decentralised policy (``TeamView`` is one, too), or of one that sees all states."""
