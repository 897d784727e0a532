"""Checks of mixed teams: agents on grids, agents along paths, and what pairs of both kinds can spoil.

No code of the search is used. The certificates of both parts are checked like any other; here it is checked that they
are about the agents and regions of the problem, that what they say together is what the task asks for, and what pairs
between them may spoil:

1. the automaton of the task and that of the agents on grids are followed at once through all letters that agree with
   the letters of the paths and with usual pairs: where the latter accepts, so does the former;
2. an agent along a path is where its linear deviation g is, up to its drift D, as long as its inequalities hold. So it
   is near only where g is near a box that is wider by D, whatever happens otherwise: g is *not* conditioned;
3. g is normal and independent of the agents on grids, so that the difference from a lattice point is a normal vector.

Reference: docs/theory/pairs.md, "Mixed teams".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from ...envs.agents import AnyAgent, PairRegion
from ..cells import FloatArray
from ..certificates import Certificate, OnGrid, on_cells, path_under
from ..path_checking import Whereabouts, whereabouts_along
from .pairs_check import (
    OWN_ERROR,
    RELATIVE,
    has_plain_noise,
    lost_on_the_way,
    over_axes,
    pairs_asked,
    undecided_course,
)

if TYPE_CHECKING:
    from ...envs.problem import Problem
    from ..certificates import Certificate, MixedProof

TAIL, UNIT = 1.0 + 1e-12, 2.0**-53
"""Factor on probabilities and sums that are rounded up, and half the distance from 1 to the next number."""

MOST_FACTOR = 1e3
"""Largest factor between densities with which noise along several outputs is taken together: beyond, one is better."""


def wrong_mixed(certificate: Certificate[MixedProof], problem: Problem) -> tuple[list[str], float]:
    """Return what is wrong with a mixed team's certificate apart from its parts, and what pairs may spoil at most."""
    failures = _wrong_parts(certificate, problem)
    if failures:
        return failures, 1.0
    known = _known(certificate, problem)
    together = _followed(problem, certificate.proof.grids.problem, known)
    failures = _wrong_words(certificate, problem, together)
    between = _between(certificate, problem)
    if failures or not between:
        return failures, 0.0
    grids = certificate.proof.grids
    base = grids if on_cells(grids) is grids else grids.proof.base
    failures = _wrong_agents(problem, base, between)
    if failures:
        return failures, 1.0
    usual = np.array(certificate.proof.usual, dtype=bool)
    letter = problem.labeling.at(0).letter([agent.initial.low for agent in problem.agents])
    asked = pairs_asked(problem)
    unlike = letter[problem.labeling.first_pair :] != usual
    if any(unlike[k] and asked[problem.automaton.initial, k] for k, _ in between):
        return ["a pair is not as usual at the start"], 1.0
    try:
        return [], _spoiled(certificate, base, between, _asked_on_grids(problem, base, together))
    except (OverflowError, ArithmeticError) as error:
        return [str(error)], 1.0


# --- parts
def _wrong_parts(certificate: Certificate[MixedProof], problem: Problem) -> list[str]:
    """Both parts are about the agents of the problem, each in one, and about its regions."""
    grids, paths = certificate.proof.parts
    if not grids.proof.has_cells or path_under(paths) is not paths:
        return ["its parts are not one on grids and one along paths"]
    parts = (grids.problem, paths.problem)
    names = problem.agent_names
    if len(certificate.proof.usual) != len(problem.labeling.pairs):
        return ["what it takes its pairs to be does not fit the problem"]
    if sorted([*parts[0].agent_names, *parts[1].agent_names]) != sorted(names):
        return ["its agents are not those of the problem, each in one part"]
    if any(pair.moves for pair in problem.labeling.pairs):
        return ["a pair moves with the time, of which mixed teams know nothing"]
    if any(agent.angles for agent in problem.agents):
        return ["an agent has an angle, and nothing is known of how near angles of a mixed team are"]
    if problem.groups or any(part.groups for part in parts):
        return ["it is of independent tasks, which have certificates of their own"]
    for part in parts:
        own = {agent.name: agent for agent in part.agents}
        if [name for name in names if name in own] != list(part.agent_names):
            return ["the agents of a part are in another order than in the problem"]
        for agent in problem.agents:
            if agent.name in own and own[agent.name].to_dict() != agent.to_dict():
                return [f"agent `{agent.name}` is not that of the problem"]
            if agent.name in own and _named(agent) & ({*names} - {*own}):
                return [f"the dynamics of agent `{agent.name}` name agents of the other part"]
        wanted = _propositions(problem, {*own})
        if list(part.automaton.propositions) != wanted or {*part.propositions} != {*wanted}:
            return ["the propositions of a part are not those about its agents"]
        if any(part.propositions[name].to_dict() != problem.propositions[name].to_dict() for name in wanted):
            return ["a region of a part is not that of the problem"]
    steps = certificate.proof.paths.proof.n_steps
    if parts[0].horizon != steps or not 1 <= steps <= problem.horizon:
        return ["its parts do not end at the same time"]
    if parts[0].automaton.semantics != problem.automaton.semantics:
        return ["the tasks of the problem and on grids are judged at different times"]
    if not problem.automaton.is_co_safe and steps != problem.horizon:
        return ["it ends before the horizon, and the task is judged there"]
    if problem.initial_q is None or parts[0].initial_q is None:
        return ["where an automaton is after the first letter depends on the start"]
    return []


def _named(agent: AnyAgent) -> set[str]:
    """Agents whose states or inputs an agent's dynamics name."""
    return {name.split(".")[0] for name in agent.others}


def _propositions(problem: Problem, names: set[str]) -> list[str]:
    """Propositions about some agents and nobody else, in the order of the automaton."""
    labeling, result = problem.labeling, []
    for p, name in enumerate(problem.automaton.propositions):
        if p < labeling.first_pair:
            owners = {problem.propositions[name].agent}
        else:
            pair = labeling.pairs[p - labeling.first_pair]
            owners = {problem.agent_names[pair.first], problem.agent_names[pair.second]}
        result += [name] if owners <= names else []
    return result


def _between(certificate: Certificate[MixedProof], problem: Problem) -> list[tuple[int, PairRegion]]:
    """Numbers of pairs with one agent on a grid and one along a path."""
    along = [name in certificate.proof.paths.problem.agent_names for name in problem.agent_names]
    return [(k, pair) for k, pair in enumerate(problem.labeling.pairs) if along[pair.first] != along[pair.second]]


# --- words
def _known(certificate: Certificate[MixedProof], problem: Problem) -> list[NDArray[np.int8]]:
    """For each time, what is known of propositions: 1 or -1, 0 if they are open, 2 if agents on grids decide them."""
    names, first = problem.automaton.propositions, problem.labeling.first_pair
    along = {name: p for p, name in enumerate(certificate.proof.paths.problem.automaton.propositions)}
    on_grids = {*certificate.proof.grids.problem.automaton.propositions}
    between = {k for k, _ in _between(certificate, problem)}
    result = []
    for letter in certificate.proof.paths.proof.letters:
        row = np.zeros(len(names), dtype=np.int8)
        for p, name in enumerate(names):
            if name in on_grids:
                row[p] = 2
            elif name in along:
                row[p] = letter[along[name]]
            elif p - first in between:
                row[p] = 1 if certificate.proof.usual[p - first] else -1
        result.append(row)
    return result


def _followed(problem: Problem, base: Problem, known: list[NDArray[np.int8]]) -> list[set[tuple[int, int]]]:
    """States of both automata, at times 0 to S, to which letters lead that agree with what is known."""
    ours, theirs = problem.automaton, base.automaton
    number = {name: p for p, name in enumerate(ours.propositions)}
    tests = [number[name] for name in theirs.propositions]
    assert problem.initial_q is not None and base.initial_q is not None
    result = [{(problem.initial_q, base.initial_q)}]
    for row in known[1:]:
        entries = [(int(ours.root[q]), int(theirs.root[b])) for q, b in result[-1]]
        seen, ends = {*entries}, set[tuple[int, int]]()
        while entries:
            a, b = entries.pop()
            p = int(ours.variable[a]) if a >= 0 else len(tests) + len(number)
            r = tests[int(theirs.variable[b])] if b >= 0 else len(tests) + len(number)
            if a < 0 and b < 0:
                ends.add((-1 - a, -1 - b))
                continue
            following = []
            for branch, value in ((0, -1), (1, 1)):
                if row[min(p, r)] in (0, 2, value):
                    mine = a if p > r else int((ours.low, ours.high)[branch][a])
                    other = b if r > p else int((theirs.low, theirs.high)[branch][b])
                    following.append((mine, other))
            fresh = [pair for pair in following if pair not in seen]
            seen.update(fresh)
            entries += fresh
        result.append(ends)
    return result


def _wrong_words(
    certificate: Certificate[MixedProof], problem: Problem, together: list[set[tuple[int, int]]]
) -> list[str]:
    """Where the agents on grids have done their task, the whole one is done; controllers know where they are."""
    ours, theirs = problem.automaton, certificate.proof.grids.problem.automaton
    states = certificate.proof.states_on_grids(certificate.problem)
    for t, pairs in enumerate(together):
        is_judged = ours.is_co_safe or t == problem.horizon
        if is_judged and any(theirs.accepting[b] and not ours.accepting[q] for q, b in pairs):
            return ["what agents on grids do is accepted where the task is not"]
        # Where the task on grids is decided, the run counts as lost, or the whole task is done.
        open_pairs = {(q, b) for q, b in pairs if not theirs.absorbing[b]}
        if len({q for q, _ in open_pairs}) < len(open_pairs):
            return ["a state of the task goes with two states of the task on grids"]
        if any(states[t, q] != b for q, b in open_pairs):
            return ["its controllers take the task on grids to be in another state"]
    return []


def _asked_on_grids(problem: Problem, base: OnGrid, together: list[set[tuple[int, int]]]) -> NDArray[np.bool_]:
    """Which pairs the whole task may ask for in each state on grids: bool (Q, number of pairs)."""
    asked, is_done = pairs_asked(problem), problem.automaton.finished
    result = np.zeros((base.problem.automaton.n_states, asked.shape[1]), dtype=bool)
    for pairs in together[:-1]:
        for q, b in pairs:
            if not is_done[q]:
                result[b] |= asked[q]
    # What is over on grids is followed no further: nobody may ask then, unless it is lost.
    over = base.problem.automaton.finished
    if np.any(result[over]):
        raise ArithmeticError("its task on grids is over while pairs may still spoil it")
    return result


# --- pairs
def _wrong_agents(problem: Problem, base: OnGrid, between: list[tuple[int, PairRegion]]) -> list[str]:
    """Agents on grids move to lattice points and plain normal noise; what pairs compare of them are states."""
    failures = []
    parts = dict(zip(base.problem.agent_names, base.proof.agents, strict=True))
    for _, pair in between:
        for i, outputs in zip((pair.first, pair.second), pair.outputs, strict=True):
            agent = problem.agents[i]
            if not np.array_equal(agent.initial.low, agent.initial.high):
                failures.append(f"the start of agent `{agent.name}` is not known")
            part = parts.get(agent.name)
            if part is None:
                continue
            axes = [agent.output_axis(k) for k in outputs]
            if any(axis is None or axis[1] != 1.0 for axis in axes):
                failures.append(f"a pair compares outputs of agent `{agent.name}` that are no states")
            elif len({axis[0] for axis in axes if axis is not None}) < len(axes):
                failures.append(f"a pair compares a state of agent `{agent.name}` twice")
    for agent, part in zip(base.problem.agents, base.proof.agents, strict=True):
        if part.relation["kind"] != "exact" or part.menu is not None:
            failures.append(f"the relation of agent `{agent.name}` is not exact, so pairs cannot be subtracted")
        elif not np.array_equal(part.coordinates, np.eye(agent.n_states)) or not has_plain_noise(agent):
            failures.append(f"the noise of agent `{agent.name}` is not Gaussian and independent along its states")
    return failures


def _spoiled(
    certificate: Certificate[MixedProof],
    base: OnGrid,
    between: list[tuple[int, PairRegion]],
    asked: NDArray[np.bool_],
) -> float:
    """Upper bound on the probability that a pair of both kinds is not as usual while the task is open and asks."""
    problem, paths = certificate.problem, certificate.proof.paths
    compared: dict[str, list[tuple[int, ...]]] = {}
    for _, pair in between:
        for i, outputs in zip((pair.first, pair.second), pair.outputs, strict=True):
            compared.setdefault(problem.agent_names[i], []).append(outputs)
    along = {
        agent.name: {outputs: whereabouts_along(agent, path, outputs) for outputs in {*compared.get(agent.name, [])}}
        for agent, path in zip(paths.problem.agents, paths.proof.paths, strict=True)
    }
    tables: dict[tuple[int, int], FloatArray] = {}
    charged = 0.0
    for t, states, masses, _ in undecided_course(base):
        totals = np.array([own.sum() for own in masses])
        for k, pair in between:
            if not np.any(asked[states, k]):
                continue
            first = problem.agent_names[pair.first] in base.problem.agent_names
            mine, other = (pair.first, pair.second) if first else (pair.second, pair.first)
            i = base.problem.agent_names.index(problem.agent_names[mine])
            found = [problem.agents[mine].output_axis(m) for m in pair.outputs[0 if first else 1]]
            axes = [axis[0] for axis in found if axis is not None]
            if (k, t) not in tables:
                place = along[problem.agent_names[other]][pair.outputs[1 if first else 0]][t + 1]
                side = _Side(pair, 1.0 if first else -1.0, bool(certificate.proof.usual[k]), place)
                noise = problem.agents[mine].noise_covariance
                lattices = [base.proof.agents[i].lattice[a] for a in axes]
                tables[k, t] = side.bounds(lattices, np.array([noise[a, a] for a in axes]))
            near = float(np.sum(over_axes(masses[i], axes) * tables[k, t]))
            charged += near * float(np.prod(np.delete(totals, i)))
    return min(1.0, (charged + lost_on_the_way(base)) * RELATIVE)


@dataclass(frozen=True, eq=False)
class _Side:
    """A pair, whether the agent on a grid is its first one (1) or second one (-1), and where the other one is."""

    pair: PairRegion
    sign: float
    usual: bool
    place: Whereabouts

    def bounds(self, lattices: list[FloatArray], noise: FloatArray) -> FloatArray:
        """Upper bounds (Z_1, ..) on the probability of being near, or else of not being so, from lattice points."""
        shape = tuple(len(own) for own in lattices)
        if not np.all(np.isfinite(self.place.covariance)) or not np.all(np.isfinite(self.place.wider)):
            return np.ones(shape)
        variances = noise + np.diag(self.place.covariance)
        off = np.diag(self.place.off) + 4.0 * UNIT * variances
        above, below = (variances + off) * TAIL, variances - off
        if np.any(below <= 0.0):
            return np.ones(shape)
        ends = [self._ends(k, own, math.sqrt(above[k])) for k, own in enumerate(lattices)]
        # The density of the true variance is at most this factor times that of the larger one.
        factors = np.sqrt(above / below) * TAIL
        spread = [tuple(-1 if k == j else 1 for j in range(len(shape))) for k in range(len(shape))]
        if self.usual:
            outside = [
                (factors[k] * _beyond(*ends[k], math.sqrt(above[k]))).reshape(spread[k]) for k in range(len(shape))
            ]
            total = np.zeros(shape)
            for part in outside:
                total = total + part
            return np.asarray(np.minimum(1.0, total * TAIL))
        result = np.ones(shape)
        for k, (low, high) in enumerate(ends):
            result = np.minimum(result, (factors[k] * _within(low, high, math.sqrt(above[k]))).reshape(spread[k]))
        return np.minimum(result, self._together(ends, above, noise, spread))

    def _ends(self, k: int, own: FloatArray, std: float) -> tuple[FloatArray, FloatArray]:
        """Distances (Z,) of the limits of output k from the mean of the difference, wider by drift and rounding."""
        low, high = (float(end[k]) for end in (self.pair.inner_box if self.usual else (self.pair.low, self.pair.high)))
        centre = self.place.centre[:, k]
        size = float(np.abs(own).max() + np.abs(centre).max()) + abs(low) + abs(high)
        wider = (float(self.place.wider[k]) + 1e-14 * size + 1e-12 * std) * TAIL
        if self.usual:
            wider = -wider
        gaps = np.stack([self.sign * (own - centre[0]), self.sign * (own - centre[1])])
        least, most = gaps.min(axis=0), gaps.max(axis=0)
        if self.usual:
            return low - wider - least, high + wider - most
        return low - wider - most, high + wider - least

    def _together(
        self,
        ends: list[tuple[FloatArray, FloatArray]],
        above: FloatArray,
        noise: FloatArray,
        spread: list[tuple[int, ...]],
    ) -> FloatArray:
        """Upper bounds by independent noise that is larger: its density, times a factor, is above the true one."""
        covariance = np.diag(noise) + self.place.covariance
        beside = np.abs(covariance) + self.place.off
        larger = (above + np.sum(beside, axis=1) - np.diag(beside)) * TAIL
        least = _least_determinant(covariance, self.place.off + 4.0 * UNIT * np.diag(above))
        most = float(np.prod(larger))
        if not least * MOST_FACTOR**2 > most:
            return np.ones(1)
        result = np.full((1,) * len(ends), math.sqrt(most / least) * TAIL)
        for (low, high), own, shape in zip(ends, larger.tolist(), spread, strict=True):
            result = result * _within(low, high, math.sqrt(own)).reshape(shape)
        return np.minimum(1.0, result * TAIL)


def _least_determinant(matrix: FloatArray, off: FloatArray) -> float:
    """Lower bound on the determinant of a matrix whose entries are known up to ``off``; 0 where there is none."""
    p, size = len(matrix), np.abs(matrix) + off
    if p > 3:
        return 0.0
    total, error = 0.0, 0.0
    for order in permutations(range(p)):
        sign = round(float(np.linalg.det(np.eye(p)[list(order)])))
        total += sign * math.prod(float(matrix[k, m]) for k, m in enumerate(order))
        largest = math.prod(float(size[k, m]) for k, m in enumerate(order))
        exact = math.prod(float(abs(matrix[k, m])) for k, m in enumerate(order))
        # What entries are off by, and some units in the last place of each product and sum.
        error += (largest - exact) + 32.0 * p * UNIT * largest
    return max(0.0, total - error * TAIL)


def _within(low: FloatArray, high: FloatArray, std: float) -> FloatArray:
    """Upper bounds (Z,) on the probability that a normal number of mean 0 lies between two numbers."""
    scale = math.sqrt(2.0) * std
    a, b = low / scale, high / scale
    upper, lower = 0.5 * (erfc(a) - erfc(b)), 0.5 * (erfc(-b) - erfc(-a))
    mass = np.where(a > 0.0, upper, lower)
    return np.asarray(np.where(low < high, np.clip(mass * TAIL + OWN_ERROR, 0.0, 1.0), 0.0))


def _beyond(low: FloatArray, high: FloatArray, std: float) -> FloatArray:
    """Upper bounds (Z,) on the probability that a normal number of mean 0 lies outside of two numbers."""
    scale = math.sqrt(2.0) * std
    mass = 0.5 * (erfc(-low / scale) + erfc(high / scale))
    return np.asarray(np.where(low < high, np.clip(mass * TAIL + OWN_ERROR, 0.0, 1.0), 1.0))
