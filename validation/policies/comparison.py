"""Policies compared on one problem with common random numbers.

All policies meet the same starts and the same noise (``rollout``: one seed, one chunk size), so their outcomes are
paired, episode by episode. For each policy the comparison shows the success rate with exact limits (Clopper-Pearson),
the certified bound if there is one, the time of training or synthesis, and what information the policy uses. For each
pair it shows the exact McNemar test, which looks only at the episodes in which exactly one of the two succeeds, with
Holm's method over all pairs (docs/theory/evidence.md, "Two policies").

A learner trained with several seeds is given as a sequence: the table has one row per seed, and one line states mean
and range with limits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from ...envs.suite import as_problem
from ...envs.systems.arguments import counted, shortened, tree_text
from ...envs.tasks.problem import Problem
from ...synthesis.certificates.controllers import LOCAL, Controller
from ...synthesis.certificates.proofs import Certificate, Synthesis, certificate_from, shown_bound, told_claim
from ...synthesis.extended_check.claims import checked_once
from ...synthesis.interop import is_model
from ..statistical_tests import (
    VACUOUS,
    Batchable,
    Rollouts,
    Saved,
    TrialOptions,
    TrialPlan,
    clopper_pearson,
    holm,
    html_table,
    mean_limits,
    names_plan,
    p_at_least,
    planned,
    rollout,
)
from .rollout_policies import as_controller
from .shielded_policy import ShieldedController
from .training import Training

ENTRIES_SHOWN = 8
"""Policies that a short form lists, with which it stays within a dozen lines."""


@dataclass(frozen=True, repr=False)
class Contestant:
    """A policy and the facts that are known before it is simulated.

    Parameters
    ----------
    group, name : str
        Names; several seeds of one learner share a group.
    information : str
        What the agents of the policy see, in words.
    controller : object with ``batch(dynamics)``
    lower_bound, gap : float or None
        Certified lower bound, and how far above it the probability can be if that is certified, too.
    refused : str or None
        What is claimed, and why it is not certified, of a certificate that ``check`` refuses; it has no bound.
    seconds : float or None
        Time of training or synthesis.
    seed : int or None
        Seed of the training.
    """

    group: str
    name: str
    information: str
    controller: Batchable
    lower_bound: float | None = None
    gap: float | None = None
    seconds: float | None = None
    seed: int | None = None
    refused: str | None = None

    def __repr__(self) -> str:
        return f"Contestant({self.name!r}, {type(self.controller).__name__})"


@dataclass(frozen=True, repr=False)
class Entry:
    """The row of one policy: the fields of ``Contestant``, and its ``rate`` with exact limits ``ci_low``, ``ci_high``.

    ``inadmissible`` counts the episodes in which the policy asked for an input beyond the input box, which saturated.
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
    refused: str | None = None

    def __repr__(self) -> str:
        names = ("success", "certified", "seconds", "sees")
        rows = [(name, text) for name, text in zip(names, self.texts(), strict=True) if text != "-"]
        return tree_text(f"Entry {self.name!r}", rows)

    def texts(self) -> tuple[str, str, str, str]:
        """Return success rate with limits, certified bound, seconds and information in words; "-" for none."""
        nothing = "-" if self.refused is None else "claimed, NOT valid"
        bound = nothing if self.lower_bound is None else shown_bound(self.lower_bound, self.gap)
        if self.lower_bound is not None and self.lower_bound <= 0.0:
            bound = f"{bound} ({VACUOUS})"
        seconds = "-" if self.seconds is None else f"{self.seconds:.1f}"
        return f"{self.rate:.5f}   [{self.ci_low:.5f}, {self.ci_high:.5f}]", bound, seconds, self.information


@dataclass(frozen=True)
class Pair:
    """Two policies: episodes in which each alone succeeds, exact two-sided McNemar p-value, and its Holm adjustment."""

    first: str
    second: str
    only_first: int
    only_second: int
    p_value: float
    adjusted: float


@dataclass(frozen=True, repr=False)
class Comparison(Saved):
    """Policies side by side on one problem.

    Parameters
    ----------
    problem, fingerprint : str
    horizon, episodes, seed, chunk : int
    confidence : float
        Confidence of the limits of each entry.
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

    @property
    def is_invalid(self) -> bool:
        """Whether ``check`` refuses the certificate of a policy."""
        return any(entry.refused is not None for entry in self.entries)

    @property
    def is_refuted(self) -> bool:
        """Whether the rollouts contradict the bound of a policy."""
        return any(entry.lower_bound is not None and entry.ci_high < entry.lower_bound for entry in self.entries)

    def entry(self, name: str) -> Entry:
        """Return the row of one policy; raise KeyError if there is no policy of this name."""
        return {entry.name: entry for entry in self.entries}[name]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        return {**asdict(self), "entries": [asdict(e) for e in self.entries], "pairs": [asdict(p) for p in self.pairs]}

    def __str__(self) -> str:
        width = max(len("policy"), *(len(entry.name) for entry in self.entries))
        limits = f"{100 * self.confidence:g} % limits"
        lines = [
            *(f"{entry.name}: {entry.refused}" for entry in self.entries if entry.refused is not None),
            f"{self._title()}, common random numbers (seed {self.seed})",
            f"{'policy':<{width}}  success   {limits:<20} {'certified':<28} {'seconds':>8}  what agents see",
        ]
        for entry in self.entries:
            rate, bound, seconds, information = entry.texts()
            lines.append(f"{entry.name:<{width}}  {rate}   {bound:<28} {seconds:>8}  {information}")
        return "\n".join([*lines, *self._groups(), *self._tests()])

    def __repr__(self) -> str:
        rows = [
            (shortened(entry.name, 40), "   ".join(text for text in entry.texts()[:2] if text != "-"))
            for entry in self.entries[:ENTRIES_SHOWN]
        ]
        more = len(self.entries) - ENTRIES_SHOWN
        rows += [("...", counted(more, "more policy", "more policies"))] if more > 0 else []
        return tree_text(f"Comparison: {self._title()}", rows)

    def _repr_html_(self) -> str:
        head = ("policy", f"success, {100 * self.confidence:g} % limits", "certified", "seconds", "what agents see")
        return html_table(self._title(), [(entry.name, *entry.texts()) for entry in self.entries], head)

    def _title(self) -> str:
        """Return what was run."""
        return f"{self.problem}, horizon {self.horizon}: {counted(self.episodes, 'episode')} per policy"

    def _groups(self) -> list[str]:
        """Return a line for every learner that was trained with several seeds.

        The limits of the mean are Student's, and hold approximately; that the range covers the median of all trainings
        holds exactly, for half of them are above the median and half below, one by one.
        """
        lines = []
        for group in dict.fromkeys(entry.group for entry in self.entries):
            rates = [entry.rate for entry in self.entries if entry.group == group]
            if len(rates) > 1:
                low, high = mean_limits(rates, self.confidence)
                covers = 1.0 - 0.5 ** (len(rates) - 1)
                lines.append(
                    f"{group}: mean {np.mean(rates):.5f} over {len(rates)} training seeds, about "
                    f"{100 * self.confidence:g} % limits [{low:.5f}, {high:.5f}] (Student); range "
                    f"[{min(rates):.5f}, {max(rates):.5f}], which covers the median training with probability "
                    f"{covers:.4g}"
                )
        return lines

    def _tests(self) -> list[str]:
        """Return a line for every pair of policies."""
        return [
            f"{p.first} against {p.second}: {p.only_first} episodes won by the first alone, {p.only_second} by the "
            f"second alone; exact McNemar p {_shown_p(p.p_value)}, Holm-adjusted p {_shown_p(p.adjusted)}"
            for p in self.pairs
        ]


@names_plan
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
        Syntheses and certificates of this problem, trainings, actors, controllers, models of other libraries and
        paths of files (``as_policy``), decentralised policies in any form
        that ``certify`` takes, objects with ``batch(dynamics)``; or a sequence of these (several training seeds).
    plan, **trial
        Episodes (default 10,000), seed, confidence of the two-sided limits of each policy (.99), chunk, executor,
        progress; see ``TrialPlan``.

    Raises
    ------
    ValueError
        If there is no policy, if one has an unknown form, or if a certificate is about another problem.
    KeyboardInterrupt
        On Ctrl-C: policies can be compared only over the same episodes.

    Examples
    --------
    >>> import certigym as cg
    >>> from certigym.baselines import IdleController
    >>> problem = cg.make_problem("invariance-v0", n_agents=2)
    >>> result = compare(problem, {"centre": lambda x, q, t: -0.5 * x, "idle": IdleController()}, 500)
    >>> [entry.name for entry in result.entries], len(result.pairs)
    (['centre', 'idle'], 1)
    """
    # The names must differ, because pairs and rows are found by them.
    problem, settled = as_problem(problem), planned(plan, trial, 10_000, 0.99)
    contestants = [c for name, policy in policies.items() for c in contestants_of(problem, name, policy)]
    if not contestants:
        raise ValueError("`policies`: expected at least one policy, got none")
    names = [contestant.name for contestant in contestants]
    if len(set(names)) < len(names):
        raise ValueError(f"`policies`: expected names that differ, got {', '.join(names)}")
    # One plan for all: the same seed and chunks give all policies the same starts and noise.
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
    """Return the contestants for which a value of ``policies`` stands: one, or one per element of a sequence."""
    if isinstance(policy, str) and not Path(policy.rpartition("@")[0] or policy).exists():
        raise ValueError(
            f"`policies`: expected a policy, certificate or training for {name!r}, or the path of a file that exists, "
            f"got the text {policy!r}; load certificates from elsewhere with `load`"
        )
    # Several training seeds: one contestant each, which share the name as their group.
    if isinstance(policy, Sequence) and not isinstance(policy, str) and not is_model(policy):
        if len(policy) == 1:
            return contestants_of(problem, name, policy[0])
        members = [contestants_of(problem, name, member)[0] for member in policy]
        seeds = [k if member.seed is None else member.seed for k, member in enumerate(members)]
        return [
            replace(member, group=name, name=f"{name} (seed {seed})")
            for member, seed in zip(members, seeds, strict=True)
        ]
    # A certificate brings its bound along, which holds for its problem only.
    if isinstance(policy, Synthesis | Certificate):
        certificate = certificate_from(policy)
        if certificate.fingerprint != problem.fingerprint:
            raise ValueError(
                f"`policies`: the certificate of {name!r} is about another problem ({certificate.problem.name!r}); "
                "its bound does not hold here, give its controller alone"
            )
        spent = policy.stats["seconds"] if isinstance(policy, Synthesis) else None
        seconds = float(sum(spent.values()) - spent.get("check", 0.0)) if isinstance(spent, dict) else None
        carrier = certificate.controller
        claim = certificate.lower_bound, certificate.gap
        if not (checked := checked_once(certificate)):
            refused = told_claim(shown_bound(*claim), checked)
            return [Contestant(name, name, _information(carrier), carrier, seconds=seconds, refused=refused)]
        return [Contestant(name, name, _information(carrier), carrier, *claim, seconds)]
    if isinstance(policy, Training):
        actor = policy.actor
        return [Contestant(name, name, policy.information, actor, seconds=policy.seconds, seed=policy.seed)]
    # Any other controller is simulated as it is; a decentralised policy becomes one first.
    controller: Any = policy if hasattr(policy, "batch") else as_controller(problem, policy)
    # A policy behind a shield has a bound, whoever proposes.
    kept = controller.kept if isinstance(controller, ShieldedController) else None
    return [Contestant(name, name, _information(controller), controller, kept)]


def mcnemar(only_first: int, only_second: int) -> float:
    """Return the exact two-sided p-value of equal success probabilities.

    Only episodes count in which exactly one policy succeeds. If the probabilities are equal, each of the two policies
    is that one with probability 1/2.

    Examples
    --------
    >>> mcnemar(0, 5), mcnemar(3, 3), mcnemar(0, 0)
    (0.0625, 1.0, 1.0)
    """
    # Twice the smaller tail of a binomial distribution with probability 1/2.
    fewer, total = min(only_first, only_second), only_first + only_second
    return 1.0 if total == 0 else min(1.0, 2.0 * float(p_at_least(fewer, total, 0.5)))


def _shown_p(value: float) -> str:
    """Return a p-value in words; one below the smallest float64 is not shown as 0."""
    return f"= {value:.2g}" if value > 0.0 else "< 1e-300"


def _information(controller: Any) -> str:
    """Return what the agents of a controller see, in words."""
    if isinstance(controller, Controller):
        return f"{LOCAL}, own abstract state" if any(a.is_coupled for a in controller.agents) else LOCAL
    return str(getattr(controller, "information", "not stated"))


def _entry(contestant: Contestant, run: Rollouts, confidence: float) -> Entry:
    """Return the row of a contestant from its rollouts."""
    facts = {name: value for name, value in vars(contestant).items() if name != "controller"}
    rate = run.successes / run.episodes
    low, high = clopper_pearson(run.successes, run.episodes, confidence)
    shown: dict[str, Any] = {"successes": run.successes, "rate": rate, "inadmissible": run.inadmissible}
    return Entry(**facts, **shown, ci_low=low, ci_high=high)


def _pairs(names: Sequence[str], runs: Sequence[Rollouts]) -> tuple[Pair, ...]:
    """Return the tests of all pairs of policies, adjusted together."""
    tests = []
    for a, b in combinations(range(len(runs)), 2):
        only_a = int((runs[a].success & ~runs[b].success).sum())
        only_b = int((runs[b].success & ~runs[a].success).sum())
        tests.append((names[a], names[b], only_a, only_b, mcnemar(only_a, only_b)))
    adjusted = holm([test[-1] for test in tests])
    return tuple(Pair(*test, float(p)) for test, p in zip(tests, adjusted, strict=True))
