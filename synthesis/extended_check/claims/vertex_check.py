"""Claims on grids whose vertices have inputs, of one agent and of teams: what fails at most is computed again."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....envs.tasks.problem import Problem
from ...certificates.proofs import (
    Certificate,
    CheckReport,
    NotCanonicalError,
    VertexProof,
    VertexTeamProof,
    canonical_problem,
)
from ...checker import Refused, Unreadable, bound_of, read_problem
from ..vertex_grids import failure_of, team_failure


def check_vertices(certificate: Certificate[VertexProof], problem: Problem) -> CheckReport:
    """Verify a certificate on a grid of vertices: backup by backup, for the problem in the checker's form."""
    grid, laws = certificate.proof.grid, problem.agents[0].laws

    def failure() -> float:
        checked = read_problem({"problem": canonical_problem(problem)})
        held = grid.edges, grid.inputs, grid.laws, grid.jumps, grid.near
        return failure_of(checked, *held, laws, grid.window, grid.matrix)

    return _by_recomputing(certificate, problem, failure)


def check_vertex_team(certificate: Certificate[VertexTeamProof], problem: Problem) -> CheckReport:
    """Verify a certificate on grids of vertices of a team: term by term, for the problem in the checker's form."""
    proof, laws = certificate.proof, [agent.laws for agent in problem.agents]

    def failure() -> float:
        checked = read_problem({"problem": canonical_problem(problem)})
        sets, guards = (proof.sets, proof.start_sets), (proof.guards, proof.start)
        return team_failure(checked, proof.grids, sets, guards, proof.tree, laws)

    return _by_recomputing(certificate, problem, failure)


def _by_recomputing(certificate: Certificate, problem: Problem, recompute: Callable[[], float]) -> CheckReport:
    """Verify a claim by an upper bound on the failure that a function finds."""
    failures, failure = list[str](), 1.0
    if certificate.fingerprint != problem.fingerprint:
        failures.append("it was made for another problem (the fingerprints differ)")
    if not failures:
        try:
            with np.errstate(all="ignore"):
                failure = recompute()
        except (NotCanonicalError, Refused, Unreadable) as reason:
            failures.append(str(reason))
    if not failures and not failure <= certificate.proof.failure:
        claimed = f"it says that it fails with probability {certificate.proof.failure:.6g} at most"
        failures.append(f"{claimed}, but what was recomputed is {failure:.6g}")
    recomputed = float("nan") if failures else bound_of(failure)
    return CheckReport(not failures, certificate.lower_bound, recomputed, tuple(failures))
