"""Check a certificate against Monte Carlo rollouts of the continuous system."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..synthesis.certificate import Certificate
from ..synthesis.synthesize import Synthesis
from .rollout import CHUNK, rollout
from .verdict import REFUTED, clopper_pearson, verdict


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
        Whether the claim was tested from above as well.
    gap : float or None
        Width of an exact claim.
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
        Start, bound, seed, chunk, fingerprint, version.
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
        return "\n".join(
            [
                f"problem      {self.problem}, horizon {self.horizon}, {start}",
                f"method       {self.method} ({self.details['bound']} bound, rank {self.rank})",
                f"certified    {claim}",
                f"simulated    {self.successes} of {self.episodes} episodes: {self.estimate:.6f}, "
                f"{100 * self.confidence:g} % limits [{self.ci_low:.6f}, {self.ci_high:.6f}]",
                f"verdict      {self.verdict}",
                f"times        {times}",
            ]
        )


def shown_bound(lower: float, gap: float | None) -> str:
    """A bound in words, its digits rounded down so that what is printed holds too."""
    digits = max(6, 3 - math.floor(math.log10(min(lower, 1.0 - lower))) if 1e-12 < lower < 1.0 - 1e-12 else 12)
    shown = math.floor(lower * 10**digits) / 10**digits
    claim = f"P >= {shown:.{digits}f}" if lower == 0 or lower > 1e-12 else f"P >= {lower:.3g}"
    return claim if gap is None else f"{claim} (exact to {gap:.1e})"


def validate(
    result: Synthesis | Certificate,
    episodes: int = 100_000,
    seed: int = 0,
    *,
    confidence: float = 0.999,
    initial_state: Any = None,
    chunk: int = CHUNK,
    progress: Callable[[int], None] | None = None,
) -> ValidationReport:
    """Test a certified bound with independent rollouts of the continuous system under its own controller.

    Parameters
    ----------
    result : Synthesis or Certificate
    episodes : int
    seed : int
    confidence : float
        Of the two-sided limits; a true certificate is refuted with probability at most ``1 - confidence``.
    initial_state : optional
        Start of the rollouts, as in ``Problem.replace``; the claim is then the certificate's bound there.
    chunk : int
        Worlds per chunk of the simulation; part of the random record.
    progress : callable, optional
        Called with the number of episodes finished.
    """
    certificate = result.certificate if isinstance(result, Synthesis) else result
    synthesis_seconds: dict[str, float | None] = {"abstract": None, "synthesize": None}
    if isinstance(result, Synthesis):
        synthesis_seconds = dict(result.stats["seconds"])  # type: ignore[call-overload]
    began = time.perf_counter()
    clopper_pearson(0, 1, confidence)
    lower, gap, start = certificate.lower_bound, certificate.gap if certificate.exact else None, certificate.start
    problem = certificate.problem
    if initial_state is not None:
        problem = problem.replace(initial_state=initial_state)
        joint = np.concatenate([agent.initial.low for agent in problem.agents])
        lower, gap, start = float(certificate.at(joint)[0]), None, "point"
    runs = rollout(problem, certificate.controller, episodes, seed, chunk=chunk, progress=progress)
    ci_low, ci_high = clopper_pearson(runs.successes, runs.episodes, confidence)
    seconds = {**synthesis_seconds, "validate": time.perf_counter() - began}
    return ValidationReport(
        problem=problem.name,
        horizon=problem.horizon,
        method=certificate.method,
        lower_bound=lower,
        exact=gap is not None,
        gap=gap,
        episodes=runs.episodes,
        successes=runs.successes,
        estimate=runs.successes / runs.episodes,
        ci_low=ci_low,
        ci_high=ci_high,
        confidence=confidence,
        verdict=verdict(lower, gap, ci_low, ci_high),
        rank=certificate.rank,
        seconds=seconds,
        details=_details(certificate, start, runs.seed, runs.chunk),
    )


def _details(certificate: Certificate, start: str, seed: int, chunk: int) -> dict[str, Any]:
    from .. import __version__

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
