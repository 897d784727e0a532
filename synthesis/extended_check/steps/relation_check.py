"""Verification of a simulation relation from the matrices alone, whoever found it.

For every agent: the error stays in a set E under the coupled step, rounding of the controller included; the abstract
means are what the relation says; every input that a policy can ask for is admissible from every related state; and
``delta`` is at least the probability that the coupling fails. Comparisons carry their tolerance on the restrictive
side. The set of a tube is not the one of the search: every number of terms gives an invariant zonotope, so does what
they have in common, and its supports are computed here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from ....envs.systems.agents import AnyAgent, LinearAgent
from ...certificates.cell_probabilities import AgentRecord, state
from ...relations.grids import FloatArray, lattice_axes, linear_agent
from ...relations.kinds import (
    BoxRelation,
    CoupledRelation,
    ExactRelation,
    MapRelation,
    Relation,
    SymbolicTargets,
    ellipsoid_factor,
    ellipsoid_failure,
    ellipsoid_is_invariant,
    ellipsoid_support,
)
from .execution import Execution, targets_alone
from .geometry import cell_boxes
from .target_enclosures import wrong_targets

MOST_TERMS = 400
"""Most terms of the zonotopes around a tube."""

OUTWARD = 1.0 + 1e-12
"""Widening of half widths and supports, far above their rounding and far below that of the relations themselves."""


WIDENED = 1.0 + 1e-9
"""Widening of the interval of a ``paper`` relation, which leaves room for rounding; its margins are as wide."""


def verify_relation(agent: AnyAgent, part: AgentRecord, relation: Relation, execution: Execution) -> list[str]:
    """What is wrong with the relation of one agent; an empty list if it holds.

    Parameters
    ----------
    agent : AnyAgent
        The continuous agent.
    part : AgentPart
        Grid, lattice and policy to be verified.
    relation : Relation
        Of its controller.
    execution : Execution
        What its controller may be off by.
    """
    return VERIFIED[type(relation)](agent, part, relation, execution)


def wrong_for_uneven_noise(agent: AnyAgent, part: AgentRecord) -> list[str]:
    """What is wrong with the grid of an agent whose noise has scales, or that has states without noise."""
    if part.relation["kind"] != "boxes":
        return [f"the relation of agent `{agent.name}` is not for noise that is larger in places, or nowhere at all"]
    if not np.array_equal(part.coordinates, np.eye(agent.n_states)):
        return [f"the grid axes of agent `{agent.name}` are not its states"]
    for axis, points in zip(lattice_axes(agent), part.lattice, strict=True):
        numbers = np.arange(-1.0, part.grid.shape[axis.state] + 1.0)
        if not axis.is_interpolated and not np.array_equal(points, numbers):
            return [f"the lattice of agent `{agent.name}` does not number the cells of a state without noise"]
    return []


def label_margin(part: AgentRecord, relation: Relation, execution: Execution) -> FloatArray | None:
    """How far (d,) related states may be from the centres of their cells, in state units; None if in the same cell."""
    if relation.is_cell:
        return None
    return error_support(part, relation, execution, part.coordinates)  # type: ignore[arg-type]  # coupled


def error_support(part: AgentRecord, relation: CoupledRelation, execution: Execution, rows: FloatArray) -> FloatArray:
    """Upper bounds (n,) on ``rows @ e`` for all errors of a coupled relation, rows (n, d) in grid coordinates."""
    if relation.shape is not None:
        support = ellipsoid_support(relation.shape, relation.epsilon, rows)
        state("ellipsoid support", relation.shape, relation.epsilon, rows, support)
        return support
    if relation.kind == "paper":
        return np.asarray(np.abs(rows) @ relation.reach * WIDENED)
    disturbance = _disturbance(part, relation, execution)
    support = _tube_support(relation.A + relation.B @ relation.feedback, disturbance, rows)
    state("tube", relation, disturbance, rows, support)
    return support


def _verify_maps(agent: AnyAgent, part: AgentRecord, relation: MapRelation, execution: Execution) -> list[str]:
    """Every choice is an input of the box, or a target that admissible inputs reach from all of its cell."""
    if np.any((relation.input_set < agent.input_box.low) | (relation.input_set > agent.input_box.high)):
        return ["its menu holds inputs beyond its input box"]
    if relation.mean_targets is None:
        return []
    aimed = targets_alone(part)
    return VERIFIED[type(relation.mean_targets)](agent, aimed, relation.mean_targets, execution)


def _verify_aims(agent: AnyAgent, part: AgentRecord, relation: SymbolicTargets, execution: Execution) -> list[str]:
    """Expressions are solved for admissible inputs from every point of their cells."""
    return wrong_targets(relation.agent, part, relation)


def _verify_exact(agent: AnyAgent, part: AgentRecord, relation: ExactRelation, execution: Execution) -> list[str]:
    """Every target is reached by an admissible input from every point of its cell."""
    return _verify_targets(linear_agent(agent, "exact"), part, relation, part.policy, execution)


def _verify_boxes(agent: AnyAgent, part: AgentRecord, relation: BoxRelation, execution: Execution) -> list[str]:
    """Every input that is chosen is admissible at every point of its cells, with what is fed back there."""
    input_set, gains = (np.array(part.relation[name], dtype=float) for name in ("menu", "gains"))
    if not agent.is_affine and np.any(gains):
        return ["it feeds states back inside its cells, which boxes of expressions do not know of"]
    low, high = cell_boxes(part)
    rows = part.policy.reshape(-1, part.policy.shape[-1])
    for choice in np.unique(rows[rows >= 0]):
        widest = 0.5 * np.max((high - low)[np.any(rows == choice, axis=0)], axis=0) * OUTWARD
        fed = np.abs(gains[choice]) @ widest + execution.inputs * np.any(gains[choice], axis=1)
        if np.any((input_set[choice] - fed < agent.input_box.low) | (input_set[choice] + fed > agent.input_box.high)):
            return ["its menu holds inputs beyond its input box"]
    return []


def _verify_targets(
    agent: LinearAgent, part: AgentRecord, relation: ExactRelation, choices: NDArray[Any], execution: Execution
) -> list[str]:
    """Every target is reached by an admissible input from every point of its cell."""
    state("targets", agent, part, relation, choices, execution.inputs)
    R, A = relation.right_inverse, relation.A
    low, high = cell_boxes(part)
    centres = 0.5 * (low + high)
    spread = (0.5 * (high - low) * OUTWARD) @ np.abs(R @ A).T + execution.inputs
    rows = choices.reshape(-1, choices.shape[-1])
    for policy in np.unique(rows, axis=0) if len(rows) > 1 else rows:
        index = np.unravel_index(np.maximum(policy, 0), tuple(len(axis) for axis in part.lattice))
        goal = np.stack([axis[k] for axis, k in zip(part.lattice, index, strict=True)], axis=1)
        inputs = (goal - centres @ relation.A.T - relation.drift) @ R.T + relation.input_centre
        beyond = (inputs - spread < agent.input_box.low) | (inputs + spread > agent.input_box.high)
        if np.any(beyond & (policy >= 0)[:, None]):
            return ["it is asked for inputs beyond its input box"]
    return []


def _verify_coupled(agent: AnyAgent, part: AgentRecord, relation: CoupledRelation, execution: Execution) -> list[str]:
    """Invariance, coupling, input reserve and means of a relation with memory."""
    agent = linear_agent(agent, relation.kind)
    if part.input_set is None or part.input_set.shape[1] != len(relation.inputs):
        return ["its menu does not list its inputs"]
    disturbance = _disturbance(part, relation, execution)
    failures = []
    if not np.all(np.isfinite(disturbance)):
        return ["its means are not those of its dynamics"]
    closed = relation.A + relation.B @ relation.feedback - relation.coupling
    variances = np.diag(_grid_noise(agent, part))
    if np.any(np.abs(relation.covariance - variances) > 1e-12 * variances):
        failures.append("its noise is not that of its agent")
    if relation.shape is not None:
        failures += _verify_ellipsoid(relation, relation.shape, closed, disturbance, variances)
    elif relation.kind == "paper":
        failures += _verify_interval(part, relation, closed, disturbance, variances)
    elif np.any(relation.coupling):
        failures.append("its tube is said to have a coupling")
    reserve = error_support(part, relation, execution, relation.feedback) + execution.inputs
    if not np.all(np.isfinite(reserve)):
        return [*failures, "its tube is not invariant"]
    low, high = relation.inputs - reserve, relation.inputs + reserve
    if np.any(low < agent.input_box.low) or np.any(high > agent.input_box.high):
        failures.append("its abstract inputs leave no room for the feedback")
    return failures


def _disturbance(part: AgentRecord, relation: CoupledRelation, execution: Execution) -> FloatArray:
    """Half widths (d,) of W: half the largest cell, what means are snapped by, and rounding."""
    assert part.input_set is not None
    low, high = cell_boxes(part)
    means = (0.5 * (low + high) @ relation.A.T + relation.drift)[:, None, :] + (relation.inputs @ relation.B.T)[None]
    index = np.unravel_index(part.input_set, tuple(len(axis) for axis in part.lattice))
    points = np.stack([axis[k] for axis, k in zip(part.lattice, index, strict=True)], axis=-1)
    moving = np.any(part.policy >= 0, axis=(0, 1))  # in other cells the value is 0, and nothing is promised
    snapped = np.max(np.abs(points - means)[moving], axis=(0, 1), initial=0.0)
    result = np.asarray((0.5 * np.max(high - low, axis=0) + snapped) * OUTWARD + execution.disturbance)
    state("disturbance", part, relation, execution.disturbance, result)
    return result


def _tube_support(closed: FloatArray, disturbance: FloatArray, rows: FloatArray) -> FloatArray:
    """Upper bounds (n,) on ``rows @ e`` over an invariant set; infinite if none was found.

    For every s with ``closed^s W inside alpha W``, ``alpha < 1``, the zonotope of the first s powers over
    ``1 - alpha`` is invariant; so is the intersection of all of them.
    """
    power, total, best = np.diag(disturbance), np.zeros(len(rows)), np.full(len(rows), np.inf)
    for _ in range(MOST_TERMS):
        total = total + np.abs(rows @ power).sum(axis=1)
        power = closed @ power
        alpha = float(np.max(np.abs(power).sum(axis=1) / disturbance)) * OUTWARD
        if alpha < 1.0:
            best = np.minimum(best, total / (1.0 - alpha))
        if alpha < 1e-15 or not np.isfinite(alpha):
            break
    return np.asarray(best * (1.0 + 1e-11))


def _verify_interval(
    part: AgentRecord, relation: CoupledRelation, closed: FloatArray, disturbance: FloatArray, variances: FloatArray
) -> list[str]:
    """``|a_K - F| epsilon + w <= epsilon`` and ``delta >= 2 Phi(|F| epsilon / (2 sigma)) - 1``, epsilon a little wider.

    Where related states are those of one cell, half a cell takes the place of epsilon, and ``(a_K - F) e`` is charged
    as a disturbance (``Execution``).
    """
    epsilon, coupling = float(relation.reach[0]) * WIDENED, abs(float(relation.coupling[0, 0]))
    failures = []
    if relation.is_cell:
        kept = 0.5 * float(np.max(np.diff(part.grid.edges[0]))) * OUTWARD <= epsilon
    else:
        kept = abs(closed[0, 0]) * epsilon + disturbance[0] <= epsilon
    if not kept:
        failures.append("its relation is not invariant")
    distance = coupling * epsilon / (2.0 * np.sqrt(2.0 * variances[0]))
    state("erf", distance, lost := float(erf(distance)) * (1.0 + 1e-14))
    if relation.delta < lost:
        failures.append("its delta is smaller than the probability that the coupling fails")
    return failures


def _verify_ellipsoid(
    relation: CoupledRelation, shape: FloatArray, closed: FloatArray, disturbance: FloatArray, variances: FloatArray
) -> list[str]:
    """Invariance for every vertex of W, and coupling; ``closed`` is ``A + B K - F``."""
    epsilon = relation.epsilon
    if ellipsoid_factor(shape) is None or not epsilon > 0:
        return ["its ellipsoid is none: its matrix is not positive definite, or badly conditioned"]
    failures = []
    if not ellipsoid_is_invariant(shape, epsilon, closed, disturbance):
        failures.append("its ellipsoid was not proved invariant")
    lost = ellipsoid_failure(shape, epsilon, relation.coupling, variances)
    state("ellipsoid", relation, disturbance, variances, lost)
    if relation.delta < lost:
        failures.append("its delta is smaller than the probability that the coupling fails")
    return failures


def _grid_noise(agent: LinearAgent, part: AgentRecord) -> FloatArray:
    """Covariance of the noise in grid coordinates."""
    inverse = np.linalg.inv(part.coordinates)
    return np.asarray(inverse @ agent.noise_covariance @ inverse.T)


VERIFIED: dict[type, Callable[[AnyAgent, AgentRecord, Any, Execution], list[str]]] = {
    BoxRelation: _verify_boxes,
    MapRelation: _verify_maps,
    SymbolicTargets: _verify_aims,
    ExactRelation: _verify_exact,
    CoupledRelation: _verify_coupled,
}
"""What verifies a relation, by what it is."""
