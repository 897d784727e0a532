"""The translator and MONA give the same minimal automaton, array by array."""

from __future__ import annotations

import random

import pytest

import mona
from certigym.envs.tasks.automata.parser import FormulaError
from certigym.envs.tasks.automata.translation import translate
from temporal_oracle import random_co_safe, random_formula, text

ABC = ("a", "b", "c")
needs_mona = pytest.mark.skipif(not mona.mona_available(), reason="the program mona is not on the path")

FORMULAS = [
    "G (a -> F[0,6] b)",
    "F[0,6] (a & F[0,6] b)",
    "!(a <-> X (b <-> X c))",
    "G[2,5] (a -> X[2] b)",
    "(!p2 | !p3) U p1",
    "G F a -> G F b",
    "F (a & N false)",
    "(a U b) R (c W a)",
    "X true",
    "N false",
    "true",
    "false",
]


@needs_mona
@pytest.mark.parametrize("formula", FORMULAS)
def test_chosen_formulas(formula: str) -> None:
    names = (*ABC, "p1", "p2", "p3")
    ours, theirs = translate(formula, names, "finite-trace"), mona.translated(formula, names, "finite-trace")
    assert ours.to_dict() == theirs.to_dict()


@pytest.mark.thorough
@needs_mona
def test_random_finite_trace_formulas() -> None:
    rng = random.Random(11)
    for _ in range(150):
        formula = text(random_formula(rng, ABC, rng.choice([2, 3, 4])))
        ours, theirs = translate(formula, ABC, "finite-trace"), mona.translated(formula, ABC, "finite-trace")
        assert ours.to_dict() == theirs.to_dict(), formula


@pytest.mark.thorough
@needs_mona
def test_random_co_safe_formulas() -> None:
    rng = random.Random(12)
    for _ in range(150):
        formula = text(random_co_safe(rng, ABC, rng.choice([2, 3, 4])))
        ours, theirs = translate(formula, ABC, "co-safe"), mona.translated(formula, ABC, "co-safe")
        assert ours.to_dict() == theirs.to_dict(), formula


@needs_mona
def test_families_and_limits() -> None:
    names = [f"{kind}_{i}" for i in range(12) for kind in ("safe", "target")]
    families = {"safe": names[::2], "target": names[1::2]}
    formula = "all(safe) U (any(target) & all(safe))"
    ours, theirs = (read(formula, names, "co-safe", families) for read in (translate, mona.translated))
    assert ours.to_dict() == theirs.to_dict()
    with pytest.raises(FormulaError, match="max_states"):
        mona.translated("F[0,30] a", ABC, "co-safe", max_states=10)
