"""Agents that nobody steers: moving obstacles, drifts, clocks. They have no inputs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg


def expression(**changes: Any) -> cg.Agent:
    arguments: dict[str, Any] = {
        "states": ["place"], "dynamics": ["place + 0.8"], "noise": [{"law": "gaussian", "std": 0.1}],
        "state_low": [-5], "state_high": [9], "initial_state": [-2],
    }  # fmt: skip
    return cg.Agent(name="tram", **{**arguments, **changes})


def linear(**changes: Any) -> cg.LinearAgent:
    arguments: dict[str, Any] = {
        "A": [[1.0]], "offset": [0.8], "noise_covariance": [[0.01]], "state_low": [-5], "state_high": [9],
        "initial_state": [-2],
    }  # fmt: skip
    return cg.LinearAgent(name="tram", **{**arguments, **changes})


@pytest.mark.parametrize("make", [expression, linear])
def test_no_inputs_are_one_that_is_always_zero(make: Any) -> None:
    agent = make()
    assert agent.n_inputs == 1 and agent.input_low == agent.input_high == 0.0
    none: dict[str, Any] = {"inputs": []} if make is expression else {"B": None}
    assert make(**none).model_key == agent.model_key
    np.testing.assert_allclose(agent.mean(np.array([1.0]), np.array([0.0])), [1.8])


@pytest.mark.parametrize("make", [expression, linear])
def test_a_box_without_inputs_is_refused(make: Any) -> None:
    with pytest.raises(ValueError, match="`input_high`: expected nothing for an agent without inputs"):
        make(input_high=[1.0])
