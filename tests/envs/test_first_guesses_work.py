"""What a user writes first works: a formula as text, and one agent outside a list."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg


def robot() -> cg.LinearAgent:
    return cg.LinearAgent(name="robot", A=0.9, B=1.0, noise_covariance=0.04, state_low=-4, state_high=4, input_low=-1,
                          input_high=1, initial_state=-2)  # fmt: skip


def test_a_problem_says_what_it_must_and_no_more() -> None:
    problem = cg.Problem(horizon=6, agents=robot(), propositions={"goal": cg.Proposition("robot", 0.5, 2)},
                         specification="F goal")  # fmt: skip
    same = cg.Problem(name="problem", horizon=6, agents=[robot()], specification=cg.Specification("F goal"),
                      propositions={"goal": cg.Proposition("robot", [0.5], [2])})  # fmt: skip
    assert problem.fingerprint == same.fingerprint


def test_make_is_that_of_gymnasium() -> None:
    env, same = cg.make("reach-avoid-v0"), cg.central_env("reach-avoid-v0")
    assert np.array_equal(env.reset(seed=3)[0], same.reset(seed=3)[0]) and env.action_space == same.action_space


def test_one_agent_needs_no_names_and_windows_say_the_horizon() -> None:
    goal = cg.Proposition("robot", 0.5, 2)
    same = cg.Problem(horizon=6, agents=robot(), propositions={"goal": goal}, specification="F[0,6] goal")
    for region in (goal, (0.5, 2), ([0.5], [2]), {"low": 0.5, "high": 2}, {"agent": "robot", "low": 0.5, "high": 2}):
        regions: Any = {"goal": region}
        problem = cg.Problem(agents=robot(), propositions=regions, specification="F[0,6] goal")
        assert problem.fingerprint == same.fingerprint, region
    assert cg.Problem(agents=robot(), propositions={"goal": goal}, specification="F goal").horizon == 100
    with pytest.raises(ValueError, match="`horizon` is missing"):
        cg.Problem(agents=robot(), propositions={"goal": goal}, specification=cg.Specification("G goal"))
    pair: Any = {"goal": (0.5, 2)}
    with pytest.raises(ValueError, match=r"`propositions.goal`: expected a Proposition, a Pair, or a dict"):
        cg.Problem(
            horizon=6, agents=[robot(), robot().replace(name="other")], propositions=pair, specification="F goal"
        )


@pytest.mark.parametrize("id", ["reach-avoid-v0", "car-park-v0"])
def test_controllers_predict_in_the_environment_of_make(id: str) -> None:
    """The same inputs as those that they return by agents, each mapped to [-1, 1]; an episode is played with them."""
    env = cg.make(id)
    controller: Any = cg.synthesize(id, 40, relation="exact").controller
    (observation, _), agents = env.reset(seed=0), env.problem.agents
    d = sum(agent.n_states for agent in agents)
    own = {
        agent.name: np.concatenate([x, observation[d:]])
        for agent, x in zip(
            agents, np.split(observation[:d], np.cumsum([a.n_states for a in agents])[:-1]), strict=True
        )
    }
    action, state = controller.predict(observation)
    middle, half = (np.concatenate([getattr(a.input_box, k) for a in agents]) for k in ("center", "high"))
    inputs = np.concatenate([*controller.act(own).values()])
    assert state is None and action.dtype == np.float32 and action == pytest.approx((inputs - middle) / (half - middle))
    assert np.array_equal(controller.predict(observation[None])[0], action[None])
    over = False
    while not over:
        action, _ = controller.predict(observation, deterministic=True)
        assert env.action_space.contains(action)
        observation, _, ended, cut, _info = env.step(action)
        over = ended or cut
    with pytest.raises(ValueError, match="`observation`: expected a mapping by agents, or"):
        controller.predict(np.zeros(2))
