"""Verification of a simulation relation from the matrices alone, whoever found it.

For every agent: the relation is invariant under the coupled step, the abstract means are what the relation says, every
input that a policy can ask for is admissible from every related state, and ``delta`` is at least the probability that
the coupling fails. Comparisons carry their tolerance on the restrictive side.
"""

from __future__ import annotations

import numpy as np
from scipy.special import erf

from ...envs.agents import LinearAgent
from ..cells import FloatArray
from ..certificates import AgentPart
from ..relations import (
    CoupledRelation,
    disturbance_of,
    ellipsoid_factor,
    ellipsoid_failure,
    ellipsoid_is_invariant,
    ellipsoid_support,
    tube_generators,
)


def verify_relation(agent: LinearAgent, part: AgentPart) -> list[str]:
    """What is wrong with the relation of one agent; an empty list if it holds.

    Parameters
    ----------
    agent : LinearAgent
        The continuous agent.
    part : AgentPart
        Grid, lattice, relation and policy to be verified.
    """
    return _verify_exact(agent, part) if part.relation["kind"] == "exact" else _verify_coupled(agent, part)


def _verify_exact(agent: LinearAgent, part: AgentPart) -> list[str]:
    """Every target is reached by an admissible input from every point of its cell."""
    inverse = np.linalg.inv(part.coordinates)
    A, B, offset = inverse @ agent.A @ part.coordinates, inverse @ agent.B, inverse @ agent.offset
    middle = 0.5 * (agent.input_box.low + agent.input_box.high)
    to_input = np.linalg.pinv(B)
    if np.max(np.abs(B @ to_input - np.eye(len(B)))) > 1e-9:
        return ["its inputs do not reach every mean"]
    spread = part.grid.half_widths @ np.abs(to_input @ A).T
    rows = part.policy.reshape(-1, part.policy.shape[-1])
    for policy in np.unique(rows, axis=0) if len(rows) > 1 else rows:
        index = np.unravel_index(np.maximum(policy, 0), tuple(len(axis) for axis in part.lattice))
        goal = np.stack([axis[k] for axis, k in zip(part.lattice, index, strict=True)], axis=1)
        inputs = (goal - part.grid.centres @ A.T - offset - B @ middle) @ to_input.T + middle
        beyond = (inputs - spread < agent.input_box.low) | (inputs + spread > agent.input_box.high)
        if np.any(beyond & (policy >= 0)[:, None]):
            return ["it is asked for inputs beyond its input box"]
    return []


def _verify_coupled(agent: LinearAgent, part: AgentPart) -> list[str]:
    """Invariance, coupling, input reserve and means of a relation with memory."""
    try:
        relation = part.relation_of(agent)
    except ValueError as error:
        return [str(error)]
    if not isinstance(relation, CoupledRelation):
        return ["its relation is of another kind"]
    inverse = np.linalg.inv(part.coordinates)
    A, B, offset = inverse @ agent.A @ part.coordinates, inverse @ agent.B, inverse @ agent.offset
    if part.menu is None or part.menu.shape[1] != len(relation.inputs):
        return ["its menu does not list its inputs"]
    means = (part.grid.centres @ A.T + offset)[:, None, :] + (relation.inputs @ B.T)[None]
    index = np.unravel_index(part.menu, tuple(len(axis) for axis in part.lattice))
    points = np.stack([axis[k] for axis, k in zip(part.lattice, index, strict=True)], axis=-1)
    half = np.array([0.5 * np.max(np.diff(edges)) for edges in part.grid.edges])
    snapped = np.max(np.abs(points - means), axis=(0, 1))
    closed = A + B @ relation.feedback
    if relation.shape is not None:
        return _verify_ellipsoid(agent, part, relation, relation.shape, closed - relation.coupling, snapped)
    failures = _verify_tube(agent, part, closed, half, snapped) if part.relation["kind"] == "tube" else []
    if part.relation["kind"] == "paper":
        failures = _verify_scalar(agent, relation, closed, half, snapped)
    reserve = np.abs(_generators(part, closed) @ relation.feedback.T).sum(axis=0)
    return failures + _verify_reserve(agent, relation, reserve)


def _verify_reserve(agent: LinearAgent, relation: CoupledRelation, reserve: FloatArray) -> list[str]:
    """Every abstract input leaves ``reserve`` (m,) to both sides."""
    low, high = relation.inputs - reserve, relation.inputs + reserve
    if np.any(low < agent.input_box.low) or np.any(high > agent.input_box.high):
        return ["its abstract inputs leave no room for the feedback"]
    return []


def _verify_scalar(
    agent: LinearAgent, relation: CoupledRelation, closed: FloatArray, half: FloatArray, snapped: FloatArray
) -> list[str]:
    """``|a_K - F| epsilon + h/2 <= epsilon`` and ``delta >= 2 Phi(|F| epsilon / (2 sigma)) - 1``."""
    epsilon, coupling = float(relation.reach[0]), float(relation.coupling[0, 0])
    deviation = float(np.sqrt(agent.noise_covariance[0, 0]))
    failures = []
    if abs(closed[0, 0] - coupling) * epsilon + half[0] > epsilon * (1 + 1e-12):
        failures.append("its relation is not invariant")
    if relation.delta < float(erf(abs(coupling) * epsilon / (2.0 * np.sqrt(2.0) * deviation))) * (1 - 1e-14):
        failures.append("its delta is smaller than the probability that the coupling fails")
    if snapped[0] > 1e-9 * half[0]:
        failures.append("its means are not those of its dynamics")
    return failures


def _verify_tube(
    agent: LinearAgent, part: AgentPart, closed: FloatArray, half: FloatArray, snapped: FloatArray
) -> list[str]:
    """``(A + B K)^s W inside alpha W`` with alpha < 1 for the zonotope used, W as large as cells and snapping are."""
    generators = _generators(part, closed)
    snap = np.array(part.relation["snap"], dtype=float)
    failures = []
    if np.any(snapped > snap * (1 + 1e-9) + 1e-9 * half):
        failures.append("its means are snapped by more than its tube allows for")
    # E is invariant if the support of (A + B K) E + W is not larger than that of E along every facet normal; for the
    # zonotope sum_{k<s} M^k W / (1 - alpha) that is what M^s W inside alpha W says, checked on the generators
    d = len(half)
    steps = len(generators) // d
    first, last = generators[:d], generators[-d:]
    scale = np.diag(first) / (half + snap)
    alpha = 1.0 - 1.0 / np.min(scale)
    beyond = np.abs(closed @ last.T / np.min(scale)).sum(axis=1)
    if steps < 1 or not 0.0 <= alpha < 1.0 or np.any(beyond > alpha * (half + snap) * (1 + 2e-9) + 1e-15):
        failures.append("its tube is not invariant")
    return failures


def _verify_ellipsoid(
    agent: LinearAgent,
    part: AgentPart,
    relation: CoupledRelation,
    shape: FloatArray,
    closed: FloatArray,
    snapped: FloatArray,
) -> list[str]:
    """Invariance for every vertex of W, coupling, margins of labels and inputs; ``closed`` is ``A + B K - F``."""
    epsilon, snap = relation.epsilon, relation.snap
    if ellipsoid_factor(shape) is None or not epsilon > 0:
        return ["its ellipsoid is none: its matrix is not positive definite, or badly conditioned"]
    failures = []
    if np.any(snap < 0) or np.any(snapped > snap + 1e-9 * disturbance_of(part.grid, None) / 2):
        failures.append("its means are snapped by more than its ellipsoid allows for")
    if not ellipsoid_is_invariant(shape, epsilon, closed, disturbance_of(part.grid, snap)):
        failures.append("its ellipsoid was not proved invariant")
    inverse = np.linalg.inv(part.coordinates)
    variances = np.diag(inverse @ agent.noise_covariance @ inverse.T)
    if relation.delta < ellipsoid_failure(shape, epsilon, relation.coupling, variances):
        failures.append("its delta is smaller than the probability that the coupling fails")
    if np.any(relation.state_reach < ellipsoid_support(shape, epsilon, part.coordinates)):
        failures.append("the box around its ellipsoid is too small")
    return failures + _verify_reserve(agent, relation, ellipsoid_support(shape, epsilon, relation.feedback))


def _generators(part: AgentPart, closed: FloatArray) -> FloatArray:
    """Generators (G, d) of the error set."""
    if part.relation["kind"] == "paper":
        half = 0.5 * float(np.max(np.diff(part.grid.edges[0])))
        return np.array([[max(float(part.relation["epsilon"]), half)]])
    found = tube_generators(closed, disturbance_of(part.grid, np.array(part.relation["snap"], dtype=float)))
    return np.full((1, len(closed)), np.inf) if found is None else found
