"""The batched core moves by the stated law, reads letters from time 0 on, lets failure win, and ignores batch size."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import batch_simulator as core
from problems import linear
from sample_problems import mixed_problem, planar, scalar

FALSE_ALARM = 1e-6


def zeros(dynamics: core.Dynamics, n_worlds: int) -> list[np.ndarray]:
    return [np.zeros((*block.input_low.shape[:2], n_worlds)) for block in dynamics.blocks]


def still(dynamics: core.Dynamics, n_worlds: int) -> list[np.ndarray]:
    return [np.zeros((*block.columns.shape, n_worlds)) for block in dynamics.blocks]


def single(agent: cg.LinearAgent, horizon: int = 1) -> cg.Problem:
    return cg.Problem(
        name="single",
        horizon=horizon,
        agents=[agent],
        propositions={},
        specification=cg.Specification("true", "finite-trace"),
    )


def test_noise_has_the_stated_covariance() -> None:
    """Fixed seed, n = 200,000, false alarm 1e-6 over 5 claims; the gap seen is 1.6 % of a variance.

    Mistaking a covariance for a standard deviation changes the first variance from .25 to .0625.
    """
    agent = planar(initial_low=None, initial_high=None, initial_state=[1.0, -2.0])
    dynamics = core.Dynamics.of(single(agent))
    n = 200_000
    rng = np.random.default_rng(7)
    worlds = core.initial(dynamics, rng, n)
    inputs = [np.tile(np.array([[0.5], [-1.0]])[..., None], (1, 1, n))]
    after = core.transition(dynamics, worlds, inputs, core.noise(dynamics, rng, n))
    mean = agent.A @ np.array([1.0, -2.0]) + agent.B @ np.array([0.5, -1.0]) + agent.offset
    error = after.states[0][:, 0] - mean[:, None]
    quantile = NormalDist().inv_cdf(1.0 - FALSE_ALARM / 5.0 / 2.0)
    sigma = agent.noise_covariance
    assert (np.abs(error.mean(axis=1)) <= quantile * np.sqrt(np.diag(sigma) / n)).all()
    for i, j in ((0, 0), (0, 1), (1, 1)):  # variance of a product of jointly normal numbers (Isserlis)
        spread = np.sqrt((sigma[i, i] * sigma[j, j] + sigma[i, j] ** 2) / n)
        assert abs((error[i] * error[j]).mean() - sigma[i, j]) <= quantile * spread


def test_singular_covariance_moves_along_its_range() -> None:
    agent = planar(noise_covariance=[[1.0, 2.0], [2.0, 4.0]], offset=None, A=np.zeros((2, 2)))
    assert np.allclose(agent.noise_factor @ agent.noise_factor.T, agent.noise_covariance, atol=1e-14)
    dynamics = core.Dynamics.of(single(agent))
    rng = np.random.default_rng(0)
    after = core.transition(
        dynamics, core.initial(dynamics, rng, 50), zeros(dynamics, 50), core.noise(dynamics, rng, 50)
    )
    assert np.allclose(2.0 * after.states[0][0], after.states[0][1], atol=1e-12)


@pytest.mark.parametrize("negative", [-1e-18, -1e-16])
def test_variances_a_little_below_zero_count_as_zero(negative: float) -> None:
    """Rounding leaves such eigenvalues in covariances that users compute; neither form of the factor may be NaN."""
    diagonal = planar(noise_covariance=[[1.0, 0.0], [0.0, negative]])
    assert diagonal.noise_factor.tolist() == [[1.0, 0.0], [0.0, 0.0]] and "standard deviation 1, 0" in repr(diagonal)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    covariance = turn @ np.diag([1.0, negative]) @ turn.T
    full = planar(noise_covariance=(covariance + covariance.T) / 2)
    assert np.isfinite(full.noise_factor).all()
    assert np.allclose(full.noise_factor @ full.noise_factor.T, full.noise_covariance, atol=1e-14)


def test_the_start_is_uniform_in_its_box_and_draws_nothing_for_points() -> None:
    """Fixed seed, n = 100,000, false alarm 1e-6 over 2 claims (Hoeffding); the gap seen is .9 % of the width."""
    dynamics = core.Dynamics.of(mixed_problem())
    n = 100_000
    x = core.initial(dynamics, np.random.default_rng(3), n).states[1]
    gap = np.sqrt(np.log(2.0 / (FALSE_ALARM / 2.0)) / (2.0 * n))
    assert ((x[0] >= -1.0) & (x[0] < 1.0)).all() and (x[1] == 0.0).all()
    assert (np.abs(((x[0] + 1.0) / 2.0).mean(axis=-1) - 0.5) <= gap).all()
    rng = np.random.default_rng(5)
    core.initial(core.Dynamics.of(cg.make_problem("invariance-v0")), rng, 10)
    assert rng.random() == np.random.default_rng(5).random()


class Highest(np.random.Generator):
    """Draws the largest number below 1 each time."""

    def random(self, *shape: object, **_: object) -> np.ndarray:  # type: ignore[override]
        return np.full(shape[0], np.nextafter(1.0, 0.0))  # type: ignore[call-overload]


def test_rounding_never_carries_a_start_onto_the_upper_corner() -> None:
    box = {"initial_low": [2.0, -5.0], "initial_high": [3.0, -2.5]}
    dynamics = core.Dynamics.of(cg.make_problem("reach-avoid-v0", **box))
    start = core.joint(dynamics, core.initial(dynamics, Highest(np.random.PCG64(0)), 3))
    assert (start < [3.0, -2.5]).all() and (start > [2.9, -2.6]).all()


def test_joint_states_stand_in_agent_order() -> None:
    dynamics = core.Dynamics.of(mixed_problem())
    joint = np.arange(12.0).reshape(2, 6)
    worlds = core.initial_at(dynamics, joint)
    assert (core.joint(dynamics, worlds) == joint).all()
    block, place = dynamics.position[2]  # the second scalar agent stands after two scalars and a pair: column 3
    assert (worlds.states[block][:, place] == joint[:, [3]].T).all()
    with pytest.raises(ValueError, match=r"`states`: expected shape \(number of worlds, 6\), got \(2, 5\)"):
        core.initial_at(dynamics, joint[:, :5])


def test_the_step_is_the_matrix_equation() -> None:
    dynamics = core.Dynamics.of(mixed_problem())
    rng = np.random.default_rng(2)
    worlds = core.initial(dynamics, rng, 5)
    normals = core.noise(dynamics, rng, 5)
    inputs = [rng.normal(size=u.shape) for u in zeros(dynamics, 5)]
    after = core.transition(dynamics, worlds, inputs, normals)
    for i, agent in enumerate(dynamics.problem.agents):
        block, k = dynamics.position[i]
        one = linear(agent)
        expected = one.A @ worlds.states[block][:, k] + one.B @ inputs[block][:, k] + one.offset[:, None]
        expected += agent.noise_factor @ normals[block][:, k]
        assert np.allclose(after.states[block][:, k], expected, rtol=1e-13, atol=1e-13)


def two_agents(
    a: list[list[float]], horizon: int = 3, semantics: str = "co-safe", formula: str = "F goal"
) -> cg.Problem:
    agents = scalar(name="d", A=a, state_low=[-4.0], state_high=[4.0]).copies(2)
    goal = cg.Proposition("d_0", [1.0], [4.0])
    return cg.Problem(
        name="two",
        horizon=horizon,
        agents=[agent.replace(initial_state=[0.0]) for agent in agents],
        propositions={"goal": goal},
        specification=cg.Specification(formula, semantics),
    )


def test_leaving_the_workspace_beats_acceptance_in_the_same_step() -> None:
    dynamics = core.Dynamics.of(two_agents([[2.0]]))
    #                     accept and exit, accept, exit, neither
    start = np.array([[0.75, 3.0], [0.75, 0.0], [0.0, 3.0], [0.0, 0.0]])
    worlds = core.transition(dynamics, core.initial_at(dynamics, start), zeros(dynamics, 4), still(dynamics, 4))
    assert worlds.failed.tolist() == [True, False, True, False]
    assert worlds.accepted.tolist() == [False, True, False, False]
    later = core.transition(dynamics, worlds, [np.full_like(u, 50.0) for u in zeros(dynamics, 4)], still(dynamics, 4))
    assert later.failed.tolist() == [True, False, True, True]  # after acceptance an exit does not count
    assert later.accepted.tolist() == [False, True, False, False]
    assert core.satisfied(dynamics, later).tolist() == [False, True, False, False]


def test_the_first_letter_is_that_of_the_start() -> None:
    dynamics = core.Dynamics.of(two_agents([[0.0]]))
    worlds = core.initial_at(dynamics, np.array([[1.0, 0.0], [0.0, 0.0], [1.0, 5.0], [5.0, 0.0]]))
    assert worlds.accepted.tolist() == [True, False, False, False]
    assert worlds.failed.tolist() == [False, False, True, True]
    now = core.Dynamics.of(two_agents([[0.0]], formula="goal"))
    assert core.initial_at(now, np.array([[1.0, 0.0], [0.0, 0.0]])).accepted.tolist() == [True, False]
    following = core.Dynamics.of(two_agents([[2.0]], formula="X goal"))
    worlds = core.initial_at(following, np.array([[1.0, 0.0], [0.5, 0.0]]))
    assert worlds.accepted.tolist() == [False, False]
    worlds = core.transition(following, worlds, zeros(following, 2), still(following, 2))
    assert worlds.accepted.tolist() == [True, True]


def test_a_start_outside_fails_even_the_task_true() -> None:
    dynamics = core.Dynamics.of(two_agents([[0.0]], formula="true"))
    worlds = core.initial_at(dynamics, np.array([[0.0, 0.0], [0.0, 4.5]]))
    assert worlds.accepted.tolist() == [True, False] and worlds.failed.tolist() == [False, True]


@pytest.mark.parametrize("start", [-10.0, 1.0], ids=["without p", "with p"])
def test_what_no_word_can_miss_is_satisfied_at_time_0(start: float) -> None:
    """No letter decides `(F p) | (X !p)`, so that even an exit at time 1 comes too late; `F p` waits for p."""
    agent = scalar(initial_state=[start], A=[[0.0]], B=[[1000.0]])
    region = {"p": cg.Proposition("left", [0.0], [5.0])}
    for formula, satisfied in (("(F p) | (X !p)", True), ("F p", start > 0)):
        task = cg.Specification(formula, "co-safe")
        problem = cg.Problem(name="task", horizon=3, agents=[agent], propositions=region, specification=task)
        env = cg.central_env(problem)
        assert env.reset(seed=0)[1]["satisfied"] == satisfied
        _, reward, terminated, _, info = env.step(np.ones(1))
        assert terminated and info["satisfied"] == satisfied and reward == float(satisfied)


def test_finite_traces_are_judged_at_the_horizon_only() -> None:
    dynamics = core.Dynamics.of(two_agents([[0.5]], horizon=2, semantics="finite-trace", formula="F goal"))
    worlds = core.initial_at(dynamics, np.array([[2.0, 0.0], [0.0, 0.0]]))
    for expected in ([False, False], [False, False], [True, False]):
        assert core.satisfied(dynamics, worlds).tolist() == expected
        assert not worlds.accepted.any()
        if worlds.time < 2:
            worlds = core.transition(dynamics, worlds, zeros(dynamics, 2), still(dynamics, 2))
    with pytest.raises(ValueError, match=r"`worlds`: expected a time before the horizon 2, got 2"):
        core.transition(dynamics, worlds, zeros(dynamics, 2), still(dynamics, 2))


def test_an_exit_violates_a_finite_trace_for_good() -> None:
    dynamics = core.Dynamics.of(two_agents([[2.0]], horizon=2, semantics="finite-trace", formula="true"))
    worlds = core.initial_at(dynamics, np.array([[0.0, 3.0], [0.0, 1.0]]))
    worlds = core.transition(dynamics, worlds, zeros(dynamics, 2), still(dynamics, 2))
    back = [np.where(x != 0.0, -4.0 * x, 0.0) for x in worlds.states]
    worlds = core.transition(dynamics, worlds, back, still(dynamics, 2))
    assert (np.abs(core.joint(dynamics, worlds)) <= 4.0).all()
    assert core.satisfied(dynamics, worlds).tolist() == [False, True]


def test_unstable_worlds_may_leave_all_numbers() -> None:
    dynamics = core.Dynamics.of(two_agents([[1e90]], horizon=8))
    worlds = core.initial_at(dynamics, np.array([[-1.0, -1.0]]))
    for _ in range(8):
        worlds = core.transition(dynamics, worlds, zeros(dynamics, 1), still(dynamics, 1))
    assert worlds.failed[0] and not worlds.accepted[0]
