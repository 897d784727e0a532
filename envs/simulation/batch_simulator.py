"""The batched functional core: start, noise, transition, letters, automaton step. Every environment is a view on it.

Linear agents of equal sizes (d, m, p), and agents with the same expressions, form a *block*, whose states are one array
(d, n, M): component, agent of the block, world. All sums run elementwise in a fixed order, so the trajectory of a world
does not depend, to the last bit, on the number of worlds computed beside it.

The step of an agent (`moved`), membership (`labeling.inside`, `contains`) and the order of decisions (`decided`) are
written for anything that adds, multiplies and compares: this module runs them on arrays, `single_simulator` on numbers.

One step, in this order:

1. `x' = A x + B u + c + L z`, or `f(x, u, t) + L z`, with `z` standard normal and `L L' = Sigma`; then what agents
   share, source by source (`problem.joint_noise`);
2. a world in which any agent has left its workspace fails, even if another agent would complete the task in this step;
3. the automaton reads the letter of x', with the regions of the time after the step;
4. a co-safe task is accepted on entering an accepting state.

Failed and accepted are absorbing; the states of decided worlds move on.

Reference: docs/theory/setting.md, "Satisfaction".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import and_
from typing import Any, Protocol

import numpy as np

from ..systems.agents import wrapped
from ..systems.arguments import counted, read_only, shortened, tree_text
from ..systems.backends import concatenated, double, is_host, namespace, to_host
from ..tasks.automata import Automaton
from ..tasks.problem import Problem
from ..tasks.regions import contains, inside
from .blocks import Block, PairBlock, Put, WrittenMotion, block_of, pair_blocks, placed
from .diagrams import Diagrams
from .disturbances import Behaviour, checked_behaviour, named_disturbances
from .rules import decided, moved, noisy
from .tables import Reader, reader


class Draws(Protocol):
    """Source of random numbers: a `numpy.random.Generator`, or several of them, each for some of the worlds."""

    def standard_normal(self, size: tuple[int, ...], /) -> np.ndarray:
        """Return standard normal numbers; worlds are the last axis."""

    def random(self, size: tuple[int, ...], /) -> np.ndarray:
        """Return numbers uniform on [0, 1); worlds are the last axis."""


@dataclass(frozen=True, eq=False, repr=False)
class Dynamics:
    """A problem arranged for batches.

    Attributes
    ----------
    problem : Problem
    blocks : tuple of Block
    position : tuple of (int, int)
        Per agent: its block, and its place in the block.
    accepting : np.ndarray of bool, shape (Q,)
        Automaton states whose entry accepts the task at once: none for finite-trace tasks.
    disturbance : Behaviour
        How bounded disturbances behave.
    put : callable
        How arrays get to where the worlds live: `numpy.asarray`, or that of a device (`arrays.device_put`).
    """

    problem: Problem
    blocks: tuple[Block, ...]
    position: tuple[tuple[int, int], ...]
    accepting: np.ndarray
    disturbance: Behaviour = "zero"
    put: Put = np.asarray

    def __repr__(self) -> str:
        agents, blocks = counted(self.problem.n_agents, "agent"), counted(len(self.blocks), "block")
        return f"Dynamics({shortened(self.problem.name, 60)!r}, {agents} in {blocks})"

    @classmethod
    def of(cls, problem: Problem, disturbance: Behaviour = "zero", put: Put = np.asarray) -> Dynamics:
        """Return the dynamics of a problem.

        Linear agents of equal sizes, and equal expressions, share a block if their noise has the same laws.
        """
        if problem.automaton.reads_exits:
            raise ValueError(
                f"`problem`: expected a task, got the opposite of one, {problem.name!r}, which certificates alone are "
                "about; simulate the task itself"
            )
        # Blocks come in the order of their first agents, which fixes the order of all random numbers.
        members: dict[object, list[int]] = {}
        for i, agent in enumerate(problem.agents):
            sizes = (agent.n_states, agent.n_inputs, agent.n_outputs)
            members.setdefault((sizes, agent.stack_key, agent.laws), []).append(i)
        place = {i: (b, k) for b, group in enumerate(members.values()) for k, i in enumerate(group)}
        blocks = tuple(placed(block_of(problem, group), put) for group in members.values())
        places = tuple(place[i] for i in range(problem.n_agents))
        return cls(problem, blocks, places, put(problem.automaton.finished), checked_behaviour(disturbance), put)

    @cached_property
    def pairs(self) -> tuple[PairBlock, ...]:
        """The propositions about pairs of agents, stacked."""
        return tuple(placed(pairs, self.put) for pairs in pair_blocks(self.problem, self.position))

    @property
    def is_host(self) -> bool:
        """Whether the worlds are arrays of numpy."""
        return self.put is np.asarray

    @cached_property
    def automaton(self) -> Automaton | Diagrams:
        """What reads letters where the worlds live."""
        automaton = self.problem.automaton
        return automaton if self.is_host else Diagrams.of(automaton, self.put)

    @cached_property
    def winning(self) -> Any:
        """Automaton states that satisfy the task if the word ends there, bool (Q,)."""
        return self.put(self.problem.automaton.accepting)

    @cached_property
    def rows(self) -> Any:
        """Positions (D,) of the components of a joint state among the rows of all blocks, one after the other."""
        order = [to_host(block.columns).ravel() for block in self.blocks]
        return self.put(np.argsort(np.concatenate(order)))

    @cached_property
    def points(self) -> tuple[np.ndarray, ...] | None:
        """Where all worlds start, (d, n, 1) per block, if starts are points: then none has to be drawn."""
        if any(block.start_box is not None for block in self.blocks):
            return None
        return starts(self, np.random.default_rng(0), 1)

    @cached_property
    def first(self) -> tuple[int, bool, bool] | None:
        """Automaton state, failed and accepted at the start, if all starts are read alike: none is judged again."""
        if self.points is None:
            boxes = [(b.initial_low, b.initial_low if b.start_box is None else b.start_box[1]) for b in self.blocks]
            if self.reader is None or self.reader.statuses(self.problem.automaton.initial, boxes).size > 1:
                return None
        world = initial(self, np.random.default_rng(0), 1)
        return int(world.q[0]), bool(world.failed[0]), bool(world.accepted[0])

    @cached_property
    def begins_undecided(self) -> bool:
        """Whether no start settles the task, as far as is known without drawing one."""
        return self.first is not None and not (self.first[1] or self.problem.automaton.absorbing[self.first[0]])

    @cached_property
    def rows_stand(self) -> bool:
        """Whether the rows of all blocks, one after the other, are the components of a joint state in order."""
        return bool((to_host(self.rows) == np.arange(self.problem.n_states)).all())

    @cached_property
    def input_columns(self) -> tuple[np.ndarray, ...]:
        """Columns (m, n) of a joint input, for each component and agent of a block."""
        starts = np.array([columns.start for columns in self.problem.input_columns])
        return tuple(starts[to_host(b.agents)] + np.arange(b.n_inputs)[:, None] for b in self.blocks)

    @cached_property
    def inputs_stand(self) -> bool:
        """Whether there is one block, and its inputs are those of a joint input in order."""
        return len(self.blocks) == 1 and bool((np.diff(self.input_columns[0].ravel()) == 1).all())

    @cached_property
    def input_rows(self) -> Any:
        """Positions of the components of a joint input among the rows of all blocks, one after the other."""
        columns = self.problem.input_columns
        order = [
            np.stack([np.arange(columns[i].start, columns[i].stop) for i in to_host(block.agents)], axis=1).ravel()
            for block in self.blocks
        ]
        return self.put(np.argsort(np.concatenate(order)))

    @cached_property
    def noise_shapes(self) -> tuple[tuple[int, int], ...]:
        """Rows of noise that each block draws, and its number of agents."""
        return tuple((len(block.columns) + extra_rows(self, block), len(block.agents)) for block in self.blocks)

    @cached_property
    def is_disturbed(self) -> bool:
        """Whether an agent has bounded disturbances."""
        return any(block.n_disturbances for block in self.blocks)

    @cached_property
    def names_others(self) -> bool:
        """Whether the dynamics of an agent name a state or an input of another one."""
        return any(len(block.beside) for block in self.blocks)

    @cached_property
    def names_inputs(self) -> bool:
        """Whether the dynamics of an agent name an input of another one."""
        return any(any(agent.neighbour_inputs) for agent in self.problem.agents)

    @cached_property
    def proposition_rows(self) -> Any:
        """Positions (P,) of the propositions among those of all blocks, and then of pairs."""
        order = [to_host(block.propositions) for block in self.blocks]
        order += [to_host(pairs.propositions) for pairs in self.pairs]
        return self.put(np.argsort(np.concatenate(order)))

    @cached_property
    def reader(self) -> Reader | None:
        """Tables that judge worlds; None if they would be too large, or do not apply (see `tables.reader`)."""
        # Tables read agent by agent, count in place, and know regions that stand still.
        if self.pairs or not self.is_host or self.problem.labeling.moves:
            return None
        return reader(self.blocks, self.problem.labeling, self.problem.automaton, self.accepting, decided)


@dataclass(frozen=True, eq=False, repr=False)
class Worlds:
    """A batch of M worlds.

    Attributes
    ----------
    states : tuple of np.ndarray, shape (d, n, M)
        One array per block.
    q : np.ndarray of int32, shape (M,)
        Automaton states; those of failed worlds no longer change.
    time : int, or np.ndarray of int, shape (M,)
        Control steps taken: one number, or one per world after `restart` has set some of them back.
    failed, accepted : np.ndarray of bool, shape (M,)
        At most one of them holds; both are absorbing. For co-safe tasks, accepted says that the world has not failed
        and its automaton state is accepting; for finite-trace tasks it is never set.
    """

    states: tuple[np.ndarray, ...]
    q: np.ndarray
    time: Any
    failed: np.ndarray
    accepted: np.ndarray

    def __repr__(self) -> str:
        least, most = (int(pick(self.time)) if np.size(self.time) else 0 for pick in (np.min, np.max))
        rows = [
            ("time", f"{least}" if least == most else f"{least} to {most}"),
            ("failed", int(self.failed.sum())),
            ("accepted", int(self.accepted.sum())),
            ("states", ", ".join(str(x.shape) for x in self.states[:6]) + (", ..." if len(self.states) > 6 else "")),
        ]
        return tree_text(f"Worlds: {self.n_worlds}", rows)

    @property
    def n_worlds(self) -> int:
        """Number of worlds M."""
        return int(self.q.size)


def initial(dynamics: Dynamics, rng: Draws, n_worlds: int) -> Worlds:
    """Return worlds at time 0 with starts drawn uniformly from the start boxes; fixed starts draw no numbers."""
    return begin(dynamics, starts(dynamics, rng, n_worlds))


def starts(dynamics: Dynamics, rng: Draws, n_worlds: int) -> tuple[np.ndarray, ...]:
    """Return the initial states that `initial` draws, one array (d, n, M) per block."""
    states = []
    for block in dynamics.blocks:
        xp, shape = namespace(block.initial_low), (*block.initial_low.shape[:2], n_worlds)
        if block.start_box is None:
            states.append(xp.broadcast_to(block.initial_low, shape) + 0.0)
        else:
            width, last = block.start_box
            states.append(xp.minimum(block.initial_low + width * rng.random(shape), last))
    return tuple(states)


def initial_at(dynamics: Dynamics, states: np.ndarray) -> Worlds:
    """Return worlds at time 0 with given joint states (M, D), components in agent order."""
    states = np.asarray(states, dtype=float)
    n_states = dynamics.problem.n_states
    if states.ndim != 2 or states.shape[1] != n_states:
        raise ValueError(f"`states`: expected shape (number of worlds, {n_states}), got {states.shape}")
    return begin(dynamics, split_joint(dynamics, states))


def begin(dynamics: Dynamics, states: tuple[np.ndarray, ...], time: Any = 0) -> Worlds:
    """Return worlds at time 0, one number or one for each world, with given states, one array (d, n, M) per block."""
    one, xp, first = states[0][0, 0], namespace(states[0]), dynamics.problem.automaton.initial
    if dynamics.is_host:
        q, undecided = np.full(one.shape, first, dtype=np.int32), np.zeros(one.shape, dtype=np.bool_)
    else:
        q, undecided = xp.full_like(one, first, dtype=xp.int64), xp.zeros_like(one, dtype=xp.bool)
    return _read(dynamics, states, time, q, undecided, undecided)


def restart(dynamics: Dynamics, worlds: Worlds, which: np.ndarray, rng: np.random.Generator) -> Worlds:
    """Return the worlds, with those of `which`, bool (M,), put back to time 0 and a freshly drawn start."""
    places = which.nonzero()[0]  # numpy writes at numbers faster than under a mask
    if len(places) == which.size:
        return begin(dynamics, starts(dynamics, rng, which.size), np.zeros(which.size, dtype=np.int64))
    begun = dynamics.points or starts(dynamics, rng, len(places))
    states = tuple(x.copy() for x in worlds.states)
    _put(states, places, begun)
    # From here on each world has a time of its own.
    time = worlds.time.copy() if np.ndim(worlds.time) else np.full(which.size, worlds.time)
    q, failed, accepted = worlds.q.copy(), worlds.failed.copy(), worlds.accepted.copy()
    time[places] = 0
    if dynamics.first is not None:
        q[places], failed[places], accepted[places] = dynamics.first
    else:
        fresh = begin(dynamics, begun)
        q[places], failed[places], accepted[places] = fresh.q, fresh.failed, fresh.accepted
    return Worlds(states, q, time, failed, accepted)


def _put(states: tuple[np.ndarray, ...], places: np.ndarray, starts: tuple[np.ndarray, ...]) -> None:
    """Write starts (d, n, k or 1) into states (d, n, M) of the k worlds with the numbers `places`."""
    for x, start in zip(states, starts):
        n_rows = x.shape[0] * x.shape[1]
        # numpy writes at numbers of a row faster than at those of many rows.
        for row, values in zip(x.reshape(n_rows, -1), start.reshape(n_rows, -1)):
            row[places] = values


def moved_or_begun(
    dynamics: Dynamics, worlds: Worlds, inputs: Sequence[np.ndarray], which: np.ndarray, rng: np.random.Generator
) -> Worlds:
    """Return the worlds one step later, but those of `which`, bool (M,), at time 0 and a freshly drawn start.

    Numbers are drawn and bits are as if these were put back by `restart` and the others were cut out for `transition`.
    No world is cut out: all of them move, starts are written over what has come of old worlds, and all are read once.
    Disturbances must not be a function, which would see worlds that it should not. Worlds have times of their own, and
    those that are not in `which` are before the horizon.
    """
    places = which.nonzero()[0]
    if not len(places):
        return moved_on(dynamics, worlds, inputs, noise(dynamics, rng, which.size))
    if len(places) == which.size:
        return begin(dynamics, starts(dynamics, rng, which.size), np.zeros(which.size, dtype=np.int64))
    begun = dynamics.points or starts(dynamics, rng, len(places))
    # The column of each world among the numbers drawn: those that begin take some that are not used.
    column = np.zeros(which.size, dtype=np.intp)
    column[(~which).nonzero()[0]] = np.arange(which.size - len(places))
    normals = [z.take(column, axis=-1) for z in noise(dynamics, rng, which.size - len(places))]
    states = _successors(dynamics, worlds, inputs, normals)
    _put(states, places, begun)
    time, q = worlds.time + 1, worlds.q.copy()
    time[places], q[places] = 0, dynamics.problem.automaton.initial
    # One Boolean is greater than another where it holds and the other does not.
    return _read(dynamics, states, time, q, worlds.failed > which, worlds.accepted > which)


def selected(worlds: Worlds, which: np.ndarray) -> Worlds:
    """Return only the worlds with the numbers `which`, in increasing order; all must be at one time."""
    states = tuple(x.take(which, axis=-1) for x in worlds.states)
    return Worlds(states, worlds.q[which], worlds.time, worlds.failed[which], worlds.accepted[which])


def noise(dynamics: Dynamics, rng: Draws, n_worlds: int) -> tuple[np.ndarray, ...]:
    """Return standard normal numbers for one step, one array (d, n, M) per block.

    Blocks whose disturbances are random have a further row for each disturbance. Where agents share noise, the numbers
    of all sources (K, M) come last.
    """
    own = tuple([rng.standard_normal((*shape, n_worlds)) for shape in dynamics.noise_shapes])
    n_sources = len(dynamics.problem.joint_noise)
    return (*own, rng.standard_normal((n_sources, n_worlds))) if n_sources else own


def extra_rows(dynamics: Dynamics, block: Block) -> int:
    """Return the number of rows of normal numbers that the disturbances of a block take."""
    return block.n_disturbances if dynamics.disturbance == "random" else 0


def disturbances(
    dynamics: Dynamics, worlds: Worlds, inputs: Sequence[np.ndarray], normals: Sequence[np.ndarray]
) -> tuple[np.ndarray | None, ...]:
    """Return the disturbances (k, n, M) of one step per block; None for blocks without any."""
    if not dynamics.is_disturbed:
        return (None,) * len(dynamics.blocks)
    if not isinstance(dynamics.disturbance, str):
        return dynamics.disturbance(dynamics, worlds, inputs)
    result: list[np.ndarray | None] = []
    for block, x, z in zip(dynamics.blocks, worlds.states, normals):
        if not isinstance(block.motion, WrittenMotion) or not block.n_disturbances:
            result.append(None)
            continue
        shape = (block.n_disturbances, *x.shape[1:])
        rows = (
            z[len(x) :]
            if extra_rows(dynamics, block)
            else namespace(x).broadcast_to(namespace(x).zeros_like(x[:1]), shape)
        )
        result.append(named_disturbances(*block.disturbance_ends, dynamics.disturbance, worlds.time, rows))
    return tuple(result)


def transition(
    dynamics: Dynamics, worlds: Worlds, inputs: Sequence[np.ndarray], normals: Sequence[np.ndarray]
) -> Worlds:
    """Return the worlds one step later.

    Parameters
    ----------
    dynamics : Dynamics
    worlds : Worlds
        Before the horizon.
    inputs : sequence of np.ndarray, shape (m, n, M)
        One array per block, used as they are: the caller has to keep them in the input box.
    normals : sequence of np.ndarray, shape (d, n, M)
        Numbers that `noise` has drawn; more rows where disturbances are random, and one array more for shared noise.

    Raises
    ------
    ValueError
        If the worlds are at the horizon.
    """
    # The time is a number, or one per world after a restart.
    over = worlds.time >= dynamics.problem.horizon
    if over if isinstance(over, bool) else over.any():
        raise ValueError(f"`worlds`: expected a time before the horizon {dynamics.problem.horizon}, got {worlds.time}")
    return moved_on(dynamics, worlds, inputs, normals)


def moved_on(dynamics: Dynamics, worlds: Worlds, inputs: Sequence[np.ndarray], normals: Sequence[np.ndarray]) -> Worlds:
    """Return the worlds one step later, as `transition` does, without a look at the time: no number leaves a device."""
    states = _successors(dynamics, worlds, inputs, normals)
    return _read(dynamics, states, worlds.time + 1, worlds.q, worlds.failed, worlds.accepted)


def _successors(
    dynamics: Dynamics, worlds: Worlds, inputs: Sequence[np.ndarray], normals: Sequence[np.ndarray]
) -> tuple[np.ndarray, ...]:
    """Return the next states (d, n, M) of all blocks, in fresh arrays."""
    unknown = disturbances(dynamics, worlds, inputs, normals)
    others = neighbours(dynamics, worlds.states, inputs)
    steps = zip(dynamics.blocks, worlds.states, inputs, normals, unknown, others)
    now = worlds.time
    states = tuple(successor(block, x, u, z, v, beside, now) for block, x, u, z, v, beside in steps)
    if dynamics.problem.joint_noise:
        states = tuple(_shaken(block, x, normals[-1]) for block, x in zip(dynamics.blocks, states))
    return tuple(_turned_back(block, x) if block.angle_rows else x for block, x in zip(dynamics.blocks, states))


def _turned_back(block: Block, x: np.ndarray) -> np.ndarray:
    """Return states (d, n, M) whose angles are in their workspace again."""
    rows = list(x)
    with np.errstate(all="ignore"):  # states may not be defined
        for k in block.angle_rows:
            rows[k] = wrapped(rows[k], block.state_low[k])
    return namespace(x).stack(rows)


def _shaken(block: Block, x: np.ndarray, sources: np.ndarray) -> np.ndarray:
    """Return states (d, n, M) with what sources (K, M) of noise add to them, one after the other."""
    rows = list(x)
    for c, k, factor in block.shared_noise:
        rows[c] = rows[c] + factor * sources[k]
    return namespace(x).stack(rows)


def neighbours(
    dynamics: Dynamics, states: Sequence[np.ndarray], inputs: Sequence[np.ndarray] | None = None
) -> tuple[np.ndarray | None, ...]:
    """Return the states and inputs of others (l, n, M) that each block's dynamics name; None for blocks without any.

    `inputs` (m, n, M) per block are those of the step; before they are chosen they are no numbers.
    """
    if not dynamics.names_others:
        return (None,) * len(dynamics.blocks)
    # Rows are counted, not inferred: there may be no world at all.
    rows = _rows_of(states)[dynamics.rows]
    if dynamics.names_inputs and inputs is not None:
        rows = concatenated([rows, double(_rows_of(inputs)[dynamics.input_rows])])
    elif dynamics.names_inputs:
        xp, shape = namespace(rows), (len(dynamics.input_rows), rows.shape[1])
        rows = concatenated([rows, xp.broadcast_to(xp.full_like(rows[:1], float("nan")), shape)])
    return tuple(rows[block.beside] if len(block.beside) else None for block in dynamics.blocks)


def _rows_of(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """Return arrays (d, n, M) of all blocks as rows, one after the other."""
    return concatenated([x.reshape(x.shape[0] * x.shape[1], x.shape[-1]) for x in blocks])


def successor(
    block: Block,
    x: np.ndarray,
    u: np.ndarray,
    z: np.ndarray,
    v: np.ndarray | None = None,
    beside: np.ndarray | None = None,
    time: Any = None,
) -> np.ndarray:
    """Return the next states of a block, shape (d, n, M).

    `v` (k, n, M) are disturbances and `beside` (l, n, M) states and inputs of others, if there are any. `time` is that
    before the step, a number or one for each world; it may be left out where nothing names it.
    Under an unstable A the states of a decided world may overflow; infinity and NaN lie outside every workspace.
    """
    components = []
    z = block.noise_of.components(z[: len(x)])
    # The functions of expressions may not be defined, nor may states that are infinite have a sum.
    with np.errstate(all="ignore"):
        if isinstance(block.motion, WrittenMotion):
            means, z = block.motion.moved(x, u, z, v, beside, time)
            components = noisy(means, block.noise_rows, z)
            return means if is_host(x) else namespace(x).stack(components)
        for (a, to_a), (b, to_b), c, (factor, to_z) in block.linear_rows:
            # Zero entries of the matrices are left out, and so are the components that they would multiply.
            read = [x[k] for k in to_a], [u[k] for k in to_b], [z[k] for k in to_z]
            components += moved([a], [b], [c], [factor], *read)
    return namespace(x).stack(components) if len(components) > 1 else components[0][None]


def letters(dynamics: Dynamics, states: Sequence[np.ndarray], time: Any = None) -> np.ndarray:
    """Return which propositions hold in each world, bool (P, M), for states (d, n, M) per block.

    `time` is that of the states, a number or one for each world; it may be left out where no region moves.
    """
    rows: list[np.ndarray] = []
    outputs: dict[int, np.ndarray] = {}
    for b, (block, x) in enumerate(zip(dynamics.blocks, states)):
        if len(block.propositions) or dynamics.pairs:
            with np.errstate(over="ignore", invalid="ignore"):
                outputs[b] = block.outputs(x)
        if len(block.propositions):
            # One row per proposition: the outputs of the agent that owns it.
            y = outputs[b][:, block.owners]
            rows.append(contains(y, *block.regions(time)))
    for pairs in dynamics.pairs:
        rows.append(pairs.hold(outputs, time))
    if not rows:
        return dynamics.put(np.zeros((0, states[0].shape[-1]), dtype=bool))
    return concatenated(rows)[dynamics.proposition_rows]


def satisfied(dynamics: Dynamics, worlds: Worlds) -> np.ndarray:
    """Return whether the task is satisfied so far, bool (M,); a finite-trace task is so at the horizon at earliest."""
    automaton = dynamics.problem.automaton
    if automaton.is_co_safe:
        return worlds.accepted
    judged = worlds.time == dynamics.problem.horizon
    return judged & ~worlds.failed & dynamics.winning[worlds.q]


def joint(dynamics: Dynamics, worlds: Worlds) -> np.ndarray:
    """Return the joint states, shape (M, D), components in agent order."""
    # Rows are moved whole, and turned once: to write column by column is many times slower.
    return np.ascontiguousarray(joint_rows(dynamics, worlds).T)


def joint_rows(dynamics: Dynamics, worlds: Worlds) -> np.ndarray:
    """Return the joint states with the worlds as the last axis, a fresh array (D, M), components in agent order."""
    rows = _rows_of(worlds.states)
    return rows if dynamics.rows_stand else rows[dynamics.rows]


def split_joint(dynamics: Dynamics, states: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return joint states (M, D) as one array (d, n, M) per block."""
    return tuple(np.ascontiguousarray(np.moveaxis(states[:, block.columns], 0, -1)) for block in dynamics.blocks)


def _read(
    dynamics: Dynamics, states: tuple[np.ndarray, ...], time: Any, q: np.ndarray, failed: Any, accepted: Any
) -> Worlds:
    """Return the worlds at new states: judge exits, let the automaton read the letters, and decide."""
    # The tables and the rules give the same bits; the tables are faster where they apply.
    if dynamics.reader is not None:
        q, failed, accepted = dynamics.reader.read(states, q, failed)
    else:
        following = dynamics.automaton.next_state(q, letters(dynamics, states, time))
        q, failed, accepted = decided(dynamics.accepting, q, following, failed, accepted, _outside(dynamics, states))
    if not dynamics.is_host:
        return Worlds(states, q, time, failed, accepted)
    return Worlds(states, read_only(q.astype(np.int32, copy=False)), time, read_only(failed), read_only(accepted))


def _outside(dynamics: Dynamics, states: Sequence[np.ndarray]) -> np.ndarray:
    """Return whether any agent is outside its workspace, bool (M,)."""
    parts = (inside(x, block.state_low, block.state_high) for block, x in zip(dynamics.blocks, states))
    return ~reduce(and_, (namespace(part).all(part, axis=0) for part in parts))
