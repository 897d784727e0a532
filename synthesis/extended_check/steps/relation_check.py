"""Verification of a simulation relation from the matrices alone, whoever found it.

For every agent: the error stays in a set E under the coupled step, rounding of the controller included; the abstract
means are what the relation says; every input that a policy can ask for is admissible from every related state; and
``delta`` is at least the probability that the coupling fails. Comparisons carry their tolerance on the restrictive
side.
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
)
from .execution import Execution, targets_alone
from .geometry import cell_boxes
from .target_enclosures import wrong_targets

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
    for axis, points in zip(lattice_axes(agent), part.lattice, strict=True):
        numbers = np.arange(-1.0, part.grid.shape[axis.state] + 1.0)
        if not axis.is_interpolated and not np.array_equal(points, numbers):
            return [f"the lattice of agent `{agent.name}` does not number the cells of a state without noise"]
    return []


def label_margin(part: AgentRecord, relation: Relation, execution: Execution) -> FloatArray | None:
    """How far (d,) related states may be from the centres of their cells, in state units; None if in the same cell."""
    if relation.is_cell or not isinstance(relation, CoupledRelation):
        return None
    return error_support(relation, np.eye(len(relation.reach)))


def error_support(relation: CoupledRelation, rows: FloatArray) -> FloatArray:
    """Upper bounds (n,) on ``rows @ e`` for all errors of a coupled relation, rows (n, d)."""
    return np.asarray(np.abs(rows) @ relation.reach * WIDENED)


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
    """Every input that is chosen is admissible."""
    input_set = np.array(part.relation["menu"], dtype=float)[np.unique(part.policy[part.policy >= 0])]
    if np.any((input_set < agent.input_box.low) | (input_set > agent.input_box.high)):
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
    variances = np.diag(agent.noise_covariance)
    if np.any(np.abs(relation.covariance - variances) > 1e-12 * variances):
        failures.append("its noise is not that of its agent")
    failures += _verify_interval(part, relation, closed, disturbance, variances)
    reserve = error_support(relation, relation.feedback) + execution.inputs
    low, high = relation.inputs - reserve, relation.inputs + reserve
    if np.any(low < agent.input_box.low) or np.any(high > agent.input_box.high):
        failures.append("its abstract inputs leave no room for the feedback")
    return failures


def _disturbance(part: AgentRecord, relation: CoupledRelation, execution: Execution) -> FloatArray:
    """Half widths (d,) of W: half the largest cell, how far means are from lattice points, and rounding."""
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


VERIFIED: dict[type, Callable[[AnyAgent, AgentRecord, Any, Execution], list[str]]] = {
    BoxRelation: _verify_boxes,
    MapRelation: _verify_maps,
    SymbolicTargets: _verify_aims,
    ExactRelation: _verify_exact,
    CoupledRelation: _verify_coupled,
}
"""What verifies a relation, by what it is."""
