"""Paths of agents that name states of each other: each knows the tubes of the others, and is planned between them.

Tubes are nominal states, strips and linearization errors, met with the workspace. They depend on each other, step by
step, so agents are planned in turn, each with the tubes that the others have so far; the first plans take the others
for standing still. None of them does what only another one needs, such as a boiler that burns for rooms: where such
plans fail often all agents are planned as one, and keep that plan. What is found is as consistent as it happens to be:
the check goes through all agents side by side, and what it proves is claimed (docs/theory/paths.md, "Agents of any
dynamics").
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import place_of
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from ..chance_constraints import Limits, NonlinearModel, TeamModel, Tie, limits_along
from .nominal_planner import Aim, Planner
from .nonlinear_search import BATCH, QUARTER, WIDEST, FeedbackTrajectory, NonlinearSearch

ROUNDS = 3
"""How often all agents are planned anew between the tubes of the others."""

ALONE = -6.9
"""Logarithm of the failure, one in a thousand, from which plans in turn will do."""

RESERVES_TOGETHER = (1.4, 2.0)
"""What plans of all agents as one take a deviation for, in deviations, one after the other."""

MOST_TOGETHER, ROUNDS_TOGETHER, GENERATIONS_TOGETHER = 40, 60, 2
"""States of all agents up to which they are planned as one, rounds of such a plan, and generations of feedbacks."""

WIDTHS = (5.5, 4.5, 3.8, 6.5)
"""Half widths of tubes that are tried, in deviations."""


class Ties:
    """Which agents of a problem name states of which others, and how that is told to their searches."""

    def __init__(self, problem: Problem, searches: Sequence[NonlinearSearch]) -> None:
        self.searches = searches
        self.of_agent = [_named(problem, i) for i in range(problem.n_agents)]
        all_ties = [tie for ties in self.of_agent for tie in ties]
        self.watched = [{tie.state for tie in all_ties if tie.agent == j} for j in range(problem.n_agents)]
        self.watch(WIDTHS[0])
        self.are_any = any(self.of_agent)

    def watch(self, width: float) -> None:
        """Keep what is named in tubes of a width, in deviations."""
        for search, states in zip(self.searches, self.watched, strict=True):
            if states:
                search.watch(tuple(sorted(states)), width)

    def of_best_width(self, letters: NDArray[np.int8], found: Sequence[FeedbackTrajectory]) -> list[FeedbackTrajectory]:
        """Return the best of paths planned anew with tubes of several widths: narrow ones fail, wide ones push."""
        best: list[FeedbackTrajectory] = []
        for width in WIDTHS:
            self.watch(width)
            again = self.settled(letters, found, NonlinearSearch.planned_anew)
            if not best or _score(again) < _score(best):
                best = again
        self.watch(WIDTHS[0])
        return best

    def begin(self) -> None:
        """Take all that is named for standing where it starts."""
        for search, ties in zip(self.searches, self.of_agent, strict=True):
            if ties:
                ranges = search.model.unknown[:, None].copy()
                for k, j, state in ties:
                    start = self.searches[j].agent.initial
                    ranges[:, 0, k] = 0.5 * (start.low[state] + start.high[state])
                search.model = search.model.changed(beside=ranges)

    def follow(self, states: Sequence[FloatArray]) -> None:
        """Take all that is named for being where nominal states (S + 1, d) of all agents have it."""
        for search, ties in zip(self.searches, self.of_agent, strict=True):
            if ties:
                ranges = np.repeat(search.model.unknown[:, None], len(states[0]), axis=1)
                for k, j, state in ties:
                    ranges[:, :, k] = states[j][:, state]
                search.model = search.model.changed(beside=ranges)

    def between(self, found: Sequence[FeedbackTrajectory]) -> list[NonlinearModel]:
        """Return the models of all agents between the tubes that others have; these are those of searches from now."""
        for i, search in enumerate(self.searches):
            if self.of_agent[i]:
                search.model = search.model.changed(beside=self._ranges(i, found))
        return [search.model for search in self.searches]

    def settled(
        self,
        letters: NDArray[np.int8],
        found: Sequence[FeedbackTrajectory],
        better: Callable[[NonlinearSearch, NDArray[np.int8], FeedbackTrajectory], FeedbackTrajectory | None],
        rounds: int = ROUNDS,
    ) -> list[FeedbackTrajectory]:
        """Return paths of all agents, each made better in turn, between the tubes of the others.

        Where that leaves much they are planned as one, and feedbacks alone are made better in turn.
        """
        result = self._in_turn(letters, found, better, rounds)
        for reserve in RESERVES_TOGETHER:
            if _score(result) < ALONE or self.searches[0].work.is_over():
                break
            again = self._together(result, letters, reserve)
            if again is None:
                break
            result = min(result, self._in_turn(letters, again, _refitted, rounds), key=_score)
        return result

    def _in_turn(
        self,
        letters: NDArray[np.int8],
        found: Sequence[FeedbackTrajectory],
        better: Callable[[NonlinearSearch, NDArray[np.int8], FeedbackTrajectory], FeedbackTrajectory | None],
        rounds: int,
    ) -> list[FeedbackTrajectory]:
        """Return paths of all agents, each made better in turn, between the tubes of the others."""
        result = [*found]
        for _ in range(rounds):
            for i, search in enumerate(self.searches):
                if self.of_agent[i]:
                    search.model = search.model.changed(beside=self._ranges(i, result))
                result[i] = better(search, letters, result[i]) or result[i]
        return result

    def _together(
        self, found: Sequence[FeedbackTrajectory], letters: NDArray[np.int8], reserve: float
    ) -> list[FeedbackTrajectory] | None:
        """Return paths of all agents planned as one, from those that were found; None if that fails."""
        problem, searches = self.searches[0].problem, self.searches
        if problem.n_states > MOST_TOGETHER:
            return None
        # The task, and where the agents are now, side by side.
        each = [
            limits_along(problem, search.agent, letters, one.faces).for_nominal(
                one.spreads.states[2], one.spreads.outputs[2]
            )
            for search, one in zip(searches, found, strict=True)
        ]
        limits = Limits.side_by_side(each)
        outputs = np.concatenate([one.nominal.outputs[0] for one in found], axis=1)
        inputs = np.concatenate([one.nominal.inputs for one in found], axis=1)
        model = TeamModel([search.model for search in searches], self.of_agent)
        x, y, push = kept_away(searches, found, reserve)
        aim = Aim(limits, x, y, push, outputs, np.zeros(outputs.shape[1]))
        planner = Planner(model, aim, searches[0].work)  # type: ignore[arg-type]
        states, inputs, cost = planner.improved(inputs, ROUNDS_TOGETHER)
        if not np.isfinite(cost):
            return None
        # Tubes are not known yet: feedbacks are looked for as if the others went along this plan.
        self.follow([states[:, own] for own in problem.columns])
        result = []
        for search, one, own, of_inputs in zip(searches, found, problem.columns, problem.input_columns, strict=True):
            nominal = search.snapped(letters, states[:, own], inputs[:, of_inputs], one.faces)
            result.append(search.of_thetas(nominal, one.faces, search.around([one.theta], 0.3, BATCH // 2)))
        return result

    def _ranges(self, i: int, found: Sequence[FeedbackTrajectory]) -> FloatArray:
        """Return the ranges (2, S + 1, k) of what agent i does not know, along paths of all agents."""
        whole = self.searches[i].model.unknown
        ranges = np.repeat(whole[:, None], len(found[i].nominal.states), axis=1)
        for k, j, state in self.of_agent[i]:
            one = found[j]
            _, linearization_error, shift = (part[:, state] for part in one.spreads.states)
            strip = one.spreads.strips[:, state].copy()
            strip[0] = 0.0
            strip[~np.isfinite(strip)] = whole[1, k] - whole[0, k]
            middle = one.nominal.states[:, state] + shift
            ranges[:, :, k] = np.clip(
                [middle - strip - linearization_error, middle + strip + linearization_error], whole[0, k], whole[1, k]
            )
        return ranges


def kept_away(
    searches: Sequence[NonlinearSearch], found: Sequence[FeedbackTrajectory], reserve: float
) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Return what plans keep from limits of states, outputs and inputs: deviations and linearization errors."""

    def of(name: str, widths: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
        width = np.concatenate(widths)
        sd, linearization_error = (
            np.concatenate([getattr(one.spreads, name)[k] for one in found], axis=1) for k in (0, 1)
        )
        return np.clip(reserve * sd, 1e-5 * width, WIDEST * width), np.clip(
            QUARTER * linearization_error, 0.0, WIDEST * width
        )

    return (
        of("states", [search.width for search in searches]),
        of("outputs", [search.spans for search in searches]),
        of("inputs", [2.0 * search.half for search in searches]),
    )


def _score(found: Sequence[FeedbackTrajectory]) -> float:
    return float(np.logaddexp.reduce([one.score for one in found]))


def _refitted(search: NonlinearSearch, letters: NDArray[np.int8], found: FeedbackTrajectory) -> FeedbackTrajectory:
    """Return the same plan with a better feedback, between the tubes that the others have now."""
    nominal = replace(found.nominal, model=search.model)
    again = search.of_thetas(nominal, found.faces, search.around([found.theta], 0.3))
    return search.searched(again, GENERATIONS_TOGETHER)


def _named(problem: Problem, i: int) -> list[Tie]:
    """Return which unknowns of agent i are states of others; inputs, and states of agents with angles, are left out."""
    agent = problem.agents[i]
    first, ties = len(agent.unknowns) - len(agent.others), []
    for k, name in enumerate(agent.others):
        owner, state, is_input = place_of(name, problem.agents)
        if not is_input and not problem.agents[owner].angles and not getattr(problem.agents[owner], "unrolled", ()):
            ties.append(Tie(first + k, owner, state))
    return ties
