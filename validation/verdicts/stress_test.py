"""How far a bound survives when the system is not the model: rollouts under a ladder of mismatches.

Every rung is tested as a claim of its own, ``P_mismatch >= lower_bound``, Holm-adjusted over all rungs. Nothing of this
is certified: a bound speaks of its model, and a rung says what rollouts show where the model is wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

from ...envs.agents import write_json
from ...synthesis.certificates import as_certificate, rounded_down
from ..simulation import FAMILIES, Mismatch, TrialOptions, TrialPlan, planned, rollout
from ..statistics import CONFIRMED, CONSISTENT, REFUTED, check_confidence, clopper_pearson, holm, p_at_least, p_at_most
from .success_rate import claim_at

LADDERS: dict[str, tuple[Mismatch, ...]] = {
    "noise scale": tuple(Mismatch(noise_scale=s) for s in (1.05, 1.1, 1.2, 1.35, 1.5, 2.0)),
    "noise family": tuple(Mismatch(noise_family=family) for family in FAMILIES[1:]),
    "actuator bias up": tuple(Mismatch(actuator_bias=b) for b in (0.02, 0.05, 0.1, 0.2, 0.4)),
    "actuator bias down": tuple(Mismatch(actuator_bias=-b) for b in (0.02, 0.05, 0.1, 0.2, 0.4)),
    "delay": tuple(Mismatch(delay=d) for d in (1, 2, 3)),
    "dropout": tuple(Mismatch(dropout=p) for p in (0.02, 0.05, 0.1, 0.2, 0.4)),
}
"""Rungs from mild to severe (noise families in no order)."""


@dataclass(frozen=True)
class Rung:
    """One mismatch and what rollouts under it show.

    Parameters
    ----------
    ladder : str
    mismatch : Mismatch
    estimate, ci_low, ci_high : float
        Share of successes and its exact limits, for itself.
    verdict : str
        On the nominal bound, all rungs tested together.
    """

    ladder: str
    mismatch: Mismatch
    estimate: float
    ci_low: float
    ci_high: float
    verdict: str


@dataclass(frozen=True)
class StressReport:
    """The bound under every mismatch.

    Parameters
    ----------
    problem, horizon, lower_bound, episodes, seed, confidence
        What was run; ``episodes`` per rung, on common random numbers.
    nominal : float
        Share of successes without mismatch.
    rungs : tuple of Rung
    interrupted : bool
        Whether Ctrl-C kept some rungs from being run.
    """

    problem: str
    horizon: int
    lower_bound: float
    episodes: int
    seed: int
    confidence: float
    nominal: float
    rungs: tuple[Rung, ...]
    interrupted: bool = False

    def survives(self, ladder: str) -> Mismatch | None:
        """The last rung before the first that refutes the bound; None if that is the mildest one."""
        last = None
        for rung in self.rungs:
            if rung.ladder == ladder:
                if rung.verdict == REFUTED:
                    break
                last = rung.mismatch
        return last

    def to_dict(self) -> dict[str, Any]:
        """Everything as JSON values."""
        plain = ("problem", "horizon", "lower_bound", "episodes", "seed", "confidence", "nominal", "interrupted")
        ladders = dict.fromkeys(rung.ladder for rung in self.rungs)
        survived = {name: self.survives(name) for name in ladders}
        return {
            **{name: getattr(self, name) for name in plain},
            "survives": {name: None if m is None else str(m) for name, m in survived.items()},
            "rungs": [{**vars(rung), "mismatch": vars(rung.mismatch)} for rung in self.rungs],
        }

    def save(self, path: str | Path) -> None:
        """Write ``to_dict()`` as JSON."""
        write_json(path, self.to_dict())

    def __str__(self) -> str:
        lines = [
            f"stress       {self.problem}, horizon {self.horizon}, {self.episodes} episodes per mismatch",
            f"certified    P >= {rounded_down(self.lower_bound)} for the model; "
            f"simulated without mismatch {self.nominal:.6f}",
        ]
        for rung in self.rungs:
            limits = f"[{rung.ci_low:.6f}, {rung.ci_high:.6f}]"
            lines.append(f"  {rung.mismatch!s:<24} {rung.estimate:.6f} {limits}  {rung.verdict}")
        for name in dict.fromkeys(rung.ladder for rung in self.rungs):
            lines.append(f"not refuted  {name}: {self.survives(name) or 'at no rung'}")
        return "\n".join(lines)


def stress(
    certificate: Any,
    plan: TrialPlan | int | None = None,
    *,
    ladders: Mapping[str, Sequence[Mismatch]] | None = None,
    initial_state: Any = None,
    **trial: Unpack[TrialOptions],
) -> StressReport:
    """Test the nominal bound under mismatches; see the module for what the verdicts mean.

    Parameters
    ----------
    certificate : Synthesis, Certificate, ProductCertificate or path
    plan, **trial
        Episodes per mismatch (default 20,000), seed, confidence (.999), chunk, executor, progress; see ``TrialPlan``.
        After Ctrl-C the report is about the rungs that were finished.
    ladders : mapping from str to sequence of Mismatch, optional
        From mild to severe; default: ``LADDERS``.
    initial_state : optional
        As in ``validate``.
    """
    settled = planned(plan, trial, 20_000)
    check_confidence(settled.confidence)
    certificate, episodes = as_certificate(certificate), settled.episodes
    problem, lower, _, _ = claim_at(certificate, initial_state)
    pairs = [(name, rung) for name, rungs in (LADDERS if ladders is None else ladders).items() for rung in rungs]
    counts: list[int] = []
    try:
        for mismatch in (None, *(rung for _, rung in pairs)):
            counts.append(rollout(problem, certificate.controller, settled, mismatch=mismatch).successes)
    except KeyboardInterrupt:
        if len(counts) < 2:
            raise
    interrupted = len(counts) <= len(pairs)
    pairs = pairs[: len(counts) - 1]
    against = holm(p_at_least(counts[1:], episodes, lower))
    in_favour = holm(p_at_most(counts[1:], episodes, lower))
    level = 0.5 * (1.0 - settled.confidence)
    rungs = []
    for (name, rung), k, p, opposite in zip(pairs, counts[1:], against, in_favour, strict=True):
        verdict = REFUTED if p <= level else CONFIRMED if opposite <= level or lower <= 0.0 else CONSISTENT
        rungs.append(Rung(name, rung, k / episodes, *clopper_pearson(k, episodes, settled.confidence), verdict))
    return StressReport(
        problem=problem.name,
        horizon=problem.horizon,
        lower_bound=lower,
        episodes=episodes,
        seed=settled.seed,
        confidence=settled.confidence,
        nominal=counts[0] / episodes,
        rungs=tuple(rungs),
        interrupted=interrupted,
    )
