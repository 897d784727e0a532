"""Test a certificate at many starts, step by step, and in a world that differs from the model."""

from __future__ import annotations

import numpy as np

import certigym as cg
from certigym.validation.statistical_tests import AuditReport, FieldReport, StressReport, find_weakest

problem = cg.make_problem("reach-avoid-v0", horizon=6, initial_state=[-20.0, -3.0])
certificate = cg.synthesize(problem, cells=200).certificate

# many starts at once: Holm over all of them
starts = np.column_stack([np.linspace(-19.9, 4.9, 40), np.full(40, -3.0)])
field: FieldReport = cg.validate_field(certificate, starts, 1_000)
print(f"field: {field.verdict}, {field.fraction_refuted:.0%} refuted")
weakest = find_weakest(certificate, 40_000)
print("weakest start found", weakest.states[weakest.weakest], weakest.verdict)

# every step: the value must not fall in expectation
audited: AuditReport = cg.audit(certificate, 5_000)
print(audited)

# stop as soon as it is clear
print(cg.validate(certificate, 200_000, sequential=True))

# other noise, actuators and sensors: here nothing is certified, there are only rollouts
windy = cg.Mismatch(noise_scale=1.2, delay=1)
print(cg.validate(certificate, 10_000, mismatch=windy).verdict, "under", windy)
stressed: StressReport = cg.stress(certificate, 2_000)
print(stressed)
