"""Given networks along the run that they take without noise: letters, sides of regions, and radii of ellipsoids.

Nothing is optimised but the proof: the networks act as they are. The run says which propositions hold when; of these a
word asks for as few, and as safe ones, as the automaton accepts. What every choice is worth is asked of the checker.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtr

from ....envs.tasks.problem import Problem
from ...certificates.proofs import (
    AgentPath,
    AlongPath,
    Certificate,
    GivenPolicy,
    PathProof,
    canonical_problem,
    changed,
    contents_of,
    verdict_of,
)
from ...checker import (
    CheckedProblem,
    Joint,
    Refused,
    automaton_states,
    check_words,
    demands,
    failure_of,
    followed,
    known_at,
    known_at_start,
    linear_forms,
    read_problem,
    read_trajectories,
    value_on,
    walk,
)
from ...relations.grids import FloatArray, NoRunFound, RelationRefused
from ...relations.kinds import ON_CELLS, NetworkPolicy
from .policy_reasons import widening_layer

LOST = (1e-10, 1e-8, 1e-6, 1e-4, 1e-2)
"""Probabilities, of all ellipsoids of an agent together, that radii are chosen for, the widest tubes first."""

MOST_TIMES = 8
"""Times at which the task may be counted as done that are looked at."""

MOST_ACCEPTED = 12
"""Steps for which a run goes on after it has been accepted: later times are hardly ever better."""

TRIED = 2
"""How many words are tried with every radius, and how many of all certificates are proved."""

LITTLE = 1e-7
"""Probability of failing below which radii are not chosen with more care."""

DIRECTIONS = 16
"""Directions of half-spaces that keep two agents apart, in a plane."""

HALVINGS = 4
"""Radii that are tried between two of these."""

SURE = 8.0
"""Deviations by which all that the run is accepted by is held, after which it is not followed any more: what is lost
there is far less than the least of ``LOST``. Wider tubes may need later times."""

LOST_BY = 2.0
"""Deviations by which what errors are besides noise leaves the workspace, after which a tube is not followed any more:
the state stays inside with less than .03."""

FEW_STATES = 3
"""States of an agent up to which messages speak of cells."""

FAR = 40.0
"""Deviations beyond which a demand costs nothing."""


@dataclass(frozen=True, eq=False)
class _Run:
    """A run without noise: states (T + 1, d) and inputs (T, m) of all agents, letters (T + 1, P) that are 1 or -1."""

    states: list[FloatArray]
    inputs: list[FloatArray]
    letters: NDArray[np.int8]
    accepted: list[int]


@dataclass(frozen=True, eq=False)
class _Margins:
    """How many deviations each literal is away (T + 1, P), and by which side or direction of what is kept away from.

    So are the workspaces (T + 1, D). Times are known up to ``last``.
    """

    deviations: FloatArray
    inside: FloatArray
    faces: NDArray[np.int64]
    normals: FloatArray
    last: int


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A word along the run, on the tube of radii that ``lost`` stands for, and about what fails of it."""

    failure: float
    letters: NDArray[np.int8]
    margins: _Margins
    lost: float


def networks_along(problem: Problem, policies: Sequence[GivenPolicy], enough: float = 0.0) -> AlongPath:
    """Return the best certificate of networks as they are, along their run without noise.

    Where a failure of ``enough`` will do, radii are taken that seem to allow it, and no others are tried.

    Raises
    ------
    RelationRefused
        If the run does not satisfy the task, or nothing is proved; the message says why, and what would help.
    """
    if problem.groups:
        raise RelationRefused("policies along a trajectory have one task, which does not fall apart")
    known = read_problem({"problem": canonical_problem(problem)})
    run = _run_of(problem, known, policies)
    if not run.accepted:
        raise NoRunFound("the run of the policies without noise does not satisfy the task: train on, or elsewhere")
    found, why = list[_Candidate](), "nothing is known of the policies on any tube around their run"

    def look(lost: float) -> bool:
        """Add what words seem to lose with these radii; return whether none seemed to lose less before."""
        margins = _margins(problem, known, run, policies, lost)
        more = [_Candidate(lost + fails, word, margins, lost) for fails, word in _words(problem, known, run, margins)]
        found.extend(more[:TRIED])
        found.sort(key=lambda one: one.failure)
        return bool(more) and found[0] is more[0]

    # Wide tubes first; narrow ones are for policies that bend.
    tried = (1e-4 * enough, 0.3 * enough, 1e-4) if enough > 0.0 else LOST
    for lost, later in zip(tried, (*tried[1:], 1.0), strict=True):
        try:
            look(lost)
        except Refused as refused:
            why = str(refused)
        if found and found[0].failure <= max(enough, later):
            break
    if enough == 0.0 and found and found[0].failure > LITTLE:
        _look_between(look, max((lost for lost in tried if lost < found[0].lost), default=0.0), found[0])
    best = _proved(problem, policies, run, found)
    if best is None or best.proof.failure >= 1.0:
        why = "nothing is proved of these policies along their run: " + (
            why if best is None else _likeliest(best, known)
        )
        raise RelationRefused(why if enough > 0.0 else f"{why}{_in_words(problem, known, run, policies)}")
    return best


def _look_between(look: Callable[[float], bool], low: float, best: _Candidate) -> None:
    """Look at radii between those that were too wide and those that were not."""
    high = best.lost
    if best.failure >= 10.0 * high:  # rows fail more than ellipsoids: a narrower tube may help
        look(10.0 * high)
        return
    for _ in range(HALVINGS if low > 0.0 else 0):
        middle = float(np.sqrt(low * high))
        try:
            low, high = (low, middle) if look(middle) else (middle, high)
        except Refused:
            low = middle


def _proved(
    problem: Problem, policies: Sequence[GivenPolicy], run: _Run, found: Sequence[_Candidate]
) -> AlongPath | None:
    """Return the best certificate of those that seem to lose least, each of which claims what the checker proves."""
    best: AlongPath | None = None
    for one in found[:TRIED]:
        if best is not None and best.proof.failure <= one.failure:
            break
        own = _certificate(problem, policies, run, one.letters, one.margins, one.lost)
        own = changed(own, failure=min(1.0, verdict_of(own).recomputed * (1.0 + 1e-9)))
        best = own if best is None or own.proof.failure < best.proof.failure else best
    return best


def _in_words(problem: Problem, known: CheckedProblem, run: _Run, policies: Sequence[GivenPolicy]) -> str:
    """Return which layer leaves out most on narrow tubes, and what would help."""
    try:
        layer = widening_layer(known, _joint(problem, known, run, policies, LOST[-1]))
    except Refused:  # there is no tube at all
        return ""
    return (
        ("" if layer is None else f"; {layer}")
        + "; noise of this size needs a smoother policy, as `certigym.baselines.smoothed` and `train --certify` make it"
        + (", or cells (`cells=`)" if _may_have_cells(problem, policies) else "")
    )


def _may_have_cells(problem: Problem, policies: Sequence[GivenPolicy]) -> bool:
    """Return whether `certify` may be asked for cells, which few states have."""
    networks = [policy for policy in policies if isinstance(policy, NetworkPolicy)]
    if networks and (problem.labeling.pairs or problem.names_time or not all(a.is_affine for a in problem.agents)):
        return False
    is_known = all(policy.network.activation in ON_CELLS for policy in networks)
    is_small = all(agent.n_states <= FEW_STATES for agent in problem.agents)
    return is_known and is_small and not any(policy.sees_all for policy in policies)


def _likeliest(certificate: AlongPath, known: CheckedProblem) -> str:
    """Return what fails most probably, in words."""
    worst = failure_of(known, read_trajectories(contents_of(certificate), known))[1]
    return f"most probable is that {worst.removeprefix('; most probable: ')} fails"


def _run_of(problem: Problem, known: CheckedProblem, policies: Sequence[GivenPolicy]) -> _Run:
    """Return the run without noise, and the times by which it has been accepted."""
    x = [0.5 * (agent.initial.low + agent.initial.high) for agent in problem.agents]
    q, automaton, T = _first_state(known), problem.automaton, problem.horizon
    states, letters, accepted = [[own] for own in x], [np.zeros(0)], list[int]()
    inputs: list[list[FloatArray]] = [[] for _ in x]
    count = len(automaton.propositions)
    for t in range(T):
        seen = [np.concatenate(x) if policy.sees_all else own for policy, own in zip(policies, x, strict=True)]
        u = [policy.inputs(own[:, None], np.array([q]), t)[:, 0] for policy, own in zip(policies, seen, strict=True)]
        x = _moved(problem, known, x, u, t)
        if not all(
            np.all((a.state_low <= own) & (own <= a.state_high)) for a, own in zip(problem.agents, x, strict=True)
        ):
            break
        for own, moved, some, pushed in zip(states, x, inputs, u, strict=True):
            own.append(moved)
            some.append(pushed)
        holds = problem.labeling.at(t + 1).letter(x)
        letters.append(np.where(np.asarray(holds, dtype=bool), 1, -1))
        if not (automaton.is_co_safe and automaton.accepting[q]):
            q = int(automaton.next_state(q, holds))
        if automaton.accepting[q] and (automaton.is_co_safe or t + 1 == T):
            accepted.append(t + 1)
        if len(accepted) == MOST_ACCEPTED:
            break
    letters[0] = np.zeros(count)
    return _Run(
        [np.array(own) for own in states],
        [np.array(own).reshape(-1, a.n_inputs) for own, a in zip(inputs, problem.agents, strict=True)],
        np.array(letters, dtype=np.int8).reshape(-1, count),
        accepted,
    )


def states_along(problem: Problem, policies: Sequence[GivenPolicy], start: FloatArray) -> FloatArray:
    """Return the joint states (S + 1, D) of the run without noise from a start (D,), as far as it goes."""
    begun = problem.replace(initial_state=start.tolist())
    run = _run_of(begun, read_problem({"problem": canonical_problem(begun)}), policies)
    return np.concatenate(run.states, axis=1)


def _first_state(known: CheckedProblem) -> int:
    """Return the automaton state after the letter of time 0: of runs that are not accepted, wherever they start."""
    automaton = known.automaton
    reached = followed(automaton, {automaton.initial}, known_at_start(known))
    undecided = {q for q in reached if not (automaton.is_co_safe and automaton.accepting[q])}
    if len(undecided) > 1:
        raise RelationRefused("the starts lie in and out of a region, so that policies begin in two automaton states")
    return min(undecided or reached)


def _moved(
    problem: Problem, known: CheckedProblem, x: Sequence[FloatArray], u: Sequence[FloatArray], t: int
) -> list[FloatArray]:
    """Return the next states without noise, disturbances in the middle of their ranges."""
    result = []
    for i, (given, agent) in enumerate(zip(problem.agents, known.agents, strict=True)):
        if not given.unknowns:
            result.append(given.at(t).mean(x[i][:, None], u[i][:, None])[:, 0])
            continue
        names = dict(zip((*agent.states, *agent.inputs), (*x[i], *u[i]), strict=True))
        names |= {name: 0.5 * (low + high) for name, (low, high) in agent.disturbances.items()}
        names |= {name: x[j][k] for name, (j, k) in agent.states_of_others.items()}
        names |= {name: u[j][k] for name, (j, k) in agent.inputs_of_others.items()}
        leaves = {"t": np.full((2, 1), float(t))} | {name: np.full((2, 1), float(v)) for name, v in names.items()}
        result.append(np.array([float(np.mean(value_on(tree, leaves))) for tree in agent.dynamics]))
    return result


def _radii(problem: Problem, policies: Sequence[GivenPolicy], steps: int, lost: float) -> tuple[float, ...]:
    """Return radii of the ellipsoids of all agents, which errors leave with about this probability in all."""
    # agents who see the states of all keep in one ellipsoid
    share = lost / (steps * (1 if all(policy.sees_all for policy in policies) else problem.n_agents))
    sizes = [problem.n_states if policy.sees_all else a.n_states for policy, a in zip(policies, problem.agents)]
    return tuple(_radius(d, share, all(a.laws is None for a in problem.agents)) for d in sizes)


def _radius(d: int, share: float, normal: bool) -> float:
    """Return the radius of an ellipsoid in d dimensions that errors leave with about this probability."""
    if normal:
        return float(np.sqrt(chdtri(d, share)))
    # (y / d)^(d/2) exp((d - y) / 2) = share: the checker's bound for sub-Gaussian noise, solved by a few steps
    y = 2.0 * d
    for _ in range(60):
        y = d * (1.0 + np.log(y / d)) - 2.0 * np.log(share)
    return float(np.sqrt(y))


def _certificate(
    problem: Problem,
    policies: Sequence[GivenPolicy],
    run: _Run,
    letters: NDArray[np.int8],
    margins: _Margins | None,
    lost: float,
) -> AlongPath:
    """Return the certificate of a word along the run, which claims nothing."""
    steps, paths = len(letters) - 1, []
    for agent, states, inputs in zip(problem.agents, run.states, run.inputs, strict=True):
        d, m = agent.n_states, agent.n_inputs
        strips = np.full((steps + 1, d + m), np.inf)
        paths.append(AgentPath(inputs[:steps], np.zeros((steps, m, d)), states[: steps + 1], strips))
    faces = np.full(letters.shape, -1) if margins is None else margins.faces[: steps + 1]
    normals = None
    if problem.labeling.pairs:
        size = sum(pair.size for pair in problem.labeling.pairs)
        normals = np.zeros((steps + 1, size)) if margins is None else margins.normals[: steps + 1]
    radii = _radii(problem, policies, steps, lost)
    proof = PathProof(tuple(paths), letters, faces, 1.0, normals, tuple(policies), radii)
    return Certificate(problem, proof, {"relation": "path", "policy": "as it is"})


def _joint(problem: Problem, known: CheckedProblem, run: _Run, policies: Sequence[GivenPolicy], lost: float) -> Joint:
    """Return the checker's joint system along the run, on the tube of some radii, before its first step."""
    read = read_trajectories(contents_of(_certificate(problem, policies, run, run.letters, None, lost)), known)
    return Joint.of(known, read.trajectories, read.letters)


def _margins(
    problem: Problem,
    known: CheckedProblem,
    run: _Run,
    policies: Sequence[GivenPolicy],
    lost: float,
) -> _Margins:
    """Return how far all literals of the run are away, in deviations, on the tube of some radii.

    ``Refused`` if the tube is lost before the run is accepted.
    """
    joint = _joint(problem, known, run, policies, lost)
    shape, size = run.letters.shape, sum(pair.size for pair in problem.labeling.pairs)
    away, inside = np.full(shape, np.inf), np.full((shape[0], len(joint.spread)), np.inf)
    found = _Margins(away, inside, np.full(shape, -1), np.zeros((shape[0], size)), shape[0] - 1)
    for tube in walk(joint):
        if (t := tube.t) == 0:
            continue
        rooms = np.minimum(
            joint.states[t] + tube.drift[0] - joint.box[0], joint.box[1] - joint.states[t] - tube.drift[1]
        )
        sigmas = np.sqrt(tube.forms.variance)
        found.inside[t] = np.where((sigmas > 0.0) | (rooms < 0.0), rooms / np.maximum(sigmas, 1e-300), np.inf)
        if np.any(found.inside[t] < -LOST_BY):
            if t <= run.accepted[0]:
                raise Refused(f"the tube leaves the workspace at time {t}")
            return replace(found, last=t - 1)
        literals = [literal for p in range(shape[1]) for literal in _literals(problem, run, t, p)]
        asked = [(p, face, normal, part) for p, face, normal in literals
                 for part in _demands(known, run, t, p, face, normal, size)]  # fmt: skip
        if not asked:
            continue
        rows, values = linear_forms(joint, tube, [part for *_, part in asked])
        linearization_error, spread = joint.errors.rows(rows)
        each = dict[tuple[int, int], tuple[float, int, FloatArray | None]]()
        for k, (p, face, normal, part) in enumerate(asked):
            value = values[:, k] + linearization_error[:, k]
            room = min(value[0] - part.low, part.high - value[1])
            sigma = float(np.sqrt(spread.variance[k]))
            far = room / sigma if sigma > 0.0 else np.inf if room > 0.0 else -np.inf
            key = p, id(normal) if normal is not None else face
            each[key] = min(each.get(key, (np.inf, face, normal)), (far, face, normal), key=lambda one: one[0])
        for (p, _), (far, face, normal) in each.items():
            if found.deviations[t, p] == np.inf or far > found.deviations[t, p]:
                found.deviations[t, p], found.faces[t, p] = far, face
                if normal is not None:
                    found.normals[t, _columns(problem, p)] = normal
        if t in run.accepted and np.min(found.deviations[t], where=run.letters[t] > 0, initial=np.inf) > SURE:
            return replace(found, last=t)
    return found


def _literals(problem: Problem, run: _Run, t: int, p: int) -> Iterator[tuple[int, int, FloatArray | None]]:
    """Yield the ways in which what the run says of a proposition may be asked for: a side, or a direction."""
    first = problem.labeling.first_pair
    if run.letters[t, p] > 0:
        yield p, -1, None
    elif p < first:
        name = problem.automaton.propositions[p]
        for face in range(2 * len(problem.propositions[name].low)):
            yield p, face, None
    else:
        pair = problem.labeling.pairs[p - first]
        if pair.size == 1:
            yield from ((p, -1, np.array([sign])) for sign in (-1.0, 1.0))
            return
        for k in range(DIRECTIONS):
            angle = 2.0 * np.pi * k / DIRECTIONS
            direction = np.zeros(pair.size)
            direction[:2] = np.cos(angle), np.sin(angle)
            yield p, -1, direction


def _columns(problem: Problem, p: int) -> slice:
    """Return where the direction of a pair stands."""
    pairs, k = problem.labeling.pairs, p - problem.labeling.first_pair
    first = sum(pair.size for pair in pairs[:k])
    return slice(first, first + pairs[k].size)


def _demands(
    known: CheckedProblem, run: _Run, t: int, p: int, face: int, normal: FloatArray | None, size: int
) -> list[Any]:
    """Return what one literal asks for at a time, in one way; nothing if that cannot be asked."""
    letters, faces = np.zeros(run.letters.shape, dtype=np.int64), np.full(run.letters.shape, -1)
    normals = np.zeros((len(letters), size))
    letters[t, p], faces[t, p] = run.letters[t, p], face
    if normal is not None:
        first = sum(len(pair.outputs[0]) for pair in known.pairs[: p - len(known.regions)])
        normals[t, first : first + len(normal)] = normal
    try:
        return list(demands(known, letters, faces, normals, t))
    except Refused:
        return []


def _words(
    problem: Problem, known: CheckedProblem, run: _Run, margins: _Margins
) -> list[tuple[float, NDArray[np.int8]]]:
    """Return words of the run that are accepted and ask for little, and about how they fail, the least first."""
    held = np.where(run.letters > 0, margins.deviations, np.inf).min(axis=1, initial=np.inf)
    # Times at which what then holds is held most surely; all of them if there are few.
    times = sorted((t for t in run.accepted if t <= margins.last), key=lambda t: -float(np.minimum(held[t], FAR)))[
        :MOST_TIMES
    ]
    found, count = [], run.letters.shape[1]
    for last in times:
        order = np.argsort(margins.deviations[: last + 1], axis=None, kind="stable")
        letters = _fewest(known, run.letters[: last + 1], list(zip(*np.unravel_index(order, (last + 1, count)))))
        if letters is None or not _is_accepted(known, letters, margins.faces):
            continue
        asked = margins.deviations[: last + 1][letters != 0]
        fails = float(np.sum(2.0 * ndtr(-np.minimum(asked, FAR))))
        fails += float(np.sum(ndtr(-np.minimum(margins.inside[: last + 1], FAR))))
        found.append((fails, last, letters))
    return [(fails, letters) for fails, _, letters in sorted(found, key=lambda one: one[:2])]


def _fewest(
    known: CheckedProblem, letters: NDArray[np.int8], order: Sequence[tuple[Any, Any]]
) -> NDArray[np.int8] | None:
    """Return letters (S + 1, P) less those, in an order of places, without which the word is accepted as well.

    At every time the networks see one automaton state; None if the word is not accepted, or they may see several.
    """
    automaton, last = known.automaton, len(letters) - 1
    done = {q for q, accepting in enumerate(automaton.accepting) if accepting}

    def after(states: set[int], t: int) -> set[int]:
        """Letters of a time; what is accepted stays so if the task is co-safe, and is not followed any more."""
        reached = followed(automaton, states, known_at(known, letters[t].astype(np.int64), t))
        return reached - done if automaton.is_co_safe else reached

    def is_right(states: set[int], t: int) -> bool:
        return len(states) <= 1 and (t < last or states <= (set() if automaton.is_co_safe else done))

    letters, first = letters.copy(), followed(automaton, {automaton.initial}, known_at_start(known))
    reached = [first - done if automaton.is_co_safe else first]
    for t in range(1, last + 1):
        reached.append(after(reached[-1], t))
    if not all(map(is_right, reached, range(last + 1))):
        return None
    for t, p in order:
        if not letters[t, p]:
            continue
        kept, letters[t, p], later = letters[t, p], 0, list[set[int]]()
        # what follows is the same from the first time on at which the state is
        for s in range(t, last + 1):
            later.append(after(later[-1] if later else reached[t - 1], s))
            if later[-1] == reached[s] or not is_right(later[-1], s):
                break
        if is_right(later[-1], t + len(later) - 1):
            reached[t : t + len(later)] = later
        else:
            letters[t, p] = kept
    return letters


def _is_accepted(known: CheckedProblem, letters: NDArray[np.int8], faces: NDArray[np.int64]) -> bool:
    """Return whether every word that agrees with letters is accepted, and networks know the automaton state."""
    try:
        check_words(known, letters.astype(np.int64), faces[: len(letters)])
        automaton_states(known, letters.astype(np.int64))
    except Refused:
        return False
    return True
