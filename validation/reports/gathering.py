"""One self-contained HTML page about a certificate: what is claimed, what rollouts show, and how to run it again.

The page has no scripts and loads nothing; all drawings are inline SVG, all text from the certificate is escaped. The
data it was made of are embedded as JSON and can be written to a file of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import write_text
from ...synthesis.certificates import Certificate, ProductCertificate, as_certificate
from ...synthesis.checking import check
from ..audits import audit, bound_by_steps_left, claimed_values
from ..simulation import Loop, Plan, TrialOptions, TrialPlan, paths, planned
from ..verdicts import slice_axes, slice_starts, start_box, validate, validate_field
from .content import ReportContent
from .page import page_of

DRAWN = 40
"""Rollouts drawn."""


def report(
    certificate: Any,
    path: str | Path,
    plan: TrialPlan | int | None = None,
    *,
    axes: Sequence[int] | None = None,
    **trial: Unpack[TrialOptions],
) -> ReportContent:
    """Write one self-contained page about a certificate, and return what it shows.

    Parameters
    ----------
    certificate : Synthesis, Certificate, ProductCertificate or path
    path : str or Path
        The page (``.html``).
    plan, **trial
        Episodes of the validation (default 100,000), seed, confidence (.999), chunk, executor, progress; see
        ``TrialPlan``. The audit takes at most 20,000 episodes, the map as many as the validation in all. After Ctrl-C
        during the validation the report is about what was finished, with a short audit and a coarse map.
    axes : sequence of int, optional
        Joint coordinates of the map, one or two; default: the first of the first two agents.
    """
    content = gathered(certificate, planned(plan, trial, 100_000), axes)
    write_text(path, page_of(content))
    return content


def gathered(certificate: Any, plan: Plan, axes: Sequence[int] | None = None) -> ReportContent:
    """Run check, validation, audit and a map of margins, and collect what a report shows."""
    claim = as_certificate(certificate)
    problem = claim.problem
    shown = slice_axes(problem, axes)
    shape = (40,) if len(shown) == 1 else (20, 20)
    grid = slice_starts(problem, shown, shape)
    states, success = paths(Loop(problem, claim.controller, plan.seed, max(DRAWN, 1)), DRAWN)
    validation = validate(certificate, plan)
    episodes = min(plan.episodes, 1000) if validation.interrupted else plan.episodes
    each = replace(plan, episodes=max(20, episodes // len(grid)))
    return ReportContent(
        certificate=claim,
        validation=validation,
        audit=audit(claim, replace(plan, episodes=min(episodes, 20_000))),
        checked=check(claim),
        field=validate_field(claim, grid, each, shape=shape),
        axes=shown,
        bounds=_bounds(claim, 0.5 * np.sum(start_box(problem), axis=0)),
        states=states,
        success=success,
    )


def _bounds(certificate: Certificate | ProductCertificate, state: NDArray[Any]) -> NDArray[Any]:
    """Lower bounds (T,) from a joint state when the last 1 .. T steps are played; of independent tasks, the product."""
    if isinstance(certificate, Certificate):
        return bound_by_steps_left(certificate, claimed_values(certificate), state)
    return np.prod([_bounds(part, own) for part, own in certificate.split(state)], axis=0)
