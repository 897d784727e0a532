"""Pairs whose box or distance names the time hold where they are then: for simulators, searches and the check."""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import Dynamics, SingleSimulator
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.tasks.problem import problem_from_dict
from kinds import mostly_thorough
from pair_problems import judged_by_hand

HORIZON = 12

MOVING: dict[str, tuple[dict[str, Any], Any]] = {
    "distance": ({"distance": "0.6 + 0.1*t"}, lambda d, t: np.hypot(*d) < 0.6 + 0.1 * t),
    "distance that closes": ({"distance": "1.5*sin(0.7*t)"}, lambda d, t: np.hypot(*d) < 1.5 * math.sin(0.7 * t)),
    "box": (
        {"low": ["-1 - 0.1*t", -1], "high": [0.5, "1 + 0.05*t"]},
        lambda d, t: (-1 - 0.1 * t <= d[0]) & (d[0] < 0.5) & (-1 <= d[1]) & (d[1] < 1 + 0.05 * t),
    ),
    "box of states": (
        {"low": ["0.1*t"], "high": ["0.1*t + 2"], "of": ["y"]}, lambda d, t: (0.1 * t <= d[1]) & (d[1] < 0.1 * t + 2)
    ),
}  # fmt: skip


def robot(name: str, start: list[float], std: float = 0.08) -> cg.Agent:
    return cg.Agent(
        name=name, states=["x", "y"], inputs=["u", "v"], dynamics=["x + u", "y + v"],
        noise=[{"law": "gaussian", "std": std}] * 2, state_low=[-6, -6], state_high=[6, 6], input_low=[-1, -1],
        input_high=[1, 1], initial_state=start,
    )  # fmt: skip


def problem_of(
    formula: str, near: dict[str, Any], std: float = 0.08, regions: dict[str, cg.Proposition] | None = None
) -> cg.Problem:
    kind = "finite-trace" if formula.startswith("G") else "co-safe"
    regions = regions or {"there": cg.Proposition("one", [3, -1], [5, 1])}
    return cg.Problem(
        name="moving-pairs", horizon=HORIZON, agents=[robot("one", [-4, 0], std), robot("two", [4, 0.2], std)],
        propositions={**regions, "near": cg.Pair(["one", "two"], **near)},
        specification=cg.Specification(formula, kind),
    )  # fmt: skip


@pytest.mark.parametrize("name", MOVING)
def test_a_pair_holds_where_it_is_at_each_time(name: str) -> None:
    near, wanted = MOVING[name]
    problem = problem_of("F (near & there)", near)
    dynamics = Dynamics.of(problem)
    single_simulator = SingleSimulator.of(dynamics)
    states = np.random.default_rng(3).uniform(-2.5, 2.5, (4, 400))
    blocks = core.split_joint(dynamics, states.T)
    held = 0
    for t in range(HORIZON + 1):
        truth = wanted(states[:2] - states[2:], t)
        held += int(truth.sum())
        assert np.array_equal(core.letters(dynamics, blocks, t)[1], truth)
        assert np.array_equal(core.letters(dynamics, blocks, np.full(400, t))[1], truth)
        for k in range(0, 400, 40):
            joint = [states[:2, k], states[2:, k]]
            assert problem.labeling.at(t).letter(joint)[1] == truth[k]
            assert single_simulator._letter(tuple(tuple(x.tolist()) for x in joint), t)[0] >> 1 == truth[k]
    assert 0 < held < 400 * (HORIZON + 1)
    with pytest.raises(ValueError, match="names the time"):
        problem.labeling.letter([states[:2, 0], states[2:, 0]])


@pytest.mark.parametrize("name", MOVING)
def test_pairs_are_saved_as_they_are_written(name: str) -> None:
    problem = problem_of("F (near & there)", MOVING[name][0])
    again = problem_from_dict(json.loads(json.dumps(problem.to_dict())))
    assert again.fingerprint == problem.fingerprint == pickle.loads(pickle.dumps(problem)).fingerprint
    assert set(problem.to_dict()["propositions"]["near"]) == {"agents", *MOVING[name][0]}
    assert problem.names_time
    still = problem_of("F (near & there)", {"distance": "2/2"})
    assert still.fingerprint == problem_of("F (near & there)", {"distance": 1}).fingerprint
    assert not still.names_time


@mostly_thorough("formula", ["!near U there", "F (near & there)"])
@mostly_thorough("name", MOVING)
def test_what_is_certified_is_checked_and_met(name: str, formula: str) -> None:
    from certigym.validation.statistical_tests import Loop, paths

    near, wanted = MOVING[name]
    problem = problem_of(formula, near)
    result = cg.synthesize(problem)
    assert cg.check(result.certificate, problem)
    assert result.certificate.lower_bound > 0.999
    states, success = paths(Loop(problem, result.controller, 5, 200), 200)
    assert np.array_equal(success, judged_by_hand(states, wanted, formula))
    assert success.mean() > 0.98


@pytest.mark.thorough
def test_the_check_reads_pairs_at_their_time() -> None:
    """A pair that is wide at all times but one: who is told otherwise, or is late by one, is refused."""
    gap = "5 - 4.4*max(0, 1 - abs(t - {}))"
    regions = {"there": cg.Proposition("one", [-1, -1], [1, 1]), "here": cg.Proposition("two", [-1, -1], [2, 1])}
    formula = "F (there & here & !near)"
    honest = problem_of(formula, {"distance": gap.format(8)}, regions=regions)
    certificate = cg.synthesize(honest, relation="path").certificate
    assert cg.check(certificate, honest)
    assert certificate.lower_bound > 0.99
    for other in (gap.format(7), gap.format(9), "5", "5 - 0.1*t"):
        wrong = problem_of(formula, {"distance": other}, regions=regions)
        assert not cg.check(certificate, wrong)
        assert not cg.check(replace(certificate, problem=wrong), wrong)


@pytest.mark.thorough
def test_paths_for_a_pair_that_stands_still_do_not_do_for_one_that_grows() -> None:
    still, wrong = (problem_of("!near U there", {"distance": d}, 0.15) for d in (1.0, "1 + 0.12*t"))
    certificate = cg.synthesize(still, relation="path").certificate
    assert cg.check(certificate, still)
    assert not cg.check(replace(certificate, problem=wrong), wrong)


def test_grids_say_that_they_know_pairs_that_stand_still() -> None:
    problem = problem_of("!near U there", {"low": [-1, -1], "high": [1, "1 + t"]}, 0.9)
    with pytest.raises(ValueError, match="grids know pairs that stand still"):
        cg.synthesize(problem, relation="exact")


@pytest.mark.parametrize(
    ("near", "said"),
    [
        ({"low": ["t", "q"], "high": [1, 1]}, "`low[1]`: unknown name 'q'"),
        ({"distance": "-1 - t"}, "can meet at some time from 0 to 12"),
        ({"distance": "log(t)"}, "not finite at t = 0"),
    ],
)
def test_what_cannot_be_is_refused_in_words(near: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=r"[`:]") as caught:
        problem_of("F near", near)
    assert said in str(caught.value)
