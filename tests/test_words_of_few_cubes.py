"""Words of few cubes: accepted, whatever agrees with them, and enough where an automaton counts or says too little."""

from __future__ import annotations

from itertools import groupby, islice, pairwise
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.nominal_paths.drifts import Drifts
from certigym.synthesis.nominal_paths.segments import segmented_ways
from certigym.synthesis.nominal_paths.timed_words import timed_ways
from certigym.synthesis.nominal_paths.words import is_accepted, ways_of, without_needless


def robot(**changes: Any) -> cg.LinearAgent:
    given: dict[str, Any] = {
        "name": "robot", "A": [[1.0]], "B": [[1.0]], "noise_covariance": [[0.01]], "state_low": [-5.0],
        "state_high": [5.0], "input_low": [-0.8], "input_high": [0.8], "initial_state": [-4.0],
    }  # fmt: skip
    return cg.LinearAgent(**given | changes)


def task(formula: str, horizon: int, semantics: str = "finite-trace", **agents: Any) -> cg.Problem:
    return cg.Problem(
        name="words",
        horizon=horizon,
        agents=[robot(), *agents.values()],
        propositions={
            "here": cg.Proposition("robot", low=[1.0], high=[3.0]),
            "lane": cg.Proposition("robot", low=[-0.7], high=[0.7]),
            **({"busy": cg.Proposition("other", low=[-1.5], high=[1.5])} if agents else {}),
        },
        specification=cg.Specification(formula, semantics=semantics),
    )


@pytest.mark.parametrize(
    ("formula", "semantics"),
    [
        ("F[0,14] G[0,5] here", "finite-trace"),
        ("F (lane & F here)", "co-safe"),
        ("(!lane U here) | G !lane", "finite-trace"),
    ],
)
def test_every_word_is_accepted_whatever_agrees_with_it(formula: str, semantics: str) -> None:
    problem = task(formula, 20, semantics)
    found = list(islice(segmented_ways(problem), 60))
    assert len(found) > 3
    for way, times in found:
        steps = times[-1] if problem.automaton.is_co_safe else problem.horizon
        letters = way.letters(times, steps, len(problem.automaton.propositions))
        assert letters is not None
        assert is_accepted(problem, letters)


def test_automata_that_count_steps_have_paths() -> None:
    """F[0,14] G[0,5] has some sixty states and no stays: ways through the automaton alone find nothing."""
    problem = task("F[0,14] G[0,5] here", 20)
    result = cg.synthesize(problem, relation="path")
    assert result.certificate.lower_bound > 0.9999
    assert cg.check(result.certificate, problem)


def test_one_waits_until_nobody_is_in_the_lane() -> None:
    """The loop of `!(lane & busy) U here` is read beside the lane at first, and in it later."""
    lift = cg.LinearAgent(
        name="other", A=[[1.0]], offset=[0.4], noise_covariance=[[1e-4]],
        state_low=[-9.0], state_high=[9.0], initial_state=[-2.0],
    )  # fmt: skip
    problem = task("!(lane & busy) U here", 16, "co-safe", other=lift)
    busy = Drifts(problem).letters[:, list(problem.automaton.propositions).index("busy")]
    positions = -2.0 + 0.4 * np.arange(17)
    np.testing.assert_array_equal(busy, np.where((positions >= -1.5) & (positions < 1.5), 1, -1))
    result = cg.synthesize(problem, relation="path")
    assert result.certificate.lower_bound > 0.99
    assert cg.check(result.certificate, problem)


def test_what_was_forbidden_up_to_a_jump_is_not_asked_for_after_it() -> None:
    """With `!lane U (busy & X F lane)` nothing is said of the lane between the jump and the end."""
    other = robot(name="other")
    problem = task("!lane U (busy & X F lane)", 9, "co-safe", other=other)
    lane, busy = (list(problem.automaton.propositions).index(name) for name in ("lane", "busy"))
    letters = np.zeros((10, len(problem.automaton.propositions)), dtype=np.int8)
    letters[1:, lane] = -1
    letters[5, busy], letters[9, lane] = 1, 1
    less = without_needless(problem, letters)
    np.testing.assert_array_equal(less[:, lane], [0, -1, -1, -1, -1, 0, 0, 0, 0, 1])
    assert is_accepted(problem, less)


def test_visits_again_and_again_are_timed_by_how_far_it_is() -> None:
    """A patrol whose automaton counts steps: no ways are looked for without end, and visits are told apart in time."""
    problem = cg.Problem(
        name="patrol",
        horizon=30,
        agents=[robot(input_low=[-2.0], input_high=[2.0])],
        propositions={
            "east": cg.Proposition("robot", low=[2.0], high=[4.0]),
            "west": cg.Proposition("robot", low=[-4.5], high=[-2.5]),
        },
        specification=cg.Specification("G[0,20] F[0,10] east & G[0,20] F[0,10] west", semantics="finite-trace"),
    )
    assert list(islice(ways_of(problem), 1)) == []
    (way, times), *_ = timed_ways(problem)
    letters = way.letters(times, problem.horizon, 2)
    assert letters is not None and is_accepted(problem, letters)
    visits = [tuple(letter) for letter in letters[1:].tolist() if max(letter) > 0]
    runs = [visit for visit, _ in groupby(visits)]
    assert len(runs) >= 5 and all(a != b for a, b in pairwise(runs))
    result = cg.synthesize(problem, relation="path")
    assert result.certificate.lower_bound > 0.9999
    assert cg.check(result.certificate, problem)
