"""Many syntheses of one problem: one per horizon, or several attempts at once on any executor."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from ...envs.problem import Problem
from ...synthesis.certificates import Certificate
from ...synthesis.horizons import each_horizon
from ...synthesis.synthesize import synthesize
from ..simulation import Executor, in_order
from .success_rate import ValidationReport, validate


def sweep_horizons(
    problem: Problem,
    horizons: Iterable[int],
    episodes: int = 20_000,
    seed: int = 0,
    *,
    executor: Executor | None = None,
    **settings: Any,
) -> list[ValidationReport]:
    """Synthesize and validate the problem at every horizon; reports in the order of ``horizons``.

    Each search begins with the policies of the horizon before (see ``synthesis.horizons``), one after the other.

    Parameters
    ----------
    problem : Problem
    horizons : iterable of int
        Control steps.
    episodes, seed
        Of each validation.
    executor : Executor, optional
        Where rollouts are computed; default: here.
    **settings
        Arguments of ``synthesize``, such as ``cells``.
    """
    asked = list(horizons)
    found = {own.horizon: own for own in each_report(problem, asked, episodes, seed, executor=executor, **settings)}
    return [found[horizon] for horizon in asked]


def each_report(
    problem: Problem, horizons: Iterable[int], episodes: int, seed: int, *, executor: Executor | None = None,
    **settings: Any,
) -> Iterator[ValidationReport]:  # fmt: skip
    """``sweep_horizons`` one by one, in increasing order of horizons."""
    for found in each_horizon(problem, horizons, **settings):
        yield validate(found, episodes, seed, executor=executor)


def synthesize_best(
    problem: Problem, attempts: Sequence[Mapping[str, Any]], *, executor: Executor | None = None
) -> tuple[Certificate, list[float]]:
    """The certificate with the largest lower bound among several attempts, and the bounds of all (certified).

    Parameters
    ----------
    problem : Problem
    attempts : sequence of mappings
        Arguments of ``synthesize`` of each attempt, such as ``{"cells": 100, "max_sweeps": 12}``.
    executor : Executor, optional
        Where they run; default: here, one after the other.

    Raises
    ------
    ValueError
        If there is no attempt.
    """
    if not attempts:
        raise ValueError("`attempts`: expected at least one, got none")
    best: Certificate | None = None
    bounds = []
    for certificate in in_order(_attempt, problem, attempts, executor):
        bounds.append(certificate.lower_bound)
        if best is None or certificate.lower_bound > best.lower_bound:
            best = certificate
    assert best is not None
    return best, bounds


def _attempt(problem: Problem, settings: Mapping[str, Any]) -> Certificate:
    return synthesize(problem, **settings).certificate
