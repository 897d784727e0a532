"""Check a certificate against Monte Carlo rollouts of the continuous system."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...envs.problem import Problem
from ...synthesis.certificates import (
    EXACT_GAP,
    Certificate,
    ProductCertificate,
    Synthesis,
    checked_certificate,
    relations_tried,
    rounded_up,
    shown_bound,
)
from ..simulation import CHUNK, Executor, Loop, Mismatch, interrupts_at_checkpoints, stream
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
    def refuted(self) -> bool:
        """Whether the rollouts contradict the claim."""
        return self.verdict == REFUTED

    def to_dict(self) -> dict[str, Any]:
        """All fields as JSON values, ``details`` among the others."""
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "details"}
        return {**fields, **self.details}

    def save(self, path: str | Path) -> None:
        """Write ``to_dict()`` as JSON."""
        Path(path).write_text(json.dumps(self.to_dict(), indent=2, allow_nan=False) + "\n", encoding="utf-8")

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


class ValidationInterrupted(KeyboardInterrupt):
    """The rollouts were interrupted; ``report`` is about the episodes finished by then, a prefix in index order."""

    def __init__(self, report: ValidationReport) -> None:
        super().__init__(f"interrupted after {report.episodes} episodes")
        self.report = report


def validate(
    result: Synthesis | Certificate | ProductCertificate,
    episodes: int = 100_000,
    seed: int = 0,
    *,
    confidence: float = 0.999,
    initial_state: Any = None,
    chunk: int = CHUNK,
    sequential: bool = False,
    mismatch: Mismatch | None = None,
    executor: Executor | None = None,
    progress: Callable[[int], None] | None = None,
) -> ValidationReport:
    """Test a certified bound with independent rollouts of the continuous system under its own controller.

    Parameters
    ----------
    result : Synthesis, Certificate or ProductCertificate
    episodes : int
        The most, if ``sequential``.
    seed : int
    confidence : float
        Of the two-sided limits; a true certificate is refuted with probability at most ``1 - confidence``.
    initial_state : optional
        Start of the rollouts, as in ``Problem.replace``; the claim is then the certificate's bound there.
    chunk : int
        Worlds per chunk of the simulation; part of the random record.
    sequential : bool
        Stop at the first episode that confirms or refutes the claim. Verdict and limits come from e-processes, which
        hold at whatever time one stops; the limits are wider than those of a fixed number of episodes.
    mismatch : Mismatch, optional
        Simulate a system that differs from the certified model; only the lower bound is tested then.
    executor : Executor, optional
        Where chunks are computed; the report is the same for any.
    progress : callable, optional
        Called with the number of episodes finished.

    Raises
    ------
    ValueError
        If a number is out of range.
    ValidationInterrupted
        On Ctrl-C, with the report so far, if at least one chunk was finished.
    """
    began = time.perf_counter()
    check_confidence(confidence)
    certificate = result.certificate if isinstance(result, Synthesis) else result
    if not isinstance(certificate, ProductCertificate):
        checked_certificate(certificate)
    problem, lower, gap, start = claim_at(certificate, initial_state)
    gap = gap if mismatch is None else None  # of another system nobody claims an upper bound
    loop = Loop(problem, certificate.controller, seed, chunk, mismatch=mismatch)
    state, inadmissible, interrupted = SequentialState(lower, gap, confidence), 0, False
    chunks = stream(loop, episodes, executor)
    try:
        with interrupts_at_checkpoints() as checkpoint:
            for part in chunks:
                state = state.advance(part.success) if sequential else state.add(part.success)
                inadmissible += part.inadmissible
                if progress is not None:
                    progress(len(part.success))
                if state.verdict != CONSISTENT:
                    break
                checkpoint()
    except KeyboardInterrupt:
        if state.episodes == 0:
            raise
        interrupted = True
    finally:
        chunks.close()
    limits = confidence_sequence if sequential else clopper_pearson
    ci_low, ci_high = limits(state.successes, state.episodes, confidence)
    details = _details(certificate, start, seed, chunk) | {"inadmissible": inadmissible, "sequential": sequential}
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
    report = ValidationReport(
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
        confidence=confidence,
        verdict=state.verdict if sequential else verdict(lower, gap, ci_low, ci_high),
        rank=certificate.rank,
        seconds={**seconds, "validate": time.perf_counter() - began},
        details=details,
    )
    if interrupted:
        raise ValidationInterrupted(report)
    return report


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


def _details(certificate: Certificate | ProductCertificate, start: str, seed: int, chunk: int) -> dict[str, Any]:
    from ... import __version__

    return {
        "start": start,
        "bound": certificate.bound,
        "fingerprint": certificate.fingerprint,
        "settings": certificate.settings,
        "seed": seed,
        "chunk": chunk,
        "certigym": __version__,
        "numpy": np.__version__,
    }
