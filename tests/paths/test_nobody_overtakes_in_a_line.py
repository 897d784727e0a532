"""Agents that keep apart along a line stay in their order: plans begin in it, and look at each word once."""

from __future__ import annotations

from collections import Counter
from itertools import islice
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.trajectories.planning import CountedWork, follow_the_leader, path_search, team_search
from certigym.synthesis.trajectories.words.automaton_paths import letters_of


def carts(number: int, order: bool = True) -> cg.Problem:
    """Return carts on a line that all go into one hall, the first one first."""
    cart = cg.Agent(
        name="cart",
        states=["x"],
        inputs=["u"],
        dynamics=["x + 0.6*u"],
        noise_covariance=[[0.0009]],
        state_low=[-3],
        state_high=[20],
        input_low=[-1],
        input_high=[1],
        initial_state=[0],
    )
    names = [f"cart_{k}" for k in range(number)]
    last = number - 1
    first = "".join(f" & (!goal_{k - 1} U goal_{k})" for k in range(last, last - 2, -1)) if order else ""
    return cg.Problem(
        name="hall",
        horizon=20,
        agents=[cart.replace(name=name, initial_state=[2.0 * k]) for k, name in enumerate(names)],
        propositions={
            "near": cg.Pair("cart_*", [-0.8], [0.8], pairs="neighbours"),
            "goal": cg.Proposition("cart_*", [9], [14]),
        },
        specification=cg.Specification(f"G !any(near) & F G all(goal){first}", "finite-trace"),
    )


@pytest.mark.thorough
def test_carts_enter_one_after_the_other() -> None:
    problem = carts(4)
    certificate = cg.synthesize(problem, relation="path", effort=20).certificate
    assert certificate.lower_bound > 0.999 and cg.check(certificate)


@pytest.mark.thorough
def test_plans_keep_the_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """Guesses that end in one point have the carts pass through each other."""
    problem = carts(4)
    plan = next(plan for plan in path_search._plans(problem) if len(plan.times) == 2)
    letters = letters_of(problem, plan)
    assert letters is not None

    def places() -> np.ndarray:
        found = team_search.TeamSearch(problem, CountedWork()).quick(letters, bar=-np.inf)
        assert found is not None
        return np.concatenate([one.nominal.states for one in found.found], axis=1)

    assert np.all(np.diff(places(), axis=1) > 0.8)
    monkeypatch.setattr(team_search, "follow_the_leader", lambda guesses, limits: guesses)
    assert not np.all(np.diff(places(), axis=1) > 0.8)


@pytest.mark.thorough
def test_words_of_teams_are_looked_at_a_few_times() -> None:
    """Ways that differ in what nobody needs are one: those with further jumps come before their many other times."""
    problem = carts(4)
    plans = list(islice(path_search._plans(problem), 40))
    letters = Counter(one.tobytes() for plan in plans if (one := letters_of(problem, plan)) is not None)
    assert max(letters.values()) <= path_search.MOST_ALIKE
    assert 3 in {len(plan.times) for plan in plans}


def test_guesses_keep_the_order_of_the_starts() -> None:
    steps, rng = 6, np.random.default_rng(0)
    guesses = [np.concatenate([[[2.0 * k]], rng.uniform(0.0, 4.0, (steps, 1))]) for k in (1, 0, 2)]
    group: Any = type("Group", (), {
        "numbers": np.arange(2), "agents": np.array([[1, 0], [0, 2]]), "outputs": np.zeros((2, 2, 1), dtype=int),
        "low": np.full((steps + 1, 2, 1), -0.5), "high": np.full((steps + 1, 2, 1), 0.8), "asked": np.full((7, 2), -1),
    })()  # fmt: skip
    moved = follow_the_leader.follow_the_leader(guesses, [group])
    places = np.concatenate([moved[k] for k in (1, 0, 2)], axis=1)
    assert np.all(np.diff(places[1:], axis=1) >= 1.25 * 0.8 - 1e-12)
    np.testing.assert_array_equal(places[0], [0.0, 2.0, 4.0])
    # As little as possible: the middle of all stays where it was.
    before = np.concatenate([guesses[k] for k in (1, 0, 2)], axis=1)
    np.testing.assert_allclose(places.sum(axis=1), before.sum(axis=1))
