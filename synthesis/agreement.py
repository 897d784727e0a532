"""Claims along paths, and of mixed teams, that the check agrees with: the larger probability of failing is claimed.

Search and check enclose the same expressions by code of their own, and neither is always the narrower one. A claim
that the check would refuse by a little is of no use to anybody.
"""

from __future__ import annotations

from dataclasses import replace

from ..envs.problem import Problem, out_of_reach
from .cells import NoRunFound
from .certificates import AlongPath, Certificate, MixedProof, Synthesis, changed, path_under
from .checking import check, wrong_mixed
from .nominal_paths import CountedWork, path_certificate

MOST_PAIRS = 15
"""Pairs up to which the check is asked: of larger teams it takes seconds."""

LAST_DIGIT = 2.0**-52
"""What numbers near 1 are rounded by, at most."""


def along_path(problem: Problem, work: CountedWork) -> Synthesis:
    """Return a synthesis along a path that claims no more than search and check both prove.

    Raises
    ------
    RelationRefused
        If there is none; NoRunFound if no run without noise satisfies the task, as is known without a search.
    """
    if not work.is_hopeless and (lost := out_of_reach(problem, rare=0.0)) is not None:
        raise NoRunFound(f"no nominal path satisfies the task: {lost.why}")
    return agreed(path_certificate(problem, work))


def agreed(found: Synthesis) -> Synthesis:
    """Return a synthesis whose certificate, if it is along a path, claims no more than the check proves."""
    certificate = found.certificate
    if path_under(certificate) is not certificate or (modest := agreed_path(certificate)) is certificate:
        return found
    return replace(found, certificate=modest, controller=modest.controller)


def agreed_path(certificate: AlongPath) -> AlongPath:
    """Return a certificate along a path that claims no more than the check proves."""
    if len(certificate.problem.labeling.pairs) > MOST_PAIRS:
        return certificate
    if check(certificate):
        return certificate
    report = check(changed(certificate, failure=1.0))
    # The check says a bound near 1, and what is left of it is known up to its last digit alone.
    proved = 1.0 - report.recomputed + LAST_DIGIT if report else 1.0
    return changed(certificate, failure=min(1.0, proved * (1.0 + 1e-9)))


def agreed_mixed(certificate: Certificate[MixedProof]) -> Certificate[MixedProof]:
    """Return a mixed team's certificate that takes off no less for its pairs than the check does."""
    failures, near = wrong_mixed(certificate, certificate.problem)
    if failures or near <= certificate.proof.near:
        return certificate
    # Elsewhere sums may be rounded in another order.
    return changed(certificate, near=min(1.0, near * (1.0 + 1e-9)))
