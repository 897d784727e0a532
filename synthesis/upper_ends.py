"""Upper ends: at most how often certified controllers, or deployed networks, succeed.

They are certified for the *opposite* task, whose automaton is that of the task with the other states accepting at the
horizon. No run satisfies both. So one minus a lower bound for the opposite is an upper bound for the task, and
relation, search and check are those of all certificates (docs/theory/bounds.md, "The other end of any certificate").
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..envs.agents import tree_text
from ..envs.problem import Problem, Specification, refuse_joint_noise
from ..envs.suite import as_problem
from .bridges import certifiable
from .cells import CellCounts
from .certificates import Certificate, PairsCertificate, TeamCertificate, rounded_up
from .checking import check, other_controllers, wrong_opposite, wrong_team
from .raw_networks import certify_network, differences
from .synthesize import synthesize


@dataclass(frozen=True, eq=False, repr=False)
class UpperEnd:
    """An upper bound on the success probability of certified controllers, or of networks as they are deployed.

    Parameters
    ----------
    problem : Problem
    opposite : Certificate
        About the same controllers, or networks, and the opposite task.
    """

    problem: Problem
    opposite: Certificate

    @property
    def upper_bound(self) -> float:
        """Upper bound on the probability that the task is satisfied, from the problem's start."""
        return min(1.0, float(np.nextafter(1.0 - self.opposite.lower_bound, 2.0)))

    def __repr__(self) -> str:
        rows = [("bound", f"P <= {rounded_up(self.upper_bound, 6)}"), ("method", self.opposite.method)]
        return tree_text(f"UpperEnd of {self.problem.name!r}", rows)


def opposite_of(problem: Problem) -> Problem:
    """Return the problem whose task is judged at the horizon, and satisfied where the one of ``problem`` is not."""
    refuse_joint_noise(problem)
    automaton = replace(problem.automaton, semantics="finite-trace", accepting=~problem.automaton.accepting)
    return Problem(
        name=f"not {problem.name}",
        horizon=problem.horizon,
        agents=problem.written_agents,
        propositions=problem.declared,
        specification=Specification(automaton=automaton),
    )


def bound_above(certificate: Any) -> UpperEnd:
    """Compute a certified upper bound on how often the controllers of a certificate satisfy its task.

    It is for all relations with cells, ``linear`` and ``boxes`` among them, whose certificates have no other upper
    end; it takes about as long as an evaluation. Runs that leave the workspaces count as if they might have succeeded.

    Of the certificate its policies, cells, relations and their settings are taken, and evaluated anew;
    ``wrong_upper_end`` verifies what comes out by the code of the check.

    Parameters
    ----------
    certificate : Certificate or TeamCertificate
        About one task. For a joint agent on a grid the end is about the problem of the joint agent, which is the team.

    Raises
    ------
    ValueError
        If it is of another kind, or about networks (``bound_network_above``).
    """
    if isinstance(certificate, TeamCertificate) and isinstance(certificate.base, Certificate):
        if wrong := wrong_team(certificate.problem, certificate.base.problem):
            raise ValueError(f"`certificate`: expected a joint agent that is the team, got another: {wrong[0]}")
        certificate = certificate.base
    if isinstance(certificate, PairsCertificate):
        raise ValueError(
            "`certificate`: expected one whose policies were evaluated on the whole task, got one by subtraction: what "
            "is subtracted for pairs of agents bounds no success from above beyond its `gap`"
        )
    if not isinstance(certificate, Certificate) or any("network" in part.relation for part in certificate.agents):
        raise ValueError(
            "`certificate`: expected one of a single task on cells, of controllers and not of networks, got another "
            "kind; independent tasks have one for each part, networks `bound_network_above`"
        )
    try:
        found = synthesize(opposite_of(certificate.problem), start=certificate, max_sweeps=0)
    except ValueError as error:
        raise ValueError(f"`certificate`: its policies cannot be evaluated for the opposite task: {error}") from error
    assert isinstance(found.certificate, Certificate)
    end = UpperEnd(certificate.problem, found.certificate)
    failures = other_controllers(certificate, end.opposite)
    if failures:
        raise ValueError(f"`certificate`: its controllers could not be kept for the opposite task: {failures[0]}")
    return end


def bound_network_above(
    problem: Any, actor: Any, cells: CellCounts = None, *, relation: str = "auto", targets_per_cell: int | None = None
) -> UpperEnd:
    """Compute a certified upper bound on the satisfaction probability of networks as they are deployed.

    Runs that leave the workspaces count as if they might have succeeded.

    Parameters
    ----------
    problem, actor, cells, relation, targets_per_cell
        As for ``certify_network``.

    Raises
    ------
    ValueError
        As for ``certify_network``.
    """
    problem = as_problem(problem)
    actor = certifiable(problem, actor)
    found = certify_network(opposite_of(problem), actor, cells, relation=relation, targets_per_cell=targets_per_cell)
    assert isinstance(found.certificate, Certificate)
    return UpperEnd(problem, found.certificate)


def wrong_upper_end(end: UpperEnd, of: Any = None) -> list[str]:
    """Return why an upper end does not hold; empty if it was verified by the code of the check.

    The opposite task is compared with the problem, and its certificate is checked like any other. With ``of``, a
    certificate or an actor, its controllers or networks are compared with those of the upper end. Without it, the end
    is verified for the controllers in ``end.opposite``, whosever they are.
    """
    failures = wrong_opposite(end.problem, end.opposite.problem)
    if not failures:
        failures = list(check(end.opposite).failures)
    if not failures and isinstance(of, TeamCertificate) and isinstance(of.base, Certificate):
        failures, of = wrong_team(of.problem, of.base.problem), of.base
    if not failures and isinstance(of, Certificate):
        # Which states are undecided depends on the task: controllers of another one may differ where it matters here.
        is_same = of.problem.fingerprint == end.problem.fingerprint
        failures = (
            other_controllers(of, end.opposite) if is_same else ["it is for another problem than the certificate"]
        )
    elif not failures and of is not None:
        failures = differences(end.opposite, of)
    return failures
