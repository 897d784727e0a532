"""What is proved from other starts for the controllers of a certificate that speaks of its own.

A path certificate is about one start, but its controllers can begin anywhere, and the check can be asked what it proves
of them there: for a box of starts around its own, of a linear agent along the nominal path to
which ``u = ubar + K (x - xbar)`` leads from there (the same inputs, written about another path). Nothing is taken over
from the certificate's own claim. What cannot be asked, or not for long, is not known (NaN).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import LinearAgent, with_matrices
from ....synthesis.certificates.proofs import (
    AgentPath,
    AlongPath,
    Certificate,
    changed,
    member_agents,
    members_of,
    path_under,
)
from ....synthesis.extended_check.claims import check
from ...statistical_tests import start_box

MOST_WORK = 4000
"""States of a path times starts that are checked: about half a minute of one core."""

HALVINGS = 5
"""How often the way to the edge of the workspace is halved where a bound is looked for around a start."""


def bounds_from(certificate: Any, starts: NDArray[Any]) -> NDArray[Any]:
    """Return lower bounds (N,) from joint starts (N, D) for the controllers of a certificate; NaN where none is known.

    At the certificate's own start, and in a box of them, that is at least its own bound.
    """
    low, high = start_box(certificate.problem)
    inside = np.all((starts >= low) & (starts <= high), axis=1)
    found = _elsewhere(certificate, starts)
    own = getattr(certificate.proof, "least_bound", certificate.lower_bound)  # of a mean, what holds from every start
    return np.where(inside, np.fmax(found, own), found)


def _elsewhere(certificate: Any, starts: NDArray[Any]) -> NDArray[Any]:
    """Return what is proved from starts, or NaN."""
    if not along_paths(certificate):
        return np.full(len(starts), np.nan)
    if path_under(certificate) is not None:
        return np.array([_proved(certificate, start) for start in starts])
    # Of independent tasks only those whose start differs are asked about.
    product = np.ones(len(starts))
    for part, columns in zip(members_of(certificate), task_columns(certificate), strict=True):
        own, numbers = np.unique(starts[:, columns], axis=0, return_inverse=True)
        product *= bounds_from(part, own)[numbers.ravel()] * (1.0 - 2.0**-50)
    return product


def task_columns(certificate: Any) -> list[NDArray[np.int64]]:
    """Return which components of a joint state belong to each task."""
    components = [np.arange(columns.start, columns.stop) for columns in certificate.problem.columns]
    return [np.concatenate([components[i] for i in agents]) for agents in member_agents(certificate)]


def along_paths(certificate: Any) -> bool:
    """Whether a certificate, or every part of it, is along a path, of one agent or of a joint one."""
    return all(path_under(member) is not None for member in members_of(certificate))


def work_of(certificate: Any) -> int:
    """Return how many states of paths a check goes through, of the largest part."""
    paths = [path_under(member) for member in members_of(certificate) if path_under(member) is not None]
    return max(path.proof.n_steps * path.problem.n_states for path in paths)


def reach(certificate: Any, axes: tuple[int, ...]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return a box (low, high) around the start, as far along each axis as something is proved, and a little more."""
    agents = certificate.problem.agents
    edges = [np.concatenate([getattr(agent, name) for agent in agents]) for name in ("state_low", "state_high")]
    low, high = (edge.astype(float) for edge in edges)
    middle = 0.5 * np.sum(start_box(certificate.problem), axis=0)
    for axis in axes:
        for side in (low, high):
            way, share = side[axis] - middle[axis], 1.0
            for _ in range(HALVINGS):
                start = middle.copy()
                start[axis] += 0.999 * share * way
                if bounds_from(certificate, start[None])[0] > 0.0:
                    break
                share *= 0.5
            side[axis] = middle[axis] + min(1.0, 1.5 * share) * way
    return low, high


def _proved(certificate: Any, start: NDArray[Any]) -> float:
    """Return the lower bound that the check proves from a start (D,); 0 if it proves nothing."""
    path = begun_at(path_under(certificate), start)
    # A nominal trajectory begins where it does: it is asked about a box of starts around that place.
    first = np.concatenate([own.states[0] for own in path.proof.paths])
    off = np.abs(start - first)
    box = {
        "initial_low": np.minimum(first - off, start).tolist(),
        "initial_high": np.maximum(first + off, start).tolist(),
    }
    moved: Certificate = replace(path, problem=path.problem.replace(**box)) if off.any() else path
    if path_under(certificate) is not certificate:
        problem = certificate.problem.replace(**box if off.any() else {"initial_state": start.tolist()})
        moved = changed(replace(certificate, problem=problem), base=moved)
    report = check(moved)
    # What it computes is rounded to the nearest number: the one below it is no more.
    return max(0.0, math.nextafter(report.recomputed, 0.0)) if report else 0.0


def begun_at(certificate: AlongPath, start: NDArray[Any]) -> AlongPath:
    """Return a certificate that claims nothing, for the same inputs from another start (D,)."""
    problem, paths = certificate.problem, []
    for agent, path, columns in zip(problem.agents, certificate.proof.paths, problem.columns, strict=True):
        is_linear = agent.is_affine and certificate.proof.networks is None
        paths.append(_from(with_matrices(agent), path, start[columns]) if is_linear else path)
    moved = replace(certificate, problem=problem.replace(initial_state=start.tolist()))
    return changed(moved, paths=tuple(paths), failure=1.0)


def _from(agent: LinearAgent, path: AgentPath, start: NDArray[Any]) -> AgentPath:
    """Return the nominal path of a linear agent that its feedback gives from another start, without noise."""
    inputs, states = np.empty_like(path.inputs), np.empty_like(path.states)
    states[0] = start
    for t, (u, gain) in enumerate(zip(path.inputs, path.gains, strict=True)):
        inputs[t] = u + gain @ (states[t] - path.states[t])
        states[t + 1] = agent.A @ states[t] + agent.B @ inputs[t] + agent.offset
    return replace(path, inputs=inputs, states=states)
