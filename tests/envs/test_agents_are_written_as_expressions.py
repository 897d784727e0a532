"""Agents by expressions are agents like others: in files, in one world and in many, in environments and commands."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.baselines import RandomController
from certigym.envs.interfaces import panels
from certigym.envs.tasks.problem import problem_from_dict
from written_problems import bent, bent_team, oscillator

EXAMPLE = Path(__file__).parents[2] / "examples" / "pendulum_and_cart.toml"


def test_files_fingerprints_and_pickles_keep_the_agent() -> None:
    problem = cg.load(EXAMPLE)
    pendulum = problem.agents[0]
    assert isinstance(pendulum, cg.Agent) and isinstance(problem.agents[1], cg.LinearAgent)
    assert pendulum.noise_covariance.tolist() == [[0.1 * 0.1, 0.0], [0.0, 0.2 * 0.2]]
    again = problem_from_dict(problem.to_dict())
    assert again.fingerprint == problem.fingerprint == pickle.loads(pickle.dumps(problem)).fingerprint
    assert copy.copy(pendulum).to_dict() == pendulum.to_dict() == cg.Agent(**pendulum.to_dict()).to_dict()
    # Another parameter is another problem; another name of the problem is not.
    data = problem.to_dict()
    data["agents"][0]["parameters"]["damping"] = 0.3
    assert problem_from_dict(data).fingerprint != problem.fingerprint
    assert problem.replace(disturbance_scale=2.0).agents[0].noise_covariance[0, 0] == pytest.approx(0.04)
    assert problem.replace(initial_state={"pendulum": [0.5, 0.1]}).agents[0].initial.low.tolist() == [0.5, 0.1]
    assert "angle'" in repr(pendulum) and "sin(angle)" in repr(pendulum)
    assert [agent.name for agent in pendulum.copies(2)] == ["pendulum_0", "pendulum_1"]


def test_what_is_not_defined_is_outside_the_workspace() -> None:
    agent = bent("one", dynamics=["log(x) + u"])
    problem = bent_team()
    problem = cg.Problem(
        name="log",
        horizon=2,
        agents=[agent, problem.agents[1]],
        propositions=problem.declared,
        specification=problem.specification,
    )
    rollouts = cg.rollout(problem, RandomController(), episodes=50, seed=0)
    assert not rollouts.success.any()  # the logarithm of the start, -2, is not a number


def test_outputs_may_be_expressions() -> None:
    """A ring in the plane is an interval of the distance; labels of points and of boxes agree with it."""
    agent = oscillator(outputs=["sqrt(x**2 + y**2)", "x"])
    problem = cg.Problem(
        name="ring",
        horizon=3,
        agents=[agent],
        propositions={"ring": cg.Proposition("vdp", [1.0, -9.0], [2.0, 9.0])},
        specification=cg.Specification("G ring", "finite-trace"),
    )
    points = np.random.default_rng(0).uniform(-3, 3, (2, 500))
    radius = np.hypot(*points)
    assert np.array_equal(problem.labeling.class_at(0, points)[0], (1.0 <= radius) & (radius < 2.0))
    assert agent.output_axis(0) is None and agent.output_axis(1) == (0, 1.0)
    low = points.T - 0.05
    possible = problem.labeling.box_classes(0, low, low + 0.1)
    inside = np.flatnonzero(problem.labeling.classes[0][:, 0])
    corners = [np.hypot(*(low + 0.1 * np.array(side)).T) for side in ((0, 0), (0, 1), (1, 0), (1, 1), (0.5, 0.5))]
    for radius in corners:
        holds = (1.0 <= radius) & (radius < 2.0)
        assert np.all(possible[:, inside].any(axis=1) >= holds) and np.all(possible.sum(axis=1) >= 1)
    assert possible.sum(axis=1).mean() < 1.4
    assert panels(problem)[0].regions == ()
    assert len(cg.rollout(problem, RandomController(), episodes=100, seed=0).success) == 100


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dynamics": ["x + step*y", "y + step*(1 - x**2)*v"]}, r"`dynamics\[1\]`: unknown name 'v'"),
        ({"dynamics": ["x"]}, "2 strings, one for each state"),
        ({"dynamics": "x + y"}, "2 strings"),
        ({"states": ["x", "lambda"]}, "no word of Python"),
        ({"disturbances": {"wind": [1, 0]}}, "exchange the two"),
        ({"outputs": ["u"]}, r"`outputs\[0\]`: unknown name 'u'"),
        ({"noise_covariance": None, "noise": [{"law": "cauchy", "std": 1}] * 2}, "one of the laws gaussian"),
        ({"noise_covariance": None, "noise": [{"law": "gaussian", "std": -1}] * 2}, "std of at least 0"),
    ],
)
def test_mistakes_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        oscillator(**changes)
