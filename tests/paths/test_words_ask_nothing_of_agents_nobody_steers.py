"""Words that are accepted whatever agents do that nobody steers: against all words, one by one, and as certificates."""

from __future__ import annotations

from itertools import product

import pytest

import certigym as cg
from certigym.synthesis.trajectories.words.safe_reach import whatever_others_do

HORIZON = 24


def problem(formula: str, noise: float = 0.5, horizon: int = HORIZON, **changes: object) -> cg.Problem:
    """A van, and calls that come at random."""
    van = cg.Agent(
        name="van", states=["x"], inputs=["u"], dynamics=["x + u"], noise_covariance=[[0.0025]], state_low=[-4],
        state_high=[4], input_low=[-1], input_high=[1], initial_state=[-2],
    )  # fmt: skip
    caller = cg.Agent(
        name="caller", states=["z"], dynamics=["0.8*z"], noise_covariance=[[noise**2]], state_low=[-10],
        state_high=[10], initial_state=[0],
    )  # fmt: skip
    return cg.Problem(
        name="calls",
        horizon=horizon,
        agents=[van, caller],
        propositions={
            "ring": cg.Proposition("caller", [1.8], [10]),
            "scene": cg.Proposition("van", [1], [3]),
            "home": cg.Proposition("van", [-3], [-1]),
        },
        specification=cg.Specification(formula, "finite-trace" if "G" in formula else "co-safe"),
    )


@pytest.mark.parametrize(
    "formula",
    [
        "G (ring -> F[0,2] scene)",
        "G (ring -> X[2] scene) & F home",
        "(ring -> home) U scene",
        "F (scene & F home) & F[0,1] (ring | home)",
        "F ((ring & scene) | (!ring & X scene))",
    ],
)
def test_a_word_is_accepted_exactly_if_it_is_whatever_the_others_do(formula: str) -> None:
    steps = 3
    task = problem(formula, horizon=steps)
    freed = whatever_others_do(task)
    assert freed is not None
    assert freed.initial_q == 1 and task.initial_q is not None
    # The letter of the start is known.
    for word in product(product((False, True), repeat=2), repeat=steps):
        told = [{name for name, holds in zip(("scene", "home"), letter) if holds} for letter in word]
        always = all(
            task.automaton.accepts([{"home"}, *(own | ({"ring"} if ring else set()) for own, ring in zip(told, rings))])
            for rings in product((False, True), repeat=steps)
        )
        for others in (set[str](), {"ring"}):
            assert freed.automaton.accepts([{"home"}, *(own | others for own in told)]) == always


def test_there_is_none_where_it_says_nothing() -> None:
    # Nobody but the steered is asked anything, no word is accepted whatever comes, the others are known beforehand.
    assert whatever_others_do(problem("G !scene")) is None
    assert whatever_others_do(problem("F ring")) is None
    assert whatever_others_do(problem("G (ring -> F[0,2] scene)", noise=0.0)) is None


def test_calls_that_come_at_random_are_answered_along_a_path() -> None:
    task = problem("G (ring -> F[0,4] scene)")
    result = cg.synthesize(task, relation="path")
    assert result.certificate.lower_bound > 0.999
    assert cg.check(result.certificate, task)
    # Some call comes in most runs; a claim refuted in 2000 of them by mistake has the probability 1e-6 at most.
    report = cg.validate(result, 2_000, seed=0)
    assert "refuted" not in str(report)
