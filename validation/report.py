"""One self-contained HTML page about a certificate: what is claimed, what rollouts show, and how to run it again.

The page has no scripts and loads nothing; all drawings are inline SVG, all text from the certificate is escaped. The
data it was made of are embedded as JSON and can be written to a file of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..spread import Executor
from ..synthesis.certificate import Certificate, checked_certificate
from ..synthesis.check import CheckReport, check
from .audit import audit
from .audit_report import AuditReport
from .chunks import paths
from .claims import bound_by_steps_left, claimed_values
from .fields import FieldReport, validate_field
from .loop import CHUNK, Loop
from .page import page_of
from .starts import slice_starts, start_box
from .validate import ValidationInterrupted, ValidationReport, validate

DRAWN = 40
"""Rollouts drawn."""


@dataclass(frozen=True, eq=False)
class ReportContent:
    """Everything a report shows.

    Parameters
    ----------
    certificate : Certificate
    validation : ValidationReport
    audit : AuditReport
    checked : CheckReport
    field : FieldReport
        Along the slice ``axes``.
    axes : tuple of int
        Joint coordinates of the slice.
    bounds : (T,) array
        Bounds from the start (or the middle of its box) when the last 1 .. T steps of the policies are played.
    states : (T + 1, M, D) array
        Rollouts to draw; NaN after their decision.
    success : (M,) bool array
    """

    certificate: Certificate
    validation: ValidationReport
    audit: AuditReport
    checked: CheckReport
    field: FieldReport
    axes: tuple[int, ...]
    bounds: NDArray[Any]
    states: NDArray[Any]
    success: NDArray[np.bool_]

    @property
    def refuted(self) -> bool:
        """Whether anything contradicts the certificate."""
        return self.validation.refuted or self.audit.refuted or self.field.verdict == "refuted" or not self.checked

    def to_dict(self) -> dict[str, Any]:
        """Everything but the drawings as JSON values."""
        return {
            "refuted": self.refuted,
            "validation": self.validation.to_dict(),
            "audit": self.audit.to_dict(),
            "check": {"valid": self.checked.valid, "failures": list(self.checked.failures)},
            "field": {"axes": list(self.axes), **self.field.to_dict()},
            "bound_by_steps": self.bounds.tolist(),
            "problem": self.certificate.problem.to_dict(),
            "fingerprint": self.certificate.fingerprint,
        }


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
