"""What a report page shows, gathered before it is drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...synthesis.certificates import Certificate, ProductCertificate
from ...synthesis.checking import CheckReport
from ..audits import AuditReport
from ..verdicts import FieldReport, ValidationReport


@dataclass(frozen=True, eq=False)
class ReportContent:
    """Everything a report shows.

    Parameters
    ----------
    certificate : Certificate or ProductCertificate
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

    certificate: Certificate | ProductCertificate
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
