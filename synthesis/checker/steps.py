"""One step of all agents along a trajectory: what their inputs may be, and where the errors go.

All agents are one system with the joint state ``x = xbar + e`` and inputs ``u = ubar + K e + rho`` (rho: the rounding
of a controller, or what a network leaves out), clipped to their boxes.

**Theorem.** Let the errors e be in a *tube*, a box that holds 0, and inputs keep what is asked of them here. Then the
next error is ``e' = F e + b + L w`` with the matrices F and L and the box of b that ``advance`` adds to the errors.

*Proof.* A state is an expression of errors, inputs and disturbances, which is linear up to what ``jets``
bounds on a box; inputs follow errors, so that ``F = A + B K``, and what they are off by is in b, with the next nominal
state and the mean of the noise. QED

The tube comes from the errors themselves: a row of e is a form g of the noise, and something between ends that the
tubes of earlier times bound (``error_system``); strips ``|g| <= width`` are asked for (``trajectories``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from .angles import HALF_TURN, OFF
from .constraints import ROUNDED, Constraints, kinds_of, mean_of, sized
from .error_system import Ellipsoid, ErrorSystem, Forms, Seen
from .expressions import names_in
from .feedbacks import Feedback, enclosed_feedback
from .fields import Refused
from .intervals import add, down, interval, neg, up
from .jets import expanded
from .networks import Network, automaton_states, enclosed
from .problem import Problem
from .rigorous import Array, Truth, U, Whole

LARGEST_ERROR = 1e100  # linearization errors beyond it end the check: what follows overflows


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Of one agent: inputs (S, m), feedback gains (S, m, d), states (S + 1, d), widths (S + 1, d + m) of the tube.

    Inputs follow errors at ``places`` (k,) of the joint state: its own, or what a network sees. Where one acts, inputs
    and gains are not looked at, and these errors keep in an ellipsoid of a ``radius``.
    """

    inputs: Array
    gains: Array
    states: Array
    widths: Array
    places: Whole
    network: Network | Feedback | None = None
    radius: float = np.inf


@dataclass(frozen=True, eq=False)
class _Reads:
    """What the dynamics of an agent depend on: errors, then inputs, then disturbances, and their places by name.

    ``columns`` are those of the joint error, ``inputs`` numbers of joint inputs, ``ranges`` (2, .) of disturbances.
    """

    columns: list[int]
    inputs: list[int]
    ranges: Array
    places: dict[str, int]

    @classmethod
    def of(cls, problem: Problem, i: int, followed: Sequence[Whole]) -> _Reads:
        agent, slices, inputs_at = problem.agents[i], problem.slices, problem.input_slices
        named = names_in(agent.dynamics)
        states = {name: at for name, at in agent.states_of_others.items() if name in named}
        inputs = {name: (i, k) for k, name in enumerate(agent.inputs)}
        inputs |= {name: at for name, at in agent.inputs_of_others.items() if name in named}
        columns = [*range(slices[i].start, slices[i].stop)]
        columns += [slices[j].start + k for j, k in states.values()]
        for j, _ in inputs.values():  # an input follows the errors of its own agent, or what a network sees
            columns += [*followed[j]]
        columns = list(dict.fromkeys(columns))
        places = {name: k for k, name in enumerate(agent.states)}
        places |= {name: columns.index(slices[j].start + k) for name, (j, k) in states.items()}
        places |= {name: k for k, name in enumerate((*inputs, *agent.disturbances), start=len(columns))}
        ranges = np.array(list(agent.disturbances.values())).reshape(-1, 2).T
        return cls(columns, [inputs_at[j].start + k for j, k in inputs.values()], ranges, places)


@dataclass(frozen=True, eq=False)
class Joint:
    """All agents as one along a trajectory: what holds at all times, errors so far, and what has been asked.

    Boxes (2, D) and (2, M) of states and inputs; nominal states (S + 1, D), inputs (S, M) and widths of the tube;
    ``spread`` (D,) of the start; which states (D,) are angles, and which inputs (M,) are those of networks; the
    automaton states (S + 1) that these see.
    """

    problem: Problem
    trajectories: tuple[Trajectory, ...]
    reads: list[_Reads]
    box: Array
    input_box: Array
    states: Array
    inputs: Array
    widths: Array
    input_widths: Array
    spread: Array
    turning: Truth
    networked: Truth
    seen: list[int]
    errors: ErrorSystem
    constraints: Constraints

    @classmethod
    def of(cls, problem: Problem, trajectories: tuple[Trajectory, ...], letters: Whole) -> Joint:
        """Return all agents at time 0, where nothing has been asked; ``Refused`` if a trajectory does not fit."""
        agents = problem.agents
        boxes = [(agent.state_box, agent.start, agent.input_box) for agent in agents]
        box, start, input_box = (np.concatenate(ends, axis=1) for ends in zip(*boxes))
        # Of each agent nominal states, inputs, and widths of both.
        parts = [(o.states, o.inputs, *np.split(o.widths, [o.states.shape[1]], axis=1)) for o in trajectories]
        states, inputs, widths, input_widths = (np.concatenate(own, axis=1) for own in zip(*parts))
        if np.any(start[0] < box[0]) or np.any(start[1] > box[1]):
            raise Refused("a start lies outside the workspace of its agent")
        # A point start is the nominal state itself; a box start is an error of time 0.
        point = start[0] == start[1]
        if np.any(point & (start[0] != states[0])):
            raise Refused("a trajectory begins elsewhere than its agent")
        spread = np.where(point, 0.0, np.maximum(up(start[1] - states[0]), up(states[0] - start[0])))
        turning = np.array([name in agent.angles for agent in agents for name in agent.states])
        box = np.where(turning, np.array([[-np.inf], [np.inf]]), box)  # no angle leaves its workspace
        wrong = np.argwhere((states < box[0]) | (states > box[1]))
        if len(wrong):
            raise Refused(f"state {wrong[0, 1]} of the nominal trajectory leaves the workspace at time {wrong[0, 0]}")
        networked = np.repeat([o.network is not None for o in trajectories], [len(agent.inputs) for agent in agents])
        seen = automaton_states(problem, letters) if any(isinstance(o.network, Network) for o in trajectories) else []
        kinds, places = kinds_of(problem), [own.places for own in trajectories]
        return cls(
            problem, trajectories, [_Reads.of(problem, i, places) for i in range(len(agents))], box, input_box,
            states, inputs, widths, input_widths, spread, turning, networked, seen,
            ErrorSystem(spread, len(kinds)), Constraints(kinds),
        )  # fmt: skip

    def rows(self, places: Whole | slice, part: Array) -> Array:
        """Return rows (n, D) of the joint state that are ``part`` (n, d) at some places."""
        rows = np.zeros((len(part), len(self.spread)))
        rows[:, places] = part
        return rows


@dataclass(frozen=True, eq=False)
class Tube:
    """At a time t: ends (2, D) of errors, and of what they are besides g; ellipsoids of agents with networks."""

    t: int
    ends: Array
    drift: Array
    forms: Forms
    ellipsoids: list[Ellipsoid | None]

    @classmethod
    def at(cls, joint: Joint, t: int) -> Tube:
        """Return between which ends (2, D) errors stay, if they keep what is asked for up to this time.

        They rest on constraints of earlier times, and on the widths of this one, which others ask for.
        """
        drift, forms = joint.errors.rows(np.eye(len(joint.spread)))
        # |g| <= width is asked at times from 1 on; at time 0 there is no noise.
        width = joint.widths[t].copy() if t else np.zeros(len(joint.spread))
        shared: dict[tuple[bytes, float], Ellipsoid] = {}  # one for all who see the same
        keys = [(own.places.tobytes(), own.radius) for own in joint.trajectories]
        for own, key in zip(joint.trajectories, keys):
            if own.network is not None and t and key not in shared:
                shared[key] = Ellipsoid.of(joint.errors, own.places, own.radius, joint.constraints.kinds)
                width[own.places] = np.minimum(width[own.places], shared[key].widths)
        still = (drift == 0).all(axis=0) & (width == 0)
        low, high = np.minimum(down(drift[0] - width), 0.0), np.maximum(up(drift[1] + width), 0.0)
        # states are in their workspaces, too; the tube holds 0, where the dynamics are expanded
        low = np.maximum(low, np.minimum(down(joint.box[0] - joint.states[t]), 0.0))
        high = np.minimum(high, np.maximum(up(joint.box[1] - joint.states[t]), 0.0))
        ends = np.where(still, 0.0, np.stack([low, high]))
        if not np.all(np.abs(ends[:, joint.turning]) <= HALF_TURN):
            raise Refused(f"an angle may be half a turn from the trajectory at time {t}")
        return cls(t, ends, drift, forms, [shared.get(key) for key in keys])

    def seen(self, joint: Joint, i: int) -> Seen:
        """Return the errors that the network of agent i sees, if there is one, or its own."""
        here = joint.trajectories[i].places
        return Seen(self.ends[:, here], self.ellipsoids[i], lambda rows: joint.errors.besides(joint.rows(here, rows)))


@dataclass(frozen=True, eq=False)
class _Moves:
    """Inputs of all agents: nominal (M,), deviations (2, M), what gains (M, D) leave out (M,)."""

    nominal: Array
    deviation: Array
    rounding: Array
    gains: Array


def advance(joint: Joint, tube: Tube) -> None:
    """One step of all agents: inputs stay in their boxes, and the next error is F e and something in a box."""
    D, t = len(joint.spread), tube.t
    matrix, pushed, noise = np.zeros((D, D)), np.zeros((2, D)), joint.problem.noise.copy()
    off = np.zeros(noise.shape)
    # All inputs first: dynamics may name those of other agents.
    moves = _inputs(joint, tube)
    for i, (agent, here) in enumerate(zip(joint.problem.agents, joint.problem.slices, strict=True)):
        # The next error is what the dynamics give less the next nominal state, and the mean of the noise.
        rows, ends = _step(joint, moves, tube, i)
        matrix[here, joint.reads[i].columns] = rows
        mean = mean_of(agent)
        if agent.scale:
            point, box = _around(joint, moves, tube, i)
            on_tube, own = add(interval(point), box), joint.reads[i].places.items()
            # it may have something of its own that is called t
            leaves = {"t": interval(np.full(1, float(t)))} | {name: on_tube[:, k : k + 1] for name, k in own}
            noise[here], off[here], mean = sized(agent, noise[here], leaves, t)
        pushed[:, here] = add(add(ends, neg(interval(joint.states[t + 1, here]))), mean)
    # angles wrap at the double next to a turn
    pushed = add(pushed, np.array([[-OFF], [OFF]]) * joint.turning)
    if not np.all(np.isfinite(matrix)) or not np.abs(pushed).max() <= LARGEST_ERROR or not np.all(np.isfinite(noise)):
        raise Refused(f"the linearization error grows beyond all limits at time {t}")
    joint.errors.step(matrix, pushed, np.abs(tube.ends).max(axis=0), noise, off)


def _inputs(joint: Joint, tube: Tube) -> _Moves:
    """Ask that the inputs of feedbacks stay in their boxes, and return what all inputs may be."""
    t, u, (low, high), agents = tube.t, joint.inputs[tube.t], joint.input_box, joint.problem.agents
    names = [f"input `{name}` of `{agent.name}`" for agent in agents for name in agent.inputs]
    for k in np.flatnonzero(((u < low) | (u > high)) & ~joint.networked)[:1]:
        raise Refused(f"the nominal {names[k]} leaves its box at time {t}")
    gain, reach = np.zeros((len(u), len(joint.spread))), np.abs(tube.ends).max(axis=0)
    for own, rows in zip(joint.trajectories, joint.problem.input_slices, strict=True):
        gain[rows, own.places] = own.gains[t] if own.network is None else 0.0
    # inputs that no error reaches are their nominal values to the last bit
    moved = np.any((gain != 0.0) & (reach > 0.0), axis=1)
    # u + K (x - xbar) as floating point computes it: d products and sums, and the difference of states
    d = np.array([len(agent.states) for agent in agents for _ in agent.inputs], dtype=float)
    size = np.abs(u) + np.abs(gain) @ (reach + U * np.abs(joint.states[t]))
    rounding = np.where(moved, 4.0 * (d + 3.0) * U * size + np.abs(gain) @ (OFF * joint.turning), 0.0)
    # K e is a row like others: a form g of the noise, and something between ends.
    ends, forms = joint.errors.rows(gain * moved[:, None])
    width = joint.input_widths[t] if t else np.where(moved, np.inf, 0.0)
    # It is no farther from 0 than errors in the tube allow, nor than its own strip and ends.
    spread = np.abs(gain) @ reach * ROUNDED
    low_move, high_move = np.maximum(ends[0] - width, -spread), np.minimum(ends[1] + width, spread)
    low_move, high_move = np.minimum(low_move - rounding, 0.0), np.maximum(high_move + rounding, 0.0)
    # no input is beyond its box while constraints hold; what is clipped by rounding is nearer to its nominal value
    deviation = np.stack([np.maximum(low_move, down(low - u)), np.minimum(high_move, up(high - u))])
    moves = _Moves(u.copy(), np.where(moved, deviation, 0.0), rounding, gain)
    value = add(add(interval(u), np.stack([-rounding, rounding])), ends)[:, moved]
    labels = [f"{names[k]} at time {t}" for k in np.flatnonzero(moved)]
    if labels:
        below, above = down(value[0] - low[moved]), down(high[moved] - value[1])
        joint.constraints.add(below, above, width[moved], forms.at(moved), labels)
    for i, own in enumerate(joint.trajectories):
        if own.network is not None:
            _move_by_network(joint, own.network, tube, i, moves)
    return moves


def _move_by_network(joint: Joint, network: Network | Feedback, tube: Tube, i: int, moves: _Moves) -> None:
    """Say what the inputs of a network may be: in their box, whatever it answers."""
    agent, here, seen, t = joint.problem.agents[i], joint.trajectories[i].places, tube.seen(joint, i), tube.t
    if isinstance(network, Feedback):
        u, gains, rest = enclosed_feedback(network, agent, joint.states[t, here], t, seen)
    else:
        row = joint.seen[t], len(joint.problem.automaton.accepting), float(np.float32(1.0 - t / joint.problem.horizon))
        u, gains, rest = enclosed(network, agent, joint.states[t, here], row, seen)
    if not np.all(np.isfinite(rest)):
        raise Refused(f"nothing is known of the network of `{agent.name}` at time {t}")
    # around a nominal input in the box, what the gains leave out is as wide on both sides
    low, high = agent.input_box
    nominal = np.clip(u + 0.5 * (rest[0] + rest[1]), low, high)
    off = add(add(interval(u), rest), neg(interval(nominal)))
    spare = np.abs(off).max(axis=0)
    moved = seen.rows(gains) + np.stack([-spare, spare])
    least = np.maximum(np.minimum(moved[0], 0.0), down(low - nominal))
    most = np.minimum(np.maximum(moved[1], 0.0), up(high - nominal))
    mine = joint.problem.input_slices[i]
    moves.nominal[mine], moves.deviation[:, mine], moves.rounding[mine] = nominal, np.stack([least, most]), spare
    moves.gains[mine, here] = gains


def _around(joint: Joint, moves: _Moves, tube: Tube, i: int) -> tuple[Array, Array]:
    """Return the nominal values (v,) of all that agent i reads, and the box (2, v) of deviations from them."""
    reads = joint.reads[i]
    # Disturbances are deviations from the middle of their ranges.
    middle = 0.5 * reads.ranges[0] + 0.5 * reads.ranges[1]
    away = np.stack([down(reads.ranges[0] - middle), up(reads.ranges[1] - middle)])
    point = np.concatenate([joint.states[tube.t, reads.columns], moves.nominal[reads.inputs], middle])
    return point, np.concatenate([tube.ends[:, reads.columns], moves.deviation[:, reads.inputs], away], axis=1)


def _step(joint: Joint, moves: _Moves, tube: Tube, i: int) -> tuple[Array, Array]:
    """Return rows (d, n) of F at the columns that agent i reads, and ends (2, d) of the rest of its step."""
    reads, chosen = joint.reads[i], joint.reads[i].inputs
    n, m, (point, box) = len(reads.columns), len(chosen), _around(joint, moves, tube, i)
    # How variables follow errors and disturbances: inputs by their gains, up to what these leave out.
    rounding, gains = moves.rounding[chosen], moves.gains[np.ix_(chosen, reads.columns)]
    free = [*range(n), *range(n + m, len(point))]
    transform = np.eye(len(point))[:, free]
    transform[n : n + m, :n] = gains
    off = np.concatenate([np.zeros(n), rounding, np.zeros(len(point) - n - m)])
    which = joint.trajectories[i].places[:, None] == [*reads.columns, *[-1] * (len(free) - n)]
    bounded = partial(tube.seen(joint, i).followed, which, transform, off, box, free)
    # The matrix leaves out disturbances, so that they count with their whole range.
    slopes, ends = expanded(joint.problem.agents[i].dynamics, point, reads.places, box, tube.t, n + m, bounded)
    A, B = slopes[:, :n], slopes[:, n : n + m]
    # A + B K is rounded, and inputs are off by their rounding
    spare = (m + 3.0) * U * (np.abs(A) + np.abs(B) @ np.abs(gains)) @ np.abs(box[:, :n]).max(axis=0)
    spare = (spare + np.abs(B) @ rounding) * ROUNDED + 1e-290
    return A + B @ gains, add(ends, np.stack([-spare, spare]))
