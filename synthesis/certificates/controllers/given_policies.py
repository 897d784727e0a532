"""Decentralised policies from anywhere, ``u_i = pi_i(x_i, q, time)``, brought into one form.

A policy may be given as

- a function ``f(x, q, time)`` of one agent's state (d,), the automaton state and the time, that returns its input (m,);
- the same on many states at once, marked by ``vectorized``: states (d, N) to inputs (m, N);
- an ``InputTable``: one input per time, automaton state and cell of a grid;
- a mapping from agent names to these; what is not a mapping serves all agents;
- the controllers of a certificate under the ``exact`` relation;
- any object with ``inputs(agent, states, q, time)`` as in ``Decentralised``, such as a trained actor.

Every agent sees its own state, the shared automaton state and the time, nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ....envs.systems.arguments import counted
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray, Grid
from .agent_controller import AgentController
from .controller import Controller

LOCAL = "own state, automaton state, time"
"""Information structure of a decentralised policy, in words."""


@runtime_checkable
class Decentralised(Protocol):
    """Policies of all agents of a problem; each sees its own state, the automaton state and the time."""

    def inputs(self, agent: int, states: FloatArray, q: NDArray[Any], time: int) -> FloatArray:
        """Return inputs (m, N) of the agent with this number for its states (d, N) and automaton states (N,)."""


@dataclass(frozen=True)
class Vectorized:
    """A function of states (d, N), one automaton state and the time that returns inputs (m, N)."""

    function: Callable[[FloatArray, int, int], Any]


def vectorized(function: Callable[[FloatArray, int, int], Any]) -> Vectorized:
    """Mark a policy ``f(x, q, time)`` that takes states (d, N) and returns inputs (m, N); ``q`` is one number.

    Examples
    --------
    >>> brake = vectorized(lambda x, q, time: -0.5 * x)
    >>> brake.function(np.ones((1, 3)), 0, 0).tolist()
    [[-0.5, -0.5, -0.5]]
    """
    return Vectorized(function)


@dataclass(frozen=True, eq=False, repr=False)
class InputTable:
    """One input per time, automaton state and cell.

    Parameters
    ----------
    grid : Grid
        Cells; states outside count as in the nearest cell.
    inputs : (T, Q, S, m) array
        Inputs in their units. After time T - 1 the last row is repeated, so that T = 1 is a stationary policy.
    """

    grid: Grid
    inputs: FloatArray

    def __post_init__(self) -> None:
        table = np.asarray(self.inputs, dtype=float)
        if table.ndim != 4 or table.shape[2] != self.grid.n_cells or not np.isfinite(table).all():
            raise ValueError(
                f"`inputs`: expected finite numbers of shape (times, automaton states, {self.grid.n_cells} cells, "
                f"inputs), got shape {table.shape}"
            )
        object.__setattr__(self, "inputs", table)

    def __repr__(self) -> str:
        times, states, _, m = self.inputs.shape
        sizes = f"{counted(times, 'time')}, {counted(states, 'automaton state')}, {counted(m, 'input')}"
        return f"InputTable({sizes}, {self.grid})"

    def at(self, states: FloatArray, q: NDArray[Any], time: int) -> FloatArray:
        """Return the inputs (m, N) at states (d, N)."""
        points = [np.nan_to_num(x, nan=e[0]).clip(e[0], e[-1]) for x, e in zip(states, self.grid.edges, strict=True)]
        rows = self.inputs[min(time, len(self.inputs) - 1), q, self.grid.cell_of(np.stack(points))]
        return np.asarray(rows.T)


AgentPolicy = Callable[[FloatArray, int, int], Any] | Vectorized | InputTable
"""A policy of one agent."""

Policy = AgentPolicy | Mapping[str, AgentPolicy] | Decentralised | Controller
"""Policies of all agents, in any form of the module docstring."""


@dataclass(frozen=True, eq=False)
class CheckedPolicies:
    """Policies given agent by agent, their answers checked.

    Parameters
    ----------
    agents : tuple of AnyAgent
    policies : tuple of AgentPolicy
    """

    agents: tuple[AnyAgent, ...]
    policies: tuple[AgentPolicy, ...]

    def inputs(self, agent: int, states: FloatArray, q: NDArray[Any], time: int) -> FloatArray:
        """Return inputs (m, N) of one agent, or raise ValueError if its policy answers with anything else."""
        policy, points = self.policies[agent], np.asarray(states, dtype=float)
        if isinstance(policy, InputTable):
            return self._checked(agent, policy.at(points, q, time), points.shape[1])
        result = np.empty((self.agents[agent].n_inputs, points.shape[1]))
        # Functions are asked about one automaton state at a time. They get copies, which they may change.
        for state in np.unique(q):
            here = np.flatnonzero(q == state)
            if isinstance(policy, Vectorized):
                answer = np.asarray(policy.function(points[:, here].copy(), int(state), int(time)), dtype=float)
            else:
                answers = [np.atleast_1d(policy(x.copy(), int(state), int(time))) for x in points[:, here].T]
                answer = np.array(answers, dtype=float).T
            result[:, here] = self._checked(agent, answer, len(here))
        return result

    def _checked(self, agent: int, answer: FloatArray, count: int) -> FloatArray:
        """Return the answer, or raise ValueError if it has another shape or numbers that are not finite."""
        expected = (self.agents[agent].n_inputs, count)
        if answer.shape == expected and not np.isfinite(answer).all():
            raise ValueError(
                f"`policy`: expected finite inputs for agent `{self.agents[agent].name}`, got numbers that are not, or "
                "None; let the function return its input at every state"
            )
        if answer.shape != expected:
            raise ValueError(
                f"`policy`: expected {expected[0]} finite inputs per state for agent `{self.agents[agent].name}`, got "
                f"an answer of shape {answer.shape} for {count} states; functions of many states at once need "
                "`vectorized`"
            )
        return answer


@dataclass(frozen=True, eq=False)
class CertifiedPolicies:
    """Controllers of a certificate that remember nothing, as policies on any grid."""

    agents: tuple[AgentController, ...]

    def inputs(self, agent: int, states: FloatArray, q: NDArray[Any], time: int) -> FloatArray:
        """Return the inputs (m, N) of one agent."""
        inputs, _ = self.agents[agent].act(np.asarray(states, dtype=float)[:, None], q, int(time), None)
        return inputs[:, 0]


def decentralised(problem: Problem, policy: Policy) -> Decentralised:
    """Return the policies of all agents of ``problem``, given in any form of the module docstring.

    Raises
    ------
    ValueError
        If the form is unknown, the agents are not those of the problem, or a controller remembers more than the time.
    """
    if isinstance(policy, Controller):
        if any(agent.is_coupled for agent in policy.agents):
            raise ValueError("`policy`: expected controllers without memory (`exact` relation), got others")
        if tuple(agent.name for agent in policy.agents) != problem.agent_names:
            raise ValueError("`policy`: expected controllers of this problem's agents, got others")
        return CertifiedPolicies(policy.agents)
    if isinstance(policy, Decentralised) and not isinstance(policy, InputTable):
        return policy
    if isinstance(policy, Mapping):
        strangers = sorted(set(policy) ^ set(problem.agent_names))
        if strangers:
            raise ValueError(f"`policy`: expected one policy per agent, got a mismatch at {', '.join(strangers[:5])}")
        policies = tuple(policy[name] for name in problem.agent_names)
    else:
        policies = (policy,) * problem.n_agents
    for name, agent, each in zip(problem.agent_names, problem.agents, policies, strict=True):
        if not (callable(each) or isinstance(each, InputTable | Vectorized)):
            raise ValueError(f"`policy`: expected a function or a table for agent `{name}`, got {type(each).__name__}")
        if isinstance(each, InputTable):
            _check_table(problem, agent, each)
    return CheckedPolicies(problem.agents, policies)


def _check_table(problem: Problem, agent: AnyAgent, table: InputTable) -> None:
    """Raise ValueError unless a table has the sizes of an agent and of the automaton."""
    expected = (agent.n_states, problem.automaton.n_states, agent.n_inputs)
    got = (len(table.grid.edges), table.inputs.shape[1], table.inputs.shape[3])
    if got != expected:
        raise ValueError(
            f"`policy`: expected a table over (state components, automaton states, inputs) = {expected} for agent "
            f"`{agent.name}`, got {got}"
        )
