"""Relations that put means on targets: of matrices, and of expressions."""

from __future__ import annotations

from ...envs.agents import AnyAgent, with_expressions
from ..cells import FloatArray, linear_agent
from .exact import ExactRelation, exact_relation
from .solved_means import WrittenTargets, written_targets


def aimed_relation(agent: AnyAgent, coordinates: FloatArray) -> ExactRelation | WrittenTargets:
    """Return the exact relation of an agent, or refuse it in words."""
    if agent.is_affine:
        return exact_relation(linear_agent(agent, "exact"), coordinates)
    return written_targets(with_expressions(agent), coordinates)
