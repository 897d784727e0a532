"""Check a certificate against Monte Carlo rollouts of the continuous system."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from ... import __version__
from ...envs.agents import write_json
from ...envs.problem import Problem
from ...synthesis.certificates import (
    EXACT_GAP,
    Certificate,
    ProductCertificate,
    Synthesis,
    as_certificate,
    relations_tried,
    rounded_up,
    shown_bound,
)
from ..simulation import (
    ChunkResult,
    Loop,
    Mismatch,
    TrialOptions,
    TrialPlan,
    collect,
    planned,
    stream,
)
from ..statistics import (
    CONSISTENT,
    REFUTED,
    SequentialState,
    check_confidence,
    clopper_pearson,
    confidence_sequence,
    verdict,
)


@dataclass(frozen=True)
class ValidationReport:
    """A certificate's claim beside what rollouts of its controller show.

    Parameters
    ----------
    problem, horizon, method
        What was certified and how.
    lower_bound : float
        The claim, from the start that was simulated.
    exact : bool
        Whether the probability is claimed to be known to ``EXACT_GAP``.
    gap : float or None
        How far above the bound the probability may be, where that is claimed; then it was tested from above as well.
    episodes, successes : int
    estimate : float
        Share of successes.
    ci_low, ci_high : float
        Exact two-sided limits at ``confidence``.
    confidence : float
    verdict : str
        ``confirmed``, ``consistent`` or ``refuted`` (see ``validation.verdict``).
    rank : int
        Largest number of terms of the value function.
    seconds : dict
        ``abstract``, ``synthesize`` (None if the certificate was loaded) and ``validate``.
    details : dict
        Start, bound, seed, chunk, fingerprint, versions; ``inadmissible`` episodes; whether ``sequential``, with its
        logarithmic e-values; ``mismatch`` and ``interrupted`` where they apply; ``abstract_upper_bound``,
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

    def to_dict(self) -> dict[str, Any]:
        """All fields as JSON values, ``details`` among the others."""
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "details"}
        return {**fields, **self.details}

    def save(self, path: str | Path) -> None:
        """Write ``to_dict()`` as JSON."""
        write_json(path, self.to_dict())

    def __str__(self) -> str:
        claim = shown_bound(self.lower_bound, self.gap)
        times = ", ".join(f"{name} {value:.2f} s" for name, value in self.seconds.items() if value is not None)
        start = {"point": "from the initial state", "mean": "mean over the initial box"}[self.details["start"]]
        above, notes = [], []
        if "abstract_upper_bound" in self.details:
            best = rounded_up(self.details["abstract_upper_bound"])
            text = f"optimum      <= {best} for any policy of these finite models"
            most = self.details.get("continuous_upper_bound")
            above.append(f"{text}, <= {rounded_up(most)} for any whatever" if most is not None and most < 1 else text)
        above += [f"tried        {line}" for line in tried_lines(self.details)]
        if self.details.get("unilateral_gain") is not None:
            gain = self.details["unilateral_gain"]
            above.append(
                f"alone        an agent gains about {gain:.1e} at most by other choices at one step and task state"
            )
        if "mismatch" in self.details:
            notes.append(f"mismatch     {self.details['mismatch']}")
        if self.details.get("inadmissible"):
            notes.append(f"inputs       inadmissible in {self.details['inadmissible']} episodes (they saturated)")
        if self.details.get("interrupted"):
            notes.append("interrupted  this is about the episodes finished by then")
        return "\n".join(
            [
                f"problem      {self.problem}, horizon {self.horizon}, {start}",
                f"method       {self.method} ({self.details['bound']} bound, rank {self.rank})",
                f"certified    {claim}",
                *above,
                f"simulated    {self.successes} of {self.episodes} episodes: {self.estimate:.6f}, "
                f"{100 * self.confidence:g} % limits [{self.ci_low:.6f}, {self.ci_high:.6f}]",
                *notes,
                f"verdict      {self.verdict}{' (sequential)' if self.details.get('sequential') else ''}",
                f"times        {times}",
            ]
        )


def tried_lines(details: dict[str, Any]) -> list[str]:
    """What each relation that was tried gave, in words."""
    tried = details.get("tried", {})
    return [f"{name}: {shown_bound(own, None) if isinstance(own, float) else own}" for name, own in tried.items()]


_ABOUT_SEARCH = ("abstract_upper_bound", "continuous_upper_bound", "unilateral_gain")
"""What reports take from the statistics of a synthesis."""


def validate(
    result: Any,
    plan: TrialPlan | int | None = None,
    *,
    initial_state: Any = None,
    sequential: bool = False,
    mismatch: Mismatch | None = None,
    **trial: Unpack[TrialOptions],
) -> ValidationReport:
    """Test a certified bound with independent rollouts of the continuous system under its own controller.

    A true certificate is refuted with probability at most ``1 - confidence``.

    Parameters
    ----------
    result : Synthesis, Certificate, ProductCertificate or path
    plan, **trial
        Episodes (default 100,000; the most, if ``sequential``), seed, confidence of the two-sided limits (.999), chunk,
        executor, progress; see ``TrialPlan``. After Ctrl-C the report is about the episodes finished by then, a prefix
        in index order.
    initial_state : optional
        Start of the rollouts, as in ``Problem.replace``; the claim is then the certificate's bound there.
    sequential : bool
        Stop at the first episode that confirms or refutes the claim. Verdict and limits come from e-processes, which
        hold at whatever time one stops; the limits are wider than those of a fixed number of episodes.
    mismatch : Mismatch, optional
        Simulate a system that differs from the certified model; only the lower bound is tested then.

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    began = time.perf_counter()
    settled = planned(plan, trial, 100_000)
    check_confidence(settled.confidence)
    certificate = as_certificate(result)
    problem, lower, gap, start = claim_at(certificate, initial_state)
    gap = gap if mismatch is None else None  # of another system nobody claims an upper bound
    loop = Loop(problem, certificate.controller, settled.seed, settled.chunk, mismatch=mismatch)
    state, inadmissible = SequentialState(lower, gap, settled.confidence), 0

    def take(part: ChunkResult) -> bool:
        nonlocal state, inadmissible
        state = state.advance(part.success) if sequential else state.add(part.success)
        inadmissible += part.inadmissible
        settled.tell(len(part.success))
        return state.verdict != CONSISTENT

    interrupted = collect(stream(loop, settled.episodes, settled.executor), take)
    limits = confidence_sequence if sequential else clopper_pearson
    ci_low, ci_high = limits(state.successes, state.episodes, settled.confidence)
    details = _details(certificate, start, settled) | {"inadmissible": inadmissible, "sequential": sequential}
    if sequential:
        details |= {"log_e_refuted": _finite(state.log_refuted), "log_e_confirmed": _finite(state.log_confirmed)}
    if mismatch is not None:
        details["mismatch"] = str(mismatch)
    if interrupted:
        details["interrupted"] = True
    seconds: dict[str, float | None] = {"abstract": None, "synthesize": None}
    if initial_state is None and (tried := relations_tried(certificate)):
        details["tried"] = tried
    if isinstance(result, Synthesis):
        seconds = dict(result.stats["seconds"])  # type: ignore[call-overload]
        if initial_state is None:
            details |= {name: result.stats[name] for name in _ABOUT_SEARCH if name in result.stats}
    return ValidationReport(
        problem=problem.name,
        horizon=problem.horizon,
        method=certificate.method,
        lower_bound=lower,
        exact=gap is not None and gap <= EXACT_GAP,
        gap=gap,
        episodes=state.episodes,
        successes=state.successes,
        estimate=state.successes / state.episodes,
        ci_low=ci_low,
        ci_high=ci_high,
        confidence=settled.confidence,
        verdict=state.verdict if sequential else verdict(lower, gap, ci_low, ci_high),
        rank=certificate.rank,
        seconds={**seconds, "validate": time.perf_counter() - began},
        details=details,
    )


def claim_at(
    certificate: Certificate | ProductCertificate, initial_state: Any = None
) -> tuple[Problem, float, float | None, str]:
    """Problem with the start, lower bound there, how far above it the probability may be, and ``point`` or ``mean``."""
    problem = certificate.problem
    if initial_state is None:
        return problem, certificate.lower_bound, certificate.gap, certificate.start
    problem = problem.replace(initial_state=initial_state)
    joint = np.concatenate([agent.initial.low for agent in problem.agents])
    return problem, float(certificate.at(joint)[0]), None, "point"


def _finite(value: float) -> float:
    return float(min(max(value, -1e6), 1e6))


def _details(certificate: Certificate | ProductCertificate, start: str, plan: TrialPlan) -> dict[str, Any]:
    """What a report says of the claim, the random record and the versions."""
    return {
        "start": start,
        "bound": certificate.bound,
        "fingerprint": certificate.fingerprint,
        "settings": certificate.settings,
        "seed": plan.seed,
        "chunk": plan.chunk,
        "certigym": __version__,
        "numpy": np.__version__,
    }
