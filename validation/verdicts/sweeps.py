"""Many syntheses of one problem: one per horizon, or several attempts, which any executor can run in parallel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from ...envs.problem import Problem
from ...synthesis.certificates import OnGrid
from ...synthesis.checking import check
from ...synthesis.horizons import each_horizon
from ...synthesis.synthesize import synthesize
from ..simulation import Executor, TrialOptions, TrialPlan, in_order, planned
from .success_rate import ValidationReport, validate


def validate_horizons(
    problem: Any, horizons: Iterable[int], plan: TrialPlan | int | None = None, **options: Any
) -> list[ValidationReport]:
    """Synthesize and validate the problem at every horizon; return the reports in the order of ``horizons``.

    The horizons are taken in increasing order, and each search begins with the policies of the one before (see
    ``synthesis.horizons``).

    Parameters
    ----------
    problem : Problem, id or path
    horizons : iterable of int
        Control steps.
    plan : TrialPlan or int, optional
        Plan of each validation; default: 20,000 episodes.
    **options
        Fields of ``TrialPlan``, such as ``episodes``; all others are arguments of ``synthesize``, such as ``cells``.
    """
    # ``progress`` goes to the synthesis, which takes an argument of that name, too.
    trial: TrialOptions = {}
    for name in [name for name in options if name in TrialOptions.__optional_keys__ and name != "progress"]:
        trial[name] = options.pop(name)  # type: ignore[literal-required]
    wanted, settled = list(horizons), planned(plan, trial, 20_000)
    reports = {report.horizon: report for report in each_report(problem, wanted, settled, options)}
    return [reports[horizon] for horizon in wanted]


def each_report(
    problem: Any, horizons: Iterable[int], plan: TrialPlan, settings: Mapping[str, Any] | None = None
) -> Iterator[ValidationReport]:
    """Yield the reports of ``validate_horizons`` one by one, in increasing order of horizons."""
    for result in each_horizon(problem, horizons, **(settings or {})):
        yield validate(result, plan).with_check(check(result.certificate))


def synthesize_best(
    problem: Problem, attempts: Sequence[Mapping[str, Any]], *, executor: Executor | None = None
) -> tuple[OnGrid, list[float]]:
    """Return the certificate with the largest lower bound among several attempts, and the lower bounds of all.

    Parameters
    ----------
    problem : Problem
    attempts : sequence of mappings
        Arguments of ``synthesize`` of each attempt, such as ``{"cells": 100, "max_sweeps": 12}``.
    executor : Executor, optional
        Where the attempts run; default: in this process, one after the other.

    Raises
    ------
    ValueError
        If there is no attempt.
    """
    if not attempts:
        raise ValueError("`attempts`: expected at least one, got none")
    best: OnGrid | None = None
    bounds = []
    for certificate in in_order(_attempt, problem, attempts, executor):
        bounds.append(certificate.lower_bound)
        if best is None or certificate.lower_bound > best.lower_bound:
            best = certificate
    assert best is not None
    return best, bounds


def _attempt(problem: Problem, settings: Mapping[str, Any]) -> OnGrid:
    """Run one synthesis; executors can import this function."""
    return synthesize(problem, **settings).certificate
