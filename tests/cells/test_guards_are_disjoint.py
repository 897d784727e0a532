"""Guards are disjoint products, complete up to failure, and lead where every letter of their cells leads."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import certigym as cg
from certigym.synthesis.abstraction.models.guards import compile_guards
from certigym.synthesis.certificates.value_functions.terms import Guards
from problems import scalar_agent, two_agents


def three_agents(formula: str, semantics: str) -> cg.Problem:
    names = ["x", "y", "z"]
    regions = {
        "a": ("x", -4, 0),
        "b": ("x", -2, 2),
        "c": ("y", -1, 1),
        "d": ("y", 1, 3),
        "e": ("z", 0, 4),
        "f": ("z", 2, 3),
    }
    return cg.Problem(
        name="three",
        horizon=2,
        agents=[scalar_agent(name) for name in names],
        propositions={k: cg.Proposition(n, [low], [high]) for k, (n, low, high) in regions.items()},
        specification=cg.Specification(formula, semantics),
    )


FORMULAS = [
    ("(!a | !c) U (b & e)", "co-safe"),
    ("F (a & c & e) & F (b | d | f)", "co-safe"),
    ("X (a <-> d) & F (c -> f)", "co-safe"),
    ("G (a -> X (d | e)) & F f", "finite-trace"),
    ("(a <-> c) U (d <-> e)", "finite-trace"),
]


def outcome(problem: cg.Problem, q: int, sets: list[np.ndarray]) -> int | None:
    """Robust successor under a tuple of label sets by brute force over all letters; None where it is not certain."""
    automaton = problem.automaton
    goal = automaton.accepting if automaton.semantics == "co-safe" else np.zeros(automaton.n_states, dtype=bool)
    classes = [problem.labeling.classes[i][own] for i, own in enumerate(sets)]
    reached = {int(automaton.next_state(q, np.concatenate(rows))) for rows in product(*classes)}
    beside = {r for r in reached if not goal[r]}
    if len(beside) > 1:
        return None
    target = beside.pop() if beside else reached.pop()
    return None if automaton.dead[target] else target


def assert_guards_are_right(problem: cg.Problem, label_sets: list[np.ndarray], guards: Guards) -> None:
    automaton = problem.automaton
    for q in range(automaton.n_states):
        own = np.flatnonzero(guards.source == q)
        if automaton.dead[q] or (automaton.semantics == "co-safe" and automaton.accepting[q]):
            assert len(own) == 0
            continue
        for combination in product(*(range(len(sets)) for sets in label_sets)):
            hits = [g for g in own if all(guards.masks[i][guards.mask[g, i], n] for i, n in enumerate(combination))]
            expected = outcome(problem, q, [label_sets[i][n] for i, n in enumerate(combination)])
            assert [int(guards.target[g]) for g in hits] == ([] if expected is None else [expected])


@st.composite
def label_sets_of(draw: Any) -> tuple[cg.Problem, list[np.ndarray]]:
    problem = three_agents(*draw(st.sampled_from(FORMULAS)))
    sets = []
    for classes in problem.labeling.classes:
        some = st.lists(st.booleans(), min_size=len(classes), max_size=len(classes)).filter(any)
        sets.append(np.array(draw(st.lists(some, min_size=1, max_size=4, unique_by=tuple))))
    return problem, sets


@given(label_sets_of())
def test_each_combination_of_label_sets_has_the_guard_of_its_robust_successor(
    case: tuple[cg.Problem, list[np.ndarray]],
) -> None:
    problem, sets = case
    assert_guards_are_right(problem, sets, compile_guards(problem, sets))


@pytest.mark.parametrize(("formula", "semantics"), FORMULAS)
def test_true_letters_lose_nothing(formula: str, semantics: str) -> None:
    problem = three_agents(formula, semantics)
    sets = [np.eye(len(classes), dtype=bool) for classes in problem.labeling.classes]
    guards = compile_guards(problem, sets)
    assert_guards_are_right(problem, sets, guards)


def test_greedy_trees_are_disjoint_and_complete_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("certigym.synthesis.abstraction.models.guards.OPTIMAL_LIMIT", 0)
    for formula, semantics in FORMULAS:
        problem = three_agents(formula, semantics)
        sets = [np.eye(len(classes), dtype=bool) for classes in problem.labeling.classes]
        assert_guards_are_right(problem, sets, compile_guards(problem, sets))


def test_exclusions_between_regions_of_an_agent_save_guards() -> None:
    problem = two_agents("(!b | !c) U a")
    guards = compile_guards(problem, [np.eye(len(c), dtype=bool) for c in problem.labeling.classes])
    assert len(guards.source) == 3  # reach a; stay with one in b and two not in c; stay with one in neither a nor b


def test_guards_grow_linearly_with_the_agents() -> None:
    sizes = []
    for n in (20, 200):
        problem = cg.make_problem("reach-avoid-n-v0", n_agents=n)
        guards = compile_guards(problem, [np.eye(len(c), dtype=bool) for c in problem.labeling.classes])
        sizes.append(len(guards.source))
    assert sizes == [21, 201]
