"""Test a certificate by Monte Carlo rollouts of the continuous system."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, field, replace
from typing import Any, Unpack

import numpy as np

from ... import __version__
from ...envs.simulation import BEHAVIOURS, Behaviour, checked_behaviour
from ...envs.systems.arguments import counted, shortened
from ...envs.tasks.problem import Problem
from ...synthesis.certificates.proofs import (
    EXACT_GAP,
    Certificate,
    CheckReport,
    Synthesis,
    VertexProof,
    certificate_from,
    on_cells,
    relations_tried,
    rounded_up,
    shown_bound,
    start_of_claim,
    told_assumed,
    why_nothing,
)
from ...synthesis.extended_check.claims import greedy_disturbance
from .binomial import CONFIRMED, CONSISTENT, REFUTED, VACUOUS, check_confidence, clopper_pearson, verdict
from .chunks import ChunkResult
from .loop import Loop
from .mismatch import Mismatch
from .report_text import INTERRUPTED, Rows, Saved, html_table, labelled_lines
from .rollouts import stream
from .sequential import SequentialState, confidence_sequence
from .trials import Plan, TrialOptions, TrialPlan, collect, names_plan, planned

MEANINGS = {
    CONFIRMED: "such rollouts would be unlikely if the claim were false",
    CONSISTENT: "the rollouts neither confirm nor refute the claim",
    REFUTED: "such rollouts would be unlikely if the claim were true",
    VACUOUS: "the certificate promises P >= 0, which says nothing",
}
"""What each verdict says."""

IN_SHORT = ("invalid", "method", "why", "mismatch", "disturbance", "inputs", "interrupted", "advice")
"""Labels of the lines of a report in short, beside the problem, and the verdict where it refutes."""

STARTS = {"point": "from the initial state", "mean": "mean over the initial box"}
"""The start that a bound speaks of, in words."""

PASSED_OVER = re.compile(r"at most (\S+), not computed")
"""How a certificate says that the bound from above of a relation is too small for a search to pay."""

GIVEN_UP = re.compile(r"(\S+) after one sweep, not gone on with")
"""How a certificate says that the search under a relation ended after its first sweep."""

MOST_WORDS = 100
"""Characters that are printed of the reason why a relation does not apply."""

FAR = 0.02
"""Distance from the bound to the rollouts' limits above which a report gives advice."""

NOT_CERTIFIED = "the certificate fails its check, and nothing is certified"
"""The headline of everything that is said about a certificate that its check refuses."""

CHECKED = "valid: separate code computed the claim again"
"""What a check that holds says."""

NEGLIGIBLE = 1e-12
"""Gain below which a report says 0: far below what is lost to rounding."""

LARGEST_LOG_E = 1e6
"""Stands for an infinite logarithmic e-value, which JSON does not have."""


@dataclass(frozen=True, repr=False)
class ValidationReport(Saved):
    """A certificate's claim beside what rollouts of its controller show.

    Parameters
    ----------
    problem, horizon, method
        What was certified and how.
    lower_bound : float
        The claim, from the start that was simulated.
    exact : bool
        Whether the certificate claims to know the probability up to ``EXACT_GAP``.
    gap : float or None
        How far above the bound the probability may be, if the certificate claims that; then both ends were tested.
    episodes, successes : int
    estimate : float
        Share of successes.
    ci_low, ci_high : float
        Exact two-sided limits at ``confidence``.
    confidence : float
    verdict : str
        ``confirmed``, ``consistent``, ``vacuous`` or ``refuted`` (see ``validation.statistics.verdict``).
    rank : int
        Largest number of terms of the value function.
    seconds : dict
        ``abstract``, ``synthesize`` (None if the certificate was loaded) and ``validate``.
    details : dict
        Start, bound, seed, chunk, fingerprint, versions; ``inadmissible`` episodes; whether ``sequential``, with its
        logarithmic e-values; ``mismatch`` and ``interrupted`` if they apply; ``check``, if one was made: whether it is
        ``valid``, and its ``failures``; ``abstract_upper_bound``,
        ``continuous_upper_bound``, ``unilateral_gain`` and ``tried`` of a synthesis (see ``synthesize``).
    """

    problem: str
    horizon: int
    method: str
    lower_bound: float
    exact: bool
    gap: float | None
    episodes: int
    successes: int
    estimate: float
    ci_low: float
    ci_high: float
    confidence: float
    verdict: str
    rank: int
    seconds: dict[str, float | None]
    details: dict[str, Any] = field(default_factory=dict)

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the rollouts early."""
        return bool(self.details.get("interrupted", False))

    @property
    def refuted(self) -> bool:
        """Whether the rollouts contradict the claim."""
        return self.verdict == REFUTED

    @property
    def is_invalid(self) -> bool:
        """Whether the certificate failed its check, if one was made: then nothing is certified."""
        return not self.details.get("check", {"valid": True})["valid"]

    def with_check(self, outcome: CheckReport) -> ValidationReport:
        """Return the report with what the check of the certificate says; a failed one becomes its headline."""
        return replace(self, details={**self.details, "check": told_of(outcome)})

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as JSON values, those of ``details`` beside the others."""
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "details"}
        return {**fields, **self.details}

    def __str__(self) -> str:
        return labelled_lines([("problem", self._title()), *self._rows()])

    @property
    def in_short(self) -> str:
        """What was certified and how, and what there is to do about it: lines for the terminal."""
        labels = (*IN_SHORT, *(["verdict"] if self.refuted else []))
        rows = [(label, text) for label, text in self._rows() if label in labels]
        return labelled_lines([("problem", self._title()), *rows])

    def __repr__(self) -> str:
        rows = [(label, text) for label, text in self._rows() if label not in ("tried", "times")]
        return labelled_lines([("problem", self._title()), *rows])

    def _repr_html_(self) -> str:
        return html_table(self._title(), self._rows())

    def _title(self) -> str:
        """Return what was certified, and from which start."""
        return f"{self.problem}, horizon {self.horizon}, {STARTS[self.details['start']]}"

    def _rows(self) -> Rows:
        """Return the claim, what limits it, what the rollouts show and the verdict, by label."""
        details = self.details
        # What was proved, what is known about better policies, what rollouts show, and what follows from them.
        limits = f"{100 * self.confidence:g} % limits [{self.ci_low:.6f}, {self.ci_high:.6f}]"
        how = ", tested after every episode" if details.get("sequential") else ""
        times = ", ".join(f"{name} {value:.2f} s" for name, value in self.seconds.items() if value is not None)
        simulated = f"{self.successes} of {self.episodes} episodes satisfied the task: {self.estimate:.6f}, {limits}"
        rows = [
            *([("invalid", f"{NOT_CERTIFIED}: {'; '.join(details['check']['failures'])}")] if self.is_invalid else []),
            ("method", f"{self.method} ({details['bound']} bound, rank {self.rank})"),
            ("claimed" if self.is_invalid else "certified", self._claim()),
            *([("why", why)] if (why := details.get("nothing")) else []),
            *self._limits_of_search(),
            ("simulated", simulated),
        ]
        if "mismatch" in details:
            rows.append(("mismatch", f"the simulated system differs from the model: {details['mismatch']}"))
        if "disturbance" in details:
            told = ", ".join(f"{name} {value:.4f}" for name, value in details.get("disturbances", {}).items())
            rows.append(("disturbance", f"{details['disturbance']}" + (f" is the worst of {told}" if told else "")))
        if inadmissible := details.get("inadmissible"):
            rows.append(("inputs", f"inadmissible in {counted(inadmissible, 'episode')}; there actuators saturated"))
        if self.interrupted:
            rows.append(("interrupted", INTERRUPTED))
        if "check" in details:
            holds = CHECKED + told_assumed(tuple(details["check"].get("assumed", ())))
            rows.append(("check", "failed, see above" if self.is_invalid else holds))
        word = f"invalid; the rollouts alone: {self.verdict}" if self.is_invalid else self.verdict
        rows.append(("verdict", f"{word}{how}: {MEANINGS[self.verdict]}"))
        return [*rows, *self._advice(), ("times", times)]

    def _claim(self) -> str:
        """Return the bound in words; one of 0 is none."""
        shown = shown_bound(self.lower_bound, self.gap)
        return shown if self.lower_bound > 0.0 else f"nothing: {shown}"

    def _advice(self) -> Rows:
        """Return what to try where the rollouts lie far above the bound; nothing elsewhere."""
        loose = self.ci_low - self.lower_bound
        if loose < FAR or self.gap is not None or self.refuted or self.is_invalid or not self.details["has_cells"]:
            return []
        less = f"rollouts lie at least {loose:.2g} above the bound: the cells lose this, not the task"
        return [("advice", f"{less}; try a larger --effort, or more --cells")]

    def _limits_of_search(self) -> Rows:
        """Return what no policy exceeds, what each relation gave, and what one agent alone could gain."""
        most, anywhere = self.details.get("abstract_upper_bound"), self.details.get("continuous_upper_bound")
        gain, rows = self.details.get("unilateral_gain"), []
        if most is not None:
            rows.append(("these models", f"no policy of these finite models does better than {rounded_up(most)}"))
        if most is not None and anywhere is not None and anywhere < 1:
            rows.append(("any policy", f"no policy of the continuous system does better than {rounded_up(anywhere)}"))
        rows += [("tried", line) for line in tried_lines(self.details)]
        if gain is not None:
            shown = gain if gain >= NEGLIGIBLE else 0.0
            rows.append(("alone", f"no single agent can gain more than about {shown:.2g} by changing one step"))
        return rows


def told_of(outcome: CheckReport) -> dict[str, Any]:
    """Return what a check says as JSON values."""
    assumed = {"assumed": list(outcome.assumed)} if outcome.assumed else {}
    return {"valid": outcome.valid, "failures": list(outcome.failures), **assumed}


def tried_lines(details: dict[str, Any]) -> list[str]:
    """Return what each relation that was tried gave, in words; nothing if there is no choice to report.

    Relations of which nothing is known but that their bound is at most 1 are left out.
    """
    tried: dict[str, float | str] = details.get("tried", {})
    told = {name: outcome for name, outcome in tried.items() if _limit_of(outcome) != 1.0}
    return [f"{name}: {_outcome_text(outcome)}" for name, outcome in told.items()] if len(told) > 1 else []


def _limit_of(outcome: float | str) -> float | None:
    """Return the bound from above for which a relation was passed over; None if it was not."""
    passed = None if isinstance(outcome, float) else PASSED_OVER.fullmatch(outcome)
    return None if passed is None else float(passed[1])


def _outcome_text(outcome: float | str) -> str:
    """Return the bound that a relation gave, or in short why there is none."""
    if isinstance(outcome, float):
        return shown_bound(outcome, None)
    if passed := PASSED_OVER.fullmatch(outcome):
        return f"passed over, it certifies at most {passed[1]}"
    if given_up := GIVEN_UP.fullmatch(outcome):
        return f"given up after one sweep, which reached {given_up[1]}"
    return shortened(outcome, MOST_WORDS)


_ABOUT_SEARCH = ("abstract_upper_bound", "continuous_upper_bound", "unilateral_gain", "nothing")
"""Statistics of a synthesis that a report repeats."""


@names_plan
def validate(
    result: Any,
    plan: TrialPlan | int | None = None,
    *,
    initial_state: Any = None,
    sequential: bool = False,
    mismatch: Mismatch | None = None,
    disturbance: Behaviour | None = None,
    **trial: Unpack[TrialOptions],
) -> ValidationReport:
    """Test a certified bound with independent rollouts of the continuous system under the certificate's controller.

    A true certificate is refuted with probability at most ``1 - confidence``. Where agents have bounded disturbances,
    each of their behaviours is simulated for as many episodes, and the report is about the worst: the first that
    refutes the claim, else that with the fewest successes. Then no claim is called confirmed, since another behaviour
    might do worse.

    Parameters
    ----------
    result : Synthesis, Certificate or path
    plan, **trial
        Episodes (default 100,000; if ``sequential``, the largest number), seed, confidence of the two-sided limits
        (.999), chunk, executor, progress; see ``TrialPlan``. After Ctrl-C the report is about the episodes finished by
        then, a prefix in index order.
    initial_state : optional
        Start of the rollouts, as in ``Problem.replace``; the claim is then the certificate's bound there. A set of
        starts needs one, a (d,) array.
    sequential : bool
        Stop at the first episode that confirms or refutes the claim. Verdict and limits then come from e-processes,
        which hold whenever one stops; the limits are wider than those of a fixed number of episodes.
    mismatch : Mismatch, optional
        Simulate a system that differs from the certified model; then only the lower bound is tested.
    disturbance : "zero", "random", "periodic", "greedy" or a function, optional
        The one behaviour of bounded disturbances that is simulated. By default all that have a name, and for
        certificates of one task the greedy one (``claims.greedy``), each with its share of ``1 - confidence``.

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    settled = planned(plan, trial, 100_000)
    check_confidence(settled.confidence)
    certificate = certificate_from(result)
    behaviours = _behaviours(certificate)
    if disturbance is not None:
        # "greedy" needs a certificate to play against; the other names are those of the dynamics
        name = _name(disturbance)
        if name == "greedy" and len(behaviours) == 1:
            raise ValueError("`disturbance`: expected a problem with bounded disturbances, got one without any")
        behaviours = {name: behaviours[name] if disturbance in behaviours else disturbance}
    if len(behaviours) == 1:
        how = _Trial(initial_state, sequential, mismatch, *next(iter(behaviours.items())))
        return _validated(result, certificate, settled, how)
    # A true certificate is to stand all behaviours together with the probability that is asked for.
    shared = replace(settled, confidence=1.0 - (1.0 - settled.confidence) / len(behaviours))
    reports = []
    for name, behaviour in behaviours.items():
        reports.append(
            _validated(result, certificate, shared, _Trial(initial_state, sequential, mismatch, name, behaviour))
        )
        if reports[-1].refuted or reports[-1].interrupted:
            break
    worst = min(reports, key=lambda report: (not report.refuted, report.estimate))
    estimates = {report.details["disturbance"]: report.estimate for report in reports}
    return replace(worst, details={**worst.details, "disturbances": estimates})


@dataclass(frozen=True)
class _Trial:
    """How one validation is simulated."""

    initial_state: Any
    sequential: bool
    mismatch: Mismatch | None
    name: str
    disturbance: Behaviour


def _behaviours(certificate: Certificate) -> dict[str, Behaviour]:
    """Return all behaviours of disturbances that are simulated, by name; one if there are no disturbances."""
    agents = certificate.problem.agents
    if not any(agent.disturbances for agent in agents):
        return {"zero": "zero"}
    named: dict[str, Behaviour] = {name: name for name in BEHAVIOURS}
    if on_cells(certificate) is certificate or isinstance(certificate.proof, VertexProof):
        named["greedy"] = greedy_disturbance(certificate)
    return named


def _name(behaviour: Behaviour) -> str:
    return behaviour if isinstance(behaviour, str) else type(behaviour).__name__.lower()


def _validated(result: Any, certificate: Certificate, settled: Plan, how: _Trial) -> ValidationReport:
    """Test a claim under one behaviour of disturbances."""
    began = time.perf_counter()
    initial_state, sequential, mismatch = how.initial_state, how.sequential, how.mismatch
    problem, lower, gap, start = claim_at(certificate, initial_state)
    gap = gap if mismatch is None else None  # the upper end of a claim holds for the model alone
    behaviour = checked_behaviour(how.disturbance)
    loop = Loop(problem, certificate.controller, settled.seed, settled.chunk, mismatch=mismatch, disturbance=behaviour)
    state, inadmissible = SequentialState(lower, gap, settled.confidence), 0

    def take(result_of_chunk: ChunkResult) -> bool:
        nonlocal state, inadmissible
        state = state.advance(result_of_chunk.success) if sequential else state.add(result_of_chunk.success)
        inadmissible += result_of_chunk.inadmissible
        settled.tell(len(result_of_chunk.success))
        return state.verdict != CONSISTENT

    # Limits after a stop that depends on the outcomes must hold at all times together.
    interrupted = collect(stream(loop, settled.episodes, settled.executor), take)
    limits = confidence_sequence if sequential else clopper_pearson
    ci_low, ci_high = limits(state.successes, state.episodes, settled.confidence)
    details = _details(certificate, start, settled) | {"inadmissible": inadmissible, "sequential": sequential}
    if sequential:
        details |= {"log_e_refuted": _finite(state.log_refuted), "log_e_confirmed": _finite(state.log_confirmed)}
    if any(agent.disturbances for agent in problem.agents):
        details["disturbance"] = how.name
    if mismatch is not None:
        details["mismatch"] = str(mismatch)
    if interrupted:
        details["interrupted"] = True
    if initial_state is None:  # the search was about the problem's start, not about any other
        details |= _facts_of_search(result, certificate)
    seconds: dict[str, float | None] = {"abstract": None, "synthesize": None}
    if isinstance(result, Synthesis):
        seconds = dict(result.stats["seconds"])  # type: ignore[call-overload]
        if result.checked is not None:
            details["check"] = told_of(result.checked)
    found = state.verdict if sequential else verdict(lower, gap, ci_low, ci_high)
    if lower <= 0.0 and found == CONSISTENT:
        found = VACUOUS  # its upper end was tested in vain
    if "disturbance" in details and found == CONFIRMED:
        found = CONSISTENT  # another behaviour might do worse
    return ValidationReport(
        problem=problem.name,
        horizon=problem.horizon,
        method=certificate.proof.method,
        lower_bound=lower,
        exact=gap is not None and gap <= EXACT_GAP,
        gap=gap,
        episodes=state.episodes,
        successes=state.successes,
        estimate=state.successes / state.episodes,
        ci_low=ci_low,
        ci_high=ci_high,
        confidence=settled.confidence,
        verdict=found,
        rank=certificate.proof.rank,
        seconds={**seconds, "validate": time.perf_counter() - began},
        details=details,
    )


def claim_at(certificate: Certificate, initial_state: Any = None) -> tuple[Problem, float, float | None, str]:
    """Return the problem with this start, the lower bound there, its ``gap`` (or None), and ``point`` or ``mean``."""
    problem = certificate.problem
    if initial_state is None:
        return problem, certificate.lower_bound, certificate.gap, start_of_claim(certificate)
    # At another start the certificate claims its value there, and no upper end.
    problem = problem.replace(initial_state=initial_state)
    joint = np.concatenate([agent.initial.low for agent in problem.agents])
    return problem, float(certificate.at(joint)[0]), None, "point"


def _facts_of_search(result: Any, certificate: Certificate) -> dict[str, Any]:
    """Return what a certificate, or a synthesis if there is one, tells about the search that made it."""
    tried = relations_tried(certificate)
    facts: dict[str, Any] = {"tried": tried} if tried else {}
    facts |= {"nothing": why} if (why := why_nothing(certificate)) else {}
    if isinstance(result, Synthesis):
        facts |= {name: result.stats[name] for name in _ABOUT_SEARCH if name in result.stats}
    return facts


def _finite(value: float) -> float:
    """Return a number that JSON can hold."""
    return float(min(max(value, -LARGEST_LOG_E), LARGEST_LOG_E))


def _details(certificate: Certificate, start: str, plan: TrialPlan) -> dict[str, Any]:
    """Return what a report says about the claim, the random record and the versions."""
    return {
        "start": start,
        "bound": certificate.proof.bound,
        "has_cells": certificate.proof.has_cells,
        "fingerprint": certificate.fingerprint,
        "settings": certificate.settings,
        "seed": plan.seed,
        "chunk": plan.chunk,
        "certigym": __version__,
        "numpy": np.__version__,
    }
