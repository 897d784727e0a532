"""Conjunctions over disjoint agents fall apart into tasks whose probabilities multiply."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import certigym as cg
from certigym.envs.tasks.automata.translation import translate
from certigym.envs.tasks.problem import groups as independent
from certigym.envs.tasks.problem.groups import independent_groups

NAMES = ("a", "b", "c", "d", "e", "f")
OWNERS = tuple(frozenset([i]) for i in (0, 0, 1, 1, 2, 2))
FAMILIES = {"first": ("a", "c", "e"), "second": ("b", "d", "f"), "pair": ("a", "d")}


def groups_of(formula: str, semantics: str = "finite-trace", n_agents: int = 3) -> list[tuple[tuple[int, ...], str]]:
    found = independent_groups(formula, semantics, NAMES, FAMILIES, OWNERS, n_agents)
    return [(group.agents, str(group.formula)) for group in found]


@pytest.fixture(autouse=True)
def _every_size_falls_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(independent, "MOST_STATES", 0)


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("F a & F c & F e", [((0,), "F a"), ((1,), "F c"), ((2,), "F e")]),
        ("G all(first)", [((0,), "G a"), ((1,), "G c"), ((2,), "G e")]),
        ("G[2,5] (a & !any(pair))", [((0,), "G[2,5] a & G[2,5] !a"), ((1,), "G[2,5] !d"), ((2,), "true")]),
        ("!F (a | c) & X e", [((0,), "G !a"), ((1,), "G !c"), ((2,), "X e")]),
        ("!(a -> c)", [((0,), "a"), ((1,), "!c"), ((2,), "true")]),
        ("F (a & c) & G e", [((0, 1), "F (a & c)"), ((2,), "G e")]),
        ("F any(pair) & G all(second)", [((0, 1), "F (a | d) & G b & G d"), ((2,), "G f")]),
        ("F a & (c U e)", [((0,), "F a"), ((1, 2), "c U e")]),
    ],
)
def test_conjunctions_fall_apart_by_agents(formula: str, expected: list[tuple[tuple[int, ...], str]]) -> None:
    assert groups_of(formula) == expected


@pytest.mark.parametrize(
    "formula",
    [
        "F (a & c & e)",
        "F a & F c | F e",
        "F a",
        "all(first) U f",
        "F a & F c & false",
        "F a & F c & G X true",
        "F a & F c & X[2] G true",
    ],
)
def test_other_tasks_stay_whole(formula: str) -> None:
    assert groups_of(formula) == []


def test_errors_point_at_the_formula_as_it_was_written() -> None:
    with pytest.raises(cg.FormulaError, match="unknown proposition 'x'"):
        groups_of("F a & G x")
    with pytest.raises(cg.FormulaError, match="not co-safe"):
        groups_of("F a & G c", "co-safe")


PARTS = ("F a", "G[0,2] b", "a U b", "G !b", "F (c & d)", "d R c", "X X c", "F (e | f)", "e M f", "N f", "F (b & !d)",
         "X true", "X[2] G true", "N true", "G (true & !b)", "!F X !false")  # fmt: skip


@given(st.lists(st.sampled_from(PARTS), min_size=2, max_size=4), st.data())
def test_a_word_satisfies_the_whole_exactly_if_it_satisfies_every_part(parts: list[str], data: st.DataObject) -> None:
    formula = " & ".join(f"({part})" for part in parts)
    found = independent_groups(formula, "finite-trace", NAMES, FAMILIES, OWNERS, 3)
    whole = translate(formula, NAMES, "finite-trace", FAMILIES)
    letters = st.sets(st.sampled_from(NAMES))
    word = data.draw(st.lists(letters, min_size=1, max_size=5))
    verdicts = []
    for group in found:
        own = set(group.automaton.propositions)
        verdicts.append(group.automaton.accepts([letter & own for letter in word]))
    assert not found or all(verdicts) == whole.accepts(word)


CO_SAFE = ("F a", "b U a", "F (c & d)", "X c", "!d U c", "F e", "F[0,2] f", "G[0,1] !b", "G[1,2] !d")


@given(st.lists(st.sampled_from(CO_SAFE), min_size=2, max_size=4), st.data())
def test_parts_of_co_safe_tasks_ask_for_the_whole(parts: list[str], data: st.DataObject) -> None:
    """Judged at the end, accepting states are absorbing: the same words satisfy the parts and the whole."""
    formula = " & ".join(f"({part})" for part in parts)
    found = independent_groups(formula, "co-safe", NAMES, FAMILIES, OWNERS, 3)
    whole = translate(formula, NAMES, "co-safe", FAMILIES)
    word = data.draw(st.lists(st.sets(st.sampled_from(NAMES)), min_size=1, max_size=5))
    assert all(group.automaton.semantics == "finite-trace" for group in found)
    verdicts = [g.automaton.accepts([letter & set(g.automaton.propositions) for letter in word]) for g in found]
    assert not found or all(verdicts) == whole.accepts(word)
    for group, word_again in itertools.product(found, [word + [set()], word + [set(NAMES)]]):
        own = set(group.automaton.propositions)
        before, after = (group.automaton.accepts([x & own for x in w]) for w in (word, word_again))
        assert after or not before


def test_small_automata_are_built_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(independent, "MOST_STATES", 7)
    assert groups_of("F a & F c & F e") != []  # 2 x 2 x 2 states
    monkeypatch.setattr(independent, "MOST_STATES", 8)
    assert groups_of("F a & F c & F e") == []
    assert groups_of("G all(first)") == []  # one state each that is not dead
    np.testing.assert_equal(len(groups_of("F a & F c & F e & F b & F d")), 3)
