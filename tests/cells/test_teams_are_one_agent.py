"""A joint agent is the team: checked entry by entry, and its claims survive an independent simulation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.dynamics import Dynamics
from certigym.envs.dynamics import worlds as core
from certigym.synthesis.cells import RelationRefused
from certigym.synthesis.certificates import Certificate, JointProof, changed
from certigym.synthesis.checking.team_check import wrong_team
from certigym.synthesis.pairs import joint_problem
from certigym.validation.statistics.binomial import clopper_pearson
from pair_problems import followers, mover


def kept_close(horizon: int = 5) -> cg.Problem:
    """Two agents that must stay within reach of each other and not come near: distances wanted and unwanted."""
    agents = [mover("back", [-2.0], noise_covariance=[[0.02]]), mover("front", [0.0], noise_covariance=[[0.01]])]
    return cg.Problem(
        name="kept-close",
        horizon=horizon,
        agents=agents,
        propositions={
            "goal": cg.Proposition("front", [1.0], [4.0]),
            "reach": cg.Pair(["back", "front"], [-3.2], [3.0]),
            "near": cg.Pair(["back", "front"], [-1.0], [1.0]),
        },
        specification=cg.Specification("G (reach & !near) & F goal", "finite-trace"),
    )


@pytest.fixture(scope="module")
def certificate() -> Certificate[JointProof]:
    held: Any = cg.synthesize(kept_close(), 40, relation="joint").certificate
    return held


def simulated(problem: cg.Problem, controller: Any, n: int, seed: int) -> int:
    """Return how many of n episodes succeed; states, letters and verdicts are computed here."""
    rng = np.random.default_rng(seed)
    automaton = problem.automaton
    batch = controller.inner.batch(Dynamics.of(controller.inner.problem))
    x = np.tile(np.concatenate([agent.initial.low for agent in problem.agents])[:, None], n)
    q, alive = np.full(n, automaton.initial), np.ones(n, dtype=bool)
    memory = None
    for t in range(problem.horizon + 1):
        alive &= (np.abs(x) <= 4.0).all(axis=0)
        gap = x[0] - x[1]
        # In the order of the labelling: goal of the second agent, then the pairs.
        letters = np.stack([x[1] >= 1.0, (gap >= -3.2) & (gap < 3.0), (gap >= -1.0) & (gap < 1.0)])
        q = automaton.next_state(q, letters).astype(np.int32)
        if t < problem.horizon:
            worlds = core.Worlds((x[:, None],), q, t, ~alive, np.zeros(n, dtype=bool))
            memory = batch.begin(worlds, rng) if memory is None else memory
            (u,), memory = batch.act(worlds, memory)
            noise = np.sqrt([[0.02], [0.01]]) * rng.standard_normal((2, n))
            x = x + u[:, 0] + noise
    return int((automaton.accepting[q] & alive).sum())


def test_claims_survive_an_independent_simulation(certificate: Certificate[JointProof]) -> None:
    """Fixed seed, n = 20,000, false alarm 1e-6; a claim .02 too large would be refuted."""
    assert cg.check(certificate) and certificate.lower_bound > 0.5
    successes = simulated(certificate.problem, certificate.controller, 20_000, 5)
    assert certificate.lower_bound <= clopper_pearson(successes, 20_000, 1.0 - 2e-6)[1]
    report = cg.validate(certificate, episodes=20_000)
    assert not report.refuted and abs(report.estimate - successes / 20_000) < 0.02


@pytest.mark.thorough
def test_random_teams_are_certified_and_not_refuted() -> None:
    """3 problems, fixed seeds, 4000 episodes each; false alarm 1e-6 over all claims."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        starts = tuple((float(x),) for x in np.linspace(-2.0, 1.0, 2) + rng.uniform(-0.3, 0.3, 2))
        near = ([-float(rng.uniform(0.5, 1.5))], [float(rng.uniform(0.5, 1.5))])
        task = ["G !any(near) & F goal", "F any(near)", "F (any(near) & F goal)"][seed % 3]
        problem = followers(task, near=near, horizon=4, starts=starts)
        certificate = cg.synthesize(problem, 16, relation="joint").certificate
        assert cg.check(certificate), seed
        report = cg.validate(certificate, episodes=4000, confidence=1.0 - 2e-6 / 3)
        assert not report.refuted, seed


def edited(problem: cg.Problem, edit: Callable[[dict[str, Any]], None]) -> cg.Problem:
    """The problem of the joint agent with a change to its one agent or its regions."""
    from certigym.envs.problem.problem_file import problem_from_dict

    data = joint_problem(problem).to_dict()
    edit(data)
    return problem_from_dict(data)


def entry(name: str, row: int, column: int, value: float) -> Callable[[dict[str, Any]], None]:
    def edit(data: dict[str, Any]) -> None:
        data["agents"][0][name][row][column] = value

    return edit


def negated(data: dict[str, Any]) -> None:
    """The difference of the second agent less the first, with an asymmetric box."""
    for row in data["agents"][0]["output_matrix"][2:]:
        row[:] = [-number for number in row]


def region(name: str, key: str, place: int, value: float) -> Callable[[dict[str, Any]], None]:
    def edit(data: dict[str, Any]) -> None:
        data["propositions"][name][key][place] = value

    return edit


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (entry("A", 0, 1, 0.1), "ties agents"),
        (entry("A", 0, 0, 0.9), "not that of agent `back`"),
        (entry("B", 1, 0, 0.2), "ties agents"),
        (entry("noise_covariance", 1, 1, 0.001), "not that of agent `front`"),
        (negated, "another box"),
        (region("near", "high", 3, 0.5), "another box"),
        (region("goal", "low", 1, 0.0), "another box"),
        (region("goal", "low", 0, 0.0), "not about"),
        (lambda data: data["agents"][0].update(input_high=[1.0, 1.5]), "`input_high`"),
        (lambda data: data["agents"][0].update(state_low=[-4.0, -5.0]), "`state_low`"),
        (lambda data: data["agents"][0].update(initial_low=[-2.0, 0.5], initial_high=[-2.0, 0.5]), "start"),
        (lambda data: data.update(horizon=4), "horizon"),
        (lambda data: data["specification"]["automaton"].update(initial=1), "automaton"),
    ],
)
def test_the_check_refuses_another_team(certificate: Certificate[JointProof], edit: Any, message: str) -> None:
    other = edited(kept_close(), edit)
    assert any(message in text for text in wrong_team(kept_close(), other))
    forged = changed(certificate, base=replace(certificate.proof.base, problem=other))
    report = cg.check(forged)
    assert not report and message in str(report)


def test_the_joint_problem_itself_is_not_refused() -> None:
    assert wrong_team(kept_close(), joint_problem(kept_close())) == []


def test_agents_act_alike_in_an_environment_and_in_batches(certificate: Certificate[JointProof]) -> None:
    problem, controller = certificate.problem, certificate.controller
    env = cg.parallel_env(problem)
    observations, infos = env.reset(seed=4)
    controller.reset(observations, infos, seed=4)
    dynamics = Dynamics.of(problem)
    batch = controller.batch(dynamics)
    worlds = core.initial_at(dynamics, np.array([[-2.0, 0.0]]))
    (inputs,), _ = batch.act(worlds, batch.begin(worlds, np.random.default_rng(0)))
    for told in (infos, None):
        actions = controller.act(observations, told)
        assert [actions["back"][0], actions["front"][0]] == inputs[0, :, 0].tolist()
    with pytest.raises(ValueError, match="all agents"):
        controller.act({"back": observations["back"]})
    with pytest.raises(ValueError, match="mismatch"):
        controller.reset({"back": observations["back"]})


@pytest.mark.thorough
def test_large_teams_are_refused_in_words() -> None:
    with pytest.raises(RelationRefused, match="at most 40 states"):
        cg.synthesize(cg.make_problem("swarm-v0", n_agents=30), relation="joint")
    with pytest.raises(RelationRefused, match="no room for a grid"):
        cg.synthesize(cg.make_problem("swarm-v0", n_agents=2), 8, relation="joint")
    with pytest.raises(ValueError, match="'back' is missing"):
        cg.synthesize(kept_close(), {"front": 8}, relation="joint")


def test_values_in_time_are_those_of_the_joint_agent(certificate: Certificate[JointProof]) -> None:
    """Fixed seed, n = 20,000, false alarm 1e-6: with three steps left no more is promised than is kept."""
    values, problem = cg.value_in_time(certificate), certificate.problem
    start, q = np.array([-2.0, 0.0]), problem.initial_q
    assert values.at(start, q, problem.horizon)[0] == pytest.approx(certificate.at(start)[0], abs=1e-12)
    by_name = {"back": [-2.0], "front": [0.0]}
    assert values.at(by_name, q, 3)[0] == values.at(start, q, 3)[0]
    # The controllers with three steps left are those of the last three steps.
    short: Any = cg.synthesize(kept_close(3), 40, relation="joint").certificate
    promised = short.at(start)[0]
    runs = cg.rollout(short.problem, short.controller, episodes=20_000, seed=5)
    assert promised <= clopper_pearson(runs.successes, runs.episodes, 1 - 1e-6)[1]
    assert 0.0 < values.at(start, q, 3)[0] <= 1.0


def test_shields_keep_what_joint_agents_promise(certificate: Certificate[JointProof]) -> None:
    """Fixed seed, n = 4,000, false alarm 1e-6: idle and random proposals behind a shield of .5 succeed that often."""
    problem, p = certificate.problem, 0.5
    assert certificate.lower_bound > p
    shielded = cg.shield(cg.as_controller(problem, lambda *_: np.zeros(1)), certificate, probability=p)
    runs = cg.rollout(problem, shielded, episodes=4000, seed=4)
    assert clopper_pearson(runs.successes, runs.episodes, 1 - 1e-6)[1] >= p
    alone = cg.rollout(problem, cg.as_controller(problem, lambda *_: np.zeros(1)), episodes=4000, seed=4)
    assert alone.successes < 0.5 * p * alone.episodes < runs.successes  # without a shield the goal is out of reach
    env = cg.shield(problem, certificate, probability=p)
    env.reset(seed=0)
    _, _, _, _, infos = env.step({name: np.zeros(1) for name in env.agents})
    assert infos["back"]["budget"] <= infos["back"]["value"]
    with pytest.raises(ValueError, match="`form`: expected 'joint' for a joint agent"):
        cg.shield(problem, certificate, probability=p, form="decentralised")
