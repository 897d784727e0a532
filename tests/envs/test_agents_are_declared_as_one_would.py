"""Agents take spaces, noise and start as pairs and numbers, with at most 12 arguments, and the keys of files, too."""

from __future__ import annotations

import inspect
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import certigym as cg

ONE: dict[str, Any] = {"name": "a", "A": 0.9, "B": 0.5}
TWO: dict[str, Any] = {"name": "a", "A": 0.9 * np.eye(2), "B": np.eye(2)}
KEYS: dict[str, Any] = {
    "state_low": [-2.0, -3.0],
    "state_high": [2.0, 3.0],
    "input_low": [-1, -1],
    "input_high": [1, 1],
}
SPACES: dict[str, Any] = {"state_space": ([-2, -3], [2, 3]), "input_space": (-1, 1)}
WRITTEN: dict[str, Any] = {
    "name": "a",
    "states": ["x", "y"],
    "inputs": ["u", "v"],
    "dynamics": ["0.9*x + u", "0.9*y + v"],
}


@pytest.mark.parametrize("kind", [cg.Agent, cg.LinearAgent])
def test_signatures_have_at_most_twelve_arguments(kind: type) -> None:
    parameters = inspect.signature(kind).parameters.values()
    assert len([one for one in parameters if one.kind is not one.VAR_KEYWORD]) <= 12
    assert all(one.name in (kind.__doc__ or "") for one in parameters)


@pytest.mark.parametrize(("make", "own"), [(cg.LinearAgent, TWO), (cg.Agent, WRITTEN)])
def test_spaces_noise_and_start_say_what_keys_of_files_say(make: Any, own: dict[str, Any]) -> None:
    plain = make(**own, **KEYS, noise_covariance=np.diag([0.0625, 0.0625]), initial_state=[0.5, 1.0])
    assert make(**own, **SPACES, noise=0.25, start=[0.5, 1.0]).to_dict() == plain.to_dict()
    assert make(**own, **SPACES, noise=[0.25, 0.25], start=(0.5, 1.0)).to_dict() == plain.to_dict()
    assert make(**own, **SPACES, noise_std=0.25, start=np.array([0.5, 1.0])).to_dict() == plain.to_dict()
    assert make(**own, **SPACES, noise=[[0.0625, 0.0], [0.0, 0.0625]], start=[0.5, 1.0]).to_dict() == plain.to_dict()
    assert make(**own, **SPACES, noise={"std": 0.25}, start=[0.5, 1.0]).to_dict() == plain.to_dict()
    box = make(**own, **KEYS, noise_std=0.25, initial_low=[0, 0], initial_high=[1, 2])
    assert make(**own, **SPACES, noise=0.25, start=([0, 0], [1, 2])).to_dict() == box.to_dict()
    assert make(**own, **SPACES, noise=0.25, start=np.array([[0, 0], [1, 2]])).to_dict() == box.to_dict()
    law = {"law": "laplace", "scale": 0.1}
    laws = make(**own, **KEYS, noise=[law, law])
    assert make(**own, **SPACES, noise=law).to_dict() == laws.to_dict()
    mixed = make(
        **own, **KEYS, noise=[{"law": "gaussian", "std": 0.25}, law]
    )  # a number is the deviation of a normal law
    assert make(**own, **SPACES, noise=[0.25, law]).to_dict() == mixed.to_dict()
    both = [{"law": "uniform", "low": -0.1, "high": high} for high in (0.1, 0.2)]
    in_one = {"law": "uniform", "low": -0.1, "high": [0.1, 0.2]}
    assert make(**own, **SPACES, noise=in_one).to_dict() == make(**own, **KEYS, noise=both).to_dict()
    with pytest.raises(ValueError, match=r"noise\.high"):
        make(**own, **KEYS, noise={"law": "uniform", "low": -0.1, "high": [0.1, 0.2, 0.3]})
    parts = [{"weight": 0.5, "law": "laplace", "scale": scale} for scale in (0.1, 0.2)]  # as many as states
    mixture = {"law": "mixture", "parts": parts}
    assert make(**own, **SPACES, noise=mixture).to_dict() == make(**own, **KEYS, noise=[mixture, mixture]).to_dict()
    beta = {"law": "scipy", "name": "beta", "args": [2.0, 3.0], "cdf_error": 1e-12, "variation": 4.0}
    assert make(**own, **SPACES, noise=beta).to_dict() == make(**own, **KEYS, noise=[beta, beta]).to_dict()
    turned = [[0.8, 0.6], [-0.6, 0.8]]
    assert (
        make(**own, **SPACES, noise={"laws": [law, law], "axes": turned}).to_dict()
        == make(**own, **KEYS, noise=[law, law], noise_axes=turned).to_dict()
    )


def test_spaces_of_gymnasium_and_numbers_for_one_axis() -> None:
    space = gym.spaces.Box(np.array([-2.0, -3.0]), np.array([2.0, 3.0]), dtype=np.float64)
    agent = cg.LinearAgent(**TWO, state_space=space, input_space=(-1, 1), noise=0.1)
    assert agent.state_low.tolist() == [-2.0, -3.0] and agent.input_high.tolist() == [1.0, 1.0]
    one = cg.LinearAgent(**ONE, noise=0.1, state_space=(-1, 1), input_space=(-1, 1), start=(-0.5, 0.5))
    assert (one.initial.low, one.initial.high) == (-0.5, 0.5), "two numbers are corners for an agent of one state"
    assert cg.LinearAgent(**ONE, noise=0.1, state_space=(-1, 1), input_space=(-1, 1), start=0.25).initial.is_point


def test_scaled_noise_is_a_mapping() -> None:
    scale = ["0.1 + 0.05*abs(x)", "0.1"]
    agent = cg.Agent(**WRITTEN, **SPACES, noise={"std": 1.0, "scale": scale})
    law = {"law": "gaussian", "std": 1.0}
    assert agent.to_dict() == cg.Agent(**WRITTEN, **KEYS, noise=[law, law], noise_scale=scale).to_dict()


def test_deviations_in_python_may_be_expressions_as_in_files() -> None:
    more: Any = {
        "states": ["a", "b"], "inputs": ["u"], "dynamics": ["0.9*a + u", "0.9*b"], "state_space": ([-1, -1], [3, 3]),
        "input_space": (0, 1), "start": [1, 1],
    }  # fmt: skip
    plain = cg.Agent(noise={"std": [1.0, 0.02], "scale": ["0.03 + 0.05*a", "1"]}, **more)
    for key in ("noise_std", "noise"):
        given: Any = {key: ["0.03 + 0.05*a", 0.02]}
        agent = cg.Agent(**given, **more)
        assert agent.noise_scale == plain.noise_scale and agent.laws == plain.laws
    assert cg.Agent(noise_std="0.1 + 0.05*t", **more).noise_scale == ("0.1 + 0.05*t",) * 2
    with pytest.raises(ValueError, match="without `noise_scale`"):
        cg.Agent(noise_std=["0.1*a", 0.1], noise_scale=["1", "a"], **more)
    with pytest.raises(ValueError, match="written as expressions"):
        cg.LinearAgent(A=1.0, B=1.0, noise_std=["0.1*x"], state_space=(-1, 1), input_space=(-1, 1), start=0)
