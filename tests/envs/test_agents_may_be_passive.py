"""Agents that nobody steers: moving obstacles, drifts, clocks. They have no inputs, and are agents like all others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg

FILE = """
name = "crossing"
horizon = 8
[[agents]]
name = "walker"
A = [[1.0]]
B = [[1.0]]
noise_covariance = [[0.01]]
state_low = [-4.0]
state_high = [4.0]
input_low = [-1.0]
input_high = [1.0]
initial_state = [-2.0]
[[agents]]
name = "tram"
states = ["place"]
inputs = []
dynamics = ["place + 0.8"]
noise = [{ law = "gaussian", std = 0.1 }]
state_low = [-5.0]
state_high = [9.0]
initial_state = [-2.0]
[propositions]
shop = { agent = "walker", low = [1.5], high = [3.0] }
track = { agent = "walker", low = [-0.5], high = [0.5] }
here = { agent = "tram", low = [-1.0], high = [1.0] }
[specification]
formula = "!(track & here) U shop"
semantics = "co-safe"
"""


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


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> cg.Problem:
    path: Path = tmp_path_factory.mktemp("own") / "crossing.toml"
    path.write_text(FILE, encoding="utf-8")
    return cg.load(path)


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


def test_a_state_may_be_called_idle() -> None:
    agent = expression(states=["idle"], dynamics=["idle + 0.8"])
    assert agent.inputs == ("idle_",)


def test_environments_have_a_space_for_it(problem: cg.Problem) -> None:
    env = cg.parallel_env(problem)
    env.reset(seed=0)
    space = env.action_space("tram")
    assert space.shape == (1,) and space.contains(np.zeros(1, dtype=space.dtype))
    before = env.state()
    env.step({name: env.action_space(name).sample() for name in env.agents})
    assert not np.array_equal(before, env.state())
