"""A problem synthesized, checked and validated at many settings: horizons, one after another, or a grid of changes."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from difflib import get_close_matches
from itertools import product
from typing import Any, Unpack

from ...envs.systems.arguments import shown
from ...envs.tasks.problem import Problem
from ...synthesis.certificates.proofs import Certificate, Synthesis
from ...synthesis.composition import each_horizon
from ...synthesis.verbs.synthesize import synthesize
from .spread import in_order
from .success_rate import ValidationReport, validate
from .trials import Plan, TrialOptions, TrialPlan, names_plan, planned

CHANGES = {"noise": float, "horizon": int, "effort": float, "cells": int}
"""What a sweep may change: a factor on the standard deviations of all noise, and arguments of the search."""


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
    anew = settings.get("relation") == "best"

    def once(task: Problem, begun: Certificate | None) -> Synthesis:
        return synthesize(task, start=None if anew else begun, **settings)

    for result in each_horizon(problem, horizons, once):
        yield validate(_whole(result), plan)


@dataclass(frozen=True)
class SweepRow:
    """What one setting of a sweep gave.

    Attributes
    ----------
    changes : dict
        What was changed, by name.
    lower_bound : float
        Certified lower bound on the success probability, checked; 0 if nothing was certified.
    method : str
        How it was found; or why nothing was.
    successes, episodes : int
        Rollouts of the certified controllers.
    low, high : float
        Exact limits of their success rate, at the confidence of the plan.
    verdict : str
        What the rollouts say of the bound; ``"refused"`` where the problem has no models of the kind asked for, and
        ``"check failed"`` where a checker does not prove the claim.
    seconds : float
        Processor seconds of this setting.
    """

    changes: dict[str, float | int]
    lower_bound: float
    method: str
    successes: int
    episodes: int
    low: float
    high: float
    verdict: str
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Return the row as numbers and words, for JSON."""
        return asdict(self)


@names_plan
def sweep(
    problem: Problem,
    over: Mapping[str, Sequence[float]],
    plan: TrialPlan | int | None = None,
    settings: Mapping[str, Any] | None = None,
    **trial: Unpack[TrialOptions],
) -> Iterator[SweepRow]:
    """Synthesize, check and validate a problem for every combination of some changes; yield a row for each, in order.

    Each combination is a job of its own, so rows are the same bits on every executor but for ``seconds``, and jobs of
    a worker that is killed run again (``spread.in_order``). Ctrl-C ends the sweep: a row is about all of its search,
    check and episodes, or is left out.

    Parameters
    ----------
    problem : Problem
    over : mapping
        Values by what is changed: ``noise`` (factors on the standard deviations of all noise), ``horizon``, ``effort``,
        ``cells``. The last one changes fastest.
    plan, **trial
        Episodes of each row (10,000 by default), seed, confidence (.999), executor of the rows; see ``TrialPlan``.
    settings : mapping, optional
        Further arguments of ``synthesize``, such as ``relation``.

    Raises
    ------
    ValueError
        If nothing is changed, a name or a value is unknown, or a number is out of range.

    Examples
    --------
    >>> import certigym as cg
    >>> from certigym.validation.statistical_tests import sweep
    >>> task = cg.make_problem("invariance-v0")
    >>> rows = [*sweep(task, {"noise": [1.0, 2.0], "horizon": [2]}, 1000)]
    >>> rows[0].changes, rows[0].lower_bound > rows[1].lower_bound
    ({'noise': 1.0, 'horizon': 2}, True)
    """
    settled = planned(plan, trial, 10_000)
    names, shared = checked_changes(over), (problem, dict(settings or {}), _alone(settled))
    jobs = [dict(zip(names, values, strict=True)) for values in product(*names.values())]
    for changes in jobs:
        _changed(problem, changes)  # what cannot be is said before anything is computed
    yield from in_order(_row, shared, jobs, settled.executor)


def checked_changes(over: Mapping[str, Sequence[Any]]) -> dict[str, list[float | int]]:
    """Return the values of a sweep by names; raise ValueError if a name or a value is unknown."""
    if not over or not all(over.values()):
        raise ValueError(f"`over`: expected values of some of {', '.join(CHANGES)}, got none")
    found = dict[str, list[float | int]]()
    for name, values in over.items():
        if name not in CHANGES:
            close = get_close_matches(str(name), CHANGES, n=1)
            remedy = f"did you mean `{close[0]}`?" if close else f"it may be {', '.join(CHANGES)}"
            raise ValueError(f"`over`: nothing is called {shown(name)}; {remedy}")
        kind = CHANGES[name]
        try:
            found[name] = [kind(value) for value in values]
        except (TypeError, ValueError):
            word = "whole numbers" if kind is int else "numbers"
            raise ValueError(f"`over`: expected {word} for `{name}`, got {shown(list(values))}") from None
    return found


def _alone(plan: Plan) -> TrialPlan:
    """Return the plan of the rollouts of one row, which are made where the row is."""
    return TrialPlan(plan.episodes, plan.seed, plan.confidence, plan.chunk)


def _changed(problem: Problem, changes: Mapping[str, Any]) -> Problem:
    """Return the problem with another noise and horizon, if these are changed."""
    return problem.replace(horizon=changes.get("horizon"), disturbance_scale=changes.get("noise"))


def _whole(result: Synthesis) -> Synthesis:
    """Return a synthesis whose search and check came to their ends; raise KeyboardInterrupt if Ctrl-C ended them.

    A search that is broken off returns what it has, which is not what this setting gives.
    """
    if result.is_broken_off:
        raise KeyboardInterrupt
    return result


def _row(shared: tuple[Problem, dict[str, Any], TrialPlan], changes: dict[str, float | int]) -> SweepRow:
    """Return the row of one setting: a job that any process can do."""
    (problem, settings, plan), began = shared, time.process_time()
    searched = {name: value for name, value in changes.items() if name in ("effort", "cells")}
    try:
        result = _whole(synthesize(_changed(problem, changes), **{**settings, **searched}))
    except ValueError as error:  # this one has no models of the kind that was asked for; others may
        return SweepRow(changes, 0.0, str(error), 0, 0, 0.0, 1.0, "refused", time.process_time() - began)
    report = validate(result, plan)
    if report.interrupted:
        raise KeyboardInterrupt
    method = str(result.stats.get("nothing") or result.certificate.proof.method)
    verdict = "check failed" if report.is_invalid else report.verdict
    return SweepRow(
        changes, report.lower_bound, method, report.successes, report.episodes, report.ci_low, report.ci_high, verdict,
        time.process_time() - began,
    )  # fmt: skip
