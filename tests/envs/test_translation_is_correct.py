"""A translated automaton accepts exactly the words that satisfy the formula, is minimal, and accepts no letter late."""

from __future__ import annotations

import random

import numpy as np
import pytest

from certigym.envs.tasks.automata import translation as translate_module
from certigym.envs.tasks.automata.automaton import Automaton
from certigym.envs.tasks.automata.decision_diagram import FALSE, TRUE
from certigym.envs.tasks.automata.normal_form import NormalForm, Term
from certigym.envs.tasks.automata.obligations import Obligations
from certigym.envs.tasks.automata.parser import FormulaError
from certigym.envs.tasks.automata.rebuilt import over_propositions
from certigym.envs.tasks.automata.translation import translate
from kinds import mostly_thorough
from temporal_oracle import Tree, all_words, holds, random_co_safe, random_formula, text

AB = ("a", "b")
ABC = ("a", "b", "c")


def final_states(automaton: Automaton, words: np.ndarray) -> np.ndarray:
    q = np.full(len(words), automaton.initial)
    for t in range(words.shape[1]):
        q = automaton.next_state(q, words[:, t, :].T)
    return q


def transition_table(automaton: Automaton) -> np.ndarray:
    letters = all_words(len(automaton.propositions), 1)[:, 0, :].T
    return np.stack([automaton.next_state(np.full(letters.shape[1], q), letters) for q in range(automaton.n_states)])


def is_minimal(automaton: Automaton) -> bool:
    """All states are reachable, and a word tells any two apart (table filling)."""
    table = transition_table(automaton)
    reached = {automaton.initial}
    for _ in range(automaton.n_states):
        reached |= {int(q) for p in reached for q in table[p]}
    differ = automaton.accepting[:, None] != automaton.accepting[None, :]
    for _ in range(automaton.n_states):
        differ = differ | differ[table[:, None, :], table[None, :, :]].any(axis=2)
    return len(reached) == automaton.n_states and bool(np.all(differ | np.eye(automaton.n_states, dtype=bool)))


def wrong_finite_word(automaton: Automaton, f: Tree, length: int) -> np.ndarray | None:
    """A word of at most `length` letters on which automaton and definition differ."""
    for n in range(1, length + 1):
        words = all_words(len(automaton.propositions), n)
        wrong = automaton.accepting[final_states(automaton, words)] != holds(f, words, automaton.propositions)
        if wrong.any():
            return words[np.argmax(wrong)]
    return None


def wrong_lasso(automaton: Automaton, f: Tree) -> np.ndarray | None:
    """A lasso on which "some prefix is accepted" and "the infinite word satisfies the formula" differ."""
    for stem, cycle in [(0, 1), (1, 1), (2, 1), (3, 1), (0, 2), (1, 2), (2, 2), (0, 3)]:
        words = all_words(len(automaton.propositions), stem + cycle)
        accepted = automaton.accepting[final_states(automaton, words)]
        q = final_states(automaton, words)
        for _ in range(automaton.n_states):
            for t in range(stem, stem + cycle):
                q = automaton.next_state(q, words[:, t, :].T)
        accepted |= automaton.accepting[q]
        wrong = accepted != holds(f, words, automaton.propositions, loop=stem)
        if wrong.any():
            return words[np.argmax(wrong)]
    return None


def every_waiting_state_can_still_be_spoiled(automaton: Automaton, f: Tree) -> bool:
    """From each state that does not accept, a run that avoids acceptance for ever violates the formula.

    Together with `wrong_lasso` (whatever is accepted satisfies the formula): accepted are exactly the good prefixes.
    """
    table = transition_table(automaton)
    letters = all_words(len(automaton.propositions), 1)[:, 0, :]
    path: dict[int, list[int]] = {automaton.initial: []}
    for q in path_order(table, automaton.initial, path):
        if automaton.accepting[q]:
            continue
        word, run = list(path[q]), [q]
        while True:
            avoiding = [code for code, target in enumerate(table[run[-1]]) if not automaton.accepting[target]]
            if not avoiding:
                return False  # every letter leads to acceptance: this state should have accepted
            word.append(avoiding[0])
            following = int(table[run[-1], avoiding[0]])
            if following in run:
                loop = len(path[q]) + run.index(following)
                break
            run.append(following)
        if holds(f, letters[np.array(word)][None], automaton.propositions, loop=loop)[0]:
            return False
    return True


def path_order(table: np.ndarray, initial: int, path: dict[int, list[int]]) -> list[int]:
    order = [initial]
    for q in order:
        for code, target in enumerate(table[q]):
            if int(target) not in path:
                path[int(target)] = [*path[q], code]
                order.append(int(target))
    return order


@mostly_thorough("seed", range(10), first=3)
def test_finite_trace_automata_agree_with_the_definition_on_all_words(seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(30):
        f = random_formula(rng, AB, rng.choice([2, 3, 3, 4]))
        automaton = translate(text(f), AB, "finite-trace")
        assert wrong_finite_word(automaton, f, 5) is None, text(f)
        assert is_minimal(automaton), text(f)


@pytest.mark.parametrize("seed", range(2))
def test_finite_trace_automata_over_three_propositions(seed: int) -> None:
    rng = random.Random(100 + seed)
    for _ in range(15):
        f = random_formula(rng, ABC, 4)
        automaton = translate(text(f), ABC, "finite-trace")
        assert wrong_finite_word(automaton, f, 3) is None, text(f)
        assert is_minimal(automaton), text(f)


@mostly_thorough("seed", range(10), first=3)
def test_co_safe_automata_accept_exactly_the_good_prefixes(seed: int) -> None:
    rng = random.Random(200 + seed)
    for _ in range(25):
        f = random_co_safe(rng, AB, rng.choice([2, 3, 4]))
        automaton = translate(text(f), AB, "co-safe")
        assert wrong_lasso(automaton, f) is None, text(f)
        assert every_waiting_state_can_still_be_spoiled(automaton, f), text(f)
        assert is_minimal(automaton), text(f)


def test_equal_languages_give_equal_arrays() -> None:
    pairs = [
        ("a U b", "b | (a & X (a U b))"),
        ("!(a U b)", "!a R !b"),
        ("G a & G b", "G (a & b)"),
        ("F F a", "true U a"),
        ("F[0,2] a", "a | X (a | X a)"),
        ("G[1,2] a", "N (a & N a)"),
        ("a -> b -> a", "true"),
        ("a W b", "(a U b) | G a"),
    ]
    for left, right in pairs:
        one, two = translate(left, AB, "finite-trace"), translate(right, AB, "finite-trace")
        assert one.to_dict() == two.to_dict(), (left, right)


def test_the_first_letter_read_is_that_of_x0() -> None:
    for semantics in ("co-safe", "finite-trace"):
        now, soon = translate("a", AB, semantics), translate("X a", AB, semantics)
        assert now.accepts([{"a"}]) and not now.accepts([set()]) and not now.accepts([set(), {"a"}])
        assert soon.accepts([set(), {"a"}]) and not soon.accepts([{"a"}]) and not soon.accepts([{"a"}, set()])
        assert not now.accepting[now.initial]


def test_strong_and_weak_next_differ_exactly_at_the_end() -> None:
    strong, weak = translate("X a", AB, "finite-trace"), translate("N a", AB, "finite-trace")
    assert not strong.accepts([{"a"}]) and weak.accepts([set()])
    assert strong.accepts([set(), {"a"}]) and weak.accepts([set(), {"a"}])
    assert not strong.accepts([set(), set()]) and not weak.accepts([set(), set()])
    assert translate("!(X a)", AB, "finite-trace").to_dict() == translate("N !a", AB, "finite-trace").to_dict()
    assert translate("F[2,2] a", AB, "finite-trace").accepts([set()]) is False
    assert translate("G[2,2] a", AB, "finite-trace").accepts([set()]) is True


def test_invariance_is_a_two_state_automaton() -> None:
    automaton = translate("G a", AB, "finite-trace")
    assert automaton.n_states == 2
    assert automaton.dead.tolist() == [False, True]


def test_a_tautology_of_the_next_letter_accepts_at_once() -> None:
    automaton = translate("X a | X !a", AB, "co-safe")
    assert automaton.n_states == 1 and automaton.accepting[automaton.initial]
    assert translate("a & (X a | X !a)", AB, "co-safe").accepts([{"a"}])
    assert translate("X X true", AB, "co-safe").n_states == 1
    assert translate("X true", AB, "finite-trace").n_states == 2 + 1  # here it asks for a second letter


def test_co_safe_acceptance_is_absorbing_and_finite_trace_acceptance_is_not() -> None:
    reach, final = translate("F a", AB, "co-safe"), translate("F (a & N false)", AB, "finite-trace")
    assert reach.accepts([{"a"}, set(), set()])
    assert final.accepts([set(), {"a"}]) and not final.accepts([{"a"}, set()])


NOT_CO_SAFE = [
    ("G a", 0, 3),
    ("b & X (F G a)", 9, 12),
    ("a R b", 0, 5),
    ("b | (a W b)", 5, 10),
    ("N a", 0, 3),
    ("!(N a)", 2, 5),
    ("!(a U b)", 2, 7),
    ("!(a M b) & a", 2, 7),
    ("F a -> b", 0, 3),
    ("F a <-> b", 0, 3),
    ("!F a", 1, 4),
]


@pytest.mark.parametrize(("formula", "start", "end"), NOT_CO_SAFE)
def test_what_no_prefix_can_prove_is_refused_where_it_stands(formula: str, start: int, end: int) -> None:
    with pytest.raises(FormulaError, match="co-safe") as caught:
        translate(formula, AB, "co-safe")
    assert (caught.value.start, caught.value.end) == (start, end)
    assert "finite-trace" in caught.value.problem
    lines = str(caught.value).splitlines()
    assert lines[-1] == " " * (4 + start) + "^" * (end - start)


@pytest.mark.parametrize("formula", ["!(G a)", "!(a R b)", "!(a W b)", "G a -> b", "!(X a)", "G[0,3] a", "!F[1,2] a"])
def test_negations_are_read_over_infinite_words(formula: str) -> None:
    trees: dict[str, Tree] = {
        "!(G a)": ("!", ("G", ("atom", "a"))),
        "!(a R b)": ("!", ("R", ("atom", "a"), ("atom", "b"))),
        "!(a W b)": ("!", ("W", ("atom", "a"), ("atom", "b"))),
        "G a -> b": ("->", ("G", ("atom", "a")), ("atom", "b")),
        "!(X a)": ("!", ("X", ("atom", "a"))),
        "G[0,3] a": ("G", (0, 3), ("atom", "a")),
        "!F[1,2] a": ("!", ("F", (1, 2), ("atom", "a"))),
    }
    automaton = translate(formula, AB, "co-safe")
    assert wrong_lasso(automaton, trees[formula]) is None
    assert every_waiting_state_can_still_be_spoiled(automaton, trees[formula])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("a", ["a", "a"], "co-safe"), "`propositions`: expected different names"),
        (("a", ["a", "F"], "co-safe"), "`propositions`: expected names of letters"),
        (("a", ["a"], "cosafe"), "`semantics`: expected"),
        (("a", ["a"], "co-safe", {"f": ["b"]}), "`families`: expected declared"),
    ],
)
def test_bad_arguments_are_named(arguments: tuple[object, ...], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        translate(*arguments)  # type: ignore[arg-type]
    assert message in str(caught.value)


@pytest.mark.thorough
def test_families_of_a_thousand_members() -> None:
    names = [name for i in range(1000) for name in (f"safe_{i}", f"target_{i}")]
    families = {"safe": names[::2], "target": names[1::2]}
    always = translate("G all(safe)", names, "finite-trace", families)
    assert (always.n_states, always.variable.size) == (2, 1000)
    reach = translate("all(safe) U (any(target) & all(safe))", names, "co-safe", families)
    assert reach.n_states == 3
    everywhere = set(families["safe"])
    assert reach.accepts([everywhere, everywhere | {"target_999"}])
    assert not reach.accepts([everywhere, (everywhere - {"safe_500"}) | {"target_999"}])
    sorted_names = sorted(names)
    moved = over_propositions(reach, sorted_names)
    again = translate("all(safe) U (any(target) & all(safe))", sorted_names, "co-safe", families)
    assert moved.to_dict() == again.to_dict()


def test_windows_within_windows_stay_small() -> None:
    assert translate("F[0,20] (a & F[0,20] b)", AB, "co-safe").n_states == 253
    assert translate("G (a -> F[0,20] b)", AB, "finite-trace").n_states == 22
    assert translate("F[0,300] a", AB, "co-safe").n_states == 303
    chain = "a"
    for _ in range(12):
        chain = f"b U ({chain})" if len(chain) % 2 else f"c U ({chain})"
    assert translate(chain, ABC, "co-safe").n_states < 20


DEEP = {
    "parity": "(b <-> X ({}))",
    "next and": "X (b & {})",
    "weak until": "(({}) W b)",
    "until": "(a U ({}))",
    "strong release": "(({}) M b)",
    "not": "!{}",
    "implication": "(a -> ({}))",
}


@pytest.mark.parametrize("shape", DEEP)
def test_deep_nesting_is_translated_or_refused(shape: str) -> None:
    """Never a RecursionError, also from deep inside another program, and no exponential blow-up."""

    def translated(formula: str, frames: int = 250) -> Automaton:
        if frames:
            return translated(formula, frames - 1)
        return translate(formula, AB, "finite-trace", max_states=400)

    for depth in (45, 190, 1000):
        formula = "a"
        for _ in range(depth):
            formula = DEEP[shape].format(formula)
        try:
            assert translated(formula).n_states <= 400
        except FormulaError as error:
            assert depth > 45 and "nests deeper" in error.problem


def test_limits_are_errors_with_a_reason() -> None:
    with pytest.raises(FormulaError, match="more than `max_states` = 50 states"):
        translate("F[0,100] a", AB, "co-safe", max_states=50)
    with pytest.raises(FormulaError, match="smaller bounds"):
        translate("F[0,90000] a", AB, "co-safe")


# --- sabotage: each broken translator must be caught by the comparisons above -----------------------------------
def some_finite_trace_formula_is_wrong() -> bool:
    rng = random.Random(0)
    formulas = [random_formula(rng, AB, 3) for _ in range(40)]
    return any(wrong_finite_word(translate(text(f), AB, "finite-trace"), f, 4) is not None for f in formulas)


def test_sabotage_next_shifted_by_one_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not some_finite_trace_formula_is_wrong()
    temporal = NormalForm._temporal

    def shifted(self: NormalForm, op: str, parts: list[Term], bounds: tuple[int, int] | None) -> Term:
        return temporal(self, op, parts, bounds or (2, 2)) if op in ("X", "N") else temporal(self, op, parts, bounds)

    monkeypatch.setattr(NormalForm, "_temporal", shifted)
    assert some_finite_trace_formula_is_wrong()


def test_sabotage_a_first_letter_that_is_skipped_is_caught() -> None:
    for operator in ("F", "G", "!"):
        f: Tree = (operator, ("atom", "a"))
        assert wrong_finite_word(translate("N " + text(f), AB, "finite-trace"), f, 2) is not None
    assert wrong_lasso(translate("X F a", AB, "co-safe"), ("F", ("atom", "a"))) is not None


def test_sabotage_weak_and_strong_swapped_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    def swapped(self: Obligations, f: int) -> bool:
        while f > TRUE:
            strong = self._order[self.diagrams.variable(f) - self.n_propositions][1]
            f = self.diagrams.high(f) if strong else self.diagrams.low(f)
        return f != FALSE

    monkeypatch.setattr(Obligations, "holds_at_end", swapped)
    assert some_finite_trace_formula_is_wrong()


def test_sabotage_acceptance_that_is_left_again_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(translate_module, "saturated", lambda graph: graph)
    late = translate("X a | X !a", AB, "co-safe")
    tree: Tree = ("|", ("X", ("atom", "a")), ("X", ("!", ("atom", "a"))))
    assert not every_waiting_state_can_still_be_spoiled(late, tree)
