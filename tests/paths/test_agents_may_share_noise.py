"""One wind for all: noise that agents share, in environments, along paths, and where agents are multiplied."""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

import certigym as cg
from certigym import Agent, LinearAgent, Pair, Problem, Proposition, Specification, check
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.simulation.single_simulator import SingleSimulator
from certigym.envs.systems.agents import AnyAgent
from certigym.envs.tasks.problem import problem_from_dict
from certigym.synthesis.certificates.proofs import PathProof, changed

SEED = 20261124


def drone(name: str, start: float, std: float = 0.01) -> LinearAgent:
    """A robot on a line whose inputs are its velocities."""
    return LinearAgent(
        name=name, A=[[1.0]], B=[[1.0]], noise_covariance=[[std**2]], state_low=[-3.0], state_high=[3.0],
        input_low=[-0.5], input_high=[0.5], initial_state=[start],
    )  # fmt: skip


def bent(name: str, start: list[float], std: float = 0.01) -> Agent:
    """The same with a bent step, and a second state."""
    return Agent(
        name=name, states=["x", "y"], inputs=["u", "v"], dynamics=["x + u + 0.05*sin(y)", "y + v"],
        noise_covariance=[[std**2, 0.0], [0.0, std**2]], state_low=[-3, -3], state_high=[3, 3],
        input_low=[-0.5, -0.5], input_high=[0.5, 0.5], initial_state=start,
    )  # fmt: skip


def team(
    agents: Sequence[AnyAgent], joint_noise: Any, formula: str = "F all(goal)", horizon: int = 6, **more: Pair
) -> Problem:
    """Agents that are to be beyond 1 together, and keep apart where `more` says so."""
    d = agents[0].n_outputs
    goal = Proposition("drone_*", [1.0] + [-3.0] * (d - 1), [3.0] * d)
    return Problem(
        name="team", horizon=horizon, agents=agents, propositions={"goal": goal, **more},
        specification=Specification(formula, "finite-trace" if "G" in formula else "co-safe"), joint_noise=joint_noise,
    )  # fmt: skip


WIND = {"wind": {"drone_*": [0.1]}, "gust": {"drone_1": [-0.05]}}


def test_worlds_feel_it_together() -> None:
    """Covariances of a step against those of the sources (Isserlis); six deviations each, a false alarm of 1e-7."""
    problem = team([drone("drone_0", 0.0, 0.02), drone("drone_1", 0.5, 0.03), bent("kite", [0.0, 0.0], 0.05)],
                   {**WIND, "sea": {"kite": {"y": 0.2}, "drone_0": [0.01]}}, formula="F goal_0")  # fmt: skip
    n, dynamics, rng = 400_000, core.Dynamics.of(problem), np.random.default_rng(SEED)
    worlds = core.initial(dynamics, rng, n)
    inputs = [np.zeros((block.n_inputs, len(block.agents), n)) for block in dynamics.blocks]
    after = core.joint(dynamics, core.transition(dynamics, worlds, inputs, core.noise(dynamics, rng, n)))
    factors = np.array([[0.1, 0.0, 0.01], [0.1, -0.05, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.2]])
    wanted = np.diag([0.02**2, 0.03**2, 0.05**2, 0.05**2]) + factors @ factors.T
    moved = after - [0.0, 0.5, 0.0, 0.0]
    spread = np.sqrt((np.outer(np.diag(wanted), np.diag(wanted)) + wanted**2) / n)
    assert np.all(np.abs(moved.T @ moved / n - wanted) <= 6.0 * spread)
    # What agents feel by themselves is in the agents of the problem; as they were written they have their own alone.
    for agent, columns in zip(problem.agents, problem.columns):
        np.testing.assert_allclose(agent.noise_covariance, wanted[columns, columns], rtol=1e-12, atol=0)
        assert np.all(np.diag(agent.noise_covariance) >= np.diag(wanted[columns, columns]))
    assert problem.written_agents[0].noise_covariance[0, 0] == 0.02**2


def test_single_worlds_and_batches_have_the_same_bits() -> None:
    problem = team([drone("drone_0", 0.0), drone("drone_1", 0.5)], WIND)
    one = SingleSimulator.of(core.Dynamics.of(problem))
    dynamics, rng = one.dynamics, np.random.default_rng(SEED)
    worlds = core.initial(dynamics, rng, 3)
    normals = core.noise(dynamics, rng, 3)
    inputs = [rng.uniform(-0.5, 0.5, (1, 2, 3))]
    batch = core.joint(dynamics, core.transition(dynamics, worlds, inputs, normals))
    for k in range(3):
        world = one.begin(core.selected(worlds, np.array([k])))
        drawn = np.concatenate([z[..., k].ravel() for z in normals]).tolist()
        assert len(drawn) == one.n_draws
        after = one.step(world, [[inputs[0][0, i, k]] for i in range(2)], drawn)
        assert [x for own in after.states for x in own] == batch[k].tolist()


def test_files_and_pickles_keep_it() -> None:
    problem = team([bent("drone_0", [0.0, 0.0]), drone("kite", 0.0)], {"wind": {"drone_*": {"y": 0.1}, "kite": [0.2]}})
    again = problem_from_dict(problem.to_dict())
    assert again.fingerprint == problem.fingerprint == pickle.loads(pickle.dumps(problem)).fingerprint
    assert problem.fingerprint != team([*problem.written_agents], {"wind": {"drone_*": {"y": 0.1}}}).fingerprint
    half = problem.replace(disturbance_scale=0.5)
    np.testing.assert_allclose(half.agents[1].noise_covariance, 0.25 * problem.agents[1].noise_covariance, rtol=1e-12)
    np.testing.assert_array_equal(half.shared_noise[0], 0.5 * problem.shared_noise[0])
    moved = problem.replace(initial_state={"kite": [0.3]})
    assert moved.agents[1].noise_covariance.tolist() == problem.agents[1].noise_covariance.tolist()
    assert moved.shared_noise[1].tolist() == [[0.2]]


@pytest.mark.parametrize(
    "joint_noise, words",
    [
        ({"wind": {"plane": [0.1]}}, "expected agents among drone_0, drone_1"),
        ({"wind": {"drone_*": [0.1, 0.2]}}, "wind.drone_"),
        ({"wind": {"drone_*": [float("nan")]}}, "wind.drone_"),
        ({"wind": {"drone_*": [0.1], "drone_0": [0.1]}}, "got two"),
    ],
)
def test_mistakes_are_named(joint_noise: Any, words: str) -> None:
    with pytest.raises(ValueError, match="joint_noise") as error:
        team([drone("drone_0", 0.0), drone("drone_1", 0.5)], joint_noise)
    assert words in str(error.value)


def test_noise_that_is_not_normal_is_refused() -> None:
    agent = LinearAgent(
        name="drone_0", A=[[1.0]], B=[[1.0]], noise=[{"law": "uniform", "low": -0.1, "high": 0.1}], state_low=[-3],
        state_high=[3], input_low=[-1], input_high=[1], initial_state=[0.0],
    )  # fmt: skip
    with pytest.raises(ValueError, match="normal noise"):
        team([agent], {"wind": {"drone_0": [0.1]}})


def one_step(
    stds: list[float],
    factors: list[list[float]],
    pairs: dict[str, Pair],
    formula: str,
    limit: float,
    low: float | None = None,
) -> Problem:
    """Two or three agents that stand still for one step, so that all probabilities are integrals of one normal law."""
    agents = [
        LinearAgent(
            name=f"drone_{i}", A=[[1.0]], B=[[1.0]], noise_covariance=[[std**2]], state_low=[-50], state_high=[50],
            input_low=[0.0], input_high=[0.0], initial_state=[0.0],
        )
        for i, std in enumerate(stds)
    ]  # fmt: skip
    sources = {f"source_{k}": {f"drone_{i}": [row[k]] for i, row in enumerate(factors)} for k in range(len(factors[0]))}
    propositions: Any = {"safe": Proposition("drone_*", [-limit if low is None else low], [limit]), **pairs}
    return Problem(name="one", horizon=1, agents=agents, propositions=propositions,
                   specification=Specification(formula, "finite-trace"), joint_noise=sources)  # fmt: skip


@pytest.mark.thorough
def test_bounds_are_below_integrals_and_near_where_differences_are() -> None:
    """Exact oracle: one step; of the difference of two agents their sources cancel a part."""
    rng = np.random.default_rng(SEED)
    for _ in range(6):
        stds, factors = rng.uniform(0.05, 0.3, 2), rng.normal(0.0, 0.3, (2, 2))
        width = float(rng.uniform(0.8, 2.5))
        near = {"near": Pair(["drone_0", "drone_1"], [-width], [width])}
        problem = one_step(stds.tolist(), factors.tolist(), near, "G near", 40.0)
        found = cg.synthesize(problem)
        spread = float(np.sqrt(np.sum(stds**2) + np.sum((factors[0] - factors[1]) ** 2)))
        truth = 2.0 * norm.cdf(width / spread) - 1.0
        assert check(found).valid
        assert truth - 1e-6 <= found.certificate.lower_bound <= truth


def test_agents_of_one_source_are_not_multiplied() -> None:
    """Where both fail together the bound is Boole's, and below the integral; a product is above it for tails apart."""
    factors = np.array([[0.5], [-0.5]])
    problem = one_step([0.05, 0.05], factors.tolist(), {}, "G all(safe)", 1.0)
    found = cg.synthesize(problem)
    covariance = np.diag([0.05**2] * 2) + factors @ factors.T
    law = multivariate_normal(np.zeros(2), covariance)
    signs = list(itertools.product((1.0, -1.0), repeat=2))
    truth = sum(np.prod(s) * law.cdf(np.array(s), rng=np.random.default_rng(SEED)) for s in signs)
    assert check(found).valid
    assert truth - 0.05 <= found.certificate.lower_bound <= truth + 1e-6


def test_a_product_of_agents_that_a_wind_drives_apart_is_refused() -> None:
    """One limit for each, and a wind that blows them against it in turn: a product claims more than is true."""
    problem = one_step([0.05, 0.05], [[0.5], [-0.5]], {}, "G all(safe)", 1.0, low=-49.0)
    found: Any = cg.synthesize(problem).certificate
    tail = norm.sf(1.0 / np.hypot(0.05, 0.5))
    product = 1.0 - (1.0 - tail) ** 2
    law = multivariate_normal(np.zeros(2), [[0.2525, -0.25], [-0.25, 0.2525]])
    truth = 1.0 - law.cdf(np.ones(2), rng=np.random.default_rng(SEED))
    assert product < truth - 1e-4 and check(found).valid
    assert truth - 1e-6 <= found.proof.failure <= 2.0 * tail * (1.0 + 1e-6)
    assert not check(changed(found, failure=product * (1.0 + 1e-6))).valid


@pytest.mark.thorough
def test_one_wind_moves_a_formation() -> None:
    """Three drones in a wind that takes all alike: they keep apart as if it did not blow; rollouts agree."""
    agents = [bent(f"drone_{i}", [-2.0, 0.6 * i - 0.6]) for i in range(3)]
    close = Pair("drone_*", distance=0.35)
    wind = {"x": {"drone_*": {"x": 0.06}}, "y": {"drone_*": {"y": 0.06}}}
    problem = team(agents, wind, "G !any(close) & F all(goal)", 12, close=close)
    found = cg.synthesize(problem)
    assert isinstance(found.certificate.proof, PathProof)
    assert found.certificate.lower_bound >= 0.999
    assert check(found).valid
    rate = cg.validate(found, episodes=20_000, seed=SEED)
    assert "refuted" not in rate.verdict


def test_the_check_refuses_what_forgets_it() -> None:
    """Certificates of the team without its winds, or of winds that blow alike, claim too much for other ones."""
    agents = [bent(f"drone_{i}", [-2.0, 0.7 * i]) for i in range(2)]
    close = Pair("drone_*", distance=0.35)
    alike = team(agents, {"w": {"drone_*": {"y": 0.06}}}, "G !any(close) & F all(goal)", 8, close=close)
    found: Any = cg.synthesize(alike).certificate
    assert check(found).valid and found.proof.failure < 1e-3
    against = {"w": {"drone_0": {"y": 0.06}, "drone_1": {"y": -0.06}}}
    other = team(agents, against, "G !any(close) & F all(goal)", 8, close=close)
    # The marginal laws are the same, to the last bit: only what agents share differs.
    for a, b in zip(alike.agents, other.agents):
        assert a.noise_covariance.tolist() == b.noise_covariance.tolist()
    forged = replace(found, problem=other)
    report = check(forged)
    assert not report.valid and "recomputed" in " ".join(report.failures)


@pytest.mark.parametrize("relation", ["exact", "linear", "boxes"])
def test_grids_refuse_it(relation: str) -> None:
    problem = team([drone("drone_0", 0.0), drone("drone_1", 0.5)], WIND)
    with pytest.raises(ValueError, match="joint_noise"):
        cg.synthesize(problem, relation=relation)


def test_what_multiplies_over_agents_refuses_it() -> None:
    problem = team([drone("drone_0", 0.0), drone("drone_1", 0.5)], WIND)
    with pytest.raises(ValueError, match="joint_noise"):
        cg.synthesize(problem, cells=20)
    with pytest.raises(ValueError, match="joint_noise"):
        cg.certify(problem, lambda states, q, time: np.zeros(1), cells=20)


def test_the_check_refuses_grids_of_teams_that_share_noise() -> None:
    """A certificate on a grid, of the same agents with all that they feel, but as if they were independent."""
    shared = team([drone("drone_0", 0.0), drone("drone_1", 0.5)], WIND)
    apart = Problem(
        name="team", horizon=6, agents=shared.agents, propositions=shared.declared, specification=shared.specification
    )
    found: Any = cg.synthesize(apart, cells=20, relation="exact").certificate
    assert check(found).valid
    report = check(replace(found, problem=shared))
    assert not report.valid and "share noise" in " ".join(report.failures)
