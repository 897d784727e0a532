"""Certificates along nominal trajectories: any dynamics, any number of agents and states.

All agents are one system with the joint state ``x = xbar + e`` and inputs ``u = ubar + K e + rho`` (rho: the rounding
of a controller), clipped to their boxes. On a *tube* of errors e its step is ``e' = F e + m + r + L w`` with any matrix
F, where the linearization error r and the mismatch m lie in a box (``jets.off_linear``). So a row of e is a form g of
the noise, and something in a box that the tube bounds (``error_system``).

**Theorem.** Ask at every time 1 .. S that errors stay in the tube (``|g| <= width`` for each state), states in their
workspaces, and outputs where the letters say; and at 0 .. S - 1 that inputs stay in their boxes. If every word that
agrees with the letters is accepted, then P(task) >= 1 - P(a constraint fails), for every start in the box.

*Proof.* While all constraints up to a time hold, errors are in the tube, no input is clipped, and so the next step is
the one above; hence at the first failure a constraint on the forms g fails (``constraints``). If none fails no agent
leaves its workspace, and the word agrees with the letters (``letters``, ``crossings``, ``automaton``). QED

Reference: docs/theory/paths.md, "Agents of any dynamics", "Teams".
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import fields
from .angles import HALF_TURN, OFF, angle_axes, check_angles, of_copies
from .constraints import ROUNDED, Constraints, Forms
from .crossings import SOMETIME, Jump, check_words, crossed, jumps
from .distributions import NORMAL
from .ellipsoids import Ellipsoid
from .error_system import ErrorSystem
from .expressions import names_in
from .feedbacks import Feedback, enclosed_feedback, read_feedback
from .fields import Refused
from .file import Contents
from .intervals import add, down, interval, mul, neg, up
from .letters import Demand, demands
from .linearization import expanded
from .networks import Network, automaton_states, enclosed, read_network
from .noise_sizes import kinds_of, mean_of, sized
from .problem import Agent, Problem
from .rigorous import Array, U

LARGEST_ERROR = 1e100
"""Linearization errors beyond it end the check: what follows overflows."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Of one agent: inputs (S, m), feedback gains (S, m, d), states (S + 1, d), widths (S + 1, d + m) of the tube.

    Where the size of its noise depends on something, ``noise_widths`` (S, d) are those of strips of the noise. Where a
    network acts, inputs and gains are not looked at, and its errors keep in an ellipsoid of a ``radius``.
    """

    inputs: Array
    gains: Array
    states: Array
    widths: Array
    noise_widths: Array
    network: Network | Feedback | None = None
    radius: float = np.inf


@dataclass(frozen=True, eq=False)
class TrajectoryProof:
    """Trajectories of all agents and what they promise: letters and faces (S + 1, P), normals (S + 1, .) of pairs."""

    trajectories: tuple[Trajectory, ...]
    letters: NDArray[np.int64]
    faces: NDArray[np.int64]
    normals: Array


def read_proof(contents: Contents, problem: Problem) -> TrajectoryProof:
    """Return the proof in a file; raise ``Unreadable`` if there is none of this kind."""
    keys = "kind", "letters", "faces", "normals", "agents"
    data = fields.table(contents.header["proof"], "proof", keys)
    propositions, compared = len(problem.automaton.propositions), sum(len(pair.outputs[0]) for pair in problem.pairs)
    letters = contents.integers(data["letters"], "proof.letters", (None, propositions), -1, SOMETIME + 1)
    steps = len(letters) - 1
    if not 1 <= steps <= problem.horizon:
        raise fields.Unreadable(f"proof.letters: {steps} steps do not fit the horizon {problem.horizon}")
    # the face of a proposition of which nothing is said is never looked at
    faces = contents.integers(data["faces"], "proof.faces", (steps + 1, propositions), -1, 2**31)
    normals = contents.floats(data["normals"], "proof.normals", (steps + 1, compared))
    entries = fields.each(data["agents"], "proof.agents", _entry, len(problem.agents))
    trajectories = []
    for agent, entry in zip(problem.agents, entries, strict=True):
        d, m, place = len(agent.states), len(agent.inputs), f"proof.{agent.name}"
        widths = contents.floats(entry["widths"], f"{place}.widths", (steps + 1, d + m), infinite=True)
        noise_widths = np.full((steps, d), np.inf)
        if "noise_widths" in entry:
            noise_widths = contents.floats(entry["noise_widths"], f"{place}.noise_widths", (steps, d), infinite=True)
        if np.any(widths < 0.0) or np.any(noise_widths < 0.0):
            raise fields.Unreadable(f"{place}: a width is negative")
        trajectories.append(
            Trajectory(
                contents.floats(entry["inputs"], f"{place}.inputs", (steps, m)),
                contents.floats(entry["gains"], f"{place}.gains", (steps, m, d)),
                contents.floats(entry["states"], f"{place}.states", (steps + 1, d)),
                widths,
                noise_widths,
                *_network(contents, entry, place, agent, problem),
            )
        )
    return TrajectoryProof(tuple(trajectories), letters, faces, normals)


def _entry(value: Any, place: str) -> dict[str, Any]:
    return fields.table(
        value, place, ("inputs", "gains", "states", "widths"), ("noise_widths", "network", "feedback", "radius")
    )


def _network(
    contents: Contents, entry: dict[str, Any], place: str, agent: Agent, problem: Problem
) -> tuple[Network | Feedback | None, float]:
    """Return what acts for an agent, if it was given, and the radius of the ellipsoid of its errors."""
    if "network" not in entry and "feedback" not in entry:
        return None, np.inf
    if "network" in entry and "feedback" in entry:
        raise fields.Unreadable(f"{place}: a network and a feedback cannot both act")
    if agent.scale or agent.angles or any(own.tail != NORMAL for own in agent.envelopes):
        raise fields.Unreadable(f"{place}: networks act where noise is normal, of one size, and no state is an angle")
    radius = fields.number(entry["radius"], f"{place}.radius") if "radius" in entry else -1.0
    if not radius > 0.0:
        raise fields.Unreadable(f"{place}: where a network acts, `radius` is above 0")
    if "feedback" in entry:
        return read_feedback(entry["feedback"], f"{place}.feedback", agent), radius
    states = len(problem.automaton.accepting)
    return read_network(contents, entry["network"], f"{place}.network", agent, states), radius


def failure_of(problem: Problem, proof: TrajectoryProof) -> tuple[float, Constraints]:
    """Return an upper bound on the probability that the task fails, and the constraints that it rests on.

    Raises
    ------
    Refused
        If words that agree with the letters are not accepted, or nothing is known beyond a step.
    """
    # What is asked of the problem and of words, before anything moves.
    check_angles(problem)
    check_words(problem, proof.letters, proof.faces)
    joint, errors, constraints = constraints_of(problem, proof)
    before = np.zeros((2, len(joint.spread)))
    for t, around, known in walk(problem, joint, errors, constraints):
        # The start has no noise, and its letter was read from its box: nothing is asked at time 0.
        if t:
            asked = demands(problem, proof.letters, proof.faces, proof.normals, t)
            asked += crossed(problem, proof.letters, proof.faces, t)
            asked = [of_copies(problem, demand, joint.states[t]) for demand in asked]
            _ask_states(joint, errors, constraints, around.ends, known, asked, t)
            tubes, leaps = (before, around.ends), jumps(problem, proof.letters, proof.faces, t)
            _ask_jumps(joint, errors, constraints, tubes, leaps, t)
        before = around.ends
    return constraints.failure(), constraints


def constraints_of(problem: Problem, proof: TrajectoryProof) -> tuple[Joint, ErrorSystem, Constraints]:
    """Return all agents as one at time 0, where nothing has been asked."""
    joint = Joint.of(problem, proof)
    kinds = kinds_of(problem, [own.noise_widths for own in proof.trajectories])
    return joint, ErrorSystem(joint.spread, len(kinds)), Constraints(kinds)


def walk(
    problem: Problem, joint: Joint, errors: ErrorSystem, constraints: Constraints
) -> Iterator[tuple[int, Tube, tuple[Array, Forms]]]:
    """Yield times, tubes, and the rows of all errors; then take the step, and ask for what it rests on."""
    for t in range(len(joint.states)):
        # The tube rests on constraints of earlier times, and on the widths of this one, which are asked for by others.
        known = errors.rows(np.eye(len(joint.spread)))
        ellipsoids = joint.ellipsoids(errors, t)
        constraints.lost += sum(own.lost for own in ellipsoids if own is not None)
        around = Tube(joint.tube(known[0], ellipsoids, t), known[0], ellipsoids)
        yield t, around, known
        if t < len(joint.states) - 1:
            _advance(joint, errors, constraints, around, t)
            constraints.lost += sum(envelope.lost for agent in problem.agents for envelope in agent.envelopes)


@dataclass(frozen=True, eq=False)
class Joint:
    """All agents as one: where each is in the joint state, boxes (2, D), nominal states and widths (S + 1, D)."""

    agents: tuple[Agent, ...]
    trajectories: tuple[Trajectory, ...]
    slices: list[slice]
    box: Array
    states: Array
    widths: Array
    spread: Array
    noise: Array
    turning: NDArray[np.bool_]
    horizon: int
    seen: list[int]  # automaton states that networks see
    n_states_of_task: int

    @classmethod
    def of(cls, problem: Problem, proof: TrajectoryProof) -> Joint:
        """Return all agents as one; ``Refused`` if a trajectory does not fit its agent."""
        agents, trajectories = problem.agents, proof.trajectories
        box, start = (np.concatenate(ends, axis=1) for ends in zip(*((a.state_box, a.start) for a in agents)))
        states = np.concatenate([own.states for own in trajectories], axis=1)
        turning = np.concatenate([angle_axes(agent) for agent in agents]) > 0.0
        if np.any(start[0] < box[0]) or np.any(start[1] > box[1]):
            raise Refused("a start lies outside the workspace of its agent")
        # A point start is the nominal state itself; a box start is an error of time 0.
        point = start[0] == start[1]
        if np.any(point & (start[0] != states[0])):
            raise Refused("a trajectory begins elsewhere than its agent")
        box = np.where(turning, np.array([[-np.inf], [np.inf]]), box)  # no angle leaves its workspace
        wrong = np.argwhere((states < box[0]) | (states > box[1]))
        if len(wrong):
            raise Refused(f"state {wrong[0, 1]} of the nominal trajectory leaves the workspace at time {wrong[0, 0]}")
        spread = np.where(point, 0.0, np.maximum(up(start[1] - states[0]), up(states[0] - start[0])))
        widths = [own.widths[:, : len(agent.states)] for agent, own in zip(agents, trajectories, strict=True)]
        slices = problem.slices
        acts = any(isinstance(own.network, Network) for own in trajectories)
        task = (
            problem.horizon,
            automaton_states(problem, proof.letters) if acts else [],
            len(problem.automaton.accepting),
        )
        around = np.concatenate(widths, axis=1)
        return cls(agents, trajectories, slices, box, states, around, spread, problem.noise, turning, *task)

    def ellipsoids(self, errors: ErrorSystem, t: int) -> list[Ellipsoid | None]:
        """Return the ellipsoid of each agent for which a network acts; there is no noise at time 0."""
        pairs = zip(self.trajectories, self.slices, strict=True)
        return [None if own.network is None or not t else Ellipsoid.of(errors, at, own.radius) for own, at in pairs]

    def tube(self, ends: Array, ellipsoids: Sequence[Ellipsoid | None], t: int) -> Array:
        """Return ends (2, D) between which errors stay, from those (2, D) of what they are besides g."""
        # |g| <= width is asked at times from 1 on; at time 0 there is no noise.
        width = self.widths[t].copy() if t else np.zeros(len(self.spread))
        for own, here in zip(ellipsoids, self.slices, strict=True):
            if own is not None:
                width[here] = np.minimum(width[here], own.widths)
        still = (ends == 0).all(axis=0) & (width == 0)
        low, high = np.minimum(down(ends[0] - width), 0.0), np.maximum(up(ends[1] + width), 0.0)
        # states are in their workspaces, too; the tube holds 0, where the dynamics are expanded
        low = np.maximum(low, np.minimum(down(self.box[0] - self.states[t]), 0.0))
        high = np.minimum(high, np.maximum(up(self.box[1] - self.states[t]), 0.0))
        tube = np.where(still, 0.0, np.stack([low, high]))
        if not np.all(np.abs(tube[:, self.turning]) <= HALF_TURN):
            raise Refused(f"an angle may be half a turn from the trajectory at time {t}")
        return tube

    def row(self, i: int, part: Array) -> Array:
        """Return the row (D,) of the joint state that is ``part`` for agent i."""
        row = np.zeros(len(self.spread))
        row[self.slices[i]] = part
        return row


def _ask_states(
    joint: Joint,
    errors: ErrorSystem,
    constraints: Constraints,
    tube: Array,
    known: tuple[Array, Forms],
    asked: Sequence[Demand],
    t: int,
) -> None:
    """Ask for workspaces, the tube and letters at a time: rows with two ends, one for all that asks for the same.

    ``known`` are ends (2, D) and numbers g of the states themselves: the tube is made of these very numbers.
    """
    # Every state has its workspace and the width of its tube; what letters ask comes after.
    D = len(joint.spread)
    rows, own = [*np.eye(D)], [*range(D)]
    place = {row.tobytes(): k for k, row in enumerate(rows)}
    values, limits = [interval(joint.states[t])], [joint.box.T]
    labels = [f"state {k} at time {t}" for k in range(D)] + [demand.label for demand in asked]
    for (row, value), demand in zip(linear_forms(joint, tube, asked, t), asked, strict=True):
        # One row for all that is asked of the same form, since every constraint costs.
        own.append(place.setdefault((row + 0.0).tobytes(), len(rows)))
        rows += [row] if own[-1] == len(rows) else []
        values.append(value)
        limits.append(np.array([[demand.low, demand.high]]))
    # What rows are besides g moves their values, and shortens the distance to both limits.
    more = errors.rows(np.array(rows[D:]).reshape(-1, D))
    drift, forms = np.concatenate([known[0], more[0]], axis=1), known[1].joined(more[1])
    value, (low, high) = add(np.concatenate(values, axis=1), drift[:, own]), np.concatenate(limits).T
    ends = np.full((2, len(rows)), np.inf)
    names = [""] * len(rows)
    for k, below, above, label in zip(own, down(value[0] - low), down(high - value[1]), labels, strict=True):
        # the narrowest limits say it all; what is nan is nowhere kept, and stays so
        names[k] = names[k] if min(below, above) >= ends[:, k].min() else label
        ends[:, k] = np.minimum(ends[:, k], (below, above))
    width = np.concatenate([joint.widths[t], np.full(len(rows) - D, np.inf)])
    constraints.add(ends[0], ends[1], width, forms, names)


def _ask_jumps(
    joint: Joint,
    errors: ErrorSystem,
    constraints: Constraints,
    tubes: tuple[Array, Array],
    asked: Sequence[Jump],
    t: int,
) -> None:
    """Ask that outputs jump over no region from time t - 1 to t, on the ``tubes`` of both times."""
    if not asked:
        return
    outputs = [Demand(((jump.agent, jump.output, 1.0),), jump.low, jump.high, jump.label) for jump in asked]
    # The difference of an output at two times is a row of the errors at both.
    old, new = (linear_forms(joint, tube, outputs, time) for tube, time in zip(tubes, (t - 1, t), strict=True))
    value = np.concatenate([add(now[1], neg(was[1])) for was, now in zip(old, new, strict=True)], axis=1)
    drift, forms = errors.rows(np.array([now[0] for now in new]), -np.array([was[0] for was in old]))
    value, (low, high) = add(value, drift), np.array([(jump.low, jump.high) for jump in asked]).T
    nothing = np.full(len(asked), np.inf)
    constraints.add(down(value[0] - low), down(high - value[1]), nothing, forms, [jump.label for jump in asked])


def linear_forms(joint: Joint, tube: Array, asked: Sequence[Demand], t: int) -> list[tuple[Array, Array]]:
    """Return rows (D,) and ends (2, 1) besides them of what is asked, on the tube."""
    known: dict[tuple[int, int], tuple[Array, Array]] = {}
    for i, (agent, here) in enumerate(zip(joint.agents, joint.slices, strict=True)):
        # Outputs are expanded once for each agent, and only those that are asked for.
        used = sorted({k for demand in asked for j, k, _ in demand.parts if j == i})
        places = {name: k for k, name in enumerate(agent.states)}
        trees = [agent.outputs[k] for k in used]
        matrix, ends = expanded(trees, joint.states[t, here], places, tube[:, here], t)
        known.update({(i, k): (matrix[n], ends[:, n : n + 1]) for n, k in enumerate(used)})
    forms = []
    for demand in asked:
        row, value, size = np.zeros(len(joint.spread)), np.zeros((2, 1)), np.zeros(len(joint.spread))
        for i, k, factor in demand.parts:
            matrix, ends = known[i, k]
            row += joint.row(i, factor * matrix)
            size += joint.row(i, np.abs(factor * matrix))
            value = add(value, mul(interval(np.full(1, factor)), ends))
        # the row is rounded where it is a product or a sum, and acts on errors in the tube
        owners = [i for i, _, _ in demand.parts]
        if any(abs(factor) != 1.0 for _, _, factor in demand.parts) or len(set(owners)) < len(owners):
            spare = (len(owners) + 3.0) * U * size @ np.abs(tube).max(axis=0) * ROUNDED + 1e-290
            value = add(value, np.array([[-spare], [spare]]))
        forms.append((row, value))
    return forms


@dataclass(frozen=True, eq=False)
class Tube:
    """Ends (2, D) of errors, and of what they are besides g, and the ellipsoids of agents for which networks act."""

    ends: Array
    drift: Array
    ellipsoids: Sequence[Ellipsoid | None]


@dataclass(frozen=True, eq=False)
class _Moves:
    """Inputs of one agent at a time: nominal (m,), deviations (2, m), what gains (m, d) leave out (m,)."""

    nominal: Array
    deviation: Array
    rounding: Array
    gains: Array


def _network_inputs(joint: Joint, errors: ErrorSystem, tube: Tube, i: int, t: int) -> _Moves:
    """Return what the inputs of a network may be: in their box, whatever it answers."""
    agent, network, here = joint.agents[i], joint.trajectories[i].network, joint.slices[i]
    if network is None:
        raise Refused(f"no network acts for `{agent.name}`")
    ends, own = tube.ends[:, here], tube.ellipsoids[i]
    far = np.abs(ends).max(axis=0)

    def reach(rows: Array) -> Array:
        """Rows of the errors: on the box of the tube, and on the ellipsoid and what rows are besides."""
        spare = (len(far) + 4.0) * U * (np.abs(rows) @ far) + 1e-290
        low, high = (np.minimum(rows * ends[0], rows * ends[1]), np.maximum(rows * ends[0], rows * ends[1]))
        box = np.stack([low.sum(axis=1) - spare, high.sum(axis=1) + spare])
        if own is None:
            return box
        drift = errors.rows(np.array([joint.row(i, row) for row in rows]))[0]
        wide = own.reach(rows, up(far + np.abs(tube.drift[:, here]).max(axis=0)))
        return np.stack([np.maximum(box[0], down(drift[0] - wide)), np.minimum(box[1], up(drift[1] + wide))])

    at = joint.states[t, here]
    if isinstance(network, Feedback):
        u, gains, rest = enclosed_feedback(network, agent, at, t, ends, reach)
    else:
        row = joint.seen[t], joint.n_states_of_task, float(np.float32(1.0 - t / joint.horizon))
        u, gains, rest = enclosed(network, agent, at, row, reach, far)
    if not np.all(np.isfinite(rest)):
        raise Refused(f"nothing is known of the network of `{agent.name}` at time {t}")
    # around a nominal input in the box, what the gains leave out is as wide on both sides
    low, high = agent.input_box
    nominal = np.clip(u + 0.5 * (rest[0] + rest[1]), low, high)
    off = add(add(interval(u), rest), neg(interval(nominal)))
    spare = np.abs(off).max(axis=0)
    moved = reach(gains) + np.stack([-spare, spare])
    deviation = np.stack([np.maximum(np.minimum(moved[0], 0.0), down(low - nominal)),
                          np.minimum(np.maximum(moved[1], 0.0), up(high - nominal))])  # fmt: skip
    return _Moves(nominal, deviation, spare, gains)


def _inputs(joint: Joint, errors: ErrorSystem, constraints: Constraints, tube: Array, i: int, t: int) -> _Moves:
    """Ask that the inputs of an agent stay in their box, and return what they may be."""
    agent, own, here = joint.agents[i], joint.trajectories[i], joint.slices[i]
    d, m = len(agent.states), len(agent.inputs)
    gain, u, (low, high) = own.gains[t], own.inputs[t], agent.input_box
    if np.any((u < low) | (u > high)):
        raise Refused(f"a nominal input of `{agent.name}` leaves its box at time {t}")
    reach = np.abs(tube[:, here]).max(axis=0)
    # inputs that no error reaches are their nominal values to the last bit
    moved = np.any((gain != 0.0) & (reach > 0.0), axis=1)
    # u + K (x - xbar) as floating point computes it: d products and sums, and the difference of states
    size = np.abs(u) + np.abs(gain) @ (reach + U * np.abs(joint.states[t, here]))
    rounding = np.where(moved, 4.0 * (d + 3.0) * U * size + np.abs(gain) @ (OFF * joint.turning[here]), 0.0)
    # K e is a row like others: a form g of the noise, and something between ends.
    rows = np.array([joint.row(i, row) for row in gain * moved[:, None]]).reshape(m, len(joint.spread))
    ends, forms = errors.rows(rows)
    width = own.widths[t, d:] if t else np.where(moved, np.inf, 0.0)
    # It is no farther from 0 than errors in the tube allow, nor than its own strip and ends.
    spread = np.abs(gain) @ reach * ROUNDED
    low_move, high_move = np.maximum(ends[0] - width, -spread), np.minimum(ends[1] + width, spread)
    low_move, high_move = np.minimum(low_move - rounding, 0.0), np.maximum(high_move + rounding, 0.0)
    # no input is beyond its box while constraints hold; what is clipped by rounding is nearer to its nominal value
    deviation = np.stack([np.maximum(low_move, down(low - u)), np.minimum(high_move, up(high - u))])
    deviation = np.where(moved, deviation, 0.0)
    value = add(add(interval(u), np.stack([-rounding, rounding])), ends)[:, moved]
    labels = [f"input `{agent.inputs[k]}` of `{agent.name}` at time {t}" for k in np.flatnonzero(moved)]
    if labels:
        below, above = down(value[0] - low[moved]), down(high[moved] - value[1])
        constraints.add(below, above, width[moved], forms.at(moved), labels)
    return _Moves(u, deviation, rounding, gain)


def _advance(joint: Joint, errors: ErrorSystem, constraints: Constraints, around: Tube, t: int) -> None:
    """One step of all agents: inputs stay in their boxes, and the next error is F e and something in a box."""
    D, tube = len(joint.spread), around.ends
    matrix, pushed, noise = np.zeros((D, D)), np.zeros((2, D)), joint.noise.copy()
    # All inputs first: dynamics may name those of other agents.
    moves = [
        _inputs(joint, errors, constraints, tube, i, t) if own.network is None
        else _network_inputs(joint, errors, around, i, t) for i, own in enumerate(joint.trajectories)
    ]  # fmt: skip
    for i, (agent, here) in enumerate(zip(joint.agents, joint.slices, strict=True)):
        # The next error is what the dynamics give less the next nominal state, and the mean of the noise.
        columns, rows, ends = _step(joint, moves, tube, i, t)
        matrix[here, columns] = rows
        mean = mean_of(agent)
        if agent.scale:
            leaves, width = _leaves(joint, moves[i], tube, i, t), joint.trajectories[i].noise_widths[t]
            noise[here], mean = sized(agent, noise[here], width, leaves, constraints, t)
        pushed[:, here] = add(add(ends, neg(interval(joint.states[t + 1, here]))), mean)
        pushed[:, here] = add(pushed[:, here], np.array([[-OFF], [OFF]]) * joint.turning[here])
    if not np.all(np.isfinite(matrix)) or not np.abs(pushed).max() <= LARGEST_ERROR or not np.all(np.isfinite(noise)):
        raise Refused(f"the linearization error grows beyond all limits at time {t}")
    errors.step(matrix, pushed, np.abs(tube).max(axis=0), noise)


def _leaves(joint: Joint, moves: _Moves, tube: Array, i: int, t: int) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return ends (2, 1) of the names of an agent on the nominal trajectory, and on the tube."""
    agent, here = joint.agents[i], joint.slices[i]
    names = (*agent.states, *agent.inputs, *agent.disturbances)
    ranges = np.array(list(agent.disturbances.values())).reshape(-1, 2).T
    nominal = np.concatenate([joint.states[t, here], moves.nominal, 0.5 * ranges[0] + 0.5 * ranges[1]])
    states = add(interval(joint.states[t, here]), tube[:, here])
    around = np.concatenate([states, add(interval(moves.nominal), moves.deviation), ranges], axis=1)
    time = {"t": interval(np.full(1, float(t)))}
    both = [{name: ends[:, k : k + 1] for k, name in enumerate(names)} for ends in (interval(nominal), around)]
    return time | both[0], time | both[1]


def _step(joint: Joint, moves: Sequence[_Moves], tube: Array, i: int, t: int) -> tuple[list[int], Array, Array]:
    """Return columns (n,) of the joint error, rows (d, n) of F there, and ends (2, d) of the rest of a step."""
    agent = joint.agents[i]
    # variables: errors that the step depends on, then inputs, then disturbances
    named = names_in(agent.dynamics)
    states = {name: place for name, place in agent.states_of_others.items() if name in named}
    inputs = {name: place for name, place in agent.inputs_of_others.items() if name in named}
    inputs = {**{name: (i, k) for k, name in enumerate(agent.inputs)}, **inputs}
    columns = [*range(joint.slices[i].start, joint.slices[i].stop)]
    columns += [joint.slices[j].start + k for j, k in states.values()]
    for j, _ in inputs.values():  # an input follows the errors of its own agent
        columns += range(joint.slices[j].start, joint.slices[j].stop)
    columns = list(dict.fromkeys(columns))
    n, m = len(columns), len(inputs)
    # Disturbances are deviations from the middle of their ranges.
    ranges = np.array(list(agent.disturbances.values())).reshape(-1, 2)
    middle = 0.5 * ranges[:, 0] + 0.5 * ranges[:, 1]
    away = np.stack([down(ranges[:, 0] - middle), up(ranges[:, 1] - middle)])
    chosen = [(moves[j], k) for j, k in inputs.values()]
    nominal = np.array([own.nominal[k] for own, k in chosen])
    rounding = np.array([own.rounding[k] for own, k in chosen])
    deviation = np.array([own.deviation[:, k] for own, k in chosen]).reshape(m, 2).T
    point = np.concatenate([joint.states[t, columns], nominal, middle])
    box = np.concatenate([tube[:, columns], deviation, away], axis=1)
    places = {name: k for k, name in enumerate(agent.states)}
    places |= {name: columns.index(joint.slices[j].start + k) for name, (j, k) in states.items()}
    places |= {name: n + k for k, name in enumerate(inputs)}
    places |= {name: n + m + k for k, name in enumerate(agent.disturbances)}
    # how inputs follow errors
    transform = np.eye(len(point))
    for row, (j, k) in enumerate(inputs.values(), start=n):
        for column, gain in zip(range(joint.slices[j].start, joint.slices[j].stop), moves[j].gains[k]):
            transform[row, columns.index(column)] = gain
    transform = np.delete(transform, range(n, n + m), axis=1)
    offsets = np.concatenate([np.zeros(n), rounding, np.zeros(len(middle))])
    follow = transform, [*range(n), *range(n + m, len(point))], offsets
    # The matrix leaves out disturbances, so that they count with their whole range.
    slopes, ends = expanded(agent.dynamics, point, places, box, t, n + m, follow)
    A, B, gains = slopes[:, :n], slopes[:, n : n + m], transform[n : n + m, :n]
    # A + B K is rounded, and inputs are off by their rounding
    spare = (m + 3.0) * U * (np.abs(A) + np.abs(B) @ np.abs(gains)) @ np.abs(box[:, :n]).max(axis=0)
    spare = (spare + np.abs(B) @ rounding) * ROUNDED + 1e-290
    return columns, A + B @ gains, add(ends, np.stack([-spare, spare]))
