"""The leaderboard: every policy on every problem of the suite, judged by the same episodes.

A row (``Standing``) is one policy on one problem: certified controllers, learners, and random inputs. Policies that are
there already are read: certificates ``ID.npz`` from one folder, trained actors ``ID/LEARNER/seed-S.npz`` from another.
The others are made, learners within a budget of world steps for each, and kept in these folders. ``replayed`` judges
the actors in a folder again, and trains nothing.

All policies of a problem meet the same starts and noise. A learner with several training seeds plays new episodes with
each actor, so the successes of all of them are independent, and Clopper-Pearson's limits of the total hold for the mean
success probability of these actors (Hoeffding 1956: a sum of trials that differ strays no further than one of equal
trials). They say nothing about training seeds that were not tried.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from ...envs.suite import as_problem, problem_ids
from ...envs.systems.arguments import counted, tree_text
from ...envs.tasks.problem import Problem
from ...synthesis.verbs.as_it_is import as_it_is
from ..statistical_tests import (
    Plan,
    TrialOptions,
    TrialPlan,
    clopper_pearson,
    names_plan,
    planned,
    rollout,
)
from .competitors import POLICIES, Competitor, Competitors, Sources, label_of, published
from .training import ALGORITHMS

SECONDS = 60.0
"""Wall-clock time in which a learner has to be certified as it was trained: along its run, and again on cells."""


@dataclass(frozen=True)
class Standing:
    """One policy on one problem.

    Parameters
    ----------
    problem, fingerprint : str
        Its id, or the name of a problem that is not in the suite.
    policy, information : str
        Its name, and what its agents see.
    episodes : int
        Per training seed.
    seeds : tuple of int
        Training seeds; empty for a policy without one.
    successes : tuple of int
        Of each training seed, or of the policy.
    low, high : float
        Exact limits of the (mean) success probability.
    confidence : float
        Of both limits together.
    lower_bound : float or None
        Certified lower bound, if the policy has one.
    steps : int or None
        World steps of training, summed over the seeds.
    seconds : float or None
        Wall-clock time of training or synthesis, summed over the seeds.
    refused : str or None
        What is claimed, and why it is not certified, of a certificate that ``check`` refuses; it has no bound.
    as_it_is : tuple of (float or str)
        Of each actor of a learner, what ``certify`` proves of it as it was trained, a lower bound, or why there is
        none, in a word.
    """

    problem: str
    fingerprint: str
    policy: str
    information: str
    episodes: int
    seeds: tuple[int, ...]
    successes: tuple[int, ...]
    low: float
    high: float
    confidence: float
    lower_bound: float | None
    steps: int | None
    seconds: float | None
    refused: str | None = None
    as_it_is: tuple[float | str, ...] = ()

    @property
    def best_as_it_is(self) -> float | str | None:
        """The largest bound of an actor as it was trained, else the first reason; None if none was asked for."""
        bounds = [bound for bound in self.as_it_is if not isinstance(bound, str)]
        return max(bounds) if bounds else next(iter(self.as_it_is), None)

    @property
    def rate(self) -> float:
        """Share of successes (an estimate)."""
        return sum(self.successes) / (self.episodes * len(self.successes))

    @property
    def middle_rate(self) -> float:
        """Interquartile mean over training seeds (descriptive): a quarter, rounded down, is left out at each end."""
        rates = sorted(count / self.episodes for count in self.successes)
        cut = len(rates) // 4
        return sum(rates[cut : len(rates) - cut]) / (len(rates) - 2 * cut)


@dataclass(frozen=True, repr=False)
class Leaderboard:
    """Rows, at most one per problem and policy.

    Parameters
    ----------
    rows : tuple of Standing
    """

    rows: tuple[Standing, ...] = ()

    @classmethod
    def load(cls, path: str | Path) -> Leaderboard:
        """Read what ``to_dict`` made from a JSON file; raise ValueError if the file holds something else."""
        try:
            stored = json.loads(Path(path).read_text(encoding="utf-8"))["rows"]
            rows: list[dict[str, Any]] = [
                {name: tuple(value) if isinstance(value, list) else value for name, value in row.items()}
                for row in stored
            ]
            return cls(tuple(Standing(**row) for row in rows))
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise ValueError(f"`{path}`: expected the JSON of a leaderboard") from error

    def row(self, problem: str, policy: str) -> Standing | None:
        """Return the row of a policy on a problem, None if there is none."""
        return next((row for row in self.rows if (row.problem, row.policy) == (problem, policy)), None)

    def holds(self, label: str, problem: Problem, policy: str) -> bool:
        """Return whether there is a row about this very problem; one about an older version of it does not count."""
        row = self.row(label, policy)
        return row is not None and row.fingerprint == problem.fingerprint

    def with_row(self, row: Standing) -> Leaderboard:
        """Return the leaderboard with this row in the place of an older one."""
        others = [old for old in self.rows if (old.problem, old.policy) != (row.problem, row.policy)]
        return Leaderboard(tuple(sorted([*others, row], key=lambda r: (r.problem, _place(r.policy)))))

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        return {"rows": [asdict(row) for row in self.rows]}

    @property
    def policies(self) -> tuple[str, ...]:
        """The names of all policies, those of the default columns first."""
        return tuple(sorted({row.policy for row in self.rows}, key=_place))

    def __repr__(self) -> str:
        problems = {row.problem for row in self.rows}
        rows = [
            (name, f"on {counted(sum(r.policy == name for r in self.rows), 'problem')}") for name in self.policies[:8]
        ]
        return tree_text(f"Leaderboard: {counted(len(problems), 'problem')}", rows)


@names_plan
def leaderboard(
    ids: Iterable[Any] | None = None,
    policies: Sequence[str] = POLICIES,
    plan: TrialPlan | int | None = None,
    *,
    sources: Sources = Sources(),  # noqa: B008 (a frozen record)
    board: Leaderboard = Leaderboard(),
    finished: Callable[[Leaderboard, Standing], None] | None = None,
    **trial: Unpack[TrialOptions],
) -> Leaderboard:
    """Fill the rows of a leaderboard that it does not hold yet.

    Parameters
    ----------
    ids : iterable of problems, ids or paths, optional
        Default: the suite.
    policies : sequence of str
        Of "certified", "random", "ppo", "ippo", "mappo", "central-ppo", "sac".
    plan, **trial
        Episodes per policy and training seed (default 20,000), seed, confidence (.999), chunk, executor, progress.
    sources : Sources
        Folders, budget and training seeds.
    board : Leaderboard
        Rows that are there already and stay.
    finished : callable, optional
        Called after each row with the leaderboard so far and the row.

    Raises
    ------
    ValueError
        If a policy is unknown, an argument is out of range, or a learner is to be trained without the extra ``rl``.
    """
    settled = judging_plan(planned(plan, trial, 20_000))
    known = ("certified", *ALGORITHMS, "random")
    for policy in policies:
        if policy not in known:
            raise ValueError(f"`policies`: expected {', '.join(map(repr, known))}, got {policy!r}")
    for id in problem_ids() if ids is None else ids:
        competitors = Competitors(as_problem(id), label_of(id), sources)
        for policy in policies:
            row = board.row(competitors.label, policy)
            if row is None or not board.holds(competitors.label, competitors.problem, policy):
                row = judged(competitors.label, policy, competitors.of(policy), settled)
            if policy in ALGORITHMS and len(row.as_it_is) < len(row.seeds):
                held = replace(competitors, sources=replace(sources, seeds=row.seeds))
                row = replace(row, as_it_is=tuple(map(certified_as_it_is, held.of(policy))))
            if row != board.row(competitors.label, policy):
                board = board.with_row(row)
                if finished is not None:
                    finished(board, row)
    return board


def replayed(
    learners: Path,
    ids: Iterable[Any] | None = None,
    plan: TrialPlan | int | None = None,
    *,
    finished: Callable[[Leaderboard, Standing], None] | None = None,
    **trial: Unpack[TrialOptions],
) -> Leaderboard:
    """Judge the actors in a folder again, on the same episodes as `leaderboard`; nothing is trained.

    Parameters
    ----------
    learners : Path
        Folder with ``ID/LEARNER/seed-S.npz``.
    ids, plan, finished, **trial
        As for `leaderboard`.
    """
    settled, board = judging_plan(planned(plan, trial, 20_000)), Leaderboard()
    for id in problem_ids() if ids is None else ids:
        label = label_of(id)
        for policy, seeds in published(learners, label).items():
            competitors = Competitors(as_problem(id), label, Sources(learners=learners, seeds=seeds))
            row = judged(label, policy, competitors.of(policy), settled)
            board = board.with_row(row)
            if finished is not None:
                finished(board, row)
    return board


def certified_as_it_is(entrant: Competitor) -> float | str:
    """Return what is proved of a learner as it was trained, a lower bound, or why there is none, in a word."""
    found = as_it_is(entrant.problem, entrant.contestant.controller, seconds=SECONDS)
    return found.word if found.bound is None else found.bound


def judging_plan(plan: Plan) -> Plan:
    """Return the plan with a seed that training with the same number does not use: judging has its own episodes."""
    return replace(plan, seed=int(np.random.SeedSequence([plan.seed, 2]).generate_state(1)[0] >> 1))


def judged(label: str, policy: str, competitors: Sequence[Competitor], plan: Plan) -> Standing:
    """Return the row of a policy on the problem of this name, given by one entrant, or by one for each seed."""
    problem = competitors[0].problem
    # Actor k meets the episodes of seed + k: those of different actors are independent, those of different policies
    # are paired.
    runs = [
        rollout(problem, entrant.contestant.controller, replace(plan, seed=plan.seed + k))
        for k, entrant in enumerate(competitors)
    ]
    successes = tuple(run.successes for run in runs)
    low, high = clopper_pearson(sum(successes), plan.episodes * len(runs), plan.confidence)
    first = competitors[0].contestant
    steps = [entrant.steps for entrant in competitors if entrant.steps is not None]
    seconds = [entrant.contestant.seconds for entrant in competitors if entrant.contestant.seconds is not None]
    return Standing(
        problem=label,
        fingerprint=problem.fingerprint,
        policy=policy,
        information=first.information,
        episodes=plan.episodes,
        seeds=tuple(e.contestant.seed for e in competitors if e.contestant.seed is not None),
        successes=successes,
        low=float(low),
        high=float(high),
        confidence=plan.confidence,
        lower_bound=None if first.lower_bound is None else float(first.lower_bound),
        steps=sum(steps) if steps else None,
        seconds=round(sum(seconds), 1) if seconds else None,
        refused=first.refused,
    )


def _place(policy: str) -> tuple[int, str]:
    """Return where the column of a policy stands: those that are known first, then submitted ones by name."""
    known = ("certified", *ALGORITHMS)
    if policy == "random":
        return len(known) + 1, ""
    return (known.index(policy), "") if policy in known else (len(known), policy)
