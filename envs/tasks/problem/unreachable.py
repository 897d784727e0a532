"""Tasks that are out of reach: boxes around all that agents can do say so in milliseconds, before any search.

For each automaton state there is a box for every agent that holds all its states in runs which come to it. A step
encloses the dynamics on the box, for all inputs and unknowns, and adds the noise; what is read cuts the boxes along the
faces of regions. Where no accepting state is come to the task is out of reach, whatever the controllers are: surely as
long as no noise is larger than those that were added (docs/theory/bounds.md, "Tasks out of reach").
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...systems.agents import AnyAgent
from ...systems.distributions import Gaussian, Law
from ...systems.expressions import Affine, Operation, Tree, enclosed, names_in, operations_in, turns
from .record import Problem

RARE = 1e-6
"""Probability that some noise of a run is larger than those that are added."""

LONGER = 8
"""How many horizons are looked at to say how many steps a task needs."""

MOST_OPERATIONS, MOST_READ = 6_000, 10_000
"""Operations, and propositions that are read, up to which all steps are looked at: the rest is left to the search."""

PARTS = {1: 16, 2: 6, 3: 3, 4: 2}
"""Parts of a box per axis, by the number of states: they are enclosed all at once, and what is around them is less."""

TURN, NEARLY = 2.0 * np.pi, 0.15
"""A turn, and by how much the workspace of a state may differ from one that looks like an angle."""

MOST_DEVIATIONS = 1e9
"""Deviations beyond which noise is not known."""

FloatArray = NDArray[np.float64]
Ends = tuple[FloatArray, FloatArray]
Boxes = tuple[Ends, ...]
"""Lowest and highest state of each agent."""


@dataclass(frozen=True)
class OutOfReach:
    """Why no controller satisfies a task, in words, and the probability ``most`` that one does, from above."""

    why: str
    most: float


def out_of_reach(problem: Problem, rare: float = RARE) -> OutOfReach | None:
    """Return why a task is out of reach of any controller, with an upper bound on its probability; None if it may not.

    With ``rare = 0`` no noise is added: then it is said of runs without noise, and the bound is 0 of these alone.
    """
    if problem.groups and not problem.labeling.pairs:
        return next((found for task in problem.tasks if (found := out_of_reach(task, rare))), None)
    if problem.initial_q is None or problem.automaton.reads_exits:
        return None
    moved, read = sum(map(_operations, problem.agents)), len(problem.automaton.variable)
    if problem.horizon * moved > MOST_OPERATIONS or problem.horizon * read > MOST_READ:
        return None
    reach = _Reach(problem, rare)
    may, lost = _seen(problem, reach)
    if may:
        return None
    more = f"; no controller satisfies the task more often than {rare:g}" if rare else ""
    return OutOfReach(f"{_words(problem, reach, lost)}{_words_of_angles(problem, rare)}{more}", rare)


def _seen(problem: Problem, reach: _Reach) -> tuple[bool, int | None]:
    """Return whether a task may be satisfied, and from which step on nothing is left of it; None if something is."""
    steps = 0
    for reached in reach.steps(problem.horizon):
        if any(problem.automaton.finished[q] for q in reached):
            return True, None
        steps += bool(reached)
    may = not problem.automaton.is_co_safe and any(problem.automaton.accepting[q] for q in reached)
    return may, None if reached else steps


def _words_of_angles(problem: Problem, rare: float) -> str:
    """Return that states may be angles, in words, if the task might be in reach then; else nothing."""
    like = [like_angles(agent) for agent in problem.agents]
    pairs = zip(problem.agents, like, strict=True)
    names = dict.fromkeys(agent.states[k] for agent, axes in pairs for k in np.flatnonzero(axes))
    if not names or not _seen(problem, _Reach(problem, rare, like))[0]:
        return ""
    which, listed = ", ".join(f"`{name}`" for name in names), ", ".join(f'"{name}"' for name in names)
    how = f'write `angles = [{listed}]`, with workspaces from "-pi" to "pi", so that nothing ends there'
    return f"; if {which} {'is an angle' if len(names) == 1 else 'are angles'}, {how}"


def like_angles(agent: AnyAgent) -> NDArray[np.bool_]:
    """Return which states (d,) may be angles that are not declared: they go around once, or stand in sines.

    All dynamics are the same a turn further on.
    """
    trees, sines = agent.timed_trees, frozenset[str]().union(*map(_in_sines, agent.timed_trees))
    around = np.abs(agent.state_high - agent.state_low - TURN) <= NEARLY
    result = np.zeros(agent.n_states, dtype=bool)
    for k, name in enumerate(agent.states):
        if not agent.wrapped_axes[k] and (around[k] or name in sines):
            own, *others = (turns(tree, name) for tree in (trees[k], *trees[:k], *trees[k + 1 :]))
            result[k] = own is not None and own.denominator == 1 and all(grown == 0 for grown in others)
    return result


def _in_sines(tree: Tree) -> frozenset[str]:
    """Return the names that sines, cosines and tangents are taken of."""
    if not isinstance(tree, Operation):
        return frozenset()
    if tree.name in ("sin", "cos", "tan"):
        return names_in(tree)
    return frozenset[str]().union(*map(_in_sines, tree.arguments))


def _words(problem: Problem, reach: _Reach, lost: int | None) -> str:
    """Return why a task is out of reach, in words; ``lost`` is the step from which on nothing is left of it."""
    if lost == 0:
        return "the start itself breaks the task"
    names = enumerate(problem.automaton.propositions)
    missed = [name for p, name in names if not reach.held[p] and _is_needed(problem, p)]
    what = f"`{missed[0]}` is out of reach" if missed else "the task is out of reach"
    if lost is not None:
        return f"{what}: whatever the inputs are, {reach.left or f'it is lost by step {lost}'}"
    why = f"{what} in {problem.horizon} steps, whatever the inputs are"
    if not problem.automaton.is_co_safe or problem.names_time or problem.labeling.moves:
        return why
    # What the rarest noise would save of the way is no help: without noise more steps are needed.
    known: dict[int, bytes] = {}
    still = _Reach(problem, 0.0)
    for t, reached in enumerate(still.steps(LONGER * problem.horizon)):
        if any(problem.automaton.finished[q] for q in reached):
            return f"{why}: it takes {t} at least without noise; give it a longer `horizon`, or faster agents"
        now = {q: b"".join(end.tobytes() for ends in boxes for end in ends) for q, boxes in reached.items()}
        if now == known:
            return f"{why}, nor in more: inputs are too weak for it, or something is in the way"
        known = now
    return f"{why}, nor in {LONGER * problem.horizon}"


def _is_needed(problem: Problem, p: int) -> bool:
    """Return whether no word is accepted in which a proposition never holds after the start."""
    automaton, seen = problem.automaton, set[int]()
    assert problem.initial_q is not None
    waiting = [-1 - problem.initial_q]
    while waiting:
        entry = waiting.pop()
        if entry in seen:
            continue
        seen.add(entry)
        if entry >= 0:
            high = () if automaton.variable[entry] == p else (int(automaton.high[entry]),)
            waiting += [int(automaton.low[entry]), *high]
        elif automaton.accepting[-1 - entry]:
            return False
        else:
            waiting.append(int(automaton.root[-1 - entry]))
    return True


class _Reach:
    """Boxes around what agents can do, by automaton states, from step to step."""

    def __init__(self, problem: Problem, rare: float, free: Sequence[NDArray[np.bool_]] = ()) -> None:
        self.problem, self.automaton = problem, problem.automaton
        # States that wrap, and those that are taken to, may be anything.
        self.free = [agent.wrapped_axes for agent in problem.agents]
        if free:
            self.free = [axes | more for axes, more in zip(self.free, free, strict=True)]
        count = problem.horizon * sum(agent.n_states for agent in problem.agents)
        self.noises = [_largest_noise(agent, rare / count) for agent in problem.agents]
        self.held = np.zeros(len(self.automaton.propositions), dtype=bool)
        self.left = ""
        self._known: dict[object, Ends] = {}

    def steps(self, count: int) -> Iterator[Mapping[int, Boxes]]:
        """Yield the boxes of all automaton states that may be come to at times 0, 1, ..; none that are dead."""
        start = self.problem.initial_q
        assert start is not None
        reached: dict[int, Boxes] = {}
        if not self.automaton.dead[start]:
            reached[start] = tuple((agent.initial.low, agent.initial.high) for agent in self.problem.agents)
        yield reached
        for t in range(1, count + 1):
            after: dict[int, Boxes] = {}
            self._known.clear()
            self.left = "" if reached else self.left
            for q, moved in zip(reached, self._moved([*reached.values()], t - 1), strict=True):
                gone = [i for i, (low, high) in enumerate(moved) if np.any(low > high)]
                if gone:
                    self.left = f"agent `{self.problem.agent_names[gone[0]]}` leaves its workspace at step {t}"
                    continue
                for target, cut in self._read(q, moved, t):
                    after[target] = _hull(after.get(target), cut)
            reached = after
            yield reached

    def _moved(self, several: Sequence[Boxes], time: int) -> list[Boxes]:
        """Return the boxes one step later, within the workspaces: of several automaton states at once."""
        if not several:
            return []
        each = [
            self._moved_agent(
                i, np.array([boxes[i][0] for boxes in several]), np.array([b[i][1] for b in several]), time
            )
            for i in range(self.problem.n_agents)
        ]
        return [tuple((low[k], high[k]) for low, high in each) for k in range(len(several))]

    def _moved_agent(self, i: int, low: FloatArray, high: FloatArray, time: int) -> Ends:
        """Return the boxes (n, d) of an agent one step after boxes (n, d)."""
        agent, noise = self.problem.agents[i], self.noises[i]
        names = (*agent.states, *agent.inputs, *agent.unknowns)
        unknown = np.array([*agent.unknowns.values()]).reshape(-1, 2)
        count = PARTS.get(agent.n_states, 1)
        # The same for parts of the boxes, which are narrower, and what is around these.
        at = np.array([*np.ndindex(*(count,) * agent.n_states)])
        width = (high - low) / count
        first, last = low[:, None] + at * width[:, None], low[:, None] + (at + 1) * width[:, None]
        last = np.where(at == count - 1, high[:, None], last)
        ends = [
            *zip(np.moveaxis(first, 2, 0), np.moveaxis(last, 2, 0), strict=True),
            *((np.full((1, 1), a), np.full((1, 1), b)) for a, b in zip(agent.input_low, agent.input_high, strict=True)),
            *((np.full((1, 1), a), np.full((1, 1), b)) for a, b in unknown),
        ]
        now, shape = agent.at(time), first.shape[:2]
        mean = _enclosed(now.timed_trees, names, ends, shape)
        scales = np.ones((2, *shape, agent.n_states))
        if now.timed_scale_trees:
            scales = _enclosed(now.timed_scale_trees, names, ends, shape)
        each = [end * scale for end in noise for scale in scales]
        first, last = mean[0] + np.minimum.reduce(each), mean[1] + np.maximum.reduce(each)
        # What is not known may be anything in the workspace, and so may what wraps.
        first = np.where(np.isnan(first) | self.free[i], -np.inf, first).min(axis=1)
        last = np.where(np.isnan(last) | self.free[i], np.inf, last).max(axis=1)
        return np.maximum(first, agent.state_low), np.minimum(last, agent.state_high)

    def _read(self, q: int, boxes: Boxes, time: int) -> Iterator[tuple[int, Boxes]]:
        """Yield automaton states that may follow on one, with the boxes of all that lead there."""
        automaton = self.automaton
        waiting: dict[int, Boxes] = {int(automaton.root[q]): boxes}
        while waiting:
            # Children test later propositions than their parents: whatever leads to a node has been there before it.
            entry = min(waiting, key=lambda one: automaton.variable[one] if one >= 0 else len(automaton.propositions))
            here = waiting.pop(entry)
            if entry < 0:
                if not automaton.dead[-1 - entry]:
                    yield -1 - entry, here
                continue
            for holds, child in ((False, automaton.low[entry]), (True, automaton.high[entry])):
                cut = self._where(int(automaton.variable[entry]), holds, here, time)
                if cut is not None:
                    waiting[int(child)] = _hull(waiting.get(int(child)), cut)

    def _where(self, p: int, holds: bool, boxes: Boxes, time: int) -> Boxes | None:
        """Return the boxes within which a proposition may hold, or not; None if it cannot."""
        labeling = self.problem.labeling.at(time)
        if p >= labeling.first_pair:
            pair = labeling.pairs[p - labeling.first_pair]
            ends = [self._outputs(i, boxes[i]) for i in (pair.first, pair.second)]
            if holds not in pair.possible(*ends):
                return None
            self.held[p] |= holds
            return boxes
        (i,) = labeling.owners[p]
        k = p - int(labeling.agent_propositions[i][0])
        cut = self._cut(i, boxes[i], (labeling.low[i][:, k], labeling.high[i][:, k]), holds)
        if cut is None:
            return None
        self.held[p] |= holds
        return (*boxes[:i], cut, *boxes[i + 1 :])

    def _cut(self, i: int, box: Ends, region: Ends, holds: bool) -> Ends | None:
        """Return the box in which an agent is within a region of its outputs, or out of it; None if it cannot."""
        agent, (low, high) = self.problem.agents[i], region
        first, last = self._outputs(i, box)
        if np.any(low >= high) or np.any((last < low) | (first >= high)):
            return None if holds else box
        # Sides on which something of the box is beyond the region: of what is there a box has a single one at most.
        below, above = first < low, last >= high
        lows, highs = box[0].copy(), box[1].copy()
        if not holds:
            if np.count_nonzero(below) + np.count_nonzero(above) > 1:
                return box
            if not (below.any() or above.any()):
                return None
        for k in np.flatnonzero(np.isfinite(low) | np.isfinite(high)) if holds else np.flatnonzero(below | above):
            axis = agent.output_axis(int(k))
            if axis is None or axis[1] != 1.0 or agent.wrapped_axes[axis[0]]:
                continue
            s = axis[0]
            if holds:
                lows[s], highs[s] = max(lows[s], low[k]), min(highs[s], high[k])
            elif below[k]:
                highs[s] = min(highs[s], low[k])
            else:
                lows[s] = max(lows[s], high[k])
        return (lows, highs) if np.all(lows <= highs) else None

    def _outputs(self, i: int, box: Ends) -> Ends:
        """Return bounds on the outputs of an agent in a box; none on those of angles, which go on in other turns."""
        agent, key = self.problem.agents[i], (i, box[0].tobytes(), box[1].tobytes())
        if key not in self._known:
            low, high = agent.output_range(box[0][None], box[1][None])
            turned = np.isnan(low[0]) | np.isnan(high[0])
            turned[list(agent.angle_outputs)] = True
            self._known[key] = np.where(turned, -np.inf, low[0]), np.where(turned, np.inf, high[0])
        return self._known[key]


def _enclosed(trees: Sequence[Tree], names: Sequence[str], box: Sequence[Ends], shape: tuple[int, ...]) -> FloatArray:
    """Return the ends (2, *S, k) of k expressions on boxes of names, arrays that broadcast to S."""
    one = {name: Affine(np.zeros((1, 1)), {k: np.ones((1, 1))}) for k, name in enumerate(names)}
    found = [[np.broadcast_to(end, shape) for end in ends] for ends in enclosed(trees, one, box)]
    return np.moveaxis(np.array(found), 0, -1)


def _hull(first: Boxes | None, second: Boxes) -> Boxes:
    """Return the boxes around two."""
    if first is None:
        return second
    pairs = zip(first, second, strict=True)
    return tuple((np.minimum(a[0], b[0]), np.maximum(a[1], b[1])) for a, b in pairs)


def _operations(agent: AnyAgent) -> int:
    """Return how many operations a step of an agent is."""
    return sum(map(operations_in, (*agent.timed_trees, *agent.timed_scale_trees)))


def _largest_noise(agent: AnyAgent, rare: float) -> FloatArray:
    """Return the ends (2, d) of the noise of each state, but for what has at most a probability, state by state.

    With the probability 0 they are means, which paths take for a part of the dynamics.
    """
    laws = agent.laws or [Gaussian(float(np.sqrt(max(0.0, variance)))) for variance in np.diag(agent.noise_covariance)]
    if not rare:
        means = agent.noise_axes @ [0.0 if law.envelope is None else law.envelope.mean for law in laws]
        return np.array([means, means])
    axes = np.eye(agent.n_states) if agent.laws is None else np.abs(agent.noise_axes)
    most = axes @ [_reach_of(law, rare) for law in laws] * (1.0 + 1e-9)
    return np.array([-most, most])


def _reach_of(law: Law, rare: float) -> float:
    """Return a number that noise of a law exceeds, in size, with at most a probability; infinite if none is known."""
    size = float(law.std)
    while size and size <= MOST_DEVIATIONS * law.std:
        tails = law.tails(np.array([-size, size]))
        if float(tails[0][0] + tails[1][1]) + 2.0 * law.cdf_error <= rare:
            break
        size *= 1.25
    return size if size <= MOST_DEVIATIONS * law.std else np.inf
