"""A probe: how much better than the certified controllers can a learner do that knows what they know?

The probe does not begin at nothing. It clones the certified controllers (``imitation``), and lets PPO improve the clone
with the reward of the task alone: several attempts, with other seeds and other deviations of the actions, within a
budget of time. The attempts' actors are judged on episodes that serve for nothing but choosing the best one; the best
one then meets the certified controllers on new episodes, with common random numbers. So the result is not biased by the
choice.

What the probe finds is a statement about one actor: the difference of two success probabilities, with exact limits. If
it gains nothing, that proves nothing about all other policies; if it gains much, the certificate leaves much on the
table (coarse cells, too few targets, a search that stopped early).

The agents of the probe see what certified agents see: own state, automaton state, time, and which agent they are.
Agents with a coupling also remember an abstract state; the probe's do not.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from ...envs.suite import as_problem
from ...envs.systems.arguments import checked_count, counted, tree_text
from ...envs.systems.backends import on_one_thread
from ...envs.tasks.problem import Problem
from ...synthesis.certificates.controllers import LOCAL
from ...synthesis.certificates.proofs import Certificate, shown_bound
from ...synthesis.extended_check.claims import standing
from ..statistical_tests import (
    Plan,
    Saved,
    TrialOptions,
    TrialPlan,
    clopper_pearson,
    names_plan,
    paired_difference,
    planned,
    rollout,
)
from .actors import Actor, save_actor
from .imitation import clone, demonstrate
from .learning import Progress, actor_now, enter, learn, new_learner, new_watcher, numbers_of
from .settings import Piece, Settings, settings_for
from .training import certificate_of, score
from .views import SharedView

SECONDS = 120.0
"""Default budget of a probe: some three attempts of several hundred thousand world steps."""

DEVIATIONS = (0.2, 0.1, 0.05)
"""Deviations of the actions, one after the other: large ones find more, small ones break less where a hair's breadth
counts."""

PIECES = 8
"""Parts of an attempt, after each of which its actor is judged."""

CHOOSING = 8000
"""Episodes that choose between actors: success rates to about .004, so that the best is not a lucky one."""


@dataclass(frozen=True)
class Attempt:
    """One attempt: seed, deviation of the actions, world steps, and success of its best actor.

    The rate is an estimate from the episodes that choose, so it is biased upwards.
    """

    seed: int
    deviation: float
    steps: int
    best: float


@dataclass(frozen=True, repr=False)
class Probe(Saved):
    """What a probe found.

    Parameters
    ----------
    problem, fingerprint : str
    horizon : int
    lower_bound : float
        Certified lower bound.
    gap : float or None
        How far above it the probability can be under the certified controllers, if that is certified, too.
    episodes, seed : int
        Episodes in which both were judged.
    confidence : float
        Of all limits, each two-sided.
    certified, learned : int
        Successes of the certified controllers and of the best learner.
    only_certified, only_learned : int
        Episodes in which only one of them succeeded.
    gain, gain_low, gain_high : float
        Estimate of the learner's success probability less that of the certified controllers, and its exact limits.
    seconds : float
        Wall-clock time of cloning and learning.
    cloned : float
        Success of the clone in the episodes that choose (an estimate).
    attempts : tuple of Attempt
    information : str
    actor : Actor
        The best learner.
    """

    problem: str
    fingerprint: str
    horizon: int
    lower_bound: float
    gap: float | None
    episodes: int
    seed: int
    confidence: float
    certified: int
    learned: int
    only_certified: int
    only_learned: int
    gain: float
    gain_low: float
    gain_high: float
    seconds: float
    cloned: float
    attempts: tuple[Attempt, ...]
    information: str
    actor: Actor

    @property
    def verdict(self) -> str:
        """``better`` or ``worse``, if the limits exclude 0, else ``no difference seen``: the learner's side."""
        if self.gain_low > 0.0:
            return "better"
        return "worse" if self.gain_high < 0.0 else "no difference seen"

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the actor as JSON values."""
        fields = {name: value for name, value in vars(self).items() if name not in ("actor", "attempts")}
        return {**fields, "verdict": self.verdict, "attempts": [asdict(attempt) for attempt in self.attempts]}

    def save_actor(self, path: str | Path) -> None:
        """Write the best learner as an actor (.npz), for ``compare`` and ``certify``."""
        save_actor(self.actor, path, algorithm="probe", seed=self.seed)

    def __repr__(self) -> str:
        return tree_text(f"Probe of {self.problem!r}: {counted(self.episodes, 'episode')} each", self._rows())

    def __str__(self) -> str:
        episodes = counted(self.episodes, "episode")
        head = f"{self.problem}, horizon {self.horizon}: {episodes} each, common random numbers"
        width = max(len(name) for name, _ in self._rows())
        return "\n".join([head, *(f"{name:<{width}}  {text}" for name, text in self._rows())])

    def _rows(self) -> list[tuple[str, str]]:
        """Return names and texts of what was found."""
        steps = sum(attempt.steps for attempt in self.attempts)
        spent = f"{counted(len(self.attempts), 'attempt')}, {counted(steps, 'world step')}, {self.seconds:.0f} s"
        return [
            ("certified", f"{shown_bound(self.lower_bound, self.gap)}, simulated {self._rate(self.certified)}"),
            ("learner", self._rate(self.learned)),
            ("gain", f"{self.gain:+.5f}   [{self.gain_low:+.5f}, {self.gain_high:+.5f}]   ({self.verdict})"),
            ("limits", f"{100 * self.confidence:g} %, exact"),
            ("learned", f"{spent}; the clone of the certified controllers scored {self.cloned:.4f}"),
            ("agents see", self.information),
        ]

    def _rate(self, successes: int) -> str:
        low, high = clopper_pearson(successes, self.episodes, self.confidence)
        return f"{successes / self.episodes:.5f}   [{low:.5f}, {high:.5f}]"


@names_plan
@on_one_thread
def probe(
    problem: Any,
    certificate: Any = "certificate",
    plan: TrialPlan | int | None = None,
    *,
    seconds: float | None = SECONDS,
    steps: int | None = None,
    learned: Progress | None = None,
    **trial: Unpack[TrialOptions],
) -> Probe:
    """Let a learner try to beat the certified controllers of a problem, and say by how much it did.

    Parameters
    ----------
    problem : Problem, id or path
    certificate : Synthesis, certificate or path, optional
        Default: "certificate", the one that ``synthesize`` makes with its defaults.
    plan, **trial
        Episodes (default 20,000), seed, confidence of the limits (.999), chunk, executor, progress; see ``TrialPlan``.
        The seed decides the attempts, too.
    seconds : float, optional
        Budget for cloning and learning, not for synthesis and for the last episodes. How far the learner comes in it
        depends on the machine.
    steps : int, optional
        World steps of each attempt, one attempt per deviation, in place of the budget of time: then the result is the
        same each time.
    learned : callable, optional
        Called with the world steps taken since the last call and the latest success rate while exploring.

    Returns
    -------
    Probe
        With exact limits of the difference (``paired_difference``).

    Raises
    ------
    ValueError
        If an argument is out of range, if the problem decomposes into independent tasks, or if Stable-Baselines3 is
        not installed.
    """
    problem, settled = as_problem(problem), planned(plan, trial, 20_000)
    if problem.groups:
        raise ValueError(
            f"`problem`: expected one task, got {len(problem.groups)} independent ones; probe each of `problem.tasks`"
        )
    if steps is not None:
        checked_count(steps, "steps")
    elif seconds is None or not seconds > 0.0:
        raise ValueError(f"`seconds`: expected a positive number, got {seconds!r}")
    held = standing(certificate_of(problem, certificate))
    # Three seeds that share nothing: to learn from, to choose by, and to judge by; torch takes 31 bits.
    learning, choosing, judging = (np.random.SeedSequence(settled.seed).generate_state(3) >> 1).tolist()
    began = time.perf_counter()
    best = _Search(problem, held, learning, choosing, learned).run(None if steps is not None else seconds, steps)
    return _judged(held, best, time.perf_counter() - began, (settled, judging))


@dataclass(frozen=True)
class _Best:
    """What a search found: the score of the clone, all attempts, and the best actor."""

    cloned: float
    attempts: tuple[Attempt, ...]
    actor: Actor


def _judged(held: Certificate, best: _Best, seconds: float, plan: tuple[Plan, int]) -> Probe:
    """Return the record of a probe, from episodes that nothing has been chosen by."""
    (settled, judging), problem = plan, held.problem
    ours, theirs = (rollout(problem, policy, replace(settled, seed=judging)).success for policy in (held, best.actor))
    only = int((ours & ~theirs).sum()), int((theirs & ~ours).sum())
    low, high = paired_difference(only[1], only[0], settled.episodes, settled.confidence)
    return Probe(
        problem=problem.name,
        fingerprint=problem.fingerprint,
        horizon=problem.horizon,
        lower_bound=held.lower_bound,
        gap=held.gap,
        episodes=settled.episodes,
        seed=settled.seed,
        confidence=settled.confidence,
        certified=int(ours.sum()),
        learned=int(theirs.sum()),
        only_certified=only[0],
        only_learned=only[1],
        gain=(only[1] - only[0]) / settled.episodes,
        gain_low=low,
        gain_high=high,
        seconds=seconds,
        cloned=best.cloned,
        attempts=best.attempts,
        information=LOCAL,
        actor=best.actor,
    )


@dataclass(frozen=True)
class _Search:
    """Where the attempts of a probe take place, and what they are judged by."""

    problem: Problem
    certificate: Certificate
    seed: int
    choosing: int
    learned: Progress | None

    def run(self, seconds: float | None, steps: int | None) -> _Best:
        """Clone the controllers, and make one attempt per deviation."""
        deadline = float("inf") if seconds is None else time.perf_counter() + seconds
        view = SharedView(self.problem)
        # The clone is made once. It takes part itself, and every attempt begins with its numbers.
        model: Any = new_learner("ppo", view, settings_for("ppo", view, warm=True), self.seed)
        clone(model, demonstrate(view, self.certificate.controller, seed=self.seed), seed=self.seed)
        numbers = numbers_of(model)
        best = actor_now(model, view)
        cloned = best_score = self._score(best)
        attempts = []
        for number, deviation in enumerate(DEVIATIONS):
            # Each attempt gets an equal share of the time that is left.
            now = time.perf_counter()
            until = now + (deadline - now) / (len(DEVIATIONS) - number)
            attempt, actor = self._attempt(view, numbers, (self.seed + number, deviation), (steps, until))
            attempts.append(attempt)
            if attempt.best > best_score:
                best, best_score = actor, attempt.best
        return _Best(cloned, tuple(attempts), best)

    def _attempt(
        self, view: SharedView, numbers: dict[str, Any], start: tuple[int, float], limits: tuple[int | None, float]
    ) -> tuple[Attempt, Actor]:
        """Learn from a clone until the steps are taken or the time is over; return the best actor on the way."""
        (seed, deviation), (steps, until) = start, limits
        settings = settings_for("ppo", view, warm=True, deviation=deviation, steps=steps)
        phase = settings.phases[0]
        model: Any = new_learner("ppo", view, settings, seed)
        model.policy.load_state_dict(numbers)
        enter(model, view, settings, phase, seed)
        watcher = new_watcher(view.rows, max(1, settings.steps // PIECES), self.learned, until)
        best, best_score = actor_now(model, view), -1.0
        for length in self._lengths(settings, endless=steps is None):
            learn(model, view, Piece(length, (phase.learning_rate, phase.learning_rate)), watcher)
            actor = actor_now(model, view)
            now = self._score(actor)
            if now > best_score:
                best, best_score = actor, now
            if time.perf_counter() >= until:
                break
        taken = int(model.num_timesteps) // view.rows
        return Attempt(seed, deviation, taken, best_score), best

    def _score(self, actor: Actor) -> float:
        return score(self.problem, actor, self.choosing, CHOOSING)

    @staticmethod
    def _lengths(settings: Settings, endless: bool) -> Iterator[int]:
        """Yield the world steps of the parts of an attempt; without end if only the time limits it."""
        # A learner always finishes its round, so parts shorter than a round would add up to more than was asked for.
        count = max(1, min(PIECES, settings.steps // settings.round))
        lengths = np.diff(np.linspace(0, settings.steps, count + 1).round().astype(int)).tolist()
        yield from lengths
        while endless:
            yield lengths[-1]
