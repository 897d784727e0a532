"""What a user writes first works: a formula as text, one agent outside a list, and what other libraries call things."""

from __future__ import annotations

import numpy as np

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


def test_results_and_controllers_have_the_names_of_others() -> None:
    result = cg.synthesize("reach-avoid-v0", 40, relation="exact")
    assert result.lower_bound == result.certificate.lower_bound and result.policy is result.controller
    env = cg.parallel_env("reach-avoid-v0")
    observations, infos = env.reset(seed=0)
    result.controller.reset(observations, infos)
    acted = result.controller.act(observations)
    actions, state = result.policy.predict(observations, deterministic=True)
    assert state is None and all(np.array_equal(actions[name], acted[name]) for name in acted)


def test_make_is_that_of_gymnasium() -> None:
    env, same = cg.make("reach-avoid-v0"), cg.central_env("reach-avoid-v0")
    assert np.array_equal(env.reset(seed=3)[0], same.reset(seed=3)[0]) and env.action_space == same.action_space
