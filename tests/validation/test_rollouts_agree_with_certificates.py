"""Exact certificates agree with rollouts of the continuous system from both sides; wrong ones are refuted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

import certigym as cg
from certigym.envs.simulation.batch_simulator import Dynamics
from certigym.synthesis.certificates.proofs import OnGrid, changed, is_exact
from certigym.validation.statistical_tests.binomial import CONFIRMED, CONSISTENT, REFUTED, clopper_pearson, verdict
from certigym.validation.statistical_tests.chunks import chunk_results
from certigym.validation.statistical_tests.loop import Loop
from kinds import mostly_thorough
from problems import two_agents

FALSE_ALARM = 1e-6


def planar() -> cg.Problem:
    """A planar agent with coupled axes, spare inputs and an output map, and a scalar one."""
    plane = cg.LinearAgent(
        name="plane",
        A=[[0.9, 0.2], [-0.1, 0.8]],
        B=[[0.5, 0.1, 0.2], [0.0, 0.6, -0.3]],
        noise_covariance=[[0.10, 0.0], [0.0, 0.08]],
        state_low=[-3, -3],
        state_high=[3, 3],
        input_low=[-3, -2, -1],
        input_high=[3, 2, 3],
        initial_state=[-1.0, -1.0],
        output_matrix=[[1.0, 1.0]],
        offset=[0.1, -0.05],
    )
    line = cg.LinearAgent(
        name="line",
        A=[[1.1]],
        B=[[-0.5]],
        noise_covariance=[[0.05]],
        state_low=[-2],
        state_high=[2],
        input_low=[-2],
        input_high=[1],
        initial_state=[0.3],
    )
    return cg.Problem(
        name="planar",
        horizon=6,
        agents=[plane, line],
        propositions={"goal": cg.Proposition("plane", [1.0], [3.0]), "safe": cg.Proposition("line", [-1.0], [1.0])},
        specification=cg.Specification("safe U (goal & safe)", "co-safe"),
    )


LOUD: dict[str, Any] = {"noise_covariance": [[0.8]]}
EXACT = {
    "reach-avoid": (two_agents(horizon=4, **LOUD).replace(initial_state=[3.6, 0.4]), 100),
    "sequence": (two_agents("F (a & F c)", horizon=4, **LOUD), 100),
    "response": (two_agents("G (b -> X d)", "finite-trace", horizon=6, **LOUD), 100),
    "box": (two_agents(horizon=3, **LOUD, initial_state=None, initial_low=[-3.0], initial_high=[-1.0]), 80),
    "many": (cg.make_problem("reach-avoid-n-v0", n_agents=4), 60),
}


@mostly_thorough("name", EXACT, first=3)
def test_exact_certificates_are_right_from_both_sides(name: str) -> None:
    """Limits at 1e-6 over five claims: 200,000 episodes notice an error of about .006."""
    problem, cells = EXACT[name]
    result = cg.synthesize(problem, cells, relation="exact")
    assert is_exact(result.certificate)
    assert 0.05 < result.certificate.lower_bound < 0.999
    report = cg.validate(result, episodes=200_000, seed=11, confidence=1 - FALSE_ALARM / len(EXACT))
    assert report.verdict == CONSISTENT, str(report)
    assert report.ci_high - report.ci_low < 0.015


@pytest.mark.thorough
def test_lower_bounds_with_cut_cells_hold() -> None:
    """One-sided, 1e-6: cells cut by region boundaries cost value but never validity."""
    result = cg.synthesize(planar(), {"plane": [40, 40], "line": 60})
    assert not is_exact(result.certificate)
    assert cg.check(result.certificate)
    report = cg.validate(result, episodes=100_000, seed=5, confidence=1 - FALSE_ALARM)
    assert report.verdict != REFUTED, str(report)
    assert 0.5 < report.lower_bound <= report.ci_high


def test_weak_inputs_are_not_called_exact() -> None:
    """Where cells have no admissible target the value is a lower bound only; the automatic choice is another."""
    weak = two_agents("F (a & F c)", horizon=4, noise_covariance=[[1.5]], B=[[0.01]])
    forced = cg.synthesize(weak, 100, relation="exact").certificate
    assert not is_exact(forced)
    assert not cg.validate(forced, 20_000, confidence=1 - FALSE_ALARM / 2).refuted
    chosen = cg.synthesize(weak, 100, relation="quick")
    assert chosen.certificate.settings["relation"] == "linear"
    assert chosen.certificate.lower_bound > forced.lower_bound
    assert not cg.validate(chosen, 20_000, confidence=1 - FALSE_ALARM / 2).refuted and cg.check(chosen.certificate)


def test_bounds_at_other_starts_hold() -> None:
    result = cg.synthesize(EXACT["reach-avoid"][0], 100)
    for state in ([1.5, 0.0], [-3.9, 2.0], [-1.0, -2.0], [3.9, -3.9]):
        report = cg.validate(result, 20_000, seed=3, confidence=1 - FALSE_ALARM / 4, initial_state=state)
        assert report.lower_bound == result.certificate.at([state])[0]
        assert report.verdict != REFUTED, (state, str(report))


def wrong_noise(certificate: OnGrid) -> OnGrid:
    """The continuous system with four times the variance that was certified."""
    agents = [a.replace(noise_covariance=a.noise_covariance * 4) for a in certificate.problem.agents]
    p = certificate.problem
    return replace(
        certificate,
        problem=cg.Problem(
            name=p.name, horizon=p.horizon, agents=agents, propositions=p.propositions, specification=p.specification
        ),
    )


def agents_swapped(certificate: OnGrid) -> OnGrid:
    return changed(certificate, agents=certificate.proof.agents[::-1])


def one_step_too_many(certificate: OnGrid) -> OnGrid:
    """The value of T steps claimed for T - 1."""
    return replace(certificate, problem=certificate.problem.replace(horizon=certificate.problem.horizon - 1))


@pytest.mark.parametrize("sabotage", [wrong_noise, agents_swapped, one_step_too_many])
def test_sabotaged_certificates_are_refuted(sabotage: Any) -> None:
    problem, cells = EXACT["sequence"]
    certificate = cg.synthesize(problem, cells, relation="exact").certificate
    report = cg.validate(sabotage(certificate), episodes=20_000, seed=2, confidence=1 - FALSE_ALARM)
    assert report.verdict == REFUTED, str(report)


@pytest.mark.thorough
def test_stepping_the_environment_agrees_with_batched_rollouts() -> None:
    """2,000 episodes of the PettingZoo loop against the exact certificate, limits at 1e-6."""
    problem, cells = EXACT["sequence"]
    result = cg.synthesize(problem, cells, relation="exact")
    env = cg.parallel_env(problem)
    controller = result.controller
    successes, returns = 0, 0.0
    for episode in range(2000):
        observations, infos = env.reset(seed=0 if episode == 0 else None)
        controller.reset(observations, infos)
        reward = 0.0
        while env.agents:
            actions = controller.act(observations, infos)
            assert all(env.action_space(name).contains(action) for name, action in actions.items())
            without_infos = controller.act(observations)
            assert all(np.array_equal(actions[name], without_infos[name]) for name in actions)
            observations, rewards, _, _, infos = env.step(actions)
            reward += next(iter(rewards.values()))
        successes += any(info["satisfied"] for info in infos.values())
        returns += reward
    assert returns == successes
    low, high = clopper_pearson(successes, 2000, 1 - FALSE_ALARM)
    assert low <= result.certificate.lower_bound <= high
    batched = cg.rollout(problem, controller, 50_000, seed=4)
    low, high = clopper_pearson(batched.successes, batched.episodes, 1 - FALSE_ALARM)
    assert low <= result.certificate.lower_bound <= high


def test_batched_and_single_controllers_agree_to_the_last_bit() -> None:
    problem = planar()
    controller = cg.synthesize(problem, {"plane": [16, 16], "line": 20}, relation="exact").controller
    dynamics = Dynamics.of(problem)
    from certigym.envs.simulation import batch_simulator as core

    rng = np.random.default_rng(0)
    worlds = core.initial_at(dynamics, rng.uniform(-4, 4, size=(50, 3)))
    policy = controller.batch(dynamics)
    batch, _ = policy.act(worlds, policy.begin(worlds, rng))
    for i, agent in enumerate(problem.agents):
        block, place = dynamics.position[i]
        for w in range(50):
            state = worlds.states[block][:, [place]][:, :, [w]]
            single = controller.agents[i].act(state, worlds.q[[w]], 0, None)[0][:, 0, 0]
            np.testing.assert_array_equal(single, batch[block][:, place, w])
            assert np.all(agent.input_low <= single) and np.all(single <= agent.input_high)


def test_rollouts_depend_on_seed_and_chunk_only() -> None:
    problem, _ = EXACT["sequence"]
    controller = cg.synthesize(problem, 40).controller
    first = cg.rollout(problem, controller, 5000, seed=0)
    again = cg.rollout(problem, controller, 7500, seed=0)
    other = cg.rollout(problem, controller, 5000, seed=1)
    np.testing.assert_array_equal(first.success, again.success[:5000])
    assert not np.array_equal(first.success, other.success)
    (alone,) = chunk_results(Loop(problem, controller, 0, first.chunk), [(1, first.chunk)])
    np.testing.assert_array_equal(alone.success, first.success[first.chunk : 2 * first.chunk])


@pytest.mark.parametrize(("successes", "episodes"), [(0, 10), (10, 10), (3, 17), (99, 1000), (99_990, 100_000)])
def test_limits_are_clopper_pearson(successes: int, episodes: int) -> None:
    expected = binomtest(successes, episodes).proportion_ci(0.99, method="exact")
    assert clopper_pearson(successes, episodes, 0.99) == pytest.approx((expected.low, expected.high), rel=1e-10)


def test_verdicts() -> None:
    assert verdict(0.5, None, 0.51, 0.6) == CONFIRMED
    assert verdict(0.5, None, 0.49, 0.51) == CONSISTENT
    assert verdict(0.5, None, 0.4, 0.499) == REFUTED
    assert verdict(0.5, 0.001, 0.502, 0.6) == REFUTED
    assert verdict(0.5, 0.001, 0.5005, 0.6) == CONFIRMED
    with pytest.raises(ValueError, match="confidence"):
        clopper_pearson(1, 2, 1.0)
