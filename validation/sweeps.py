"""Many syntheses at once, on any executor: one per horizon, or several attempts at one problem."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..envs.problem import Problem
from ..spread import Executor, in_order
from ..synthesis.certificate import Certificate
from ..synthesis.synthesize import synthesize
from .validate import ValidationReport, validate


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

    Parameters
    ----------
    problem : Problem
    horizons : iterable of int
        Control steps.
    episodes, seed
        Of each validation.
    executor : Executor, optional
        Where the horizons are worked on; default: here.
    **settings
        Arguments of ``synthesize``, such as ``cells``.
    """
    return list(in_order(_at_horizon, (problem, episodes, seed, settings), horizons, executor))


def _at_horizon(shared: tuple[Problem, int, int, dict[str, Any]], horizon: int) -> ValidationReport:
    problem, episodes, seed, settings = shared
    return validate(synthesize(problem.replace(horizon=horizon), **settings), episodes, seed)


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
