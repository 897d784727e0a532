"""Paths of some agents of a team whose other agents are on grids: all are planned together, and some are kept.

The plan of the whole team says when who does what, and keeps apart those who must. What is certified of the agents that
are kept is that they keep the letters of their paths; where they are then is handed over for what others ask of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...envs.problem import Problem
from ..cells import FloatArray, RelationRefused
from ..certificates import AlongPath, Certificate, PathProof
from ..path_bounds import pair_limits
from .counted_work import CountedWork
from .nonlinear_search import Found
from .nonlinear_team import WORTHLESS, PlansOf, found_for_team
from .team_search import TeamSearch

Whereabouts = tuple[FloatArray, FloatArray, FloatArray]
"""Outputs of an agent along its path: nominal values and drifts (S + 1, p), and covariances (S + 1, p, p)."""


def paths_of_some(
    problem: Problem,
    agents: Sequence[int],
    part_of: Callable[[int], Problem],
    sources: Sequence[PlansOf],
    work: CountedWork,
) -> tuple[AlongPath, list[Whereabouts]]:
    """Return a certificate that some agents keep the letters of their paths, and where they are along these.

    Parameters
    ----------
    problem : Problem
        The whole problem.
    agents : sequence of int
        Those that are kept.
    part_of : callable
        Their problem, for a number of steps.
    sources : sequence of callables
        Plans of a problem, as for ``nonlinear_certificate``.
    work : CountedWork

    Raises
    ------
    RelationRefused
        If no paths were found that these agents keep with a probability that is worth anything.
    """
    tried, best = found_for_team(problem, [plans(problem) for plans in sources], work)
    part = part_of(len(best.letters) - 1)
    names = problem.automaton.propositions
    columns = [names.index(name) for name in part.automaton.propositions]
    letters = np.ascontiguousarray(best.letters[:, columns])
    kept: list[Found] = [best.found[i] for i in agents]
    faces = np.full(best.letters.shape, -1)
    for one in kept:
        faces = np.where(one.faces >= 0, one.faces, faces)
    faces = np.ascontiguousarray(faces[:, columns])
    search = TeamSearch(part, work)
    team = search.judged(kept, faces, pair_limits(part, letters))
    failure = min(1.0, team.failure * (1.0 + 1e-9))
    if failure >= WORTHLESS:
        raise RelationRefused(f"agents along paths keep to them with next to no probability: {team.weakest}")
    settings = {"relation": "path", "jumps": list(best.times), "candidates": tried, "weakest": team.weakest}
    normals = team.rows.normals if part.labeling.pairs else None
    paths = tuple(one.path for one in team.found)
    certificate = Certificate(part, PathProof(paths, letters, faces, failure, normals), settings)
    return certificate, [_whereabouts(one) for one in team.found]


def _whereabouts(found: Found) -> Whereabouts:
    """Return where an agent is along its path."""
    nominal, gains = found.nominal, found.feedback.gains[0]
    (A, B), (outputs, matrices) = nominal.linear, nominal.outputs
    d, noises = A.shape[1], nominal.noises
    covariance, result = np.zeros((d, d)), [np.zeros((d, d))]
    for t in range(len(A)):
        closed = A[t] + B[t] @ gains[t]
        covariance = closed @ covariance @ closed.T + noises[t]
        result.append(covariance)
    each = np.einsum("tpd,tde,tqe->tpq", matrices, np.array(result), matrices)
    _, drift, shift = found.spreads.outputs
    return outputs + shift, drift, each
