"""Many syntheses of one problem: one per horizon, or several attempts, which any executor can run in parallel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from ...envs.tasks.problem import Problem
from ...synthesis.certificates.proofs import Certificate, OnGrid, Synthesis
from ...synthesis.composition import each_horizon
from ...synthesis.verbs.synthesize import synthesize
from .spread import Executor, in_order
from .success_rate import ValidationReport, validate
from .trials import TrialPlan


def each_report(
    problem: Problem, horizons: Iterable[int], plan: TrialPlan, settings: Mapping[str, Any] | None = None
) -> Iterator[ValidationReport]:
    """Synthesize, check and validate the problem at every horizon; yield the reports one by one, as horizons increase.

    Each search begins with the policies of the horizon before (``synthesize`` with several horizons).

    Parameters
    ----------
    problem : Problem
    horizons : iterable of int
        Control steps.
    plan : TrialPlan
        Plan of each validation.
    settings : mapping, optional
        Arguments of ``synthesize``, such as ``cells``.
    """
    settings = dict(settings or {})
    anew = {"memory", "accuracy"} & {*settings} or settings.get("relation") == "best"

    def once(task: Problem, begun: Certificate | None) -> Synthesis:
        return synthesize(task, start=None if anew else begun, **settings)

    for result in each_horizon(problem, horizons, once):
        yield validate(result, plan)


def synthesize_best(
    problem: Problem, attempts: Sequence[Mapping[str, Any]], *, executor: Executor | None = None
) -> tuple[OnGrid, list[float]]:
    """Return the certificate with the largest lower bound among several attempts, and the lower bounds of all.

    Parameters
    ----------
    problem : Problem
    attempts : sequence of mappings
        Arguments of ``synthesize`` of each attempt, such as ``{"cells": 100, "relation": "exact"}``.
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
