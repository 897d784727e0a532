"""Policies compared on one problem with common random numbers.

All policies meet the same starts and the same noise (``rollout``: one seed, one chunk size), so that their outcomes are
paired, episode by episode. Per policy: success rate with exact limits (Clopper-Pearson), the certified bound if there
is one, the time it took to train or to synthesize, and what information it uses. Per pair: the exact McNemar test,
which looks only at the episodes that one of the two wins alone; Holm's method over all pairs.

A learner trained with several seeds is given as a sequence: one row per seed, and a line with mean and range.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from ...envs.agents import write_json
from ...envs.problem import Problem
from ...envs.suite import as_problem
from ...synthesis.certificates import Certificate, ProductCertificate, Synthesis, as_certificate, shown_bound
from ...synthesis.controllers import LOCAL, Controller
from ..simulation import Batchable, Rollouts, TrialOptions, TrialPlan, planned, rollout
from ..statistics import clopper_pearson, holm, p_at_least
from .rollout_policies import as_controller
from .training import Training


@dataclass(frozen=True)
class Contestant:
    """A policy and what is known of it before it is simulated.

    Parameters
    ----------
    group, name : str
        Names; several seeds of one learner share a group.
    information : str
        What its agents see, in words.
    controller : object with ``batch(dynamics)``
    lower_bound, gap : float or None
        Certified bound, and the width of an exact one.
    seconds : float or None
        To train or to synthesize.
    seed : int or None
        Of the training.
    """

    group: str
    name: str
    information: str
    controller: Batchable
    lower_bound: float | None = None
    gap: float | None = None
    seconds: float | None = None
    seed: int | None = None


@dataclass(frozen=True)
class Entry:
    """One policy's row: see ``Contestant``; and ``rate`` with exact two-sided limits ``ci_low``, ``ci_high``.

    ``inadmissible`` counts episodes in which an input beyond the input box was asked for; there it saturated.
    """

    group: str
    name: str
    information: str
    successes: int
    rate: float
    ci_low: float
    ci_high: float
    lower_bound: float | None
    gap: float | None
    seconds: float | None
    seed: int | None
    inadmissible: int


@dataclass(frozen=True)
class Pair:
    """Two policies: episodes that each won alone, exact two-sided McNemar p-value, and the same by Holm's method."""

    first: str
    second: str
    only_first: int
    only_second: int
    p_value: float
    adjusted: float


@dataclass(frozen=True)
class Comparison:
    """Policies side by side on one problem.

    Parameters
    ----------
    problem, fingerprint : str
    horizon, episodes, seed, chunk : int
    confidence : float
        Of the limits of each entry.
    entries : tuple of Entry
    pairs : tuple of Pair
        All pairs of entries.
    """

    problem: str
    fingerprint: str
    horizon: int
    episodes: int
    seed: int
    chunk: int
    confidence: float
    entries: tuple[Entry, ...]
    pairs: tuple[Pair, ...]

    def entry(self, name: str) -> Entry:
        """The row of one policy; KeyError if there is none."""
        return {entry.name: entry for entry in self.entries}[name]

    def to_dict(self) -> dict[str, Any]:
        """Everything as JSON values."""
        return {**asdict(self), "entries": [asdict(e) for e in self.entries], "pairs": [asdict(p) for p in self.pairs]}

    def save(self, path: str | Path) -> None:
        """Write ``to_dict()`` as JSON."""
        write_json(path, self.to_dict())

    def __str__(self) -> str:
        width = max(len("policy"), *(len(entry.name) for entry in self.entries))
        limits = f"{100 * self.confidence:g} % limits"
        lines = [
            f"{self.problem}, horizon {self.horizon}: {self.episodes} episodes each, common random numbers (seed "
            f"{self.seed})",
            f"{'policy':<{width}}  success   {limits:<20} {'certified':<28} {'seconds':>8}  information",
        ]
        for e in self.entries:
            bound = "-" if e.lower_bound is None else shown_bound(e.lower_bound, e.gap)
            seconds = "-" if e.seconds is None else f"{e.seconds:.1f}"
            lines.append(
                f"{e.name:<{width}}  {e.rate:.5f}   [{e.ci_low:.5f}, {e.ci_high:.5f}]   {bound:<28} {seconds:>8}  "
                f"{e.information}"
            )
        return "\n".join([*lines, *self._groups(), *self._tests()])

    def _groups(self) -> list[str]:
        lines = []
        for group in dict.fromkeys(entry.group for entry in self.entries):
            rates = [entry.rate for entry in self.entries if entry.group == group]
            if len(rates) > 1:
                span = f"[{min(rates):.5f}, {max(rates):.5f}]"
                lines.append(f"{group}: mean {np.mean(rates):.5f} over {len(rates)} training seeds, range {span}")
        return lines

    def _tests(self) -> list[str]:
        return [
            f"{p.first} / {p.second}: {p.only_first} / {p.only_second} episodes won alone, exact McNemar p "
            f"{_shown_p(p.p_value)} (Holm {_shown_p(p.adjusted)})"
            for p in self.pairs
        ]


def compare(
    problem: Any,
    policies: Mapping[str, Any],
    plan: TrialPlan | int | None = None,
    **trial: Unpack[TrialOptions],
) -> Comparison:
    """Simulate policies on the same starts and noise, and test their differences.

    Parameters
    ----------
    problem : Problem, id or path
    policies : mapping from name to policy
        Syntheses and certificates of this problem, trainings, actors, controllers, any form of
        ``synthesis.decentralised``, anything with ``batch(dynamics)``; or a sequence of these (several training seeds).
    plan, **trial
        Episodes (default 10,000), seed, confidence of the two-sided limits of each policy (.99), chunk, executor,
        progress; see ``TrialPlan``.

    Raises
    ------
    ValueError
        If there is no policy, one has an unknown form, or a certificate speaks of another problem.

    Examples
    --------
    >>> import certigym as cg
    >>> from certigym.baselines import IdleController
    >>> problem = cg.make_problem("invariance-v0", n_agents=2)
    >>> result = compare(problem, {"centre": lambda x, q, t: -0.5 * x, "idle": IdleController()}, 500)
    >>> [entry.name for entry in result.entries], len(result.pairs)
    (['centre', 'idle'], 1)
    """
    problem, settled = as_problem(problem), planned(plan, trial, 10_000, 0.99)
    contestants = [c for name, policy in policies.items() for c in contestants_of(problem, name, policy)]
    if not contestants:
        raise ValueError("`policies`: expected at least one policy, got none")
    names = [contestant.name for contestant in contestants]
    if len(set(names)) < len(names):
        raise ValueError(f"`policies`: expected names that differ, got {', '.join(names)}")
    runs = [rollout(problem, contestant.controller, settled) for contestant in contestants]
    entries = tuple(_entry(c, run, settled.confidence) for c, run in zip(contestants, runs, strict=True))
    return Comparison(
        problem=problem.name,
        fingerprint=problem.fingerprint,
        horizon=problem.horizon,
        episodes=settled.episodes,
        seed=settled.seed,
        chunk=settled.chunk,
        confidence=settled.confidence,
        entries=entries,
        pairs=_pairs(names, runs),
    )


def contestants_of(problem: Problem, name: str, policy: Any) -> list[Contestant]:
    """The contestants that a value of ``policies`` stands for."""
    if isinstance(policy, str):
        raise ValueError(
            f"`policies`: expected a policy, certificate or training for {name!r}, got the text {policy!r}; load "
            "it with `load_certificate` or `load_actor`"
        )
    if isinstance(policy, Sequence):
        if len(policy) == 1:
            return contestants_of(problem, name, policy[0])
        parts = [contestants_of(problem, name, one)[0] for one in policy]
        marks = [k if part.seed is None else part.seed for k, part in enumerate(parts)]
        return [
            Contestant(**{**vars(part), "group": name, "name": f"{name} (seed {mark})"})
            for part, mark in zip(parts, marks, strict=True)
        ]
    if isinstance(policy, Synthesis | Certificate | ProductCertificate):
        certificate = as_certificate(policy)
        if certificate.fingerprint != problem.fingerprint:
            raise ValueError(
                f"`policies`: the certificate of {name!r} speaks of another problem ({certificate.problem.name!r}); "
                "its bound does not hold here, give its controller alone"
            )
        spent = policy.stats["seconds"] if isinstance(policy, Synthesis) else None
        seconds = float(sum(spent.values())) if isinstance(spent, dict) else None
        controller = certificate.controller
        return [
            Contestant(name, name, _information(controller), controller, certificate.lower_bound, certificate.gap,
                       seconds)
        ]  # fmt: skip
    if isinstance(policy, Training):
        actor = policy.actor
        return [Contestant(name, name, actor.information, actor, seconds=policy.seconds, seed=policy.seed)]
    found: Any = policy if hasattr(policy, "batch") else as_controller(problem, policy)
    return [Contestant(name, name, _information(found), found)]


def mcnemar(only_first: int, only_second: int) -> float:
    """Exact two-sided p-value of equal success probabilities, from the episodes that each policy won alone.

    Under the null hypothesis either is the winner of such an episode with probability 1/2.

    Examples
    --------
    >>> mcnemar(0, 5), mcnemar(3, 3), mcnemar(0, 0)
    (0.0625, 1.0, 1.0)
    """
    fewer, total = min(only_first, only_second), only_first + only_second
    return 1.0 if total == 0 else min(1.0, 2.0 * float(p_at_least(fewer, total, 0.5)))


def _shown_p(value: float) -> str:
    """A p-value in words; those below the smallest number are not shown as 0."""
    return f"= {value:.2g}" if value > 0.0 else "< 1e-300"


def _information(controller: Any) -> str:
    if isinstance(controller, Controller):
        return f"{LOCAL}, own abstract state" if any(a.is_coupled for a in controller.agents) else LOCAL
    return str(getattr(controller, "information", "not stated"))


def _entry(contestant: Contestant, run: Rollouts, confidence: float) -> Entry:
    known = {name: value for name, value in vars(contestant).items() if name != "controller"}
    low, high = clopper_pearson(run.successes, run.episodes, confidence)
    return Entry(
        **known, successes=run.successes, rate=run.successes / run.episodes, ci_low=low, ci_high=high,
        inadmissible=run.inadmissible,
    )  # fmt: skip


def _pairs(names: Sequence[str], runs: Sequence[Rollouts]) -> tuple[Pair, ...]:
    found = []
    for a, b in combinations(range(len(runs)), 2):
        only_a = int((runs[a].success & ~runs[b].success).sum())
        only_b = int((runs[b].success & ~runs[a].success).sum())
        found.append((names[a], names[b], only_a, only_b, mcnemar(only_a, only_b)))
    adjusted = holm([pair[-1] for pair in found])
    return tuple(Pair(*pair, float(p)) for pair, p in zip(found, adjusted, strict=True))
