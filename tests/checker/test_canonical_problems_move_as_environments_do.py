"""The canonical form of a problem says what the environments do: means, noise, boxes and letters are the same.

A simulator that is written from the canonical problem alone is compared with the problem, for every problem of the
suite and every model in ``examples/own`` that has the form.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canonical_simulator import Simulator
from certigym.envs.suite import make_problem, problem_ids
from certigym.envs.systems.agents import Agent
from certigym.envs.tasks.problem import Problem, load_problem
from certigym.synthesis.certificates.proofs.canonical import NotCanonicalError, canonical_problem
from certigym.synthesis.checker import read_problem
from kinds import mostly_thorough

OWN = sorted((Path(__file__).parents[2] / "examples" / "own").glob("*.toml"))
NAMES = [*problem_ids(), *(str(path) for path in OWN)]
POINTS = 64


def problem_named(name: str) -> Problem:
    return load_problem(name) if name.endswith(".toml") else make_problem(name)


def random_points(problem: Problem, rng: np.random.Generator) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """States and inputs (., n) all over their boxes, corners among them."""

    def points(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        share = rng.uniform(size=(len(low), POINTS))
        share[:, :8] = np.round(share[:, :8])
        return low[:, None] + share * (high - low)[:, None]

    agents = problem.agents
    states = [points(agent.state_low, agent.state_high) for agent in agents]
    return states, [points(agent.input_low, agent.input_high) for agent in agents]


@mostly_thorough("name", NAMES, first=11, ids=lambda name: Path(name).stem)
def test_one_step_and_the_letters_are_the_same(name: str) -> None:
    problem = problem_named(name)
    try:
        data: dict[str, Any] = json.loads(json.dumps(canonical_problem(problem), allow_nan=False))
    except NotCanonicalError as reason:
        pytest.skip(str(reason))
    read_problem({"problem": data})
    simulator, rng = Simulator(data), np.random.default_rng(0)
    x, u = random_points(problem, rng)
    times = sorted({0, 1, problem.horizon // 2, problem.horizon - 1})
    for t in times:
        v = [
            {key: rng.uniform(low, high, POINTS) for key, (low, high) in agent.disturbances.items()}
            for agent in problem.agents
        ]
        with np.errstate(all="ignore"):
            wanted = [expected_means(problem, i, x, u, v[i], t) for i in range(problem.n_agents)]
            means = simulator.means(x, u, v, t)
        for mean, known in zip(means, wanted, strict=True):
            np.testing.assert_allclose(mean, known, rtol=1e-12, atol=1e-12)
    for t in [*times, problem.horizon]:
        with np.errstate(all="ignore"):
            letters = simulator.letters(x, t)
            here = problem.labeling.at(t)
            known = np.array([here.letter([own[:, k] for own in x]) for k in range(POINTS)]).T
        assert np.mean(letters != known) <= 0.002, f"{(letters != known).sum()} letters differ at time {t}"
    for agent, own in zip(data["agents"], problem.agents, strict=True):
        factor = np.reshape(agent["noise"], (own.n_states, -1))
        if own.laws is None:
            factor = np.hstack([factor, agent.get("shared_noise", np.zeros((own.n_states, 0)))])
            np.testing.assert_allclose(factor @ factor.T, own.noise_covariance, rtol=1e-9, atol=1e-300)
        else:
            np.testing.assert_array_equal(factor, own.noise_axes)
            assert agent["distributions"] == [law.to_dict() for law in own.laws]
            assert agent.get("noise_scale") == (None if own.noise_scale is None else list(own.noise_scale))
        np.testing.assert_array_equal(agent["start_low"], own.initial.low)
        np.testing.assert_array_equal(agent["state_high"], own.state_high)


def expected_means(
    problem: Problem, i: int, x: list[np.ndarray], u: list[np.ndarray], v: dict[str, np.ndarray], t: int
) -> np.ndarray:
    """The mean of the next state of an agent as the package computes it."""
    agent, others = problem.agents[i], []
    for name in agent.others:
        owner, key = name.split(".")
        j = problem.agent_names.index(owner)
        states = list(problem.agents[j].state_names)
        others.append(x[j][states.index(key)] if key in states else u[j][list(problem.agents[j].inputs).index(key)])
    if not isinstance(agent, Agent):
        return agent.mean(x[i], u[i])
    n = x[i].shape[1]
    disturbances, neighbours = (np.array([*rows]).reshape(-1, n) for rows in (v.values(), others))
    return agent.mean(x[i], u[i], disturbances, neighbours, time=t)
