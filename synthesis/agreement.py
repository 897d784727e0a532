"""Claims along paths that the check agrees with: the larger probability of failing of both is claimed.

Search and check enclose the same expressions by code of their own, and neither is always the narrower one. A claim
that the check would refuse by a little is of no use to anybody.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from .certificates import PathCertificate, Synthesis
from .checking import check

MOST_PAIRS = 15
"""Pairs up to which the check is asked: of larger teams it takes seconds."""


def agreed(found: Synthesis) -> Synthesis:
    """Return a synthesis whose certificate along a path claims no more than the check proves."""
    certificate: Any = found.certificate
    if not isinstance(certificate, PathCertificate) or len(certificate.problem.labeling.pairs) > MOST_PAIRS:
        return found
    report = check(replace(certificate, failure=1.0))
    proved = 1.0 - report.recomputed if report else 1.0
    if proved <= certificate.failure:
        return found
    certificate = replace(certificate, failure=min(1.0, proved * (1.0 + 1e-9)))
    return replace(found, certificate=certificate, controller=certificate.controller)
