"""Certificates along nominal trajectories: any dynamics, any number of agents and states.

On a *tube* of errors e around the trajectory a step of all agents is ``e' = F e + b + L w`` with a matrix F, and b in a
box (``steps``). So a row of e is a form g of the noise, and something in a box that the tube bounds (``error_system``).

**Theorem.** Ask at every time 1 .. S that errors stay in the tube (``|g| <= width`` for each state), states in their
workspaces, and outputs where the letters say; and at 0 .. S - 1 that inputs stay in their boxes. If every word that
agrees with the letters is accepted, then P(task) >= 1 - P(a constraint fails), for every start in the box.

*Proof.* While all constraints up to a time hold, errors are in the tube, no input is clipped, and so the next step is
the one above; hence at the first failure a constraint on the forms g fails (``constraints``). If none fails no agent
leaves its workspace, and the word agrees with the letters (``letters``, ``automaton``). QED

**Theorem** (cells of starts). If the task fails with a probability of at most f_i from every start in cell i of a box,
then with at most max f_i from every start, and with at most the mean of f_i by volumes from one that is drawn
uniformly. *Proof.* A cut, ``x_k <= a`` and ``x_k >= a``, covers the box by two, which share a face of volume 0. QED

Reference: docs/theory/paths.md, "Agents of any dynamics", "Teams".
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .angles import check_angles, of_copies
from .constraints import ROUNDED
from .feedbacks import Feedback, read_feedback
from .fields import Entry
from .file import Contents
from .intervals import add, down, interval, mul, neg
from .jets import expanded
from .letters import SOMETIME, Demand, check_words, crossed, demands, jumps
from .networks import Network, read_network
from .problem import Problem
from .rigorous import Array, U, Whole
from .steps import Joint, Trajectory, Tube, advance


@dataclass(frozen=True, eq=False)
class TrajectoryProof:
    """Trajectories of all agents and what they promise: letters and faces (S + 1, P), normals (S + 1, .) of pairs."""

    trajectories: tuple[Trajectory, ...]
    letters: Whole
    faces: Whole
    normals: Array

    @property
    def more(self) -> tuple[str, ...]:
        """Modules of the checker that it needs besides."""
        kinds = {"networks": Network, "feedbacks": Feedback}
        return tuple(n for n, kind in kinds.items() if any(isinstance(own.network, kind) for own in self.trajectories))


def read_proof(contents: Contents, problem: Problem, entry: Entry | None = None) -> TrajectoryProof:
    """Return the proof in a file, or in a part of it; raise ``Unreadable`` if there is none of this kind."""
    own = (entry or contents.entry("proof")).table(("kind", "letters", "faces", "normals", "agents"))
    propositions, compared = len(problem.automaton.propositions), sum(len(pair.outputs[0]) for pair in problem.pairs)
    letters = own["letters"].integers((None, propositions), -1, SOMETIME + 1)
    steps = len(letters) - 1
    if not 1 <= steps <= problem.horizon:
        raise own["letters"].wrong(f"{steps} steps do not fit the horizon {problem.horizon}")
    # the face of a proposition of which nothing is said is never looked at
    faces = own["faces"].integers((steps + 1, propositions), -1, 2**31)
    normals = own["normals"].floats((steps + 1, compared))
    entries = enumerate(own["agents"].entries(len(problem.agents)))
    trajectories = tuple(_trajectory(entry, i, problem, steps) for i, entry in entries)
    return TrajectoryProof(trajectories, letters, faces, normals)


def _trajectory(entry: Entry, i: int, problem: Problem, steps: int) -> Trajectory:
    """Return the trajectory of agent i, and the network that acts for it, if there is one."""
    agent, own = (
        problem.agents[i],
        entry.table(("inputs", "gains", "states", "widths"), ("network", "feedback", "radius")),
    )
    d, m, count = len(agent.states), len(agent.inputs), problem.slices[-1].stop
    widths = own["widths"].floats((steps + 1, d + m), infinite=True)
    if np.any(widths < 0.0):
        raise entry.wrong("a width is negative")
    path = own["inputs"].floats((steps, m)), own["gains"].floats((steps, m, d)), own["states"].floats((steps + 1, d))
    seen = np.isin(np.arange(count), np.arange(count)[problem.slices[i]])
    if not own.keys() & {"network", "feedback"}:
        return Trajectory(*path, widths, np.flatnonzero(seen))
    if own.keys() >= {"network", "feedback"} or "radius" not in own or not own["radius"].number() > 0.0:
        raise entry.wrong("a network or a feedback acts, with a `radius` above 0")
    network: Network | Feedback
    if "feedback" in own:
        network = read_feedback(own["feedback"], agent)
    else:
        network = read_network(own["network"], agent, count, len(problem.automaton.accepting))
        seen = seen | np.any(network.view != 0.0, axis=0)
        network = replace(network, view=network.view[:, seen])
    if np.any(seen & np.array([name in each.angles for each in problem.agents for name in each.states])):
        raise entry.wrong("a network, or a feedback, acts where no state that it sees is an angle")
    return Trajectory(*path, widths, np.flatnonzero(seen), network, own["radius"].number())


def failure_of(problem: Problem, proof: TrajectoryProof) -> tuple[float, str, list[Any]]:
    """Return an upper bound on the probability that the task fails, what fails most probably, and steps.

    ``Refused`` if words that agree with the letters are not accepted, or nothing is known beyond a step.
    """
    # What is asked of the problem and of words, before anything moves.
    check_angles(problem)
    check_words(problem, proof.letters, proof.faces)
    joint, before, spreads = Joint.of(problem, proof.trajectories, proof.letters), None, list[Array]()
    for tube in walk(joint):
        # The start has no noise, and its letter was read from its box: nothing is asked at time 0.
        if before is not None:
            asked = demands(problem, proof.letters, proof.faces, proof.normals, tube.t)
            asked += crossed(problem, proof.letters, proof.faces, tube.t)
            asked = [of_copies(problem, demand, joint.states[tube.t]) for demand in asked]
            _ask_states(joint, tube, asked)
            _ask_jumps(joint, before, tube, jumps(problem, proof.letters, proof.faces, tube.t))
        before = tube
        spreads.append(np.sqrt(tube.forms.variance))
    nearest = joint.constraints.nearest()
    steps = [(*nearest.get(t, (np.inf, "nothing")), spread) for t, spread in enumerate(spreads)]
    return joint.constraints.failure(), f"; most probable: {min(nearest.values())[1]}", steps


def walk(joint: Joint) -> Iterator[Tube]:
    """Yield the tubes of all times; then take the step, and ask for what it rests on."""
    given_up = sum(envelope.lost for agent in joint.problem.agents for envelope in agent.envelopes)
    for t in range(len(joint.states)):
        tube = Tube.at(joint, t)
        joint.constraints.lost += sum(own.lost for own in dict.fromkeys(tube.ellipsoids) if own is not None)
        yield tube
        if t < len(joint.states) - 1:
            advance(joint, tube)
            joint.constraints.lost += given_up


def _ask_states(joint: Joint, tube: Tube, asked: Sequence[Demand]) -> None:
    """Ask for workspaces, the tube and letters at a time: rows with two ends, one for all that asks for the same."""
    D, t = len(joint.spread), tube.t
    # Every state has its workspace and the width of its tube; what letters ask comes after.
    more, values = linear_forms(joint, tube, asked)
    rows, limits = np.concatenate([np.eye(D), more]) + 0.0, np.array([(one.low, one.high) for one in asked])
    low, high = np.concatenate([joint.box.T, limits.reshape(-1, 2)]).T
    labels = [f"state {k} at time {t}" for k in range(D)] + [demand.label for demand in asked]
    # One row for all that is asked of the same form, since every constraint costs.
    place: dict[bytes, int] = {}
    own = np.array([place.setdefault(row.tobytes(), len(place)) for row in rows])
    first = np.unique(own, return_index=True)[1]
    # What rows are besides g moves their values: of states it is what the tube is made of.
    drift, forms = joint.errors.rows(rows[first])
    value = add(np.concatenate([interval(joint.states[t]), values], axis=1), drift[:, own])
    room = np.stack([down(value[0] - low), down(high - value[1])])
    # The narrowest limits say it all; what is nan is nowhere kept, and stays so.
    ends, names = np.full((2, len(first)), np.inf), dict[int, str]()
    for side in (0, 1):
        np.minimum.at(ends[side], own, room[side])
    for k in np.argsort(room.min(axis=0), kind="stable"):
        names.setdefault(int(own[k]), labels[k])
    width = np.concatenate([joint.widths[t], np.full(len(first) - D, np.inf)])
    joint.constraints.add(ends[0], ends[1], width, forms, [names[k] for k in range(len(first))])


def _ask_jumps(joint: Joint, before: Tube, tube: Tube, asked: Sequence[Demand]) -> None:
    """Ask that outputs jump over no region from one time to the next, on the tubes of both times."""
    if not asked:
        return
    # The difference of an output at two times is a row of the errors at both.
    (old, was), (new, now) = (linear_forms(joint, own, asked) for own in (before, tube))
    drift, forms = joint.errors.rows(new, -old)
    value, (low, high) = add(add(now, neg(was)), drift), np.array([(jump.low, jump.high) for jump in asked]).T
    joint.constraints.add(down(value[0] - low), down(high - value[1]), np.inf, forms, [one.label for one in asked])


def linear_forms(joint: Joint, tube: Tube, asked: Sequence[Demand]) -> tuple[Array, Array]:
    """Return rows (n, D) of what is asked, and ends (2, n) of what it is besides them, on the tube."""
    known: dict[tuple[int, int], tuple[Array, Array]] = {}
    for i, (agent, here) in enumerate(zip(joint.problem.agents, joint.problem.slices, strict=True)):
        # Outputs are expanded once for each agent, and only those that are asked for.
        used = sorted({k for demand in asked for j, k, _ in demand.parts if j == i})
        places = {name: k for k, name in enumerate(agent.states)}
        trees = [agent.outputs[k] for k in used]
        matrix, ends = expanded(trees, joint.states[tube.t, here], places, tube.ends[:, here], tube.t, len(places))
        known.update({(i, k): (row, ends[:, n]) for n, (k, row) in enumerate(zip(used, joint.rows(here, matrix)))})
    rows, values = np.zeros((len(asked), len(joint.spread))), np.zeros((2, len(asked)))
    far = np.abs(tube.ends).max(axis=0)
    for n, demand in enumerate(asked):
        size = np.zeros(len(joint.spread))
        for i, k, factor in demand.parts:
            row, ends = known[i, k]
            rows[n] += factor * row
            size += np.abs(factor * row)
            values[:, n] = add(values[:, n], mul(interval(factor), ends))
        # the row is rounded where it is a product or a sum, and acts on errors in the tube
        owners = [i for i, _, _ in demand.parts]
        if any(abs(factor) != 1.0 for _, _, factor in demand.parts) or len(set(owners)) < len(owners):
            spare = (len(owners) + 3.0) * U * size @ far * ROUNDED + 1e-290
            values[:, n] = add(values[:, n], np.array([-spare, spare]))
    return rows, values


# Share of the volume, the problem with starts in the cell, and its proof; nothing is claimed where there is none.
Cell = tuple[float, Problem, TrajectoryProof | None]


def read_starts(contents: Contents, problem: Problem) -> list[Cell]:
    """Return the cells of the box of starts in a file; raise ``Unreadable`` if there is no proof of this kind."""
    return [*_cells(contents, contents.entry("proof"), problem, 1.0)]


def _cells(contents: Contents, entry: Entry, problem: Problem, share: float) -> Iterator[Cell]:
    if entry.value is None or entry.entries_by_name().get("kind", entry).value != "starts":
        yield share, problem, None if entry.value is None else read_proof(contents, problem, entry)
        return
    own = entry.table(("kind", "agent", "state", "cut", "below", "above"))
    i, cut, agents = own["agent"].whole(0, len(problem.agents)), own["cut"].number(), list(problem.agents)
    start, k = agents[i].start, own["state"].whole(0, len(agents[i].states))
    low, high = start[:, k].tolist()
    if not low < cut < high:
        raise own["cut"].wrong("it does not lie inside the box of starts")
    for side, key, width in ((1, "below", cut - low), (0, "above", high - cut)):
        box = start.copy()
        box[side, k] = cut
        agents[i] = replace(agents[i], start=box)
        part = replace(problem, agents=tuple(agents))
        yield from _cells(contents, own[key], part, share * width / (high - low) * (1.0 + 8.0 * U))


def failure_of_starts(problem: Problem, cells: list[Cell]) -> tuple[float, str, list[tuple[float, str, Array]]]:
    """Return an upper bound on the probability that the task fails, its largest part, and what fails from each cell."""
    total, found = 0.0, list[tuple[float, str, Array]]()
    for share, part, own in cells:
        failure, worst = (1.0, "; nothing") if own is None else failure_of(part, own)[:2]
        total += share * failure * (1.0 + 4.0 * U * len(cells))
        found.append((failure, worst, part.agents[0].start))
    return min(1.0, total), max(found, key=lambda one: one[0])[1], found
