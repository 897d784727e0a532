"""Tests of a claim step by step, along rollouts."""

from .audit_report import AuditReport
from .step_tests import audit
from .value_at import bound_by_steps_left, standing_cells

__all__ = [
    "AuditReport",
    "audit",
    "bound_by_steps_left",
    "standing_cells",
]
