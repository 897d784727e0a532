"""What an audit found, and where.

``report_of`` turns the sums of a ledger into tests and findings; ``joined_report`` puts the audits of independent tasks
together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from ...envs.systems.arguments import counted, shortened, tree_text
from ...envs.tasks.problem import Problem
from .binomial import CONSISTENT, REFUTED, VACUOUS, holm
from .report_text import INTERRUPTED, Rows, Saved, html_table, labelled_lines
from .trials import Plan

if TYPE_CHECKING:
    from .step_log import StepLog

MOST_FINDINGS = 8
"""Findings that are printed; the first ones have the most evidence."""

NEARLY_EQUAL = 1e-9
"""Difference of logarithmic e-values that counts as none: of agents with equal evidence the first one is named."""


MEANINGS_OF_AUDITS = {
    REFUTED: "the rollouts contradict the certificate",
    CONSISTENT: "nothing contradicts the certificate",
    VACUOUS: "nothing contradicts the certificate, but at its start it claims P >= 0, which says nothing",
}
"""What each verdict of an audit says."""


@dataclass(frozen=True)
class Finding:
    """A pair (time, automaton state) at which the value function falls in expectation, and which agent lets it fall.

    Parameters
    ----------
    time : int
        The step from ``time`` to ``time + 1``.
    automaton_state : str
    episodes : int
        Number of undecided episodes in this state at this time.
    mean_increment : float
        Mean of ``Y_{t+1} - Y_t``, an estimate; its expectation is at least 0 if the certificate is true.
    log_e, p_value : float
        Logarithmic e-value and Holm-adjusted p-value.
    agent, region : str
        The agent whose share of the step has the most evidence, and the propositions that held for it before the step.
    region_episodes, region_mean_increment, region_log_e
        The same figures for that share.
    contradictions : int
        Number of episodes in which the value fell although the moves of all agents had left it high: guards overlap,
        or labels are wrong.
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
                f"most of it is due to {self.agent} in {self.region} "
                f"({self.region_mean_increment:+.4g} over {counted(self.region_episodes, 'episode')})"
            )
        return (
            f"at time {self.time} in task state {self.automaton_state} the value changes by "
            f"{self.mean_increment:+.4g} on average over {counted(self.episodes, 'episode')} "
            f"(adjusted p = {self.p_value:.2g}); {where}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class AuditReport(Saved):
    """The tests of a certificate step by step, and what they found.

    Parameters
    ----------
    problem, horizon, episodes, seed, chunk, confidence
        What was run.
    tests : int
        Number of tests: one for each pair (t, q) that was met, and one for the start.
    overall_log_e, overall_p : float
        Evidence of all steps together against the certificate.
    start_p : float
        Holm-adjusted p-value of "the value at the start is at least the certified bound".
    contradictions : int
        Number of episodes, over all pairs, that contradict the tree outright; always 0 if the certificate is true.
    findings : tuple of Finding
        Rejected or contradicted pairs, those with the most evidence first.
    log_e, worlds, mean_increments : (T, Q) arrays
        Evidence, number of episodes and mean increment of every pair.
    interrupted : bool
        Whether Ctrl-C ended the audit early.
    lower_bound : float
        What the certificate claims at its start.
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
    lower_bound: float = 1.0

    @property
    def refuted(self) -> bool:
        """Whether a test rejects or an episode contradicts the tree; false with probability at most 1 - confidence."""
        level = 0.5 * (1.0 - self.confidence)
        return bool(self.findings) or self.overall_p <= level or self.start_p <= level

    @property
    def verdict(self) -> str:
        """``refuted``, ``consistent``, or ``vacuous`` where 0 is claimed at the start: an audit never confirms."""
        if self.refuted:
            return REFUTED
        return VACUOUS if self.lower_bound <= 0.0 else CONSISTENT

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        sizes = ("problem", "horizon", "episodes", "seed", "chunk", "confidence", "tests")
        results = ("overall_log_e", "overall_p", "start_p", "contradictions", "interrupted", "verdict")
        return {
            **{name: getattr(self, name) for name in (*sizes, *results, "lower_bound")},
            "findings": [vars(finding) for finding in self.findings],
            **{name: getattr(self, name).tolist() for name in ("log_e", "worlds", "mean_increments")},
        }

    def __str__(self) -> str:
        return labelled_lines([("audit", self._title()), *self._rows(MOST_FINDINGS)])

    def __repr__(self) -> str:
        rows = [(label, shortened(text, 160)) for label, text in self._rows(3)]
        return tree_text(f"AuditReport: {self._title()}", rows)

    def _repr_html_(self) -> str:
        return html_table(f"Audit: {self._title()}", self._rows(MOST_FINDINGS))

    def _title(self) -> str:
        """Return what was run."""
        return f"{self.problem}, horizon {self.horizon}, {counted(self.episodes, 'episode')}"

    def _rows(self, most: int) -> Rows:
        """Return what was tested, the evidence, at most so many findings, and the verdict."""
        together = f"p = {self.overall_p:.2g} for all steps together, p = {self.start_p:.2g} for the start"
        meaning = MEANINGS_OF_AUDITS[self.verdict]
        more = len(self.findings) - most
        return [
            ("tested", f"{counted(self.tests, 'claim')} that the value does not fall in expectation"),
            ("evidence", f"{together}; small values speak against the certificate"),
            *(("finding", str(finding)) for finding in self.findings[:most]),
            *([("findings", f"{more} more")] if more > 0 else []),
            *([("interrupted", INTERRUPTED)] if self.interrupted else []),
            ("verdict", f"{self.verdict}: {meaning}"),
        ]


def joined_report(
    problem: Problem, reports: Sequence[AuditReport], confidence: float, lower_bound: float
) -> AuditReport:
    """Return the audits of independent tasks as one report.

    Each audit has had its share of the probability of a false alarm. The states of all tasks stand side by side; the
    p-values over the tasks are adjusted by Bonferroni's method.
    """
    # The strongest evidence of any task decides, at the price of the number of tasks.
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
        lower_bound=lower_bound,
    )


def report_of(problem: Problem, step_log: StepLog, plan: Plan, interrupted: bool, lower_bound: float) -> AuditReport:
    """Return the tests and findings that the sums of an audit give; ``lower_bound`` is the claim at the start."""
    # A wealth W gives the p-value 1 / W. The pairs that were met and the start are adjusted together, by Holm's method.
    log_e, start = _log_e(step_log.wealth), float(_log_e(step_log.start))
    met = step_log.worlds > 0
    raw = np.exp(-np.maximum(np.append(log_e[met], start), 0.0))
    adjusted = holm(raw)
    p_values = np.ones(log_e.shape)
    p_values[met] = adjusted[:-1]
    # The product of the wealth over all steps sees defects that are too thin for any single pair.
    overall = float(_log_e(step_log.wealth.sum(axis=(0, 1)) + step_log.start))
    # A pair is a finding if its test rejects at half of the level, or if a single episode contradicts the tree.
    rejected = np.argwhere((p_values <= 0.5 * (1.0 - plan.confidence)) | (step_log.contradictions > 0))
    rejected = rejected[np.argsort(-log_e[tuple(rejected.T)], kind="stable")]
    means = step_log.increments / np.maximum(step_log.worlds, 1)
    findings = []
    for t, q in rejected.tolist():
        agent, region, episodes, mean, evidence = _where(problem, step_log, t, q)
        findings.append(
            Finding(
                time=t,
                automaton_state=problem.automaton.state_names[q],
                episodes=int(step_log.worlds[t, q]),
                mean_increment=float(means[t, q]),
                log_e=float(log_e[t, q]),
                p_value=float(p_values[t, q]),
                agent=agent,
                region=region,
                region_episodes=episodes,
                region_mean_increment=mean,
                region_log_e=evidence,
                contradictions=int(step_log.contradictions[t, q]),
            )
        )
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
        contradictions=int(step_log.contradictions.sum()),
        findings=tuple(findings),
        log_e=log_e,
        worlds=step_log.worlds.astype(np.int64),
        mean_increments=means,
        interrupted=interrupted,
        lower_bound=lower_bound,
    )


def _log_e(wealth: NDArray[Any]) -> NDArray[Any]:
    """Return the logarithm of the average wealth over the stakes (last axis): an e-value, too."""
    return np.asarray(logsumexp(wealth, axis=-1) - np.log(wealth.shape[-1]))


def _where(problem: Problem, step_log: StepLog, t: int, q: int) -> tuple[str, str, int, float, float]:
    """Return agent and region with the most evidence at (t, q): their names, episodes, mean increment, log e-value."""
    # Over all agents and classes: the class in which the bets against the agent's share have won most.
    strongest: tuple[float, int, int] = (-np.inf, 0, 0)
    for i, split in enumerate(step_log.split):
        evidence = np.where(step_log.split_worlds[i][t, q] > 0, _log_e(split[t, q]), -np.inf)
        if (most := float(evidence.max())) > strongest[0] + NEARLY_EQUAL:
            strongest = (most, i, int(evidence.argmax()))
    log_e, i, c = strongest
    worlds = step_log.split_worlds[i][t, q, c]
    mean = float(step_log.split_increments[i][t, q, c] / max(worlds, 1))
    return problem.agent_names[i], region_name(problem, i, c), int(worlds), mean, log_e


def region_name(problem: Problem, i: int, c: int) -> str:
    """Return the propositions of class c of agent i in words."""
    propositions = problem.labeling.agent_propositions[i]
    holds = problem.labeling.classes[i][c]
    names = (problem.labeling.names[p] for p, yes in zip(propositions, holds, strict=True) if yes)
    return " & ".join(names) or "no region"
