"""A task that no run satisfies, or that the end of a run satisfies, says so, and what to write instead."""

from __future__ import annotations

from typing import Any

import pytest

import certigym as cg
from certigym.envs.tasks.automata import may_accept, parse_formula, translate
from certigym.envs.tasks.automata.windows import ahead, fitting
from certigym.envs.tasks.problem import cut_by_the_end, why_unsatisfiable


def walker(formula: str, horizon: int = 12, **changes: Any) -> cg.Problem:
    """Whoever walks along a line between two places."""
    agent = {"A": [[1]], "B": [[1]], "noise_covariance": [[0.0025]], "initial_state": [0]}
    box = {"state_low": [-3], "state_high": [3], "input_low": [-1], "input_high": [1]}
    places = {"a": cg.Proposition("walker", [1], [2]), "b": cg.Proposition("walker", [-2], [-1])}
    task = cg.Specification(formula, "finite-trace")
    agents = [cg.LinearAgent(name="walker", **agent, **box)]
    return cg.Problem(name="walk", horizon=horizon, agents=agents, propositions=places, specification=task, **changes)


@pytest.mark.parametrize(
    ("formula", "instead"),
    [
        ("G (F[1,6] a)", "G[0,6] F[1,6] a"),
        ("G (F[1,4] a & F[0,9] b)", "G[0,3] (F[1,4] a & F[0,9] b)"),
        ("G (X[2] !b)", "G[0,10] X[2] !b"),
    ],
)
def test_what_fits_is_written_instead(formula: str, instead: str) -> None:
    assert f"write `{instead}`" in why_unsatisfiable(walker(formula))
    assert why_unsatisfiable(walker(instead)) == ""


def test_what_contradicts_itself_or_is_too_long_has_no_advice() -> None:
    for formula in ("F a & G !a", "F[13,15] a"):
        why = why_unsatisfiable(walker(formula))
        assert why.startswith("no run of 12 steps satisfies the formula") and "write" not in why
    assert why_unsatisfiable(walker("F[13,15] a", horizon=13)) == ""


@pytest.mark.parametrize("formula", ["F a & F b", "G (a -> F[1,5] b)", "G !b", "G[0,6] F[1,6] a"])
def test_nothing_is_said_of_other_tasks(formula: str) -> None:
    assert why_unsatisfiable(walker(formula)) == ""


@pytest.mark.parametrize(
    ("formula", "instead"),
    [
        ("F G[0,5] a & G !b", "F[0,7] G[0,5] a & G !b"),
        ("F[4,12] G[0,3] a", "F[4,9] G[0,3] a"),
        ("F (b & X G[1,4] a) & F b", "F[0,7] (b & X G[1,4] a) & F b"),
        ("G[9,14] a", ""),
        ("F[2,4] F G[0,5] b", ""),
        ("b U G[0,4] a", ""),
    ],
)
def test_windows_that_the_end_cuts_are_told(formula: str, instead: str) -> None:
    told = cut_by_the_end(walker(formula))
    assert f"write `{instead}`" in told if instead else "longer `horizon`" in told
    if instead:
        assert cut_by_the_end(walker(instead)) == ""
        # One letter at the end is enough before, and no longer.
        last = translate(f"({formula}) & (!a U (a & !X true))", ["a", "b"], "finite-trace")
        assert may_accept(last, 13)
        last = translate(f"({instead}) & (!a U (a & !X true))", ["a", "b"], "finite-trace")
        assert not may_accept(last, 13)


@pytest.mark.parametrize(
    "formula", ["G (a -> G[0,4] !b)", "F[0,7] G[0,5] a", "G[0,12] a", "!F G[0,5] a", "F[0,12] G a", "G a & F[9,20] b"]
)
def test_windows_within_the_horizon_are_not_told(formula: str) -> None:
    assert cut_by_the_end(walker(formula)) == ""


def test_letters_are_counted() -> None:
    exactly = translate("X[2] a & !X[3] true", ["a"], "finite-trace")
    assert [may_accept(exactly, letters) for letters in range(1, 6)] == [False, False, True, False, False]
    assert ahead(parse_formula("a -> F[1,5] (b & X c)")) == 6
    assert str(fitting(parse_formula("G a & F b"), 5)) == "G a & F b"
