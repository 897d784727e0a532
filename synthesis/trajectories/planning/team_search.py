"""Nominal paths of a team whose task speaks of pairs: planned together, with feedbacks that agents choose in turn.

All agents are planned as one, from straight lines that are bent to the same side, so that whoever meets goes around the
other one. Every pair that letters speak of stands in the plan at all times. Then each agent searches its feedback with
what the others add to the rows of pairs held as it is, and the plan is made anew with the deviations that were found.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from ..chance_constraints import (
    Feedback,
    Limits,
    NominalPath,
    PairAim,
    PairLimits,
    PairRows,
    TeamModel,
    Worth,
    deviations_of,
    key_of,
    limits_along,
    pair_limits,
    pair_rows,
    sides_of,
    worth_of,
)
from .coarse_routes import guesses
from .counted_work import CountedWork
from .coupled_trajectories import ROUNDS, Ties, kept_away
from .follow_the_leader import follow_the_leader
from .local_refinement import polished
from .nominal_planner import Aim, Planner
from .nonlinear_search import ENOUGH, FeedbackTrajectory, NonlinearSearch, is_inside, reserves_for, scored

BENDS = (0.25, -0.25, 0.5, 0.0)
"""How far straight lines are bent to the right, as shares of their lengths."""

FOLLOWED = (3000.0, 60)
"""Weight and rounds with which each agent follows its guess alone, before the team is planned."""

STAGES = ((300.0, 20), (10.0, 30), (0.0, 120))
"""Weights with which a guess is followed, and rounds of planning."""

NARROW = 0.15
"""Share of a range or a box that plans take for a deviation at first, at most."""

REPLANS = 4
"""How often a team is planned anew."""

TOUCHES, TOUCHED = 12, 10
"""How often small moves of all agents in turn are tried, and for how many generations each time."""

OF_LITTLE_WEIGHT, NOT_WORTH_IT = 0.05, 0.99
"""Shares of the failure of a team: of agents whose moves would hardly change it, and what a round has to come below."""

FEW = 8
"""Agents up to which all generations are searched after a plan."""

GENERATIONS, FEW_GENERATIONS = 5, 3
"""Batches of candidates after a plan, of few agents and of many."""

AT_ONCE = 400
"""Candidates that are looked at together."""


@dataclass(frozen=True, eq=False)
class TeamFound:
    """Nominal paths with feedbacks of all agents; ``failure`` is an upper bound for the team (rounded outward)."""

    score: float
    failure: float
    found: tuple[FeedbackTrajectory, ...]
    faces: NDArray[np.int64]
    rows: PairRows
    weakest: str
    nearest: Callable[[], dict[int, float]]


class TeamSearch:
    """Nominal paths of the agents of a problem with pairs."""

    def __init__(self, problem: Problem, work: CountedWork) -> None:
        self.problem, self.work = problem, work
        self.searches = [NonlinearSearch(problem, i, work) for i in range(problem.n_agents)]
        self.ties = Ties(problem, self.searches)
        self.model: Any = TeamModel([search.model for search in self.searches], self.ties.of_agent)
        self.columns = sum(pair.size for pair in problem.labeling.pairs)
        self.runs: list[FloatArray] | None = None
        """Outputs (T + 1, p) of each agent that are guessed first, if there are any."""

    @property
    def tried(self) -> int:
        """Candidates of feedbacks that were tried."""
        return sum(search.tried for search in self.searches)

    def quick(self, letters: NDArray[np.int8], bar: float = np.inf) -> TeamFound | None:
        """Return nominal paths for letters (S + 1, P) after little work; None if none were found.

        Those whose first feedbacks score above ``bar`` are not planned anew.
        """
        limits = pair_limits(self.problem, letters)
        self.ties.begin()
        best: tuple[float, Any] | None = None
        lines = (follow_the_leader(self._guesses(letters, bend), limits) for bend in BENDS)
        runs = [] if self.runs is None else [[own[: len(letters)] for own in self.runs]]
        for guess in chain(runs, lines):
            planned = self._planned(letters, limits, guess)
            if planned is not None and (best is None or planned[0] < best[0]):
                best = planned
            # A plan that keeps every limit by some deviations is as good as others.
            if best is not None and best[0] < 0.05 * len(self.searches) * len(letters):
                break
        if best is None:
            return None
        nominals, faces = best[1]
        thetas = [np.zeros(search.n_numbers) for search in self.searches]
        first = self._with_feedback(letters, limits, nominals, faces, thetas, warm=False)
        if first.score > bar:
            return first
        again = self._planned_anew(letters, limits, first)
        return again if again is not None and again.score < first.score else first

    def full(self, letters: NDArray[np.int8], found: TeamFound) -> TeamFound:
        """Return better nominal paths, if that is worth anything, and there is work left."""
        if self.work.is_over():
            return found
        limits = pair_limits(self.problem, letters)
        found = self._improved(found, limits)
        reserves = [*reserves_for(found.failure)]
        for _ in range(REPLANS):
            if found.failure <= ENOUGH or self.work.is_over() or not reserves:
                break
            again = self._planned_anew(letters, limits, found, reserves[0])
            again = None if again is None else self._improved(again, limits)
            if again is None or again.score >= found.score - 1e-3:
                reserves.pop(0)
            found = again if again is not None and again.score < found.score else found
        return found

    def touched_up(self, letters: NDArray[np.int8], each: Sequence[FeedbackTrajectory]) -> TeamFound:
        """Return a team that fails at most as often, after small moves of each agent beside the others as they are."""
        limits, faces = pair_limits(self.problem, letters), np.full(letters.shape, -1)
        for one in each:
            faces = np.where(one.faces >= 0, one.faces, faces)
        found = self.judged(each, faces, limits)
        for _ in range(TOUCHES):
            before = found.failure
            for i in np.argsort([-one.failure for one in found.found], kind="stable"):
                if before <= ENOUGH or self.work.is_over():
                    return found
                if found.found[i].failure < OF_LITTLE_WEIGHT * found.failure:
                    break
                found = self._touched_up(found, int(i), limits)
            if found.failure > NOT_WORTH_IT * before:
                break
        return found

    def _touched_up(self, team: TeamFound, i: int, limits: list[PairLimits]) -> TeamFound:
        """Return the team after small moves of one agent."""
        search, one, nominal = self.searches[i], team.found[i], self._asking(team)[i]
        worth, _ = nominal.worth(one.feedback)
        begun = replace(one, score=float(worth.scores()[0]), failure=float(worth.failures()[0]), nominal=nominal)
        moved = polished(search, begun, TOUCHED)
        if moved is begun:
            return team
        again = self.judged([*team.found[:i], moved, *team.found[i + 1 :]], team.faces, limits)
        return again if again.score < team.score else team

    # --- plans
    def _guesses(self, letters: NDArray[np.int8], bend: float) -> list[FloatArray]:
        """Return outputs (S + 1, p) of each agent: a bent straight line, or a way around its own regions."""
        result = []
        for search in self.searches:
            start = 0.5 * (search.agent.initial.low + search.agent.initial.high)
            line = self._line(search, letters, start, bend)
            if np.any(letters[:, self.own_propositions(search)] < 0):
                line = next(guesses(self.problem, search.agent, letters, start), line)
            result.append(line)
        return result

    def own_propositions(self, search: NonlinearSearch) -> NDArray[np.int64]:
        """Return the numbers of the propositions of an agent."""
        i = self.searches.index(search)
        return self.problem.labeling.agent_propositions[i]

    def _line(self, search: NonlinearSearch, letters: NDArray[np.int8], start: FloatArray, bend: float) -> FloatArray:
        """Return straight lines from one region that is to hold to the next, bent to the right."""
        agent, names = search.agent, self.problem.automaton.propositions
        here = agent.outputs(start[:, None])[:, 0]
        line, last, at = np.tile(here, (len(letters), 1)), 0, here
        low, high = (end[0] for end in agent.output_range(agent.state_low[None], agent.state_high[None]))
        own = self.own_propositions(search)
        for t in range(1, len(letters)):
            regions = [self.problem.propositions[names[q]].at(t) for q in own if letters[t, q] > 0]
            if not regions:
                continue
            aim = 0.5 * (
                np.max([low, *(r.low for r in regions)], axis=0) + np.min([high, *(r.high for r in regions)], axis=0)
            )
            aim = np.where(np.isfinite(aim), aim, at)
            share = np.linspace(0.0, 1.0, t - last + 1)[:, None]
            line[last : t + 1] = at + share * (aim - at) + bend * np.sin(np.pi * share) * _right(aim - at)
            last, at = t, aim
        line[last:] = at
        return line

    def _planned(
        self, letters: NDArray[np.int8], limits: list[PairLimits], guess: list[FloatArray]
    ) -> tuple[float, tuple[list[NominalPath], NDArray[np.int64]]] | None:
        """Return the cost of a plan of all agents, its nominal paths and sides of regions."""
        steps = len(letters) - 1
        together = np.concatenate(guess, axis=1)
        spans = np.concatenate([search.spans for search in self.searches])
        sharp = [
            np.tile(np.concatenate([share * getattr(search, name) for search in self.searches]), (times, 1))
            for share, name, times in ((0.02, "width", steps + 1), (0.02, "spans", steps + 1), (0.05, "half", steps))
        ]
        pairs = []
        for group in limits:
            widths = np.minimum(0.02 * np.minimum(*spans[group.places]), NARROW * group.widths)
            full = np.broadcast_to(widths, (steps + 1, *widths.shape))
            pairs.append(PairAim(group, full, np.zeros(full.shape)))
        faces = self._sides(letters, guess, [search.spans for search in self.searches])
        alone = [search.followed(letters, own, faces, *FOLLOWED)
                 for search, own in zip(self.searches, guess, strict=True)]  # fmt: skip
        u = np.concatenate(alone, axis=1)
        x, y, push = ((each, np.zeros_like(each)) for each in sharp)
        cost, states = np.inf, np.zeros(0)
        for weight, rounds in STAGES:
            if (own := self._limits(letters, faces)) is None:
                return None
            aim = Aim(own, _within(own.states, x), _within(own.outputs, y), push, together,
                      weight * 50.0 / steps / spans**2, pairs)  # fmt: skip
            states, u, cost = Planner(self.model, aim, self.work).improved(u, rounds)
            if not np.isfinite(cost):
                return None
            faces = self._sides(letters, self._outputs(states), [search.spans for search in self.searches])
        if self._limits(letters, faces) is None:
            return None
        return cost, (self._nominals(letters, states, u, faces), faces)

    def _planned_anew(
        self, letters: NDArray[np.int8], limits: list[PairLimits], found: TeamFound, reserve: float = 1.0
    ) -> TeamFound | None:
        """Return nominal paths planned with the deviations and linearization errors of others; None if that fails."""
        x, y, push = kept_away(self.searches, found.found, reserve)
        pairs = []
        for group in limits:
            linearization_error = y[1][:, group.places[0]] + y[1][:, group.places[1]]
            pairs.append(PairAim(group, deviations_of(group, y[0]), linearization_error))
        u = np.concatenate([one.nominal.inputs for one in found.found], axis=1)
        states, faces = np.zeros(0), found.faces
        medians = [np.median(np.clip(one.spreads.outputs[0], 1e-5 * search.spans, None), axis=0)
                   for one, search in zip(found.found, self.searches, strict=True)]  # fmt: skip
        outputs = np.concatenate([one.nominal.outputs[0] for one in found.found], axis=1)
        for _ in range(3):
            if (own := self._limits(letters, faces)) is None:
                return None
            shifts = (np.concatenate([one.spreads.states[2] for one in found.found], axis=1),
                      np.concatenate([one.spreads.outputs[2] for one in found.found], axis=1))  # fmt: skip
            own = own.for_nominal(*shifts)
            aim = Aim(own, x, y, push, outputs, np.zeros(outputs.shape[1]), pairs)
            states, u, cost = Planner(self.model, aim, self.work).improved(u, 40)
            if not np.isfinite(cost):
                return None
            new = self._sides(letters, self._outputs(states), medians)
            if np.array_equal(new, faces) or self._limits(letters, new) is None:
                break
            faces = new
        nominals = self._nominals(letters, states, u, faces)
        return self._with_feedback(letters, limits, nominals, faces, [one.theta for one in found.found], warm=True)

    def _sides(
        self, letters: NDArray[np.int8], outputs: Sequence[FloatArray], sharp: Sequence[FloatArray]
    ) -> NDArray[np.int64]:
        """Return the sides (S + 1, P) on which all agents pass regions."""
        faces = np.full(letters.shape, -1)
        first = self.problem.labeling.first_pair
        for search, own, unit in zip(self.searches, outputs, sharp, strict=True):
            sides = sides_of(self.problem, search.agent, letters[:, :first], own, unit)
            faces[:, :first] = np.where(sides >= 0, sides, faces[:, :first])
        return faces

    def _limits(self, letters: NDArray[np.int8], faces: NDArray[np.int64]) -> Limits | None:
        """Return the limits of all agents; None if some contradict each other."""
        each = [limits_along(self.problem, search.agent, letters, faces) for search in self.searches]
        if any(limits.are_empty for limits in each):
            return None
        return Limits.side_by_side(each)

    def _outputs(self, states: FloatArray) -> list[FloatArray]:
        """Return the outputs (S + 1, p) of each agent at states (S + 1, D)."""
        values, _ = self.model.outputs(states)
        return np.split(values, np.cumsum([search.agent.n_outputs for search in self.searches])[:-1], axis=1)

    def _nominals(
        self, letters: NDArray[np.int8], states: FloatArray, u: FloatArray, faces: NDArray[np.int64]
    ) -> list[NominalPath]:
        columns, inputs = self.problem.columns, self.problem.input_columns
        self.ties.follow([states[:, own] for own in columns])
        return [
            search.snapped(letters, states[:, columns[i]], u[:, inputs[i]], faces)
            for i, search in enumerate(self.searches)
        ]

    # --- feedbacks
    def _with_feedback(
        self,
        letters: NDArray[np.int8],
        limits: list[PairLimits],
        nominals: list[NominalPath],
        faces: NDArray[np.int64],
        thetas: list[FloatArray],
        warm: bool,
    ) -> TeamFound:
        """Return nominal paths with feedbacks after a first search of each agent."""
        # What feedbacks to begin with would let pairs do says in which directions they are kept apart.
        begun = [one for one, _ in self._scored(nominals, faces, [theta[None] for theta in thetas])]
        team = self.judged(begun, faces, limits)
        known: dict[object, FloatArray] = {}
        batches = []
        for i, search in enumerate(self.searches):
            # The first of agents that are alike looks far around; the others begin with what it is given, too.
            parent = thetas[i] if warm or search_key(search) in known else None
            known[search_key(search)] = thetas[i]
            batches.append(search.thetas(parent))
        found = [one for one, _ in self._scored(self._asking(team), faces, batches)]
        first: dict[object, FeedbackTrajectory] = {}
        for search, one in zip(self.searches, found, strict=True):
            first.setdefault(search_key(search), one)
        again = [search.around([one.theta, first[search_key(search)].theta], 0.3)
                 for search, one in zip(self.searches, found, strict=True)]  # fmt: skip
        more = [one for one, _ in self._scored(self._asking(team), faces, again)]
        best = [min(pair, key=lambda one: one.score) for pair in zip(found, more, strict=True)]
        return self.judged(best, faces, limits)

    def _improved(self, team: TeamFound, limits: list[PairLimits]) -> TeamFound:
        """Return nominal paths with better feedbacks: some generations of candidates of all agents."""
        best = team
        kept = [[(np.inf, one.theta)] for one in team.found]
        for generation in range(GENERATIONS if len(kept) <= FEW else FEW_GENERATIONS):
            sigma = 0.8 * 0.6**generation
            thetas = [search.around([theta for _, theta in parents], sigma)
                      for search, parents in zip(self.searches, kept, strict=True)]  # fmt: skip
            outcomes = self._scored(self._asking(best), best.faces, thetas)
            for parents, batch, (_, scores) in zip(kept, thetas, outcomes, strict=True):
                parents += zip(scores.tolist(), batch, strict=True)
                parents[:] = sorted((pair for pair in parents if np.isfinite(pair[0])), key=lambda pair: pair[0])[:4]
            again = self.judged([one for one, _ in outcomes], best.faces, limits)
            best = again if again.score < best.score else best
            if best.failure <= ENOUGH:
                break
        return best

    def _scored(
        self, nominals: Sequence[NominalPath], faces: NDArray[np.int64], thetas: Sequence[FloatArray]
    ) -> list[tuple[FeedbackTrajectory, FloatArray]]:
        """Return, for each agent, the best of its candidates and the scores of all."""
        result: dict[int, tuple[FeedbackTrajectory, FloatArray]] = {}
        for members in self._batches([len(own) for own in thetas]):
            tasks = [(self.searches[i], nominals[i], thetas[i]) for i in members]
            result |= dict(zip(members, scored(tasks, faces), strict=True))
        return [result[i] for i in range(len(self.searches))]

    def _batches(self, counts: Sequence[int]) -> list[list[int]]:
        """Return agents that are alike together, with not too many candidates (one for each agent) at once."""
        batches: list[list[int]] = []
        open_: dict[object, int] = {}
        for i, search in enumerate(self.searches):
            key = search_key(search)
            at = open_.get(key)
            if at is None or sum(counts[k] for k in batches[at]) + counts[i] > AT_ONCE:
                open_[key] = at = len(batches)
                batches.append([])
            batches[at].append(i)
        return batches

    def _rows(self, limits: list[PairLimits], found: Sequence[FeedbackTrajectory]) -> PairRows:
        outputs = [one.nominal.outputs[0] for one in found]
        return pair_rows(limits, outputs, [one.spreads.outputs[0] for one in found], self.columns)

    def _asking(self, team: TeamFound) -> list[NominalPath]:
        """Return the nominal paths of all agents with what pairs ask of them, the others being as they are."""
        asked = team.rows.asked([one.spreads.pairs for one in team.found])
        return [replace(one.nominal, pairs=own) for one, own in zip(team.found, asked, strict=True)]

    def judged(
        self, found: Sequence[FeedbackTrajectory], faces: NDArray[np.int64], limits: list[PairLimits]
    ) -> TeamFound:
        """Return the team with the rows of all agents and pairs together.

        Agents that name others are between the tubes of these, which the judgement tells in turn.
        """
        team = self._judged(found, faces, limits)
        for _ in range(ROUNDS if self.ties.are_any else 0):
            models = self.ties.between(team.found)
            between = [replace(one, nominal=replace(one.nominal, model=model))
                       for one, model in zip(team.found, models, strict=True)]  # fmt: skip
            team = self._judged(between, faces, limits)
        return team

    def _judged(
        self, found: Sequence[FeedbackTrajectory], faces: NDArray[np.int64], limits: list[PairLimits]
    ) -> TeamFound:
        """Return the team, each agent beside what its model says of others."""
        rows = self._rows(limits, found)
        asked = rows.asked([{}] * len(found))
        nominals = [replace(one.nominal, pairs=own) for one, own in zip(found, asked, strict=True)]
        total, kept = Worth(), dict[int, FeedbackTrajectory]()
        for members in self._batches([1] * len(found)):
            feedback = Feedback(*(np.concatenate([getattr(found[i].feedback, name) for i in members])
                                  for name in ("gains", "strips")))  # fmt: skip
            self.work.walk(len(nominals[0].inputs), self.searches[members[0]].agent.n_states, len(members))
            worth, spreads = worth_of([nominals[i] for i in members], feedback, np.arange(len(members)))
            total.extend(worth.own.flattened([self.searches[i].agent.name for i in members]))
            kept |= {i: replace(found[i], nominal=nominals[i], spreads=spreads.of(k)) for k, i in enumerate(members)}
        team = tuple(kept[i] for i in range(len(found)))
        rows.add_to(total, [one.spreads.pairs for one in team])
        # Of nominal states outside of a workspace no certificate is made.
        inside = all(is_inside(one.nominal) for one in team)
        failure = float(total.failures()[0]) if inside else 1.0
        return TeamFound(float(total.scores()[0]), failure, team, faces, rows, total.weakest(), total.nearest)


def search_key(search: NonlinearSearch) -> object:
    """Return what searches have in common whose candidates are looked at together."""
    agent = search.agent
    ends = (agent.state_low, agent.state_high, agent.input_low, agent.input_high)
    shared = search.model.shared
    shared_key = None if shared is None else shared.tobytes()
    return key_of(agent), search.model.watched, shared_key, tuple(end.tobytes() for end in ends)


def _within(limits: FloatArray, spread: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return deviations to begin with that are no larger than a share of what is allowed."""
    width = limits[1] - limits[0]
    return np.where(np.isfinite(width), np.minimum(spread[0], NARROW * np.abs(width)), spread[0]), spread[1]


def _right(way: FloatArray) -> FloatArray:
    """Return a vector as long as a way, to the right of it in the plane of the first two outputs."""
    result = np.zeros_like(way)
    if len(way) > 1:
        result[0], result[1] = way[1], -way[0]
    return result
