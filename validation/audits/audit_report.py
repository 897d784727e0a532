"""What an audit found, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from ...envs.agents import write_json
from ...envs.problem import Problem
from ..simulation import Plan
from ..statistics import CONSISTENT, REFUTED, holm

if TYPE_CHECKING:
    from .ledger import Ledger


@dataclass(frozen=True)
class Finding:
    """A pair (time, automaton state) at which the value function falls in expectation, and who stands where then.

    Parameters
    ----------
    time : int
        The step from ``time`` to ``time + 1``.
    automaton_state : str
    episodes : int
        Undecided episodes that were in this state at this time.
    mean_increment : float
        Mean of ``Y_{t+1} - Y_t``; at least 0 in a true certificate.
    log_e, p_value : float
        Logarithmic e-value and Holm-adjusted p-value.
    agent, region : str
        The agent, and the propositions that held for it before the step, whose part of the step has the most evidence.
    region_episodes, region_mean_increment, region_log_e
        The same figures of that part.
    contradictions : int
        Episodes in which the value fell although the moves of all agents had left it high: overlapping guards or
        wrong labels.
    """

    time: int
    automaton_state: str
    episodes: int
    mean_increment: float
    log_e: float
    p_value: float
    agent: str
    region: str
    region_episodes: int
    region_mean_increment: float
    region_log_e: float
    contradictions: int

    def __str__(self) -> str:
        if self.contradictions:
            where = f"guards or labels are wrong in {self.contradictions} of them"
        else:
            where = (
                f"most by {self.agent} in {self.region} ({self.region_mean_increment:.4g} over {self.region_episodes})"
            )
        return (
            f"t={self.time} {self.automaton_state}: mean increment {self.mean_increment:.4g} over {self.episodes} "
            f"episodes (adjusted p {self.p_value:.2g}); {where}"
        )


@dataclass(frozen=True, eq=False)
class AuditReport:
    """Outcome of an audit.

    Parameters
    ----------
    problem, horizon, episodes, seed, chunk, confidence
        What was run.
    tests : int
        Pairs (t, q) that were met, and the start.
    overall_log_e, overall_p : float
        Evidence of all steps together.
    start_p : float
        Holm-adjusted p-value of "the value at the start is at least the certified bound".
    contradictions : int
        Episodes of all pairs that contradict the tree outright; 0 in a true certificate, always.
    findings : tuple of Finding
        Rejected or contradicted pairs, the most evidence first.
    log_e, worlds, mean_increments : (T, Q) arrays
        All pairs.
    interrupted : bool
    """

    problem: str
    horizon: int
    episodes: int
    seed: int
    chunk: int
    confidence: float
    tests: int
    overall_log_e: float
    overall_p: float
    start_p: float
    contradictions: int
    findings: tuple[Finding, ...]
    log_e: NDArray[Any]
    worlds: NDArray[Any]
    mean_increments: NDArray[Any]
    interrupted: bool = False

    @property
    def refuted(self) -> bool:
        """Whether any test rejects, or an episode contradicts the tree; by chance with at most ``1 - confidence``."""
        level = 0.5 * (1.0 - self.confidence)
        return bool(self.findings) or self.overall_p <= level or self.start_p <= level

    @property
    def verdict(self) -> str:
        """``refuted`` or ``consistent``: an audit never confirms."""
        return REFUTED if self.refuted else CONSISTENT

    def to_dict(self) -> dict[str, Any]:
        """Everything as JSON values."""
        plain = ("problem", "horizon", "episodes", "seed", "chunk", "confidence", "tests", "overall_log_e",
                 "overall_p", "start_p", "contradictions", "interrupted", "verdict")  # fmt: skip
        return {
            **{name: getattr(self, name) for name in plain},
            "findings": [vars(finding) for finding in self.findings],
            **{name: getattr(self, name).tolist() for name in ("log_e", "worlds", "mean_increments")},
        }

    def save(self, path: str | Path) -> None:
        """Write ``to_dict()`` as JSON."""
        write_json(path, self.to_dict())

    def __str__(self) -> str:
        lines = [
            f"audit        {self.problem}, horizon {self.horizon}, {self.episodes} episodes, {self.tests} tests",
            f"all steps    log e-value {self.overall_log_e:.2f}, p {self.overall_p:.2g}; start p {self.start_p:.2g}",
            *(f"finding      {finding}" for finding in self.findings[:8]),
        ]
        if len(self.findings) > 8:
            lines.append(f"... and {len(self.findings) - 8} more findings")
        return "\n".join([*lines, f"verdict      {self.verdict}"])


def joined_report(problem: Problem, reports: Sequence[AuditReport], confidence: float) -> AuditReport:
    """The audits of independent tasks as one, in which each has had its share of the probability of a false alarm.

    States of all tasks stand side by side; p-values over the tasks are adjusted by Bonferroni.
    """
    first, n = reports[0], len(reports)
    strongest = max(reports, key=lambda report: report.overall_log_e)
    return AuditReport(
        problem=problem.name,
        horizon=problem.horizon,
        episodes=min(report.episodes for report in reports),
        seed=first.seed,
        chunk=first.chunk,
        confidence=confidence,
        tests=sum(report.tests for report in reports),
        overall_log_e=strongest.overall_log_e,
        overall_p=min(1.0, n * strongest.overall_p),
        start_p=min(1.0, n * min(report.start_p for report in reports)),
        contradictions=sum(report.contradictions for report in reports),
        findings=tuple(finding for report in reports for finding in report.findings),
        log_e=np.concatenate([report.log_e for report in reports], axis=1),
        worlds=np.concatenate([report.worlds for report in reports], axis=1),
        mean_increments=np.concatenate([report.mean_increments for report in reports], axis=1),
        interrupted=any(report.interrupted for report in reports),
    )


def report_of(problem: Problem, ledger: Ledger, plan: Plan, interrupted: bool) -> AuditReport:
    """Tests and findings from the sums of an audit."""
    log_e, start = _log_e(ledger.wealth), float(_log_e(ledger.start))
    met = ledger.worlds > 0
    raw = np.exp(-np.maximum(np.append(log_e[met], start), 0.0))
    adjusted = holm(raw)
    p_values = np.ones(log_e.shape)
    p_values[met] = adjusted[:-1]
    overall = float(_log_e(ledger.wealth.sum(axis=(0, 1)) + ledger.start))
    rejected = np.argwhere((p_values <= 0.5 * (1.0 - plan.confidence)) | (ledger.contradictions > 0))
    rejected = rejected[np.argsort(-log_e[tuple(rejected.T)], kind="stable")]
    means = ledger.increments / np.maximum(ledger.worlds, 1)
    findings = tuple(
        Finding(int(t), problem.automaton.state_names[q], int(ledger.worlds[t, q]), float(means[t, q]),
                float(log_e[t, q]), float(p_values[t, q]), *_where(problem, ledger, int(t), int(q)),
                int(ledger.contradictions[t, q]))
        for t, q in rejected
    )  # fmt: skip
    return AuditReport(
        problem=problem.name,
        horizon=problem.horizon,
        episodes=plan.episodes,
        seed=plan.seed,
        chunk=plan.chunk,
        confidence=plan.confidence,
        tests=int(met.sum()) + 1,
        overall_log_e=overall,
        overall_p=float(np.exp(-max(overall, 0.0))),
        start_p=float(adjusted[-1]),
        contradictions=int(ledger.contradictions.sum()),
        findings=findings,
        log_e=log_e,
        worlds=ledger.worlds.astype(np.int64),
        mean_increments=means,
        interrupted=interrupted,
    )


def _log_e(wealth: NDArray[Any]) -> NDArray[Any]:
    """Logarithm of the average over the stakes (last axis)."""
    return np.asarray(logsumexp(wealth, axis=-1) - np.log(wealth.shape[-1]))


def _where(problem: Problem, ledger: Ledger, t: int, q: int) -> tuple[str, str, int, float, float]:
    """Agent and region with the most evidence at (t, q), with their figures."""
    best: tuple[float, int, int] = (-np.inf, 0, 0)
    for i, split in enumerate(ledger.split):
        evidence = np.where(ledger.split_worlds[i][t, q] > 0, _log_e(split[t, q]), -np.inf)
        if (found := float(evidence.max())) > best[0] + 1e-9:
            best = (found, i, int(evidence.argmax()))
    log_e, i, c = best
    worlds = ledger.split_worlds[i][t, q, c]
    return (
        problem.agent_names[i], region_name(problem, i, c), int(worlds),
        float(ledger.split_increments[i][t, q, c] / max(worlds, 1)), log_e,
    )  # fmt: skip


def region_name(problem: Problem, i: int, c: int) -> str:
    """The propositions of class c of agent i, in words."""
    own = problem.labeling.agent_propositions[i]
    holds = problem.labeling.classes[i][c]
    return " & ".join(problem.labeling.names[p] for p, yes in zip(own, holds, strict=True) if yes) or "no region"
