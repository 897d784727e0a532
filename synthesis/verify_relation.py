"""Verification of a simulation relation from the matrices alone, whoever found it.

For every agent: the relation is invariant under the coupled step, the abstract means are what the relation says, every
input that a policy can ask for is admissible from every related state, and ``delta`` is at least the probability that
the coupling fails. Comparisons carry their tolerance on the restrictive side.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from ..envs.agent import LinearAgent
from .certificate import AgentPart
from .relation_paper import PaperRelation

FloatArray = NDArray[Any]


def verify_relation(agent: LinearAgent, part: AgentPart) -> list[str]:
    """What is wrong with the relation of one agent; an empty list if it holds.

    Parameters
    ----------
    agent : LinearAgent
        The continuous agent.
    part : AgentPart
        Grid, lattice, relation and policy to be verified.
    """
    if part.relation["kind"] == "paper":
        return _verify_paper(agent, part)
    return _verify_exact(agent, part)


def _verify_exact(agent: LinearAgent, part: AgentPart) -> list[str]:
    """Every target is reached by an admissible input from every point of its cell."""
    inverse = np.linalg.inv(part.coordinates)
    A, B, offset = inverse @ agent.A @ part.coordinates, inverse @ agent.B, inverse @ agent.offset
    middle = 0.5 * (agent.input_box.low + agent.input_box.high)
    to_input = np.linalg.pinv(B)
    if np.max(np.abs(B @ to_input - np.eye(len(B)))) > 1e-9:
        return ["its inputs do not reach every mean"]
    spread = part.grid.half_widths @ np.abs(to_input @ A).T
    rows = part.law.reshape(-1, part.law.shape[-1])
    for law in np.unique(rows, axis=0) if len(rows) > 1 else rows:
        index = np.unravel_index(np.maximum(law, 0), tuple(len(axis) for axis in part.lattice))
        goal = np.stack([axis[k] for axis, k in zip(part.lattice, index, strict=True)], axis=1)
        inputs = (goal - part.grid.centres @ A.T - offset - B @ middle) @ to_input.T + middle
        beyond = (inputs - spread < agent.input_box.low) | (inputs + spread > agent.input_box.high)
        if np.any(beyond & (law >= 0)[:, None]):
            return ["it is asked for inputs beyond its input box"]
    return []


def _verify_paper(agent: LinearAgent, part: AgentPart) -> list[str]:
    """``|a_K - F| epsilon + h/2 <= epsilon``, delta not below its closed form, inputs and means as said."""
    try:
        relation = part.relation_of(agent)
    except ValueError as error:
        return [str(error)]
    if not isinstance(relation, PaperRelation):
        return ["its relation is of another kind"]
    a, b, c = float(agent.A[0, 0]), float(agent.B[0, 0]), float(agent.offset[0])
    deviation, epsilon = float(np.sqrt(agent.noise_covariance[0, 0])), relation.epsilon
    feedback, coupling = float(part.relation["feedback"]), relation.coupling
    centres, edges = part.grid.centres[:, 0], part.grid.edges[0]
    half = float(np.max(np.maximum(edges[1:] - centres, centres - edges[:-1])))
    failures = []
    if abs(a + b * feedback - coupling) * epsilon + half > epsilon * (1 + 1e-12):
        failures.append("its relation is not invariant")
    if relation.delta < float(erf(abs(coupling) * epsilon / (2.0 * np.sqrt(2.0) * deviation))) * (1 - 1e-14):
        failures.append("its delta is smaller than the probability that the coupling fails")
    inputs = relation.inputs
    reserve = abs(feedback) * epsilon
    if np.any(inputs - reserve < agent.input_box.low[0]) or np.any(inputs + reserve > agent.input_box.high[0]):
        failures.append("its abstract inputs leave no room for the feedback")
    if part.menu is None or part.menu.shape[1] != len(inputs):
        return [*failures, "its menu does not list its inputs"]
    means = a * centres[:, None] + b * inputs + c
    if np.max(np.abs(part.lattice[0][part.menu] - means)) > 1e-9 * half:
        failures.append("its means are not those of its dynamics")
    return failures
