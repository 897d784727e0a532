"""One world on plain numbers: the world that the scalar environments step.

A numpy call costs as much as a few hundred additions, so for a single world the functions of the core (`moved`,
`inside`, `contains`, `decided`) run on Python floats here. The same functions work in the same order on the same
float64 numbers, so the bits are those of the batch. Only the loops over agents and the storage are in this module.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from ..systems.agents import AnyAgent, LinearAgent, Place, place_of, row_times, wrapped
from ..systems.arguments import counted, slices_of
from ..systems.backends import to_host
from ..tasks.regions import contains, holds, inside
from .batch_simulator import Dynamics, Worlds, extra_rows, split_joint
from .blocks import WrittenMotion
from .disturbances import Against, named_disturbances
from .rules import decided, moved, noisy

_MEMORY = 100_000
"""Most letters remembered, some tens of megabytes; beyond them the memory starts afresh."""


class AgentNumbers(NamedTuple):
    """One agent as nested tuples of floats; `C` is None where y = x.

    Agents with expressions have no matrices but that of the noise; numpy computes them, so that the bits are its own.
    """

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
    """Per proposition of the agent: its bit in a letter, lower and upper corner; at time 0 if regions move."""
    draws: tuple[int, ...]
    """Positions of the agent's components among the numbers drawn in one step."""
    motion: WrittenMotion | None
    """Dynamics that are expressions, compiled."""
    noise_rows: Any
    """Rows of the noise factor: entries that are not 0, and their positions."""
    extra: tuple[int, ...]
    """Positions of the numbers that its disturbances take, if these are random."""
    beside: tuple[Place, ...]
    """Where the states and inputs of others stand that its dynamics name."""
    lawful: AnyAgent | None
    """The agent itself, if its noise is not Gaussian."""

    def moved(self, x: Any, u: Any, z: Any, v: list[float] | None, team: tuple[Any, Any], time: int) -> list[float]:
        """Return the next state from x under the input u with standard normal numbers z and disturbances v (k).

        `team` holds the states of all agents before the step, and their inputs in it; `time` is that before the step.
        """
        if self.lawful is not None:
            z = self.lawful.components(np.array(z)[:, None])[:, 0].tolist()
        if self.motion is None:
            return moved(self.A, self.B, self.offset, self.noise_factor, x, u, z)
        others = [team[p.is_input][p.agent][p.component] for p in self.beside]
        clock = (float(time),) if self.motion.agent.names_time else ()
        groups = (x, u, v or (), others, clock)
        if self.motion.agent.noise_scale is not None:
            z = [scale * number for scale, number in zip(self.motion.scales.numbers(*groups), z)]
        return noisy(self.motion.means.numbers(*groups), self.noise_rows, z)

    def outputs(self, x: Any) -> Any:
        """Return the outputs at state x."""
        if self.motion is not None:
            return x if self.motion.agent.has_identity_output else self.motion.outputs.numbers(x)
        return x if self.C is None else [row_times(row, x) for row in self.C]


@dataclass(frozen=True, repr=False)
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

    def __repr__(self) -> str:
        verdict = "failed" if self.failed else "accepted" if self.accepted else "undecided"
        return f"World({counted(len(self.states), 'agent')}, automaton state {self.q}, time {self.time}, {verdict})"


@dataclass(frozen=True, eq=False, repr=False)
class SingleSimulator:
    """The dynamics of a problem on plain numbers.

    Attributes
    ----------
    dynamics : Dynamics
    agents : tuple of AgentNumbers
    accepting : tuple of bool
        Per automaton state: whether the task is accepted on entering it.
    judged : tuple of bool
        Per automaton state: whether a finite-trace task is satisfied in it at the horizon.
    dead : tuple of bool
        Per automaton state: whether acceptance is out of reach.
    n_draws : int
        Standard normal numbers drawn in one step.
    shared : tuple of tuples of (int, int, float)
        Per agent: state, position of a number drawn, and what it adds to that state, for noise that agents share.
    """

    dynamics: Dynamics
    agents: tuple[AgentNumbers, ...]
    accepting: tuple[bool, ...]
    judged: tuple[bool, ...]
    dead: tuple[bool, ...]
    n_draws: int
    shared: tuple[tuple[tuple[int, int, float], ...], ...]
    _following: dict[tuple[int, int], int] = field(default_factory=dict)
    _names: dict[int, tuple[str, ...]] = field(default_factory=dict)
    _regions: dict[int, tuple[Any, ...]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"OneWorld({self.dynamics!r})"

    @classmethod
    def of(cls, dynamics: Dynamics) -> SingleSimulator:
        """Return the dynamics of a problem on plain numbers (exact)."""
        problem, labeling = dynamics.problem, dynamics.problem.labeling
        still = labeling.at(0)  # where regions move, those of a time are asked for
        # `dynamics.noise` draws block after block, and in a block component after component for all its agents.
        rows = [len(block.columns) + extra_rows(dynamics, block) for block in dynamics.blocks]
        block_draws = slices_of(count * len(block.agents) for count, block in zip(rows, dynamics.blocks))
        numbers = []
        for i, agent in enumerate(problem.agents):
            block, place = dynamics.position[i]
            n = len(dynamics.blocks[block].agents)
            positions = tuple(block_draws[block].start + c * n + place for c in range(rows[block]))
            draws = positions[: agent.n_states], positions[agent.n_states :]
            corners = still.low[i].T, still.high[i].T
            beside = [place_of(name, problem.agents) for name in agent.others]
            own = _numbers(
                agent, problem.written_agents[i].noise_factor, *corners, labeling.agent_propositions[i], draws
            )
            motion = dynamics.blocks[block].motion
            if isinstance(motion, WrittenMotion):  # agents of a block share what is compiled
                own = own._replace(beside=tuple(beside), motion=motion)
            numbers.append(own)
        automaton = problem.automaton
        finite = np.asarray(automaton.accepting & ~automaton.finished)
        return cls(
            dynamics,
            tuple(numbers),
            tuple(dynamics.accepting.tolist()),
            tuple(finite.tolist()),
            tuple(automaton.dead.tolist()),
            block_draws[-1].stop + len(problem.joint_noise),
            _shared(dynamics, block_draws[-1].stop),
        )

    def begin(self, worlds: Worlds) -> World:
        """Return the only world of a batch."""
        # Blocks order agents by their sizes; a single world has them in the order of the problem.
        states: list[Any] = [None] * len(self.agents)
        for block, x in zip(self.dynamics.blocks, worlds.states):
            for place, agent in enumerate(block.agents):
                states[agent] = x[:, place, 0].tolist()
        failed = bool(worlds.failed[0])
        letter = 0 if failed else self._letter(tuple(states), int(worlds.time))[0]
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
        # Read the letter, ask the automaton, and decide in the order of `rules.decided`.
        unknown = self._disturbances(world, inputs, normals)
        steps = zip(self.agents, world.states, inputs, unknown)
        team = world.states, inputs
        now = world.time
        with self._quiet():
            states = tuple([a.moved(x, u, [normals[k] for k in a.draws], v, team, now) for a, x, u, v in steps])
            if self.dynamics.problem.joint_noise:
                for x, own in zip(states, self.shared):
                    for c, k, factor in own:
                        x[c] = x[c] + factor * normals[k]
            for i, k in self._angles:
                states[i][k] = float(wrapped(np.float64(states[i][k]), self.agents[i].state_low[k]))
            letter, outside = self._letter(states, now + 1)
        following = self._next(world.q, letter)
        q, failed, accepted = decided(self.accepting, world.q, following, world.failed, world.accepted, outside)
        return World(states, q, world.time + 1, failed, accepted, 0 if failed else letter)

    def settled(self, world: World) -> bool:
        """Return whether the verdict is final (a finite-trace task is never satisfied before the horizon)."""
        return world.failed or world.accepted or self.dead[world.q]

    def satisfied(self, world: World) -> bool:
        """Return whether the task is satisfied so far, by the rule of `dynamics.satisfied`."""
        at_end = world.time == self.dynamics.problem.horizon
        return world.accepted or (at_end and not world.failed and self.judged[world.q])

    def names(self, letter: int) -> tuple[str, ...]:
        """Return the names of the propositions of a letter."""
        if letter not in self._names:
            if len(self._names) >= _MEMORY:
                self._names.clear()
            problem = self.dynamics.problem
            names = (name for p, name in enumerate(problem.automaton.propositions) if letter >> p & 1)
            self._names[letter] = tuple(problem.told(names))
        return self._names[letter]

    @cached_property
    def _angles(self) -> list[tuple[int, int]]:
        """Which states of which agents are angles."""
        return [
            (i, k)
            for i, agent in enumerate(self.dynamics.problem.agents)
            for k in np.flatnonzero(agent.wrapped_axes).tolist()
        ]

    @cached_property
    def _calm(self) -> list[None]:
        """No disturbances, agent by agent."""
        return [None] * len(self.agents)

    @cached_property
    def _is_disturbed(self) -> bool:
        return any(block.n_disturbances for block in self.dynamics.blocks)

    @cached_property
    def _quiet(self) -> Callable[[], AbstractContextManager[Any]]:
        """What a step stands in: functions of numpy must not warn of states that are not defined, sums never do."""
        motions = [agent.motion for agent in self.agents if agent.motion is not None]
        compiled = [c for motion in motions for c in (motion.means, motion.scales, motion.outputs)]
        return nullcontext if all(c.is_plain for c in compiled) else partial(np.errstate, all="ignore")

    def _disturbances(self, world: World, inputs: Any, normals: Any) -> Sequence[list[float] | None]:
        """Return the disturbances (k) of every agent; None for those without any."""
        if not self._is_disturbed:
            return self._calm
        behaviour = self.dynamics.disturbance
        if not isinstance(behaviour, str):
            return self._asked(behaviour, world, inputs)
        result: list[list[float] | None] = []
        for agent in self.agents:
            count = 0 if agent.motion is None else len(agent.motion.calm)
            if agent.motion is None or not count:
                result.append(None)
                continue
            rows = np.array([normals[k] for k in agent.extra] or [0.0] * count)[:, None]
            low, high = agent.motion.agent.disturbance_low, agent.motion.agent.disturbance_high
            found = named_disturbances(low[:, None], high[:, None], behaviour, world.time, rows)
            result.append(found[:, 0].tolist())
        return result

    def _asked(self, behaviour: Against, world: World, inputs: Any) -> list[list[float] | None]:
        """Return what a function says about the world as a batch of one."""
        states = np.concatenate([np.asarray(x, dtype=float) for x in world.states])[None]
        joint = np.concatenate([np.asarray(u, dtype=float) for u in inputs])
        marks = (np.array([world.q], dtype=np.int32), world.time, np.array([world.failed]), np.array([world.accepted]))
        columns, blocks = self.dynamics.problem.input_columns, self.dynamics.blocks
        batch = tuple(np.stack([joint[columns[i]] for i in block.agents], axis=1)[..., None] for block in blocks)
        found = behaviour(self.dynamics, Worlds(split_joint(self.dynamics, states), *marks), batch)
        places = (self.dynamics.position[i] for i in range(len(self.agents)))
        calm = [None if agent.motion is None else agent.motion.calm.tolist() for agent in self.agents]
        chosen = (None if (values := found[b]) is None else values[:, k, 0].tolist() for b, k in places)
        return [own if values is None else values for own, values in zip(calm, chosen)]

    def _regions_at(self, time: int) -> tuple[Any, ...]:
        """Return the regions of every agent at a time, as in `AgentNumbers`."""
        labeling = self.dynamics.problem.labeling
        if not labeling.moves:
            return self._still
        if time not in self._regions:
            if len(self._regions) >= _MEMORY:
                self._regions.clear()
            here = labeling.at(time)
            self._regions[time] = tuple(
                tuple((1 << int(p), a, b) for p, a, b in zip(own, low.T.tolist(), high.T.tolist()))
                for own, low, high in zip(here.agent_propositions, here.low, here.high)
            )
        return self._regions[time]

    @cached_property
    def _still(self) -> tuple[Any, ...]:
        """The regions of every agent, if they stand still."""
        return tuple(agent.regions for agent in self.agents)

    def _letter(self, states: tuple[Any, ...], time: int) -> tuple[int, bool]:
        """Return the letter of the states at a time, and whether an agent is outside its workspace."""
        # Propositions are the bits of an integer, which is quick to build and to look up.
        letter, outside = 0, False
        outputs = []
        for a, x, regions in zip(self.agents, states, self._regions_at(time)):
            outside = outside or not inside(x, a.state_low, a.state_high)
            y = a.outputs(x)
            outputs.append(y)
            for bit, low, high in regions:
                if contains(y, low, high):
                    letter |= bit
        labeling = self.dynamics.problem.labeling
        pairs = labeling.at(time).pairs if labeling.pairs else ()
        for p, pair in enumerate(pairs, start=labeling.first_pair):
            between = pair.difference(outputs[pair.first], outputs[pair.second])
            if holds(between, pair.low, pair.high, pair.radius):
                letter |= 1 << p
        return letter, outside

    def _next(self, q: int, letter: int) -> int:
        """Return the automaton state after a letter; the automaton is asked once for each state and letter."""
        key = (q, letter)
        if key not in self._following:
            if len(self._following) >= _MEMORY:
                self._following.clear()
            automaton = self.dynamics.problem.automaton
            bits = np.array([letter >> p & 1 for p in range(len(automaton.propositions))], dtype=bool)
            self._following[key] = int(automaton.next_state(np.asarray(q), bits))
        return self._following[key]


def _numbers(
    agent: AnyAgent,
    factor: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    propositions: np.ndarray,
    draws: tuple[tuple[int, ...], tuple[int, ...]],
) -> AgentNumbers:
    """Return one agent as plain numbers; `factor` is that of its own noise, `low` and `high` have a row per region."""
    names = ("A", "B", "offset", "output_matrix")
    matrices = {name: getattr(agent, name).tolist() for name in names} if isinstance(agent, LinearAgent) else {}
    return AgentNumbers(
        A=matrices.get("A"),
        B=matrices.get("B"),
        offset=matrices.get("offset"),
        noise_factor=factor.tolist(),
        C=None if agent.has_identity_output else matrices.get("output_matrix"),
        state_low=agent.state_low.tolist(),
        state_high=agent.state_high.tolist(),
        input_low=agent.input_low.tolist(),
        input_high=agent.input_high.tolist(),
        regions=tuple((1 << int(p), a.tolist(), b.tolist()) for p, a, b in zip(propositions, low, high)),
        draws=draws[0],
        extra=draws[1],
        motion=None,
        noise_rows=[sparse_row(row) for row in factor],
        beside=(),
        lawful=None if agent.laws is None else agent,
    )


def _shared(dynamics: Dynamics, first: int) -> tuple[tuple[tuple[int, int, float], ...], ...]:
    """Return what sources add to each agent; their numbers are drawn from position `first` on."""
    result = []
    for block, place in dynamics.position:
        # Those that add to another agent of the block stay, as 0, so that the bits are those of the batch.
        own = dynamics.blocks[block].shared_noise
        result.append(tuple((c, first + k, float(to_host(factor)[place, 0])) for c, k, factor in own))
    return tuple(result)


def sparse_row(row: np.ndarray) -> tuple[list[float], list[int]]:
    """Return the entries of a row (d,) that are not 0, and their positions; one stays if all are 0."""
    positions = np.flatnonzero(row).tolist() or [0]
    return row[positions].tolist(), positions
