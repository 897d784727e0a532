"""An automaton record is complete, deterministic and checked, and every view of it steps alike."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from certigym.envs.tasks.automata.automaton import Automaton
from certigym.envs.tasks.automata.by_hand import automaton_from_transitions
from certigym.envs.tasks.automata.decision_diagram import DecisionDiagrams, DiagramSizeError
from certigym.envs.tasks.automata.minimal import StateGraph, minimal_automaton
from certigym.envs.tasks.automata.rebuilt import over_propositions
from certigym.envs.tasks.automata.translation import translate
from temporal_oracle import all_words, random_formula, text

ABC = ("a", "b", "c")
REACH = translate("(!b | !c) U a", ABC, "co-safe")


def by_hand(transitions: Any, otherwise: str | None = None, semantics: str = "co-safe", **changes: Any) -> Automaton:
    arguments: dict[str, Any] = {
        "propositions": ["a", "b"],
        "states": ["start", "done"],
        "initial": "start",
        "accepting": ["done"],
        "transitions": transitions,
        "semantics": semantics,
        "otherwise": otherwise,
    }
    return automaton_from_transitions(**(arguments | changes))


# --- stepping ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("n_unused", [0, 12])  # 3 propositions: the dense table; 15: the walk through the diagrams
def test_batched_stepping_equals_scalar_stepping(n_unused: int) -> None:
    automaton = over_propositions(REACH, (*ABC, *(f"unused_{i}" for i in range(n_unused))))
    rng = np.random.default_rng(0)
    q = rng.integers(automaton.n_states, size=(4, 5))
    letters = rng.random((3 + n_unused, 4, 5)) < 0.5
    batched = automaton.next_state(q, letters)
    assert batched.shape == (4, 5) and batched.dtype == np.int32
    for i in range(4):
        for j in range(5):
            single = automaton.next_state(q[i, j], letters[:, i, j])
            assert single.shape == () and single == batched[i, j]
            assert REACH.next_state(int(q[i, j]), letters[:3, i, j]) == single
    assert automaton.next_state(np.zeros((0, 2), dtype=int), np.zeros((3 + n_unused, 0, 2), dtype=bool)).shape == (0, 2)


def test_an_automaton_without_propositions_steps() -> None:
    automaton = translate("X true", [], "finite-trace")
    assert [automaton.accepts([()] * n) for n in range(4)] == [False, False, True, True]
    assert automaton.next_state(np.zeros(7, dtype=int), np.zeros((0, 7), dtype=bool)).shape == (7,)


def test_letters_are_collections_of_declared_names() -> None:
    assert REACH.letter(["c", "a"]).tolist() == [True, False, True]
    for letter in ("abc", ["d"]):
        with pytest.raises(ValueError, match="`names`"):
            REACH.accepts([letter])


def test_dead_states_are_those_that_cannot_accept_again() -> None:
    lost = REACH.next_state(REACH.initial, REACH.letter(["b", "c"]))
    assert REACH.dead.tolist() == [q == lost for q in range(3)]
    assert translate("G F a", ABC, "finite-trace").dead.tolist() == [False, False]
    assert translate("false", ABC, "co-safe").dead.tolist() == [True]


# --- other variable orders ----------------------------------------------------------------------------------------
def test_other_proposition_orders_keep_the_language() -> None:
    rng = random.Random(5)
    for _ in range(60):
        names = ["a", "b", "c", "d"]
        automaton = translate(text(random_formula(rng, ABC, 3)), names, "finite-trace")
        order = rng.sample([*names, "e"], 5)
        moved = over_propositions(automaton, order)
        words = all_words(5, 1)[:, 0, :]
        columns = [order.index(name) for name in names]
        for q in range(automaton.n_states):
            here = automaton.next_state(np.full(32, q), words[:, columns].T)
            assert np.array_equal(here, moved.next_state(np.full(32, q), words.T))
        assert over_propositions(moved, names).to_dict() == automaton.to_dict()
    assert over_propositions(REACH, ABC) is REACH
    with pytest.raises(ValueError, match=r"`order`: expected all propositions .* 'c' is missing"):
        over_propositions(REACH, ["a", "b"])
    assert over_propositions(translate("F a", ABC, "co-safe"), ["a"]).propositions == ("a",)


def test_random_automata_by_hand_equal_the_translation() -> None:
    """Each translated automaton, written down as guards (one cube each), is the same automaton again."""
    rng = random.Random(8)
    for _ in range(60):
        automaton = translate(text(random_formula(rng, ABC, 3)), ABC, "finite-trace")
        manager, roots = automaton.diagrams()
        rows = [
            (f"q{q}", " & ".join(("" if v else "!") + ABC[p] for p, v in cube.items()) or "true", f"q{target}")
            for q, root in enumerate(roots)
            for cube, target in manager.paths(root)
        ]
        rng.shuffle(rows)
        accepting = [f"q{q}" for q in np.flatnonzero(automaton.accepting)]
        again = automaton_from_transitions(ABC, automaton.state_names, "q0", accepting, rows, "finite-trace")
        assert again.to_dict() == automaton.to_dict()


def test_families_stand_in_guards_and_accepting_states_absorb() -> None:
    families = {"both": ["a", "b"]}
    automaton = by_hand([("start", "all(both)", "done"), ("done", "a", "start")], "start", families=families)
    assert automaton.accepts([{"a", "b"}, {"a"}]) and not automaton.accepts([{"a"}])
    final = by_hand([("start", "a", "done"), ("done", "a", "start")], "start", "finite-trace", families=families)
    assert final.accepts([{"a"}]) and not final.accepts([{"a"}, {"a"}])


@pytest.mark.parametrize(
    ("transitions", "changes", "message"),
    [
        ([("start", "a", "done"), ("start", "b", "start")], {}, "'start' .*overlap, for example on the letter a & b"),
        ([("start", "a", "done")], {}, "'start' has no transition for the letter !a"),
        ([("start", "F a", "done")], {}, "without temporal operators, got F"),
        ([("start", "x", "done")], {}, "unknown proposition 'x'"),
        ([("begin", "a", "done")], {}, "`transitions`: expected one of the states start, done, got 'begin'"),
        ([], {"initial": "begin"}, "`initial`: expected one of the states"),
        ([], {"accepting": ["end"]}, "`accepting`: expected one of the states"),
        ([], {"otherwise": "trap"}, "`otherwise`: expected one of the states"),
        ([], {"semantics": "buchi"}, "`semantics`: expected"),
    ],
)
def test_mistakes_by_hand_are_named(transitions: Any, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        by_hand(transitions, **changes)


def minimal(automaton: Any) -> Any:
    """The minimal automaton of the same language."""
    diagrams, roots = automaton.diagrams()
    graph = StateGraph(automaton.propositions, diagrams, roots, list(automaton.accepting), automaton.initial)
    return minimal_automaton(graph, automaton.semantics)


def test_minimal_automata_are_merged_and_renumbered() -> None:
    split = by_hand(
        [("start", "a", "s2"), ("start", "!a", "s1"), ("s1", "a", "s2"), ("s1", "!a", "start"), ("s2", "true", "done")],
        propositions=["a"],
        states=["unused", "start", "s1", "s2", "done"],
        otherwise="unused",
    )
    assert minimal(split).to_dict() == translate("F (a & X true)", ["a"], "finite-trace").to_dict() | {
        "semantics": "co-safe"
    }


# --- files ------------------------------------------------------------------------------------------------------------


FIELDS = sorted(REACH.to_dict())
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**70), 2**70),
    st.floats(),
    st.text(max_size=3),
    st.lists(st.integers(-5, 5), max_size=4),
    st.lists(st.one_of(st.none(), st.booleans(), st.text(max_size=2), st.integers(-(2**40), 2**40)), max_size=4),
    st.dictionaries(st.text(max_size=2), st.integers(), max_size=2),
)


@given(st.dictionaries(st.sampled_from([*FIELDS, "other"]), VALUES, min_size=1, max_size=2))
def test_hostile_dictionaries_give_an_automaton_or_a_value_error(changes: dict[str, Any]) -> None:
    try:
        automaton = Automaton.from_dict(REACH.to_dict() | changes)
    except ValueError:
        return
    word = [ABC[:i] for i in range(4)]
    assert automaton.accepts(word) in (True, False)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"low": [0, -1, -1]}, "`low`: expected children that test later propositions"),
        ({"high": [-3, 9, -2]}, "`high`: expected entries from -3 to 2"),
        ({"root": [0, -1, -3]}, None),
        ({"root": [0, -2, -1]}, "absorbing"),
        ({"accepting": [0, 2]}, "absorbing"),
        ({"initial": 3}, "`initial`: expected a state index below 3"),
    ],
)
def test_inconsistent_fields_are_named(changes: dict[str, Any], message: str | None) -> None:
    data = REACH.to_dict() | changes
    if message is None:
        assert Automaton.from_dict(data).n_states == 3
        return
    with pytest.raises(ValueError, match=message):
        Automaton.from_dict(data)
    with pytest.raises(ValueError, match="`data`"):
        Automaton.from_dict([data])  # type: ignore[arg-type]
    del data["root"]
    with pytest.raises(ValueError, match=r"`(data|version)`"):
        Automaton.from_dict(data)


# --- decision diagrams ------------------------------------------------------------------------------------------------
def test_diagrams_agree_with_truth_tables() -> None:
    rng = np.random.default_rng(1)
    manager = DecisionDiagrams()
    letters = all_words(4, 1)[:, 0, :]

    def diagram(table: np.ndarray, variable: int = 0) -> int:
        if variable == 4:
            return manager.terminal(int(table[0]))
        half = len(table) // 2
        return manager.node(variable, diagram(table[:half], variable + 1), diagram(table[half:], variable + 1))

    for _ in range(40):
        f, g = rng.integers(2, size=(2, 16))
        many = rng.integers(-3, 4, size=16)
        assert manager.conjoin(diagram(f), diagram(g)) == diagram(f & g)
        assert manager.disjoin(diagram(f), diagram(g)) == diagram(f | g)
        assert manager.negate(diagram(f)) == diagram(1 - f)
        assert manager.apply(lambda a, b: a * 10 + b, diagram(many), diagram(f), {}) == diagram(many * 10 + f)
        assert set(manager.leaves(diagram(many))) == set(many)
        fixed = manager.restrict(diagram(many), {1: True, 3: False})
        assert fixed == diagram(np.array([many[(i | 4) & ~1] for i in range(16)]))
        assert manager.support(fixed) <= {0, 2}
        for value in (-3, 3):
            found = manager.find(diagram(many), value)
            assert (found is None) == (value not in many)
            if found is not None:
                assert manager.restrict(diagram(many), found) == manager.terminal(value)
        cover = np.zeros(16, dtype=int)
        for cube, value in manager.paths(diagram(many)):
            inside = np.all([letters[:, v] == positive for v, positive in cube.items()], axis=0)
            assert np.all(many[inside] == value)
            cover += inside
        assert np.all(cover == 1)
        low, high = diagram(f), diagram(g)
        without = manager.restrict(low, {2: False}), manager.restrict(high, {2: True})
        chosen = manager.choose(2, *without)
        assert manager.restrict(chosen, {2: False}) == without[0]
        assert manager.restrict(chosen, {2: True}) == without[1]


def test_diagram_limits_and_misuse_are_errors() -> None:
    manager = DecisionDiagrams(node_limit=5)
    with pytest.raises(ValueError, match="`variable`"):
        manager.node(3, manager.literal(3), 0)
    with pytest.raises(ValueError, match="expected a terminal"):
        manager.value(manager.literal(1))
    with pytest.raises(DiagramSizeError, match="more than 5 nodes"):
        manager.conjoin_all(manager.literal(i) for i in range(10))
