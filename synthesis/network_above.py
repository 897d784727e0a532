"""Upper ends: at most how often deployed networks succeed.

The networks are certified for the *opposite* task, whose automaton is that of the task with the other states accepting
at the horizon. No run satisfies both. So one minus a lower bound for the opposite is an upper bound for the task, and
relation, search and check are those of all networks (docs/theory/networks.md, "The upper end").
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..envs.agents import tree_text
from ..envs.problem import Problem, Specification
from ..envs.suite import as_problem
from .cells import CellCounts
from .certificates import Certificate, rounded_up
from .checking import check, wrong_opposite
from .raw_networks import certify_network, differences


@dataclass(frozen=True, eq=False, repr=False)
class UpperEnd:
    """An upper bound on the success probability of networks as they are deployed.

    Parameters
    ----------
    problem : Problem
    opposite : Certificate
        About the same networks and the opposite task.
    """

    problem: Problem
    opposite: Certificate

    @property
    def upper_bound(self) -> float:
        """Upper bound on the probability that the networks satisfy the task, from the problem's start."""
        return min(1.0, float(np.nextafter(1.0 - self.opposite.lower_bound, 2.0)))

    def __repr__(self) -> str:
        rows = [("bound", f"P <= {rounded_up(self.upper_bound, 6)}"), ("method", self.opposite.method)]
        return tree_text(f"UpperEnd of {self.problem.name!r}", rows)


def opposite_of(problem: Problem) -> Problem:
    """Return the problem whose task is judged at the horizon, and satisfied where the one of ``problem`` is not."""
    automaton = replace(problem.automaton, semantics="finite-trace", accepting=~problem.automaton.accepting)
    return Problem(
        name=f"not {problem.name}",
        horizon=problem.horizon,
        agents=problem.agents,
        propositions=problem.declared,
        specification=Specification(automaton=automaton),
    )


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
    found = certify_network(opposite_of(problem), actor, cells, relation=relation, targets_per_cell=targets_per_cell)
    assert isinstance(found.certificate, Certificate)
    return UpperEnd(problem, found.certificate)


def wrong_upper_end(end: UpperEnd, actor: Any = None) -> list[str]:
    """Return why an upper end does not hold; empty if it was verified by the code of the check.

    The opposite task is compared with the problem, and its certificate is checked like any other. With an ``actor``,
    its networks are compared with those of the certificate.
    """
    failures = wrong_opposite(end.problem, end.opposite.problem)
    if not failures:
        failures = list(check(end.opposite).failures)
    if not failures and actor is not None:
        failures = differences(end.opposite, actor)
    return failures
