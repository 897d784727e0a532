"""One self-contained HTML page about a certificate: what is claimed, what rollouts show, and how to run it again.

The page has no scripts and loads nothing; all drawings are inline SVG, all text from the certificate is escaped. The
data it was made of are embedded as JSON and can be written to a file of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...synthesis.certificates import Certificate, checked_certificate
from ...synthesis.checking import check
from ..audits import audit, bound_by_steps_left, claimed_values
from ..simulation import CHUNK, Executor, Loop, paths
from ..verdicts import ValidationInterrupted, slice_starts, start_box, validate, validate_field
from .content import ReportContent
from .page import page_of

DRAWN = 40
"""Rollouts drawn."""


def gather_report(
    certificate: Certificate,
    episodes: int = 100_000,
    seed: int = 0,
    *,
    confidence: float = 0.999,
    axes: Sequence[int] | None = None,
    chunk: int = CHUNK,
    executor: Executor | None = None,
    progress: Callable[[int], None] | None = None,
) -> ReportContent:
    """Run check, validation, audit and a map of margins, and collect what a report shows.

    Parameters
    ----------
    certificate : Certificate
    episodes : int
        Of the validation; the audit takes at most 20,000, the map as many as the validation in all. After Ctrl-C
        during the validation the report is about what was finished, with a short audit and a coarse map.
    seed, confidence, chunk, executor, progress
        As in ``validate``.
    axes : sequence of int, optional
        Joint coordinates of the map, one or two; default: the first of the first two agents.
    """
    problem = checked_certificate(certificate).problem
    settings: dict[str, Any] = {
        "confidence": confidence, "chunk": chunk, "executor": executor, "progress": progress
    }  # fmt: skip
    shown = _axes(certificate, axes)
    shape = (40,) if len(shown) == 1 else (20, 20)
    grid = slice_starts(certificate, shown, shape)
    middle = 0.5 * np.sum(start_box(problem), axis=0)
    states, success = paths(Loop(problem, certificate.controller, seed, max(DRAWN, 1)), DRAWN)
    try:
        validation = validate(certificate, episodes, seed, **settings)
    except ValidationInterrupted as interrupted:
        validation, episodes = interrupted.report, min(episodes, 1000)
    return ReportContent(
        certificate=certificate,
        validation=validation,
        audit=audit(certificate, min(episodes, 20_000), seed, **settings),
        checked=check(certificate),
        field=validate_field(certificate, grid, max(20, episodes // len(grid)), seed, shape=shape, **settings),
        axes=shown,
        bounds=bound_by_steps_left(certificate, claimed_values(certificate), middle),
        states=states,
        success=success,
    )


def write_report(content: ReportContent, path: str | Path) -> None:
    """Write the page."""
    Path(path).write_text(page_of(content), encoding="utf-8")


def _axes(certificate: Certificate, axes: Sequence[int] | None) -> tuple[int, ...]:
    if axes is not None:
        if not 1 <= len(axes) <= 2 or len(set(axes)) != len(axes):
            raise ValueError(f"`axes`: expected one or two different joint coordinates, got {list(axes)}")
        return tuple(axes)
    first = np.cumsum([0, *(agent.n_states for agent in certificate.problem.agents)])
    if certificate.problem.n_agents > 1:
        return int(first[0]), int(first[1])
    return (0, 1) if certificate.problem.n_states > 1 else (0,)
