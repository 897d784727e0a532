"""Every string is read as a formula by the stated precedences, or refused with a caret under the offending place."""

from __future__ import annotations

import pickle
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from certigym.envs.tasks.automata import translate
from certigym.envs.tasks.automata.parser import Formula, FormulaError, is_proposition_name, parse_formula
from temporal_oracle import all_words, random_formula, text

PRECEDENCE = [
    ("!a U b", "(!a) U b"),
    ("F a U b", "(F a) U b"),
    ("X[2] a & b", "(X[2] a) & b"),
    ("a U b & c", "(a U b) & c"),
    ("a & b U c", "a & (b U c)"),
    ("a & b | c & d", "(a & b) | (c & d)"),
    ("a | b -> c", "(a | b) -> c"),
    ("a -> b -> c", "a -> (b -> c)"),
    ("a -> b <-> c -> d", "(a -> b) <-> (c -> d)"),
    ("a <-> b <-> c", "a <-> (b <-> c)"),
    ("a U b U c", "a U (b U c)"),
    ("a U b R c", "a U (b R c)"),
    ("a W b M c", "a W (b M c)"),
    ("! ! a", "!(!a)"),
    ("G F a -> G F b", "(G (F a)) -> (G (F b))"),
    ("F[0,2]a&b", "(F[0,2] a) & b"),
    ("(!p2 | !p3) U p1", "((!p2) | (!p3)) U p1"),
    ("G all(safe) & any(t)", "(G (all(safe))) & (any(t))"),
    ("~a && b || true", "((!a) & b) | true"),
    ("F\n[ 0 ,\t20 ] (a)", "F[0,20] a"),
]


@pytest.mark.parametrize(("short", "explicit"), PRECEDENCE)
def test_precedences(short: str, explicit: str) -> None:
    assert parse_formula(short) == parse_formula(explicit)


def test_names_that_look_like_operators_are_atoms() -> None:
    for name in ("Fa", "GFa", "U1", "trueish", "allow", "_", "X_1", "a_b_3"):
        assert parse_formula(name) == Formula("atom", name=name)
        assert is_proposition_name(name)
    for other in ("F", "true", "all", "a b", "", "1a", "a-b", "é", 3):
        assert not is_proposition_name(other)


ERRORS = [
    ("", 0, "empty formula"),
    ("a b", 2, "expected an operator or the end of the formula, got 'b'"),
    ("a and b", 2, "write & for and"),
    ("(a & b", 6, "for the ( at character 1"),
    ("F[3] a", 3, "X[3] 3 letters ahead"),
    ("F[3,1] a", 4, "upper bound of at least 3, got 1"),
    ("F[0,inf] a", 4, "without a bound write F alone"),
    ("F[0:3] a", 3, "bounds are written with a comma"),
    ("X[1,2] a", 3, "windows are written F[a,b]"),
    ("G[0,1000000] a", 4, "at most 100000"),
    ("F[0," + "9" * 5000 + "] a", 4, "at most 100000"),
    ("all", 3, "all(family)"),
    ("[] a", 0, "always is written G"),
    ("1", 0, "write true"),
    ("é", 0, "expected a formula"),
    ("(" * 5000 + "a", 200, "nests deeper"),
    ("!" * 5000 + "a", 4900, "nests deeper"),
    ("a -> " * 5000 + "a", 1000, "nests deeper"),
    ("a" * 600_000, 0, "longer than 500000 characters"),
]


@pytest.mark.parametrize(("formula", "start", "problem"), ERRORS, ids=[e[0][:12] or "empty" for e in ERRORS])
def test_errors_point_at_the_place(formula: str, start: int, problem: str) -> None:
    with pytest.raises(FormulaError) as caught:
        parse_formula(formula)
    assert problem in str(caught.value)
    assert caught.value.start == start
    assert len(str(caught.value)) < 700
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_long_flat_formulas_are_no_deep_ones() -> None:
    formula = parse_formula(" & ".join(f"a_{i}" for i in range(5000)))
    assert len(formula.operands) == 5000 and formula.depth == 2


def test_printing_and_reading_are_inverse() -> None:
    rng = random.Random(3)
    for _ in range(300):
        formula = parse_formula(text(random_formula(rng, ("a", "b", "c"), 5)))
        again = parse_formula(str(formula))
        assert again == formula and str(again) == str(formula)
    for written in ("a & (b & c) & d", "(a -> b) -> c", "a U (b U c)", "all(safe) | any(t)", "(a <-> b) <-> c"):
        assert parse_formula(str(parse_formula(written))) == parse_formula(written)


@pytest.mark.parametrize(("first", "last"), [(0, 0), (0, 2), (2, 4), (3, 3)])
def test_an_until_with_bounds_is_the_until_whose_goal_comes_in_time(first: int, last: int) -> None:
    """On all words of five letters: some b at a step from first to last, and a at all steps before."""
    task = translate(f"a U[{first},{last}] b", ("a", "b"), "finite-trace")
    for word in all_words(2, 5):
        asked = any(word[t, 1] and word[:t, 0].all() for t in range(first, last + 1))
        assert asked == task.accepts([[name for name, has in zip("ab", letter, strict=True) if has] for letter in word])


def test_formulas_made_in_python_are_checked() -> None:
    a = Formula("atom", name="a")
    with pytest.raises(ValueError, match="`operator`"):
        Formula("XX", (a,))
    with pytest.raises(ValueError, match="`operands`"):
        Formula("U", (a,))
    deep = a
    with pytest.raises(FormulaError, match="nests deeper"):
        for _ in range(200):
            deep = Formula("!", (deep,))
    with pytest.raises(ValueError, match="expected a string"):
        parse_formula(None)  # type: ignore[arg-type]


PIECES = st.sampled_from(
    ["a", "b", "Fa", "true", "false", "all", "any", *"!~&|XNFGURWM()[],:é\n", "&&", "||", "->", "<->", "0", "17"]
    + ["[0,2]", "[3]", "all(f)"]
)


@given(st.one_of(st.text(max_size=40), st.lists(PIECES, max_size=25).map(" ".join), st.lists(PIECES).map("".join)))
def test_any_text_is_a_formula_or_a_formula_error(written: str) -> None:
    try:
        formula = parse_formula(written)
    except FormulaError as error:
        assert 0 <= error.start <= error.end <= len(written)
        return
    assert parse_formula(str(formula)) == formula
