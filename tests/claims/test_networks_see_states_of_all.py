"""Networks that see states of other agents are certified along their run, and are the functions that were given."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import canonical_problem, changed, contents_of
from certigym.synthesis.checker import Joint, read_problem, read_trajectories, walk
from certigym.synthesis.interop.environments import sight_of
from kinds import mostly_thorough

EPISODES = 20_000
ENVS = {
    "central_env": 2,
    "central_vec_env": 2,
    "parallel_env(observation=full;scale=unit;actions=unit)": 2,
    "parallel_env(observation=relative;actions=unit)": 3,
    "parallel_env(observation=neighbours;actions=unit;automaton=number)": 2,
}


def team(n: int, law: Any = 0.03) -> cg.Problem:
    """Agents that are to be in their goals at one time."""
    agents = [
        cg.Agent(
            name=f"a{k}", states=["x", "v"], inputs=["u"], dynamics=["x + 0.4*v", "0.9*v + 0.4*u + 0.05*sin(x)"],
            noise=[law, law], state_space=([-4, -3], [4, 3]), input_space=(-2, 2), start=[-1.5 - k, 0.0],
        )
        for k in range(n)
    ]  # fmt: skip
    goals = {f"g{k}": cg.Proposition(f"a{k}", [0.2 + 0.3 * k, -2], [1.2 + 0.3 * k, 2]) for k in range(n)}
    task = cg.Specification(f"F ({' & '.join(goals)})")
    return cg.Problem(name="team", horizon=14, agents=agents, propositions=goals, specification=task)


def fitted(problem: cg.Problem, env: str, seed: int, activation: str) -> list[Any]:
    """Layers that move every agent to its goal, and a little with the next agent, by least squares."""
    rng, view, n, count = np.random.default_rng(seed), sight_of(env), problem.n_agents, 4000
    x = [np.stack([rng.uniform(-3, 3, count), rng.uniform(-2, 2, count)]) for _ in range(n)]
    q = rng.integers(problem.automaton.n_states, size=count)
    laws = [0.5 * (-0.9 * (x[k][0] - 0.7 - 0.3 * k) - 1.1 * x[k][1] + 0.1 * (x[(k + 1) % n][0] - x[k][0]))
            for k in range(n)]  # fmt: skip
    asked = range(1) if view.central else range(n)
    rows = np.concatenate([view.rows(problem, k, x, q, 3) for k in asked])
    wanted = np.stack(laws, axis=1) if view.central else np.concatenate(laws)[:, None]
    first = 0.7 * rng.standard_normal((rows.shape[1], 40)) / (1.0 + 0.5 * np.abs(rows).max(axis=0)[:, None])
    bias = 0.3 * rng.standard_normal(40)
    hidden = rows @ first + bias
    hidden = np.c_[np.tanh(hidden) if activation == "tanh" else np.maximum(hidden, 0.0), np.ones(len(rows))]
    last = np.linalg.solve(hidden.T @ hidden + 0.01 * np.eye(41), hidden.T @ np.clip(wanted, -1.0, 1.0))
    return [
        (first.astype(np.float32), bias.astype(np.float32)),
        (last[:-1].astype(np.float32), last[-1].astype(np.float32)),
    ]


def given(env: str, law: Any = 0.03, seed: int = 0, activation: str = "relu") -> tuple[cg.Problem, Any]:
    problem = team(ENVS[env], law)
    return problem, cg.as_policy(fitted(problem, env, seed, activation), problem, env=env, activation=activation)


@cache
def certified(env: str) -> tuple[cg.Problem, Any, cg.Synthesis]:
    problem, policy = given(env)
    return problem, policy, cg.certify(problem, policy)


@mostly_thorough("env", sorted(ENVS, key=lambda env: "relative" not in env and env != "central_env"))
def test_what_is_certified_is_what_was_given(env: str) -> None:
    """With the same noise the controller of the certificate succeeds as often as the model, and often enough."""
    problem, policy, found = certified(env)
    assert policy.why_not_as_it_is == "" and found.certificate.lower_bound > 0.3
    assert cg.check(found.certificate, problem)
    runs = [cg.rollout(problem, own, episodes=EPISODES, seed=1) for own in (policy, found.controller)]
    assert abs(runs[0].successes - runs[1].successes) <= 2
    p = found.certificate.lower_bound
    assert runs[0].successes / EPISODES >= p - 5.0 * np.sqrt(p * (1.0 - p) / EPISODES)


def test_files_hold_them_and_forgeries_are_refused(tmp_path: Any) -> None:
    problem, _, found = certified("central_env")
    certificate: Any = found.certificate
    again: Any = cg.load(cg.save(certificate, tmp_path / "c.npz") or tmp_path / "c.npz")
    assert cg.check(again, problem) and again.lower_bound == certificate.lower_bound
    states = np.random.default_rng(0).uniform(-1.0, 1.0, (problem.n_states, 50))
    q, (first, *others) = np.zeros(50, dtype=int), certificate.proof.networks
    assert np.array_equal(again.proof.networks[0].inputs(states, q, 2), first.inputs(states, q, 2))
    transposed = first.matrix.copy()
    transposed[[0, 2]] = transposed[[2, 0]]  # it sees one agent for the other
    for forged in (replace(first, matrix=transposed), replace(first, offset=first.offset + 0.1)):
        assert not cg.check(changed(certificate, networks=(forged, *others)), problem)
    with pytest.raises(ValueError, match="told"):
        cg.load(cg.save(changed(certificate, networks=(replace(first, told=0), *others)), tmp_path / "d.npz") or
                tmp_path / "d.npz")  # fmt: skip
    longer = changed(certificate, networks=(replace(first, horizon=99), *others))
    assert "another horizon" in str(cg.check(longer, problem).failures)


def test_agents_of_a_team_are_told_the_states_of_all() -> None:
    problem, _, found = certified("central_env")
    controller: Any = found.controller
    env = cg.parallel_env(problem)
    observations, infos = env.reset(seed=0)
    actions = controller.act(observations, infos)
    x = np.concatenate([infos[name]["state"] for name in problem.agent_names])[:, None]
    assert all(np.array_equal(actions[name], controller.inputs(i, x, np.array([problem.initial_q]), 0)[:, 0])
               for i, name in enumerate(problem.agent_names))  # fmt: skip
    with pytest.raises(ValueError, match="those of all agents"):
        controller.act({"a0": observations["a0"]})


def test_what_changes_places_or_lies_on_cells_is_refused_with_a_reason() -> None:
    env = "parallel_env(observation=neighbours;actions=unit;automaton=number)"
    problem = team(3)
    policy = cg.as_policy(fitted(problem, env, 0, "relu"), problem, env=env, activation="relu")
    with pytest.raises(ValueError, match="it sees own state, and where the nearest others are"):
        cg.certify(problem, policy)
    assert "change places" in policy.why_not_as_it_is
    problem, policy = given("central_env")
    for options in ({"cells": 10}, {"wrap": True}):
        with pytest.raises(ValueError, match="it sees states of all agents"):
            cg.certify(problem, policy, **options)


@pytest.mark.thorough
def test_tubes_of_noise_that_is_not_normal_hold() -> None:
    """Uniform noise, whose ellipsoids have sub-Gaussian tails."""
    problem, policy = given("central_env", {"law": "uniform", "low": -0.05, "high": 0.05}, activation="tanh")
    found = cg.certify(problem, policy)
    assert found.certificate.lower_bound > 0.5 and cg.check(found.certificate, problem)
    share = cg.rollout(problem, policy, episodes=EPISODES, seed=0).successes / EPISODES
    assert share >= found.certificate.lower_bound - 0.02


@pytest.mark.parametrize("env", ENVS)
def test_rows_are_affine_up_to_what_the_checker_charges(env: str) -> None:
    """Rows as environments compute them, at random states of the workspaces, in units of double precision."""
    problem, view, rng = team(ENVS[env]), sight_of(env), np.random.default_rng(0)
    states = [rng.uniform(a.state_low[:, None], a.state_high[:, None], (a.n_states, 2000)) for a in problem.agents]
    joint = np.concatenate(states)
    for i in range(1 if view.central else problem.n_agents):
        affine = view.affine(problem, i)
        assert affine is not None
        matrix, offset = affine
        rows = view.rows(problem, i, states, np.zeros(2000, dtype=int), 3)[:, : len(offset)]
        charged = 64.0 * 2.0**-53 * (np.abs(matrix) @ np.abs(joint) + np.abs(offset)[:, None] + 1.0)
        assert np.all(np.abs(rows.T - (matrix @ joint + offset[:, None])) <= charged)


def test_networks_do_not_see_angles() -> None:
    """Where an angle wraps, what a network sees of it jumps: such a network is refused, whoever it moves."""
    turning = cg.Agent(name="t", states=["a"], inputs=["w"], dynamics=["a + 0.1*w"], noise=0.01, angles=["a"],
                       state_space=(-np.pi, np.pi), input_space=(-1, 1), start=[0.5])  # fmt: skip
    cart = cg.LinearAgent(name="c", A=1.0, B=0.1, noise=0.01, state_space=(-2, 2), input_space=(-1, 1), start=[0.5])
    goals = {"g": cg.Proposition("c", [-0.2], [0.7])}
    problem = cg.Problem(name="p", horizon=4, agents=[turning, cart], propositions=goals,
                         specification=cg.Specification("F g"))  # fmt: skip
    rng = np.random.default_rng(0)
    layers = [((0.1 * rng.standard_normal((5, 2))).astype(np.float32), np.zeros(2, np.float32))]
    with pytest.raises(ValueError, match="acts where no state that it sees is an angle"):
        cg.certify(problem, cg.as_policy(layers, problem, env="central_env"))


def test_errors_of_one_agent_follow_those_that_its_network_sees() -> None:
    """A linear layer that couples two agents strongly: the matrix of a step is that of the closed loop."""
    agents = [
        cg.LinearAgent(name=name, A=0.9, B=0.5, noise=0.01, state_space=(-2, 2), input_space=(-1, 1), start=[start])
        for name, start in (("a", 0.6), ("b", -0.4))
    ]
    goals = {name: cg.Proposition(name, [-0.3], [0.5]) for name in ("a", "b")}
    problem = cg.Problem(name="p", horizon=5, agents=agents, propositions=goals,
                         specification=cg.Specification("F (a & b)"))  # fmt: skip
    gains = np.array([[-0.3, 0.4], [-0.5, -0.2]])
    layer = np.concatenate([gains.T, np.zeros((problem.automaton.n_states + 1, 2))]).astype(np.float32)
    policy = cg.as_policy([(layer, np.zeros(2, np.float32))], problem, env="central_env")
    certificate = cg.certify(problem, policy).certificate
    known = read_problem({"problem": canonical_problem(problem)})
    read = read_trajectories(contents_of(certificate), known)
    joint = Joint.of(known, read.trajectories, read.letters)
    assert len([*walk(joint)]) > 1
    for matrix, *_ in joint.errors.steps:
        assert np.allclose(matrix, 0.9 * np.eye(2) + 0.5 * gains, atol=1e-6)
