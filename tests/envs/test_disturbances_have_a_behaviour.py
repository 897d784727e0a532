"""Bounded disturbances do what their behaviour says, alike in one world and in many; certificates stand against all."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import BEHAVIOURS, Dynamics, SingleSimulator, batch_simulator
from certigym.synthesis.extended_check.claims import greedy_disturbance
from certigym.synthesis.relations.kinds import SymbolicMeans
from kinds import mostly_thorough
from team_problems import windy_team
from written_problems import bent


@cache
def certified() -> cg.Certificate:
    return cg.synthesize(windy_team(), 60, relation="linear").certificate


def steps(problem: cg.Problem, behaviour: Any, n_worlds: int, horizon: int) -> tuple[Any, Any]:
    """Disturbances (T, k, n, M) and worlds at the end, without inputs; one world is followed beside them."""
    dynamics, rng = Dynamics.of(problem, behaviour), np.random.default_rng(1)
    many, found = batch_simulator.initial(dynamics, rng, n_worlds), []
    single_simulator = SingleSimulator.of(dynamics)
    one = single_simulator.begin(batch_simulator.selected(many, np.array([2])))
    for _ in range(horizon):
        inputs, normals = [np.full((1, 2, n_worlds), 0.1)], batch_simulator.noise(dynamics, rng, n_worlds)
        [values] = batch_simulator.disturbances(dynamics, many, inputs, normals)
        assert values is not None
        found.append(np.array(values))
        many = batch_simulator.transition(dynamics, many, inputs, normals)
        one = single_simulator.step(one, [[0.1], [0.1]], normals[0][:, :, 2].ravel().tolist())
        assert [x[0] for x in one.states] == many.states[0][0, :, 2].tolist()
    return np.array(found), many


@mostly_thorough("behaviour", [*BEHAVIOURS, "greedy"], first=3)
def test_one_world_and_many_meet_the_same_disturbances(behaviour: str) -> None:
    found, _ = steps(windy_team(), greedy_disturbance(certified()) if behaviour == "greedy" else behaviour, 50, 4)
    assert np.all(np.abs(found) <= 0.3)
    if behaviour == "zero":
        assert not found.any()
    elif behaviour == "periodic":
        assert np.allclose(found[:, 0, 0, 0], 0.3 * np.sin(2 * np.pi * np.arange(4) / 8))
    elif behaviour == "random":
        # Uniform on [-.3, .3]: the mean of 400 numbers is within 5 standard errors (false alarms 6e-7).
        assert abs(found.mean()) < 5 * 0.6 / np.sqrt(12 * found.size) and found.std() > 0.15
        assert abs(np.corrcoef(found[:, 0, 0].ravel(), found[:, 0, 1].ravel())[0, 1]) < 0.4
    else:
        assert np.all(np.abs(found) == 0.3)
        # The wind blows the agents away from where they are to go.
        assert (found[0, 0, 0] == -0.3).all() and (found[0, 0, 1] == 0.3).all()


def test_intervals_without_zero_are_nearest_to_it() -> None:
    agent = bent("one", dynamics=["x + u + wind"], disturbances={"wind": [0.2, 0.5]})
    assert agent.mean(np.zeros((1, 3)), np.zeros((1, 3))).tolist() == [[0.2] * 3]


@pytest.mark.thorough
def test_a_claim_that_fails_under_one_behaviour_is_refuted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search leaves the wind out; calm rollouts agree with it, the greedy wind does not."""
    around = SymbolicMeans.around

    def calm(self: SymbolicMeans, *arguments: Any) -> Any:
        return around(replace(self, agent=self.agent.replace(disturbances={"wind": [0.0, 0.0]})), *arguments)

    problem = windy_team(0.7)
    with monkeypatch.context() as patch:
        patch.setattr(SymbolicMeans, "around", calm)
        broken = cg.synthesize(problem, 80, relation="boxes").certificate
    assert not cg.check(broken)
    assert cg.validate(broken, 20_000, seed=1, disturbance="zero").verdict == "consistent"
    report = cg.validate(broken, 20_000, seed=1)
    assert report.refuted and report.details["disturbance"] in ("random", "periodic", "greedy")


def test_environments_take_behaviours_by_name() -> None:
    problem = windy_team()
    ends = {}
    for behaviour in (*BEHAVIOURS, greedy_disturbance(certified())):
        env = cg.central_env(problem, disturbance=behaviour)
        env.reset(seed=5)
        ends[str(behaviour)] = env.step(np.zeros(2))[0][:2].tolist()
        parallel = cg.parallel_env(problem, disturbance=behaviour)
        parallel.reset(seed=5)
        parallel.step({name: np.zeros(1) for name in parallel.agents})
        vector = cg.vector_env(problem, 4, disturbance=behaviour)
        vector.reset(seed=5)
        vector.step(np.zeros((4, 2)))
        team = cg.team_env(problem, 4, disturbance=behaviour)
        team.reset(seed=5)
    assert ends["zero"] == ends["periodic"]  # a sine begins at 0
    assert ends["zero"] != ends["random"]
    assert np.allclose(np.abs(np.array(ends[str(greedy_disturbance(certified()))]) - ends["zero"]), 0.3)
    with pytest.raises(ValueError, match="`disturbance`: expected one of zero, random, periodic or a function"):
        cg.central_env(problem, disturbance="wild")
    with pytest.raises(ValueError, match="`disturbance`"):
        cg.rollout(problem, certified(), 10, disturbance=3)  # type: ignore[arg-type]
