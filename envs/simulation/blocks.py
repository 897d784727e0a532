"""Blocks: agents of equal sizes, stacked into arrays, so that the dynamics compute with many at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property, reduce
from operator import add
from typing import Any

import numpy as np

from ..systems.agents import TIME, Agent, AnyAgent, linear, neighbour, place_of, with_expressions, with_matrices
from ..systems.arguments import counted, read_only
from ..systems.backends import double, is_host, is_whole, namespace
from ..systems.expressions import Compiled
from ..tasks.problem import Problem
from ..tasks.regions import MOVING_REFUSAL, PairRegion, contains, holds

Put = Callable[[np.ndarray], Any]
"""How arrays get to where worlds live: see `arrays.device_put`."""

Row = np.ndarray | float
"""What an entry of their arrays is for each agent, (n, 1), or for all of them."""

Sparse = tuple[tuple[Row, ...], tuple[int, ...]]
"""Entries of a row of the agents' matrices, and their positions in the row.

Entries that are 0 for all agents are left out; one stays if all are 0.
"""


RUN = 4
"""Pairs in a run, on average, from which they are read run by run."""


@dataclass(frozen=True, eq=False)
class LinearMotion:
    """How the linear agents of a block move, and what they put out.

    Attributes
    ----------
    A, B, C : np.ndarray, shape (d, d, n, 1), (d, m, n, 1), (p, d, n, 1)
    offset : np.ndarray, shape (d, n, 1)
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    offset: np.ndarray


@dataclass(frozen=True, eq=False)
class WrittenMotion:
    """How agents move whose dynamics and outputs are the same expressions: those of `agent`.

    The functions are those of `Agent.mean`, `scales` and `outputs`, compiled: the same bits, for numbers and arrays.
    """

    agent: Agent

    @cached_property
    def means(self) -> Compiled:
        """Means of states (d), from states, inputs, disturbances, what is named of others, and the time."""
        return Compiled(self.agent.timed_trees, self._groups)

    @cached_property
    def scales(self) -> Compiled:
        """What noise is multiplied with (d), from the same; nothing without a `noise_scale`."""
        return Compiled(self.agent.timed_scale_trees, self._groups)

    @cached_property
    def outputs(self) -> Compiled:
        """Outputs (p) from states."""
        return Compiled(self.agent.output_trees, [self.agent.states])

    @cached_property
    def calm(self) -> np.ndarray:
        """Disturbances (k,) that are nearest to 0."""
        return np.clip(0.0, self.agent.disturbance_low, self.agent.disturbance_high)

    @property
    def _groups(self) -> list[Sequence[str]]:
        agent = self.agent
        beside = [neighbour(k) for k in range(len(agent.others))]
        return [agent.states, agent.inputs, tuple(agent.disturbances), beside, [TIME] if agent.names_time else []]

    def moved(
        self, x: np.ndarray, u: np.ndarray, z: np.ndarray, v: Any, beside: Any, time: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return means (d, n, M), and z (d, n, M) times its scales; arguments are those of `worlds.successor`."""
        agent = self.agent
        if not is_host(x) or (beside is None and agent.others) or (time is None and agent.names_time):
            scaled = z if agent.noise_scale is None else agent.scales(x, u, v, time) * z
            return agent.mean(x, u, v, beside, time), scaled
        v = self.calm[:, None, None] if v is None else v
        clock = [np.atleast_1d(double(time))] if agent.names_time else []
        groups = (x, np.asarray(u, dtype=float), v, beside, clock)
        means = stacked(self.means.arrays(*groups), x.shape)
        if agent.noise_scale is None:
            return means, z
        return means, stacked(self.scales.arrays(*groups), x.shape) * z


def stacked(rows: Sequence[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """Return rows that broadcast as one fresh array of a shape."""
    result = np.empty(shape)
    for k, row in enumerate(rows):
        result[k] = row
    return result


@dataclass(frozen=True, eq=False, repr=False)
class Block:
    """Agents of equal sizes, stacked.

    Attributes
    ----------
    agents : np.ndarray of int, shape (n,)
        Positions of the agents in the problem.
    motion : LinearMotion or WrittenMotion
    noise_factor : np.ndarray, shape (d, d, n, 1)
    shared_noise : tuple of (int, int, np.ndarray of shape (n, 1))
        Noise that agents share: state, source, and what the source adds to that state of each agent.
    noise_of : AnyAgent
        An agent with the laws of noise that all of them have.
    state_low, state_high, initial_low, initial_high : np.ndarray, shape (d, n, 1)
    input_low, input_high : np.ndarray, shape (m, n, 1)
    identity_output : bool
        Whether y = x for all agents.
    propositions, owners : np.ndarray of int, shape (k,)
        Propositions of these agents, and for each of them the position of its agent in the block.
    region_low, region_high : np.ndarray, shape (p, k, 1)
        With an axis of times 0 to T in front if regions move (see `regions`).
    columns : np.ndarray of int, shape (d, n)
        Positions of the components in a joint state.
    beside : np.ndarray of int, shape (l, n)
        Positions, in a joint state with the joint input behind it, of what the dynamics name of other agents.
    """

    agents: np.ndarray
    motion: LinearMotion | WrittenMotion
    noise_factor: np.ndarray
    shared_noise: tuple[tuple[int, int, np.ndarray], ...]
    noise_of: AnyAgent
    state_low: np.ndarray
    state_high: np.ndarray
    initial_low: np.ndarray
    initial_high: np.ndarray
    input_low: np.ndarray
    input_high: np.ndarray
    identity_output: bool
    propositions: np.ndarray
    owners: np.ndarray
    region_low: np.ndarray
    region_high: np.ndarray
    columns: np.ndarray
    beside: np.ndarray

    def __repr__(self) -> str:
        (m, n), d, p = self.input_low.shape[:2], len(self.state_low), self.region_low.shape[-3]
        sizes = (counted(d, "state"), counted(m, "input"), counted(p, "output"))
        return f"Block({counted(n, 'agent')} with {', '.join(sizes)})"

    @property
    def n_inputs(self) -> int:
        """Number of inputs m of each agent."""
        return len(self.input_low)

    @property
    def n_disturbances(self) -> int:
        """Number of bounded disturbances of each agent."""
        return len(self.motion.agent.disturbances) if isinstance(self.motion, WrittenMotion) else 0

    @cached_property
    def angle_rows(self) -> tuple[int, ...]:
        """Which states are angles, for all agents alike."""
        return tuple(np.flatnonzero(self.noise_of.wrapped_axes).tolist())

    @cached_property
    def linear_rows(self) -> tuple[tuple[Sparse, Sparse, Row, Sparse], ...]:
        """Rows of A, B, offset and noise factor."""
        assert isinstance(self.motion, LinearMotion)
        rows = zip(self.motion.A, self.motion.B, self.motion.offset[:, None], self.noise_factor)
        return tuple((_sparse(a), _sparse(b), numbered(c)[0], _sparse(factor)) for a, b, c, factor in rows)

    @cached_property
    def noise_rows(self) -> tuple[Sparse, ...]:
        """Rows of the noise factor, as in `linear_rows`."""
        return tuple(_sparse(row) for row in self.noise_factor)

    @cached_property
    def start_box(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Widths of the start boxes and the last numbers in them, (d, n, 1) each; None if all starts are points."""
        width = self.initial_high - self.initial_low
        if not width.any():
            return None
        # Rounding can carry a draw to the upper corner, which belongs to the next half-open region.
        return width, np.where(width > 0.0, np.nextafter(self.initial_high, -np.inf), self.initial_high)

    @cached_property
    def disturbance_ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends of the intervals of bounded disturbances, (k, 1, 1) each."""
        if not isinstance(self.motion, WrittenMotion):
            return np.zeros((0, 1, 1)), np.zeros((0, 1, 1))
        agent = self.motion.agent
        return agent.disturbance_low[:, None, None], agent.disturbance_high[:, None, None]

    def outputs(self, x: np.ndarray) -> np.ndarray:
        """Return the outputs (p, n, M) at states (d, n, M)."""
        if self.identity_output:
            return x
        if isinstance(self.motion, LinearMotion):
            return linear(self.motion.C, x)
        if not is_host(x):
            return self.motion.agent.outputs(x)
        return stacked(self.motion.outputs.arrays(x), (self.motion.agent.n_outputs, *x.shape[1:]))

    @cached_property
    def output_width(self) -> np.ndarray:
        """Widths (p, n, 1) of the outputs of the workspaces."""
        if isinstance(self.motion, LinearMotion):
            extent = (self.state_high - self.state_low)[None]
            return np.asarray((np.abs(self.motion.C) * extent).sum(axis=1))
        low, high = self.motion.agent.output_range(self.state_low[..., 0].T, self.state_high[..., 0].T)
        # Outputs without a bound, and outputs that are all the same, have no width to measure by.
        width = (high - low).T[..., None]
        return np.where(np.isfinite(width) & (width > 0.0), width, 1.0)

    def regions(self, time: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the corners of the regions at a time, (p, k, 1), or at a time for each world, (p, k, M)."""
        if self.region_low.ndim == 3:
            return self.region_low, self.region_high
        if time is None:
            raise ValueError(MOVING_REFUSAL)
        if np.ndim(time) == 0:
            return self.region_low[time], self.region_high[time]
        xp = namespace(self.region_low)
        low, high = (xp.moveaxis(corners[time][..., 0], 0, -1) for corners in (self.region_low, self.region_high))
        return low, high

    @cached_property
    def input_middle(self) -> tuple[np.ndarray, np.ndarray]:
        """Middles and half widths of the input boxes (m, n, 1), onto which [-1, 1] is mapped."""
        return 0.5 * self.input_low + 0.5 * self.input_high, 0.5 * self.input_high - 0.5 * self.input_low

    @cached_property
    def unit_rows(self) -> list[tuple[Row, Row]]:
        """Per state: the lower ends of the workspaces, and what maps their widths to 2."""
        return list(zip(numbered(self.state_low), numbered(2.0 / (self.state_high - self.state_low))))

    @cached_property
    def input_rows(self) -> list[tuple[Row, Row, Row, Row]]:
        """Per input: the ends of the boxes, and their middles and half widths."""
        return list(zip(*map(numbered, (self.input_low, self.input_high, *self.input_middle))))

    @cached_property
    def middle_stays_inside(self) -> bool:
        """Whether [-1, 1] is mapped into the input boxes whatever is rounded: products and sums are monotone."""
        middle, half = self.input_middle
        return bool((middle - half >= self.input_low).all() and (middle + half <= self.input_high).all())

    @cached_property
    def input_range(self) -> tuple[float, float]:
        """Largest interval in which every component of every agent's input is admissible."""
        return float(self.input_low.max()), float(self.input_high.min())


def placed(record: Any, put: Put) -> Any:
    """Return a block, or pairs, with its arrays where `put` puts them; what it computes from them comes along."""
    if put is np.asarray:
        return record

    def moved(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return put(value.astype(np.int64) if is_whole(value) else value)
        if isinstance(value, tuple):
            return tuple(map(moved, value))
        return placed(value, put) if is_dataclass(value) and isinstance(value, LinearMotion) else value

    there = replace(record, **{field.name: moved(getattr(record, field.name)) for field in fields(record)})
    # Properties read facts off arrays, for which numpy is the place.
    if isinstance(record, Block):
        names = ["start_box", "disturbance_ends", "output_width", "input_range", "noise_rows"]
        names += ["linear_rows"] if isinstance(record.motion, LinearMotion) else []
        there.__dict__.update({name: moved(getattr(record, name)) for name in names})
    return there


@dataclass(frozen=True, eq=False, repr=False)
class PairBlock:
    """Propositions about pairs whose first agents are in one block, whose second are in one, and whose outputs agree.

    Attributes
    ----------
    blocks : pair of int
        Numbers of the two blocks.
    places : pair of np.ndarray of int, shape (k,)
        Per proposition: where its agents stand in these blocks.
    outputs : pair of np.ndarray of int, shape (p,)
        Outputs that are compared.
    propositions : np.ndarray of int, shape (k,)
    low, high : np.ndarray, shape (p, k, 1)
    radius : np.ndarray, shape (k, 1)
        Infinite where the box alone decides.

    Where a pair moves, boxes and radii have an axis of times in front.
    """

    blocks: tuple[int, int]
    places: tuple[np.ndarray, np.ndarray]
    outputs: tuple[np.ndarray, np.ndarray]
    propositions: np.ndarray
    low: np.ndarray
    high: np.ndarray
    radius: np.ndarray

    def __repr__(self) -> str:
        return f"PairBlock({counted(len(self.propositions), 'pair')} of blocks {self.blocks[0]} and {self.blocks[1]})"

    def difference(self, outputs: Mapping[int, np.ndarray]) -> np.ndarray:
        """Return the differences (p, k, M) of the outputs that pairs compare, from the outputs (p', n, M) per block."""
        first, second = (
            outputs[b][axes[:, None], places[None]] for b, axes, places in zip(self.blocks, self.outputs, self.places)
        )
        with np.errstate(over="ignore", invalid="ignore"):  # infinity less infinity is near nothing
            result: np.ndarray = first - second
            return result

    def hold(self, outputs: Mapping[int, np.ndarray], time: Any) -> np.ndarray:
        """Return which pairs hold, bool (k, M); on this machine run by run, so that numbers stay in the cache."""
        low, high, radius = self.regions(time)
        first, second = (outputs[b] for b in self.blocks)
        with np.errstate(over="ignore", invalid="ignore"):
            if not is_host(first) or len(self.propositions) < RUN * len(self._runs):
                whole: np.ndarray = holds(self.difference(outputs), low, high, radius)
                return whole
            result = np.empty((len(self.propositions), first.shape[-1]), dtype=bool)
            for rows, one, others in self._runs:
                apart = [first[a, one] - second[b, others] for a, b in zip(*self.outputs, strict=True)]
                if self._is_round:  # no box: what is no number is not near, either
                    squares = reduce(add, (own * own for own in apart))
                    np.less(squares, radius[rows] * radius[rows], out=result[rows])
                elif self._is_boxed:
                    result[rows] = contains(apart, low[:, rows], high[:, rows])
                else:
                    result[rows] = holds(apart, low[:, rows], high[:, rows], radius[rows])
        return result

    @cached_property
    def _is_round(self) -> bool:
        """Whether all pairs stand still and have radii alone."""
        boundless = np.all(self.low == -np.inf) and np.all(self.high == np.inf)
        return bool(self.low.ndim == 3 and boundless and np.all(self.radius < np.inf))

    @cached_property
    def _is_boxed(self) -> bool:
        """Whether no pair has a radius."""
        return bool(np.all(self.radius == np.inf))

    @cached_property
    def _runs(self) -> list[tuple[slice, int, slice]]:
        """Pairs in a row of one agent and others that stand in a row: which pairs, the agent, and the others."""
        first, second = (places.tolist() for places in self.places)
        begins = [k for k in range(len(first)) if not k or first[k] != first[k - 1] or second[k] != second[k - 1] + 1]
        ends = [*begins[1:], len(first)]
        return [(slice(a, b), first[a], slice(second[a], second[a] + b - a)) for a, b in zip(begins, ends, strict=True)]

    def regions(self, time: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return boxes (p, k, 1) and radii (k, 1) at a time, or with an axis (M) last at a time for each world."""
        if self.low.ndim == 3:
            return self.low, self.high, self.radius
        if time is None:
            raise ValueError(MOVING_REFUSAL)
        if np.ndim(time) == 0:
            return self.low[time], self.high[time], self.radius[time]
        xp = namespace(self.low)
        low, high, radius = (xp.moveaxis(part[time][..., 0], 0, -1) for part in (self.low, self.high, self.radius))
        return low, high, radius


def pair_blocks(problem: Problem, position: Sequence[tuple[int, int]]) -> tuple[PairBlock, ...]:
    """Return the propositions about pairs of a problem, stacked; `position` is block and place of each agent."""
    labeling, alike = problem.labeling, dict[object, list[int]]()
    for k, pair in enumerate(labeling.pairs):
        key = (position[pair.first][0], position[pair.second][0], pair.outputs, pair.moves)
        alike.setdefault(key, []).append(k)
    result = []
    for numbers in alike.values():
        pairs = [labeling.pairs[k] for k in numbers]
        first, second = (
            np.array([position[i] for i in agents]) for agents in zip(*((p.first, p.second) for p in pairs))
        )
        low, high, radius = _of_pairs(pairs, problem.horizon)
        result.append(
            PairBlock(
                blocks=(int(first[0, 0]), int(second[0, 0])),
                places=(read_only(first[:, 1].copy()), read_only(second[:, 1].copy())),
                outputs=(np.array(pairs[0].outputs[0]), np.array(pairs[0].outputs[1])),
                propositions=read_only(labeling.first_pair + np.array(numbers)),
                low=read_only(low),
                high=read_only(high),
                radius=read_only(radius),
            )
        )
    return tuple(result)


def _of_pairs(pairs: Sequence[PairRegion], horizon: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return boxes and radii of pairs that all stand still, or all move, as a `PairBlock` has them."""
    if not pairs[0].moves:
        low, high = (np.stack([getattr(pair, end) for pair in pairs], axis=1)[..., None] for end in ("low", "high"))
        return low, high, np.array([[pair.radius] for pair in pairs])
    low, high, radius = zip(*(pair.over(np.arange(horizon + 1, dtype=float)) for pair in pairs), strict=True)
    first, last = (np.stack(ends, axis=1).transpose(2, 0, 1)[..., None] for ends in (low, high))
    return first, last, np.stack(radius, axis=1)[..., None]


def block_of(problem: Problem, group: list[int]) -> Block:
    """Return the block of some agents of a problem, named by their positions; all must have equal sizes."""
    agents = [problem.agents[i] for i in group]
    labeling = problem.labeling

    # Agents become the last axis but one; the last one is that of the worlds.
    def stacked(arrays: Sequence[np.ndarray | None]) -> np.ndarray:
        return read_only(np.stack([np.asarray(a) for a in arrays], axis=-1)[..., None])

    # Propositions of all agents of the block stand side by side; `owners` says which agent each belongs to.
    # Regions that move have an axis of times in front.
    corners = [
        labeling.corners_over(i, problem.horizon + 1) if labeling.moving else (labeling.low[i], labeling.high[i])
        for i in group
    ]
    regions_low, regions_high = (np.concatenate([own[side] for own in corners], axis=-1) for side in (0, 1))
    counts = [len(labeling.agent_propositions[i]) for i in group]
    return Block(
        agents=read_only(np.array(group)),
        motion=_motion(agents, stacked),
        # What agents share comes on top of it.
        noise_factor=stacked([problem.written_agents[i].noise_factor for i in group]),
        shared_noise=_shared(problem, group),
        noise_of=agents[0],
        state_low=stacked([a.state_low for a in agents]),
        state_high=stacked([a.state_high for a in agents]),
        initial_low=stacked([a.initial_low for a in agents]),
        initial_high=stacked([a.initial_high for a in agents]),
        input_low=stacked([a.input_low for a in agents]),
        input_high=stacked([a.input_high for a in agents]),
        identity_output=all(a.has_identity_output for a in agents),
        propositions=read_only(np.concatenate([labeling.agent_propositions[i] for i in group])),
        owners=read_only(np.repeat(np.arange(len(group)), counts)),
        region_low=read_only(regions_low[..., None]),
        region_high=read_only(regions_high[..., None]),
        # Components of an agent are consecutive in a joint state; here they are the rows.
        columns=read_only(
            np.stack([np.arange(problem.columns[i].start, problem.columns[i].stop) for i in group], axis=1)
        ),
        beside=read_only(np.stack([_beside(problem, agent) for agent in agents], axis=1)),
    )


def _shared(problem: Problem, group: list[int]) -> tuple[tuple[int, int, np.ndarray], ...]:
    """Return what sources add to the agents of a block, leaving out those that add nothing."""
    factors = np.stack([problem.shared_noise[i] for i in group], axis=-1)
    places = np.argwhere(np.any(factors != 0.0, axis=-1)).tolist()
    return tuple((c, k, read_only(factors[c, k][:, None].copy())) for c, k in places)


def _beside(problem: Problem, agent: AnyAgent) -> np.ndarray:
    """Return the positions (l,), in joint state and joint input, of what an agent's dynamics name of others."""
    positions = []
    for place in (place_of(name, problem.agents) for name in agent.others):
        # Inputs stand behind all states.
        columns, before = (problem.input_columns, problem.n_states) if place.is_input else (problem.columns, 0)
        positions.append(before + columns[place.agent].start + place.component)
    return np.array(positions, dtype=np.int64)


def _motion(
    agents: Sequence[AnyAgent], stacked: Callable[[Sequence[np.ndarray]], np.ndarray]
) -> LinearMotion | WrittenMotion:
    """Return how the agents of a block move: all of them are linear, or all have the same expressions."""
    first = agents[0]
    if not first.is_affine:
        return WrittenMotion(with_expressions(first))
    linear_agents = [with_matrices(agent) for agent in agents]
    return LinearMotion(
        A=stacked([a.A for a in linear_agents]),
        B=stacked([a.B for a in linear_agents]),
        C=stacked([a.output_matrix for a in linear_agents]),
        offset=stacked([a.offset for a in linear_agents]),
    )


def _sparse(row: np.ndarray) -> Sparse:
    positions = np.flatnonzero(np.any(row != 0.0, axis=(1, 2)))
    positions = positions if len(positions) else np.array([0])
    return numbered(row[positions]), tuple(positions.tolist())


def numbered(rows: np.ndarray) -> tuple[Row, ...]:
    """Return the rows (n, 1) of an array (k, n, 1), or a number for those that say the same of all agents.

    The bits are the same, but numpy takes up to three times as long where it has to broadcast.
    """
    return tuple(float(row[0, 0]) if np.all(row == row[0]) else row for row in rows)
