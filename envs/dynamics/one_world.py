"""One world on plain numbers: what the scalar environments step.

A numpy call costs as much as a few hundred additions, so for a single world the core's own functions (`moved`,
`inside`, `contains`, `decided`) run on Python floats here. They are the same functions in the same order on the same
float64 numbers, hence the same bits as the batch; only the loops over agents and the storage are this module's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ..agents import LinearAgent, contains, inside, row_times
from .rules import decided, moved
from .worlds import Dynamics, Worlds

_MEMORY = 100_000  # letters remembered at most


class AgentNumbers(NamedTuple):
    """One agent as nested tuples of floats; `C` is None where y = x."""

    A: Any
    B: Any
    offset: Any
    noise_factor: Any
    C: Any
    state_low: Any
    state_high: Any
    input_low: Any
    input_high: Any
    regions: tuple[tuple[int, Any, Any], ...]
    """Per proposition of the agent: its bit in a letter, lower and upper corner."""
    draws: tuple[int, ...]
    """Positions of the agent's components among the numbers drawn in one step."""


@dataclass(frozen=True)
class World:
    """One world at one time.

    Attributes
    ----------
    states : tuple of sequences of float
        One per agent.
    q, time : int
        Automaton state and control steps taken.
    failed, accepted : bool
    letter : int
        Propositions that hold, bit by bit; 0 once the world has failed.
    """

    states: tuple[Any, ...]
    q: int
    time: int
    failed: bool
    accepted: bool
    letter: int


@dataclass(frozen=True, eq=False)
class OneWorld:
    """The dynamics of a problem on plain numbers."""

    dynamics: Dynamics
    agents: tuple[AgentNumbers, ...]
    accepting: tuple[bool, ...]
    judged: tuple[bool, ...]
    dead: tuple[bool, ...]
    n_draws: int
    _following: dict[tuple[int, int], int] = field(default_factory=dict)
    _names: dict[int, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, dynamics: Dynamics) -> OneWorld:
        """Arrange the dynamics of a problem."""
        problem = dynamics.problem
        starts = np.cumsum([0, *(block.columns.size for block in dynamics.blocks)])
        numbers = []
        for i, agent in enumerate(problem.agents):
            block, place = dynamics.position[i]
            n = len(dynamics.blocks[block].agents)
            draws = tuple(int(starts[block]) + c * n + place for c in range(agent.n_states))
            numbers.append(_numbers(agent, problem.labeling.low[i].T, problem.labeling.high[i].T,
                                    problem.labeling.agent_propositions[i], draws))  # fmt: skip
        automaton = problem.automaton
        finite = np.asarray(automaton.accepting & ~automaton.finished)
        return cls(
            dynamics,
            tuple(numbers),
            tuple(dynamics.accepting.tolist()),
            tuple(finite.tolist()),
            tuple(automaton.dead.tolist()),
            int(starts[-1]),
        )

    def begin(self, worlds: Worlds) -> World:
        """Return the only world of a batch."""
        states: list[Any] = [None] * len(self.agents)
        for block, x in zip(self.dynamics.blocks, worlds.states):
            for place, agent in enumerate(block.agents):
                states[agent] = x[:, place, 0].tolist()
        failed = bool(worlds.failed[0])
        letter = 0 if failed else self._letter(tuple(states))[0]
        return World(tuple(states), int(worlds.q[0]), int(worlds.time), failed, bool(worlds.accepted[0]), letter)

    def step(self, world: World, inputs: Any, normals: Any) -> World:
        """Return the world one step later.

        Parameters
        ----------
        world : World
        inputs : sequence of sequences of float
            Per agent, within its input box.
        normals : sequence of float, length `n_draws`
            Standard normal numbers, in the order in which `dynamics.noise` draws them.
        """
        states = tuple(
            [
                moved(a.A, a.B, a.offset, a.noise_factor, x, u, [normals[k] for k in a.draws])
                for a, x, u in zip(self.agents, world.states, inputs)
            ]
        )
        letter, outside = self._letter(states)
        following = self._next(world.q, letter)
        q, failed, accepted = decided(self.accepting, world.q, following, world.failed, world.accepted, outside)
        return World(states, q, world.time + 1, failed, accepted, 0 if failed else letter)

    def settled(self, world: World) -> bool:
        """Whether nothing can change the verdict any more (a finite-trace task is never satisfied before the end)."""
        return world.failed or world.accepted or self.dead[world.q]

    def satisfied(self, world: World) -> bool:
        """Whether the task is satisfied so far, as `dynamics.satisfied` has it."""
        at_end = world.time == self.dynamics.problem.horizon
        return world.accepted or (at_end and not world.failed and self.judged[world.q])

    def names(self, letter: int) -> tuple[str, ...]:
        """Return the names of the propositions of a letter."""
        if letter not in self._names:
            if len(self._names) >= _MEMORY:
                self._names.clear()
            propositions = self.dynamics.problem.automaton.propositions
            self._names[letter] = tuple(name for p, name in enumerate(propositions) if letter >> p & 1)
        return self._names[letter]

    def _letter(self, states: tuple[Any, ...]) -> tuple[int, bool]:
        """Letter of the states, and whether an agent is outside its workspace."""
        letter, outside = 0, False
        for a, x in zip(self.agents, states):
            outside = outside or not inside(x, a.state_low, a.state_high)
            y = x if a.C is None else [row_times(row, x) for row in a.C]
            for bit, low, high in a.regions:
                if contains(y, low, high):
                    letter |= bit
        return letter, outside

    def _next(self, q: int, letter: int) -> int:
        """Automaton state after a letter; every letter asks the automaton once."""
        key = (q, letter)
        if key not in self._following:
            if len(self._following) >= _MEMORY:
                self._following.clear()
            automaton = self.dynamics.problem.automaton
            bits = np.array([letter >> p & 1 for p in range(len(automaton.propositions))], dtype=bool)
            self._following[key] = int(automaton.next_state(np.asarray(q), bits))
        return self._following[key]


def _numbers(
    agent: LinearAgent, low: np.ndarray, high: np.ndarray, propositions: np.ndarray, draws: tuple[int, ...]
) -> AgentNumbers:
    return AgentNumbers(
        A=agent.A.tolist(),
        B=agent.B.tolist(),
        offset=agent.offset.tolist(),
        noise_factor=agent.noise_factor.tolist(),
        C=None if agent.has_identity_output else agent.output_matrix.tolist(),
        state_low=agent.state_low.tolist(),
        state_high=agent.state_high.tolist(),
        input_low=agent.input_low.tolist(),
        input_high=agent.input_high.tolist(),
        regions=tuple((1 << int(p), a.tolist(), b.tolist()) for p, a, b in zip(propositions, low, high)),
        draws=draws,
    )
