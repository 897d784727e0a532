"""How far a bound survives when the system is not the model: rollouts under ladders of mismatches.

At every rung the claim ``P_mismatch >= lower_bound`` is tested, with Holm's adjustment over all rungs. Nothing of this
is certified: a bound holds for its model, and a rung says what rollouts show where the model is wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Unpack

from ...envs.systems.arguments import counted, tree_text
from ...synthesis.certificates.proofs import certificate_from, rounded_down
from .binomial import (
    CONFIRMED,
    CONSISTENT,
    REFUTED,
    VACUOUS,
    check_confidence,
    clopper_pearson,
    holm,
    p_at_least,
    p_at_most,
)
from .mismatch import FAMILIES, Mismatch
from .report_text import Rows, Saved, html_table, labelled_lines
from .rollouts import rollout
from .success_rate import claim_at
from .trials import TrialOptions, TrialPlan, names_plan, planned

LADDERS: dict[str, tuple[Mismatch, ...]] = {
    "noise scale": tuple(Mismatch(noise_scale=s) for s in (1.05, 1.1, 1.2, 1.35, 1.5, 2.0)),
    "noise family": tuple(Mismatch(noise_family=family) for family in FAMILIES[1:]),
    "actuator bias up": tuple(Mismatch(actuator_bias=b) for b in (0.02, 0.05, 0.1, 0.2, 0.4)),
    "actuator bias down": tuple(Mismatch(actuator_bias=-b) for b in (0.02, 0.05, 0.1, 0.2, 0.4)),
    "delay": tuple(Mismatch(delay=d) for d in (1, 2, 3)),
    "dropout": tuple(Mismatch(dropout=p) for p in (0.02, 0.05, 0.1, 0.2, 0.4)),
}
"""Rungs from mild to severe (noise families in no order): from hardly noticeable to more than most systems bear."""

MOST_LADDERS = 6
"""Ladders that a short form lists: as many as there are by default."""


@dataclass(frozen=True)
class Rung:
    """One mismatch and what rollouts under it show.

    Parameters
    ----------
    ladder : str
    mismatch : Mismatch
    estimate, ci_low, ci_high : float
        Share of successes and its exact limits, for this rung alone.
    verdict : str
        Verdict on the bound of the certificate, all rungs tested together.
    """

    ladder: str
    mismatch: Mismatch
    estimate: float
    ci_low: float
    ci_high: float
    verdict: str


@dataclass(frozen=True, repr=False)
class StressReport(Saved):
    """The bound of a certificate beside what rollouts under mismatches show.

    Parameters
    ----------
    problem, horizon, lower_bound, episodes, seed, confidence
        What was run; ``episodes`` is per rung, on common random numbers.
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
        """Return the last mismatch before the first that refutes the bound; None if the mildest one refutes it.

        A bound of 0 survives nothing: it is never refuted, and says nothing (None).
        """
        last = None
        for rung in self.rungs:
            if rung.ladder == ladder:
                if rung.verdict in (REFUTED, VACUOUS):
                    break
                last = rung.mismatch
        return last

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        plain = ("problem", "horizon", "lower_bound", "episodes", "seed", "confidence", "nominal", "interrupted")
        ladders = dict.fromkeys(rung.ladder for rung in self.rungs)
        survived = {name: self.survives(name) for name in ladders}
        return {
            **{name: getattr(self, name) for name in plain},
            "survives": {name: None if m is None else str(m) for name, m in survived.items()},
            "rungs": [{**vars(rung), "mismatch": vars(rung.mismatch)} for rung in self.rungs],
        }

    def __str__(self) -> str:
        rungs = [
            f"  {rung.mismatch!s:<24} {rung.estimate:.6f} [{rung.ci_low:.6f}, {rung.ci_high:.6f}]  {rung.verdict}"
            for rung in self.rungs
        ]
        head = labelled_lines([("stress", self._title()), *self._claim()])
        return "\n".join([head, *rungs, labelled_lines([("survived", text) for text in self._ladders()])])

    def __repr__(self) -> str:
        ladders = [("survived", text) for text in self._ladders()]
        more = [("survived", f"... and {len(ladders) - MOST_LADDERS} more ladders")] if ladders[MOST_LADDERS:] else []
        return tree_text(f"StressReport: {self._title()}", [*self._claim(), *ladders[:MOST_LADDERS], *more])

    def _repr_html_(self) -> str:
        ladders = [("survived", text) for text in self._ladders()]
        return html_table(f"Stress: {self._title()}", [*self._claim(), *ladders])

    def _title(self) -> str:
        """Return what was run."""
        return f"{self.problem}, horizon {self.horizon}, {counted(self.episodes, 'episode')} per mismatch"

    def _claim(self) -> Rows:
        """Return the claim and what rollouts of the model itself show, by label."""
        rows = [
            ("certified", f"P >= {rounded_down(self.lower_bound)} for the model"),
            ("simulated", f"{self.nominal:.6f} without mismatch"),
        ]
        return [*rows, ("interrupted", "by Ctrl-C; further rungs were not run")] if self.interrupted else rows

    def _ladders(self) -> list[str]:
        """Return for each ladder how far the bound is not refuted."""
        texts = []
        for name in dict.fromkeys(rung.ladder for rung in self.rungs):
            verdicts, survived = [rung.verdict for rung in self.rungs if rung.ladder == name], self.survives(name)
            if VACUOUS in verdicts:
                texts.append(f"{name}: vacuous, a bound of 0 cannot fail")
            elif REFUTED not in verdicts:
                texts.append(f"{name}: every rung")
            else:
                texts.append(f"{name}: no rung" if survived is None else f"{name}: up to {survived}")
        return texts


@names_plan
def stress(
    certificate: Any,
    plan: TrialPlan | int | None = None,
    *,
    ladders: Mapping[str, Sequence[Mismatch]] | None = None,
    initial_state: Any = None,
    **trial: Unpack[TrialOptions],
) -> StressReport:
    """Test the bound of a certificate under mismatches; nothing about the mismatched systems is certified.

    Parameters
    ----------
    certificate : Synthesis, Certificate or path
    plan, **trial
        Episodes per mismatch (default 20,000), seed, confidence (.999), chunk, executor, progress; see ``TrialPlan``.
        After Ctrl-C the report is about the rungs that were finished.
    ladders : mapping from str to sequence of Mismatch, optional
        Mismatches from mild to severe, by name of the ladder; default: ``LADDERS``.
    initial_state : optional
        Start of the rollouts, as in ``Problem.replace``; the claim is then the certificate's bound there.

    Raises
    ------
    ValueError
        If a number is out of range.
    KeyboardInterrupt
        If Ctrl-C came before the first rung was finished.
    """
    settled = planned(plan, trial, 20_000)
    check_confidence(settled.confidence)
    certificate, episodes = certificate_from(certificate), settled.episodes
    problem, lower, _, _ = claim_at(certificate, initial_state)
    pairs = [(name, rung) for name, rungs in (LADDERS if ladders is None else ladders).items() for rung in rungs]
    # Successes without mismatch first, then of each rung; a rung that Ctrl-C interrupts does not count.
    counts: list[int] = []
    try:
        for mismatch in (None, *(rung for _, rung in pairs)):
            counts.append(rollout(problem, certificate.controller, settled, mismatch=mismatch).successes)
    except KeyboardInterrupt:
        if len(counts) < 2:
            raise
    interrupted = len(counts) <= len(pairs)
    pairs = pairs[: len(counts) - 1]
    # The claims of all rungs are one family, their opposites another; each has half of the level.
    against = holm(p_at_least(counts[1:], episodes, lower))
    in_favour = holm(p_at_most(counts[1:], episodes, lower))
    level = 0.5 * (1.0 - settled.confidence)
    rungs = []
    for (name, rung), k, p, opposite in zip(pairs, counts[1:], against, in_favour, strict=True):
        # A claim of 0 is true of every system, so that surviving a mismatch says nothing.
        verdict = VACUOUS if lower <= 0.0 else REFUTED if p <= level else CONFIRMED if opposite <= level else CONSISTENT
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
