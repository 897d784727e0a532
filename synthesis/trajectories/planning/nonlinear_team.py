"""A certificate along nonlinear paths: letters from the automaton, the time of acceptance, a path for each agent."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ....envs.tasks.problem import Problem
from ...certificates.beliefs import believed_along
from ...certificates.proofs import Certificate, PathProof, Synthesis
from ...relations.grids import FloatArray, NoRunFound, RelationRefused
from ..chance_constraints import corners_along, least_by_times, most_missed, satisfies
from ..words import HALVES, Plan, letters_of, with_windows
from .counted_work import CountedWork
from .coupled_trajectories import Ties
from .local_refinement import polished
from .nonlinear_search import GOOD, FeedbackTrajectory, NonlinearSearch
from .schedules import plans_of_runs, runs_in_turn
from .team_search import TeamFound, TeamSearch, search_key

MOST_PLANS, MOST_HOPELESS = 6, 18
"""Ways with times that are tried at first, and as long as none of them can be followed at all."""

MOST_MOVES = 14
"""Moves of the times of jumps that are tried after that."""

HARDLY = -0.05
"""Logarithm of the failure from which words of few cubes are tried, too."""

PROMISING = -4.0
"""Logarithm of the failure after little work from which no further way is looked for."""

REFINED, NEAR = 4, 1.5
"""Plans on which more work is spent, and how much worse their logarithm may be after little work, which hardly tells
them apart."""

WORSE = 3.0
"""By how much the logarithm of the failure of a plan may be worse than that of the best one for more work to be spent
on it: with other visits after little work, or moved a little in all that is free."""

POLISHED = ((3, 20), (1, 200))
"""Plans that are moved a little in all that is free, and for how many generations: the best of some is gone on with."""

FAIR = 1e-3
"""Failure above which more work is spent on further plans in any case."""

FEW_PAIRS = 15
"""Pairs up to which times of jumps are moved: plans of larger teams take seconds."""

EXACT = 1e-9
"""Linearization errors up to which there are none: the rest is rounding."""

HOPELESS = 1.0 - 1e-12
"""Probability of failing from which a nonlinear path counts as impossible."""


PATIENCE, MOST_PATIENCE, OF_PAIRS = 1.0 / 32.0, 1.0 / 8.0, 0.5
"""Shares of what a search may take that plans may take as long as all of them are hopeless: for each state of the
largest agent, as grids of few states are cheap, and in all; and of teams with pairs, of which every plan is dear. Moves
of the jumps of hopeless plans may take as much again."""

WORTHLESS = 0.999
"""Probability of failing from which nothing is claimed: so near to 1 the check rounds more than that is worth."""


BEFORE_RUNS = 2
"""Sources of plans before runs of a team are tried, where these give nothing."""

CALM = 1e-2
"""Share of the noise with which a run is looked for that satisfies the task without noise."""

NO_PATH = "no nominal path along which the task is satisfied was found"

PlansOf = Callable[[Problem], Iterable[Plan]]
"""Plans of a problem."""


def refuse_other_noise(agent: AnyAgent) -> None:
    """Raise RelationRefused where no law with exponential moments is known above the noise of an agent."""
    for law in agent.laws or ():
        if law.envelope is None:
            raise RelationRefused(
                f"agent `{agent.name}`: paths are for noise of which exponential moments are known, got {law.name}; "
                "grids know it"
            )


@dataclass(frozen=True, eq=False)
class Refined:
    """Times of jumps, letters, and the nominal paths of all agents, with an upper bound on the probability of failing.

    ``normals`` are the directions of pairs of the certificate, and ``together`` says how near limits are to the team;
    None without pairs.
    """

    times: tuple[int, ...]
    letters: NDArray[np.int8]
    found: Sequence[FeedbackTrajectory]
    failure: float
    weakest: str
    normals: FloatArray | None = None
    together: Callable[[], dict[int, float]] | None = None

    @property
    def states(self) -> list[FloatArray]:
        """Nominal states (S + 1, d) of each agent."""
        return [one.nominal.states for one in self.found]

    def nearest(self) -> dict[int, float]:
        """Return, by times, how many deviations the nearest limit of the team is away, as the search has it."""
        if self.together is not None:
            return self.together()
        return least_by_times([one.nominal.worth(one.feedback)[0].nearest() for one in self.found])

    def believed(self) -> dict[str, Any]:
        """Return what the search believed of it; how near limits are where nothing is linearized, and so charged."""
        charges = [
            part for one in self.found for each in (one.spreads.states, one.spreads.outputs) for part in each[1:]
        ]
        charged = max(float(np.max(np.abs(part), initial=0.0)) for part in charges)
        spreads = np.concatenate([one.spreads.states[0] for one in self.found], axis=1)
        return believed_along(self.failure, spreads, self.nearest() if charged <= EXACT else None)


class _Apart:
    """Nonlinear paths of all agents for letters; what depends on an agent's own letters is searched once."""

    seen: list[tuple[float, Plan, NDArray[np.int8], list[FeedbackTrajectory]]]

    def __init__(self, problem: Problem, work: CountedWork) -> None:
        self.problem, self.work = problem, work
        self.searches = [NonlinearSearch(problem, i, work) for i in range(problem.n_agents)]
        self.ties = Ties(problem, self.searches)
        # Whoever names others has a path that fits theirs, and nobody else's.
        self.alike = [i if self.ties.are_any else self._alike(i) for i in range(problem.n_agents)]
        self.known: dict[object, tuple[int, FeedbackTrajectory] | None] = {}
        self.warm: list[FloatArray | None] = [None] * problem.n_agents
        self.seen, self.done, self.crossings = [], dict[object, Refined](), set[bytes]()
        self.stopped = ""

    @property
    def best(self) -> tuple[float, Plan, NDArray[np.int8], list[FeedbackTrajectory]] | None:
        """The best plan after little work."""
        return min(self.seen, key=lambda one: one[0], default=None)

    @property
    def tried(self) -> int:
        """Candidates of feedbacks that were tried."""
        return sum(search.tried for search in self.searches)

    @property
    def patience(self) -> float:
        """Share of what the search may take that hopeless plans may take."""
        return min(MOST_PATIENCE, PATIENCE * max(agent.n_states for agent in self.problem.agents))

    def of_plan(self, plan: Plan, bar: float = np.inf) -> None:
        """Look for nonlinear paths along a plan; above ``bar`` the first guess of an agent has to do."""
        letters = letters_of(self.problem, plan)
        if letters is None:
            return
        found = []
        self.ties.begin()
        for i, search in enumerate(self.searches):
            key = self._key(i, letters)
            if key not in self.known:
                one = search.quick(letters, self.warm[i], bar)
                self.known[key] = None if one is None else (i, one)
            known = self.known[key]
            if known is None:
                self.stopped = f"agent `{search.agent.name}` finds no way around regions in {plan.steps} steps"
                return
            found.append(self._moved(*known, i))
            self.warm[i] = found[-1].theta
        if self.ties.are_any:
            found = self.ties.settled(letters, found, NonlinearSearch.planned_anew)
        score = float(np.logaddexp.reduce([one.score for one in found]))
        before = next((one for one in self.seen if one[1] == plan), None)
        if before is None or score < before[0]:
            self.seen = [*(one for one in self.seen if one is not before), (score, plan, letters, found)]
            self.work.tell(any_failure(self.problem, [one.failure for one in found]))

    def with_tried_inputs(self) -> None:
        """Look for paths of the best plan, and along a run that the automaton accepts, from inputs that were tried."""
        # Feedbacks that were the best of hopeless plans are nothing to begin with.
        self.known.clear()
        self.warm = [None] * len(self.searches)
        for search in self.searches:
            search.tries_inputs = True
        for plan in (*([] if self.best is None else [self.best[1]]), *plans_of_runs(self.problem, self.work)):
            self.of_plan(plan)

    def refined(self, count: int = 1) -> Refined:
        """Return the best of a few plans, the best of all after little work, after more work."""
        best: Refined | None = None
        for score, plan, letters, found in sorted(self.seen, key=lambda one: one[0])[:count]:
            is_far = self.best is None or score > self.best[0] + NEAR
            if best is not None and (is_far or best.failure <= GOOD or self.work.is_over()):
                break
            if plan not in self.done:
                each = self._full(letters, found)
                self.done[plan] = _refined(self.problem, plan.times, letters, each)
                self.work.tell(self.done[plan].failure)
            one = self.done[plan]
            best = one if best is None or one.failure < best.failure else best
        assert best is not None
        return best

    def crossed(self, best: Refined) -> Refined:
        """Return a plan that fails at most as often, by visits at any time of a window in the place of fixed times."""
        key = best.letters.tobytes()
        if self.ties.are_any or best.failure <= GOOD or key in self.crossings:
            return best
        self.crossings.add(key)
        tried: list[tuple[float, NDArray[np.int8], list[FeedbackTrajectory]]] = []
        drawn = [deepcopy((search.rng, search.narrowing)) for search in self.searches]
        for half in HALVES:
            letters = with_windows(self.problem, best.letters, half)
            if letters is None or self.work.is_over():
                break
            each = [search.along_again(letters, one) for search, one in zip(self.searches, best.found, strict=True)]
            known = [one for one in each if one is not None]
            if len(known) == len(each):
                tried.append((float(np.logaddexp.reduce([one.score for one in known])), letters, known))
        score, letters, known = min(tried, key=lambda one: one[0], default=(np.inf, best.letters, []))
        if score < np.log(best.failure) + WORSE:
            crossing = _refined(self.problem, best.times, letters, self._full(letters, known))
            if crossing.failure < best.failure:
                self.done[letters.tobytes()] = crossing
                self.work.tell(crossing.failure)
                return crossing
        # Plans with visits at fixed times go on as if nothing else had been looked at.
        for search, generators in zip(self.searches, drawn, strict=True):
            search.rng, search.narrowing = generators
        return best

    def touched_up(self, best: Refined) -> Refined:
        """Return a plan that fails at most as often, after small moves of all that is free in the best few plans."""
        if self.ties.are_any:
            return best  # small moves of one agent would have to fit those of all others
        plans = [one for one in self.done.values() if one.failure <= best.failure * np.exp(WORSE)]
        plans = sorted(plans, key=lambda one: one.failure)
        for count, generations in POLISHED:
            if best.failure <= GOOD:
                break
            plans = sorted((self._polished(one, generations) for one in plans[:count]), key=lambda one: one.failure)
            best = min(best, *plans, key=lambda one: one.failure)
        return best

    def _polished(self, plan: Refined, generations: int) -> Refined:
        each = self._once(plan.letters, plan.found, lambda search, _, path: polished(search, path, generations))
        return _refined(self.problem, plan.times, plan.letters, each)

    def _full(self, letters: NDArray[np.int8], found: Sequence[FeedbackTrajectory]) -> list[FeedbackTrajectory]:
        """Return the paths of all agents after more work."""
        if not self.ties.are_any:
            return self._once(letters, found, NonlinearSearch.full)
        better = self.ties.settled(letters, found, NonlinearSearch.full, rounds=1)
        return self.ties.of_best_width(letters, better)

    def _once(
        self,
        letters: NDArray[np.int8],
        found: Sequence[FeedbackTrajectory],
        better: Callable[[NonlinearSearch, NDArray[np.int8], FeedbackTrajectory], FeedbackTrajectory],
    ) -> list[FeedbackTrajectory]:
        """Return what is made of the paths of all agents: once for those that are alike, with equal letters."""
        done, result = dict[object, tuple[int, FeedbackTrajectory]](), list[FeedbackTrajectory]()
        for i, (search, one) in enumerate(zip(self.searches, found, strict=True)):
            key = self._key(i, letters)
            if key not in done:
                done[key] = i, better(search, letters, one)
            result.append(self._moved(*done[key], i))
        return result

    def _key(self, i: int, letters: NDArray[np.int8]) -> tuple[object, bytes, int]:
        """Return what two agents have in common that have equal paths: what they are, and their own letters."""
        return self.alike[i], letters[:, self._own(i)].tobytes(), len(letters)

    def _moved(self, j: int, found: FeedbackTrajectory, i: int) -> FeedbackTrajectory:
        """Return a path of agent j as one of agent i, which is like it."""
        if i == j:
            return found
        faces = np.full_like(found.faces, -1)
        faces[:, self._own(i)] = found.faces[:, self._own(j)]
        model = self.searches[i].model
        return replace(found, faces=faces, nominal=replace(found.nominal, model=model))

    def _alike(self, i: int) -> object:
        """Return what agents have in common that move alike, from the same start, between the same regions."""
        search, names = self.searches[i], self.problem.automaton.propositions
        corners = [corners_along(self.problem, names[p], self.problem.horizon + 1) for p in self._own(i)]
        regions, start = tuple(end.tobytes() for ends in corners for end in ends), search.agent.initial
        return search_key(search), start.low.tobytes(), start.high.tobytes(), regions

    def _own(self, i: int) -> list[int]:
        names, agent = self.problem.automaton.propositions, self.problem.agents[i]
        return [p for p in range(min(len(names), self.problem.labeling.first_pair))
                if self.problem.propositions[names[p]].agent == agent.name]  # fmt: skip


def any_failure(problem: Problem, failures: Sequence[float]) -> float:
    """Return an upper bound on the probability that an agent fails.

    All of them are added up where agents share noise, or name each other.
    """
    if problem.joint_noise or any(agent.others for agent in problem.agents):
        return min(1.0, sum(failures) * (1.0 + 1e-12))
    return float(-np.expm1(sum(np.log1p(-min(failure, HOPELESS)) for failure in failures)))


def _refined(
    problem: Problem, times: tuple[int, ...], letters: NDArray[np.int8], found: Sequence[FeedbackTrajectory]
) -> Refined:
    """Return a plan of agents that do not look at each other."""
    failure = any_failure(problem, [one.failure for one in found])
    return Refined(times, letters, found, failure, max(found, key=lambda one: one.failure).weakest)


class _Together:
    """Nonlinear paths of all agents of a task that speaks of pairs, planned together."""

    best: tuple[float, Plan, NDArray[np.int8], TeamFound] | None
    patience = OF_PAIRS

    def __init__(self, problem: Problem, work: CountedWork) -> None:
        self.problem, self.search, self.work = problem, TeamSearch(problem, work), work
        self.best = None
        self.stopped = "agents are in each other's way in every plan that was made"

    @property
    def tried(self) -> int:
        """Candidates of feedbacks that were tried."""
        return self.search.tried

    def of_plan(self, plan: Plan, bar: float = np.inf) -> None:
        """Look for nonlinear paths along a plan, and keep them if they are the best; up to ``bar`` first guesses do."""
        letters = letters_of(self.problem, plan)
        found = None if letters is None else self.search.quick(letters, bar)
        if found is not None and letters is not None and (self.best is None or found.score < self.best[0]):
            self.best = found.score, plan, letters, found
            self.work.tell(found.failure)

    def with_tried_inputs(self) -> None:
        """Look for paths along runs that agents find in turn."""
        for plan, runs in runs_in_turn(self.problem, self.work):
            self.search.runs = runs
            self.of_plan(plan)
        self.search.runs = None

    def refined(self, count: int = 1) -> Refined:
        """Return the best plan after more work; plans of teams take so long that there is time for one."""
        assert self.best is not None
        _, (_, times, _), letters, found = self.best
        return _refined_team(times, letters, self.search.full(letters, found))

    def crossed(self, best: Refined) -> Refined:
        """Return the plan: of teams that are planned together visits are at fixed times."""
        return best

    def touched_up(self, best: Refined) -> Refined:
        """Return a plan that fails at most as often, after small moves of one agent after the other."""
        if self.search.ties.are_any:
            return best  # small moves of one agent would have to fit those of all others
        touched = _refined_team(best.times, best.letters, self.search.touched_up(best.letters, best.found))
        return touched if touched.failure < best.failure else best


def _refined_team(times: tuple[int, ...], letters: NDArray[np.int8], team: TeamFound) -> Refined:
    """Return a plan of agents that were planned together."""
    return Refined(times, letters, team.found, team.failure, team.weakest, team.rows.normals, team.nearest)


def nonlinear_certificate(problem: Problem, sources: Sequence[PlansOf], work: CountedWork) -> Synthesis:
    """Return a certificate along nonlinear paths, with its controllers.

    Where nothing is left of the bound, but a run without noise satisfies the task, it claims 0: its controllers follow
    that run, so that rollouts show that the task can be done. Where it is known that none does, they follow one that
    comes near.

    Parameters
    ----------
    problem : Problem
    sources : sequence of callables
        Ways through the automaton of a problem with the times of their jumps, in order of promise; further ones are for
        where those before them give nothing.
    work : CountedWork
        What the search may take.

    Raises
    ------
    NoRunFound
        If no run without noise was found that satisfies the task.
    """
    began = time.perf_counter()
    tried, best = found_for_team(problem, [plans(problem) for plans in sources], work)
    failure = min(1.0, best.failure * (1.0 + 1e-9))
    if failure >= WORTHLESS:
        failure, weakest = 1.0, best.weakest
        best = best if work.is_hopeless else _calm_run(problem, best, sources, work)
        best = replace(best, weakest=weakest)
    faces = np.full(best.letters.shape, -1)
    for one in best.found:
        faces = np.where(one.faces >= 0, one.faces, faces)
    settings = {
        "relation": "path", "jumps": list(best.times), "candidates": tried, "weakest": best.weakest,
    }  # fmt: skip
    if failure < 1.0 and not any(agent.others or agent.noise_scale for agent in problem.agents):
        # What others do, and what varies, is enclosed here by ranges: deviations are other upper bounds then.
        settings["believed"] = best.believed()
    paths = tuple(one.path for one in best.found)
    certificate = Certificate(problem, PathProof(paths, best.letters, faces, failure, best.normals), settings)
    seconds = {"abstract": 0.0, "synthesize": time.perf_counter() - began}
    unknown = dict.fromkeys(("abstract_upper_bound", "continuous_upper_bound", "unilateral_gain"))
    stats: dict[str, Any] = {"seconds": seconds, "rank": 1, "sweeps": [], "starts": {}, "dropped": 0.0, **unknown}
    return Synthesis(certificate, certificate.controller, stats)


def found_for_team(problem: Problem, plans: Sequence[Iterable[Plan]], work: CountedWork) -> tuple[int, Refined]:
    """Return how many candidates were tried, and the best plan; raise NoRunFound if none has paths at all."""
    pairs = len(problem.labeling.pairs)
    team: _Apart | _Together = _Together(problem, work) if pairs else _Apart(problem, work)
    share = team.patience * work.limit
    patience = work.spent + share
    for source, some in enumerate(plans):
        is_hopeless = team.best is None or team.best[0] >= HARDLY
        if source == BEFORE_RUNS and problem.n_agents > 1 and is_hopeless:
            # Agents that keep out of each other's way take turns, for which words are long.
            team.with_tried_inputs()
            if team.best is not None and team.best[0] < HARDLY:
                break
        possible = (plan for plan in some if letters_of(problem, plan) is not None)
        for number, plan in enumerate(islice(possible, MOST_HOPELESS if pairs <= FEW_PAIRS else 2), start=1):
            team.of_plan(plan)
            best_so_far = np.inf if team.best is None else team.best[0]
            is_late = work.is_over() or (best_so_far >= HARDLY and work.spent > patience)
            if best_so_far < PROMISING or is_late or (number >= MOST_PLANS and best_so_far < 0.0):
                break
        # As long as there is no hope the first plan of every source is looked at, which has words of its own.
        if team.best is not None and (team.best[0] < HARDLY or work.is_over()):
            break
    if team.best is None or team.best[0] >= HARDLY:
        team.with_tried_inputs()
    if team.best is None:
        more = f": {team.stopped}" if team.stopped else ""
        raise NoRunFound(f"{NO_PATH}{more}")
    # Windows of a team may be met in many orders: it tries other times of the jumps first.
    best = team.refined() if problem.n_agents > 1 else team.crossed(team.refined())
    if best.failure > GOOD and pairs <= FEW_PAIRS and not work.is_over():
        # Other times of the jumps, each looked at after little work.
        before = team.best[0]
        with work.within(patience + share - work.spent if best.failure >= WORTHLESS else np.inf):
            _with_better_times(team, work)
        if team.best[0] < before or best.failure > FAIR:
            again = team.crossed(team.refined(REFINED))
            best = again if again.failure < best.failure else best
    best = team.crossed(best)
    # Small moves make good plans better; where nothing is left of a bound they take longest and change nothing.
    return team.tried, best if work.is_over() or best.failure >= WORTHLESS else team.touched_up(best)


def _calm_run(problem: Problem, best: Refined, sources: Sequence[PlansOf], work: CountedWork) -> Refined:
    """Return a plan whose run without noise satisfies the task; raise NoRunFound if none was found.

    Where nothing is left of the bound a plan keeps so far from all limits that it may miss the task itself. With hardly
    any noise it is planned for nothing else.
    """
    if satisfies(problem, best.states):
        return best
    calm = problem.replace(disturbance_scale=CALM)
    # What is found with hardly any noise is no bound to be told.
    quiet = replace(work, told=lambda bound: None)
    _, again = found_for_team(calm, [plans(calm) for plans in sources], quiet)
    if not satisfies(problem, again.states):
        raise NoRunFound(f"{NO_PATH}: {most_missed(problem, again.letters, again.states) or again.weakest}")
    return again


def _with_better_times(team: _Apart | _Together, work: CountedWork) -> None:
    """Move single jumps, as long as that helps and the dearest plan so far may be afforded once more."""
    problem, tried, dearest = team.problem, 0, 0.0
    step = max(1, problem.horizon // 6)
    while step and tried < MOST_MOVES and team.best is not None:
        before = team.best[0]
        _, (way, times, steps), _, _ = team.best
        for group in way.groups:
            for move in (-step, step):
                moved = way.moved(times, group, move)
                fits = 1 <= moved[0] and moved[-1] <= problem.horizon and all(a < b for a, b in zip(moved, moved[1:]))
                if not fits or tried >= MOST_MOVES or not work.allows(dearest):
                    continue
                tried, spent = tried + 1, work.spent
                is_last = group[-1] == len(times) - 1 and problem.automaton.is_co_safe
                team.of_plan(Plan(way, moved, moved[-1] if is_last else steps), team.best[0] + NEAR)
                dearest = max(dearest, work.spent - spent)
        step = step if team.best[0] < before else step // 2
