"""The content of a report page, gathered before it is drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.arguments import tree_text
from ....synthesis.certificates.proofs import Certificate, CheckReport, shown_bound
from ...statistical_tests import NOT_CERTIFIED, REFUTED, AuditReport, FieldReport, ValidationReport
from .explorer import Explored

INVALID = "invalid"
"""The verdict on a certificate that its check refuses, whatever rollouts say."""


@dataclass(frozen=True, eq=False, repr=False)
class ReportContent:
    """Everything that a report shows.

    Parameters
    ----------
    certificate : Certificate
        Those about pairs and along paths speak of one start: they have neither audit nor tests at other starts nor
        bounds by steps, which are None.
    validation : ValidationReport
    audit : AuditReport or None
    checked : CheckReport
    field : FieldReport or None
        Tests at the points of the slice ``axes``.
    axes : tuple of int
        Joint coordinates of the slice.
    bounds : (T,) array or None
        Lower bounds from the start (or the middle of its box) if only the last 1 .. T steps of the policies are played.
    states : (T + 1, M, D) array
        Rollouts to draw; NaN after their decision.
    success : (M,) bool array
        Which of these rollouts satisfied the task.
    explored : Explored or None
        What the value explorer shows; None if the check failed.
    """

    certificate: Certificate
    validation: ValidationReport
    audit: AuditReport | None
    checked: CheckReport
    field: FieldReport | None
    axes: tuple[int, ...]
    bounds: NDArray[Any] | None
    states: NDArray[Any]
    success: NDArray[np.bool_]
    explored: Explored | None = None

    def __repr__(self) -> str:
        problem, validation = self.certificate.problem, self.validation
        rows = [
            *([] if self.checked else [("invalid", f"{NOT_CERTIFIED}: {'; '.join(self.checked.failures)}")]),
            ("certified" if self.checked else "claimed", shown_bound(validation.lower_bound, validation.gap)),
            ("simulated", f"{validation.successes} of {validation.episodes} episodes satisfied the task"),
            ("verdict", validation.verdict),
            ("check", "valid" if self.checked else "failed"),
        ]
        if self.audit is not None and self.field is not None:
            rows.append(("audit", self.audit.verdict))
            rows.append(("map", f"{self.field.verdict}, {len(self.field.states)} starts"))
        return tree_text(f"ReportContent: {problem.name}, horizon {problem.horizon}", rows)

    @property
    def refuted(self) -> bool:
        """Whether a test or the check contradicts the certificate."""
        is_refuted = self.audit is not None and self.audit.refuted
        is_refuted = is_refuted or (self.field is not None and self.field.verdict == "refuted")
        return self.validation.refuted or is_refuted or not self.checked

    @property
    def verdict(self) -> str:
        """``invalid`` if the check failed, ``refuted`` if any test contradicts, else what the rollouts say."""
        if not self.checked:
            return INVALID
        return REFUTED if self.refuted else self.validation.verdict

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the rollouts that are drawn as JSON values."""
        return {
            "refuted": self.refuted,
            "verdict": self.verdict,
            "validation": self.validation.to_dict(),
            "audit": None if self.audit is None else self.audit.to_dict(),
            "check": {"valid": self.checked.valid, "failures": list(self.checked.failures)},
            "field": None if self.field is None else {"axes": list(self.axes), **self.field.to_dict()},
            "bound_by_steps": None if self.bounds is None else self.bounds.tolist(),
            "problem": self.certificate.problem.to_dict(),
            "fingerprint": self.certificate.fingerprint,
        }
