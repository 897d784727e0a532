"""Agents share what is computed only where everything is equal that it is made of: also what an array stands for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.cell_probabilities import AgentRecord, axis_tables, kernel_key


def walker(name: str, scales: list[str]) -> cg.Agent:
    """Two states that move alike, with noise that is larger in some places along one of them."""
    return cg.Agent(
        name=name, states=["x", "y"], inputs=["u", "v"], dynamics=["x + u", "y + v"],
        noise=[{"law": "gaussian", "std": 0.2}] * 2, noise_scale=scales, state_low=[-2.0] * 2, state_high=[2.0] * 2,
        input_low=[-0.8] * 2, input_high=[0.8] * 2, initial_state=[-1.0, -1.0],
    )  # fmt: skip


# In the middle of the workspace the scales are 1, so that both agents declare the same covariance.
IN_X, IN_Y = ["1 + 0.4*sin(x)", "1"], ["1", "1 + 0.4*sin(y)"]


def both(first: list[str], second: list[str]) -> cg.Problem:
    agents = walker("left", first), walker("right", second)
    regions = {"goal": cg.Proposition("*", [0.5, 0.5], [2.0, 2.0])}
    task = cg.Specification("F all(goal)", "co-safe")
    return cg.Problem(name="both", horizon=3, agents=agents, propositions=regions, specification=task)


@pytest.fixture(scope="module")
def certificate() -> cg.Certificate:
    found = cg.synthesize(both(IN_X, IN_X), 10, relation="boxes").certificate
    assert isinstance(found, cg.Certificate)
    return found


def fresh(agent: cg.Agent, part: AgentRecord) -> list[Any]:
    return axis_tables(agent, part, {})


def test_tables_know_what_the_axes_of_a_lattice_stand_for(certificate: cg.Certificate) -> None:
    """Logarithms of scales, means, means; or means, logarithms of scales, means: the numbers are the same."""
    left, right = walker("left", IN_X), walker("right", IN_Y)
    scale, mean, other = certificate.proof.agents[0].lattice
    first = replace(certificate.proof.agents[0], lattice=(scale, mean, other))
    known: dict[Any, Any] = {}
    of_left, of_right = axis_tables(left, first, known), axis_tables(right, first, known)
    assert kernel_key(left, first) != kernel_key(right, first)
    for shared, anew in ((of_left, fresh(left, first)), (of_right, fresh(right, first))):
        assert all(np.array_equal(a, b) for a, b in zip(shared, anew, strict=True))
    assert len(of_left[0]) == len(scale) * len(mean) and len(of_right[0]) == len(scale)


def test_equal_agents_share_their_tables(certificate: cg.Certificate) -> None:
    known: dict[Any, Any] = {}
    agents = zip(certificate.problem.agents, certificate.proof.agents, strict=True)
    first, second = (axis_tables(agent, part, known) for agent, part in agents)
    assert first is second


def test_a_forged_agent_that_is_scaled_elsewhere_is_refused(certificate: cg.Certificate) -> None:
    """Parts of agents that are scaled in x, said to be of one that is scaled in x and one that is scaled in y."""
    assert cg.check(certificate)
    assert not cg.check(replace(certificate, problem=both(IN_X, IN_Y)))
    assert not cg.check(replace(certificate, problem=both(IN_Y, IN_Y)))
