"""What the checker proves of automata and words holds of all words, which are enumerated.

An automaton that passes accepts no word of at most three letters that its formula does not (co-safe: that some infinite
word which begins so does not). Formulas are random, and automata are right, sabotaged, or random, with initial states
that accept among them. On finite traces the test is complete: it refuses nothing that is right.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest

from certificate_files import one_crane, two_carts, two_tanks
from certigym.synthesis.checker import automaton_states, read_problem
from certigym.synthesis.checker.automaton import CO_SAFE, FINITE_TRACE, Automaton, followed
from certigym.synthesis.checker.fields import Refused
from certigym.synthesis.checker.formula import parse, wrong_automaton
from certigym.synthesis.checker.letters import SOMETIME, check_words, known_at

NAMES = ("a", "b")
LETTERS = [frozenset(names) for k in range(3) for names in itertools.combinations(NAMES, k)]
Word = Sequence[frozenset[str]]


def random_formula(rng: np.random.Generator, depth: int) -> str:
    r = rng.random()
    if depth == 0 or r < 0.15:
        return str(rng.choice(NAMES)) if rng.random() < 0.95 else str(rng.choice(("true", "false")))

    def inner() -> str:
        return random_formula(rng, depth - 1)

    if r < 0.3:
        return f"!({inner()})"
    if r < 0.5:
        return f"({inner()} {rng.choice(('&', '|', '->', '<->'))} {inner()})"
    if r < 0.75:
        return f"({inner()} {rng.choice(('U', 'U', 'R', 'W', 'M'))} {inner()})"
    if r < 0.88:
        return f"{rng.choice(('X', 'N', 'F', 'G', 'X[2]', 'F[1]', 'G[2]'))} ({inner()})"
    low = int(rng.integers(0, 3))
    return f"{rng.choice(('F', 'G'))}[{low},{low + int(rng.integers(0, 3))}] ({inner()})"


def satisfies(f: Any, word: Word, loop: int | None = None) -> bool:
    """Whether a finite word, or the lasso that goes back to ``loop``, satisfies a formula: by its meaning."""
    memo: dict[Any, bool] = {}
    n = len(word)

    def after(k: int) -> int | None:
        return k + 1 if k + 1 < n else loop

    def places(i: int) -> Iterator[int]:
        here: int | None = i
        for _ in range(2 * n + 2):
            if here is None:
                return
            yield here
            here = after(here)

    def at(f: Any, i: int) -> bool:
        if (f, i) not in memo:
            memo[f, i] = meaning(f, i)
        return memo[f, i]

    def until(hold: Callable[[int], bool], end: Callable[[int], bool], i: int) -> bool:
        for k in places(i):
            if end(k):
                return True
            if not hold(k):
                return False
        return False

    def meaning(f: Any, i: int) -> bool:
        if isinstance(f, bool):
            return f
        if isinstance(f, str):
            return f in word[i]
        op, a, *rest = f
        if op in ("F", "G") and rest:
            window = list(itertools.islice(places(i), rest[0], rest[1] + 1))
            return any(at(a, k) for k in window) if op == "F" else all(at(a, k) for k in window)
        b = rest[0] if rest else None
        match op:
            case "!":
                return not at(a, i)
            case "&":
                return at(a, i) and at(b, i)
            case "|":
                return at(a, i) or at(b, i)
            case "->":
                return not at(a, i) or at(b, i)
            case "<->":
                return at(a, i) == at(b, i)
            case "X":
                return (k := after(i)) is not None and at(a, k)
            case "N":
                return (k := after(i)) is None or at(a, k)
            case "F":
                return any(at(a, k) for k in places(i))
            case "G":
                return all(at(a, k) for k in places(i))
            case "U":
                return until(lambda k: at(a, k), lambda k: at(b, k), i)
            case "M":
                return until(lambda k: at(b, k), lambda k: at(a, k) and at(b, k), i)
            case "W":
                return not until(lambda k: not at(b, k), lambda k: not at(a, k) and not at(b, k), i)
        assert op == "R"
        return not until(lambda k: not at(a, k), lambda k: not at(b, k), i)

    return at(f, 0)


def is_sure(f: Any, word: Word) -> bool:
    """Whether all lassos that go on from a word, up to a length, satisfy a formula."""
    for m in (1, 2):
        for more in itertools.product(LETTERS, repeat=m):
            if any(not satisfies(f, (*word, *more), len(word) + m - 1 - k) for k in range(m)):
                return False
    return True


def words(longest: int) -> Iterator[Word]:
    for n in range(1, longest + 1):
        yield from itertools.product(LETTERS, repeat=n)


class Diagrams:
    """Nodes of an automaton as it is made."""

    def __init__(self) -> None:
        self.variable: list[int] = []
        self.low: list[int] = []
        self.high: list[int] = []

    def node(self, variable: int, low: int, high: int) -> int:
        for own, new in ((self.variable, variable), (self.low, low), (self.high, high)):
            own.append(new)
        return len(self.variable) - 1

    def full(self, leads: dict[frozenset[str], int]) -> int:
        """The entry of a state, from where each letter leads."""
        a, b = NAMES
        sides = [self.node(1, -1 - leads[frozenset(names)], -1 - leads[frozenset((*names, b))]) for names in ((), (a,))]
        return self.node(0, *sides)

    def automaton(self, semantics: str, initial: int, accepting: Sequence[bool], root: Sequence[int]) -> Automaton:
        lists = (tuple(own) for own in (root, self.variable, self.low, self.high))
        return Automaton(NAMES, semantics, initial, tuple(map(bool, accepting)), *lists)


def of_words(semantics: str, longest: int, accepts: Callable[[Word], bool]) -> tuple[Automaton, dict[Word, int]]:
    """The automaton whose states are the words up to a length; longer ones are not accepted."""
    states: dict[Word, int] = {(): 0} | {word: k for k, word in enumerate(words(longest), start=1)}
    diagrams, nowhere = Diagrams(), len(states)
    root = [diagrams.full({letter: states.get((*word, letter), nowhere) for letter in LETTERS}) for word in states]
    accepting = [bool(word) and accepts(word) for word in states]
    return diagrams.automaton(semantics, 0, [*accepting, False], [*root, -1 - nowhere]), states


def test_on_finite_traces_right_automata_pass_and_one_word_more_does_not() -> None:
    rng, refused = np.random.default_rng(0), 0
    for _ in range(120):
        f = parse(random_formula(rng, int(rng.integers(1, 4))))
        right, states = of_words(FINITE_TRACE, 3, partial(satisfies, f))
        assert wrong_automaton(right, f) == "", f
        others = [k for word, k in states.items() if word and not right.accepting[k]]
        for k in rng.choice(others, min(3, len(others)), replace=False) if others else ():
            accepting = [own or q == k for q, own in enumerate(right.accepting)]
            wrong = Automaton(NAMES, FINITE_TRACE, 0, tuple(accepting), *diagrams_of(right))
            assert f"state {k} accepts" in wrong_automaton(wrong, f), (f, k)
            refused += 1
    assert refused > 150


def diagrams_of(own: Automaton) -> tuple[tuple[int, ...], ...]:
    return own.root, own.variable, own.low, own.high


def test_prefixes_that_decide_nothing_are_no_reason_to_accept() -> None:
    """Co-safe: an automaton of all words that some lassos say to be sure passes only if every infinite word agrees."""
    rng, proved, refused = np.random.default_rng(1), 0, 0
    for _ in range(90):
        f = parse(random_formula(rng, int(rng.integers(1, 3))))
        right, states = of_words(CO_SAFE, 2, partial(is_sure, f))
        proved += wrong_automaton(right, f) == ""
        others = [(word, k) for word, k in states.items() if word and not right.accepting[k]]
        # words that go on from one that was accepted are never read
        others = [(word, k) for word, k in others if not any(right.accepting[states[word[:n]]] for n in (1, 2))]
        for place in rng.choice(len(others), min(3, len(others)), replace=False) if others else ():
            k = others[place][1]
            accepting = [own or q == k for q, own in enumerate(right.accepting)]
            wrong = Automaton(NAMES, CO_SAFE, 0, tuple(accepting), *diagrams_of(right))
            assert wrong_automaton(wrong, f), (f, others[place])
            refused += 1
    assert proved > 60 and refused > 90


def random_automaton(rng: np.random.Generator, semantics: str) -> Automaton:
    """Two to four states, shallow diagrams, any of the states accepting."""
    n, diagrams = int(rng.integers(2, 5)), Diagrams()

    def leaf() -> int:
        return -1 - int(rng.integers(n))

    root = []
    accepting = rng.random(n) < 0.4
    for q in range(n):
        kind = rng.random()
        if semantics == CO_SAFE and accepting[q]:
            root.append(-1 - q)
        elif kind < 0.15:
            root.append(leaf())
        elif kind < 0.6:
            root.append(diagrams.node(int(kind < 0.35), leaf(), leaf()))
        else:
            root.append(diagrams.node(0, diagrams.node(1, leaf(), leaf()), diagrams.node(1, leaf(), leaf())))
    return diagrams.automaton(semantics, int(rng.integers(n)), accepting.tolist(), root)


def step(automaton: Automaton, q: int, letter: frozenset[str]) -> int:
    entry = automaton.root[q]
    while entry >= 0:
        holds = automaton.propositions[automaton.variable[entry]] in letter
        entry = automaton.high[entry] if holds else automaton.low[entry]
    return -1 - entry


def accepted_first(automaton: Automaton, word: Word) -> bool:
    """Whether a word is accepted, on a finite trace, or by its last letter and none before it."""
    q = automaton.initial
    for k, letter in enumerate(word):
        if automaton.is_co_safe and automaton.accepting[q] and k:
            return False
        q = step(automaton, q, letter)
    return automaton.accepting[q]


@pytest.mark.parametrize("semantics", [CO_SAFE, FINITE_TRACE])
def test_random_automata_that_pass_accept_only_what_they_may(semantics: str) -> None:
    rng = np.random.default_rng(2)
    proved = nontrivial = 0
    for _ in range(1500):
        f, automaton = parse(random_formula(rng, int(rng.integers(1, 4)))), random_automaton(rng, semantics)
        if wrong_automaton(automaton, f):
            continue
        proved += 1
        if automaton.is_co_safe and automaton.accepting[automaton.initial]:
            assert is_sure(f, ()), f
        accepted = [word for word in words(3) if accepted_first(automaton, word)]
        nontrivial += bool(accepted)
        for word in accepted:
            assert is_sure(f, word) if automaton.is_co_safe else satisfies(f, word), (f, automaton, word)
    assert proved > 300 and nontrivial > 40


def test_an_initial_state_that_accepts_is_asked_for_the_formula() -> None:
    """An automaton that accepts before any letter is right for what is always true, and for nothing else."""
    at_once = Automaton(NAMES, CO_SAFE, 0, (True,), (-1,), (), (), ())
    assert wrong_automaton(at_once, parse("a | !a")) == ""
    for text in ("!a U b", "a U b", "F a", "a", "X true & a", "true U a"):
        assert wrong_automaton(at_once, parse(text)), text
    # also where no state accepts after the first letter: the run is satisfied by then
    once = Automaton(NAMES, CO_SAFE, 0, (True, False), (-2, -2), (), (), ())
    for text in ("!a U b", "F a", "a & !a"):
        assert "accepts before any letter" in wrong_automaton(once, parse(text)), text
    for text in ("G (a -> b)", "!a U b", "X a"):
        wrong = Automaton(NAMES, FINITE_TRACE, 0, (True,), (-1,), (), (), ())
        assert wrong_automaton(wrong, parse(text)), text


def test_a_co_safe_run_that_has_accepted_stays_where_it_is() -> None:
    """Whatever the automaton would do then; on finite traces it goes on."""
    for semantics, after in ((CO_SAFE, {0}), (FINITE_TRACE, {1})):
        once = Automaton(NAMES, semantics, 0, (True, False), (-2, -2), (), (), ())
        assert followed(once, {0}, {}) == after and followed(once, {1}, {}) == {1}


@pytest.mark.parametrize("made", [two_carts, two_tanks, one_crane])
def test_every_sabotage_of_an_automaton_of_a_file_is_refused_or_harmless(made: Any) -> None:
    """One entry changed, another initial or accepting state: what passes accepts no wrong word of three letters."""
    problem = read_problem(made()[0])
    own, f, passed, refused = problem.automaton, problem.formula, 0, 0
    assert wrong_automaton(own, f) == ""
    letters = [
        frozenset(names)
        for k in range(len(own.propositions) + 1)
        for names in itertools.combinations(own.propositions, k)
    ]
    entries = [*range(-len(own.accepting), len(own.variable))]
    for forged in sabotaged(own, entries):
        if wrong_automaton(forged, f):
            refused += 1
            continue
        passed += 1
        for n in (1, 2):
            for word in itertools.product(letters, repeat=n):
                if accepted_first(forged, word):
                    # the formulas are co-safe: a word that goes on without any letter decides
                    assert satisfies(f, (*word, frozenset()), n), (forged, word)
    assert refused > 3 and passed > 1


def sabotaged(own: Automaton, entries: list[int]) -> Iterator[Automaton]:
    lists = {"root": own.root, "low": own.low, "high": own.high, "accepting": own.accepting}
    values: dict[str, Any] = {key: getattr(own, key) for key in own.__dataclass_fields__}
    for key, row in lists.items():
        for k, old in enumerate(row):
            for new in [not old] if key == "accepting" else entries:
                changed: tuple[Any, ...] = (*row[:k], new, *row[k + 1 :])
                try:
                    yield Automaton(**{**values, key: changed})
                except ValueError:
                    continue
    for initial in range(len(own.accepting)):
        yield Automaton(**{**values, "initial": initial})


def test_dead_states_are_those_from_which_no_word_is_accepted() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        automaton = random_automaton(rng, str(rng.choice((CO_SAFE, FINITE_TRACE))))
        for q, dead in enumerate(automaton.dead()):
            reached = {q}
            for _ in automaton.accepting:
                reached |= {step(automaton, p, letter) for p in reached for letter in LETTERS}
            assert dead == (not any(automaton.accepting[p] for p in reached))


def agrees(letter: frozenset[str], known: dict[int, bool]) -> bool:
    return all((NAMES[p] in letter) == holds for p, holds in known.items())


def test_words_of_which_letters_are_known_in_part_are_all_accepted() -> None:
    """Where no window is open; at time 0 a region holds, does not hold, or the start lies on its face and in it."""
    rng, accepted = np.random.default_rng(4), 0
    sides: dict[int, tuple[float | None, float | None]] = {1: (-1.0, None), -1: (0.5, None), 0: (0.1, None)}
    for _ in range(800):
        automaton = random_automaton(rng, str(rng.choice((CO_SAFE, FINITE_TRACE))))
        horizon = int(rng.integers(1, 4))
        letters = rng.choice((-1, 0, 1), (int(rng.integers(1, horizon + 3)), 2), p=(0.3, 0.4, 0.3)).astype(np.int64)
        problem = with_regions(
            table_of(automaton), automaton.semantics, horizon, [sides[p] for p in letters[0].tolist()], 0.2
        )
        whole = len(letters) == horizon + 1 or (automaton.is_co_safe and len(letters) <= horizon)
        choices = [[letter for letter in LETTERS if may(letter, row)] for row in letters.tolist()]
        all_accepted = whole and all(is_accepted(automaton, word) for word in itertools.product(*choices))
        with contextlib.nullcontext() if all_accepted else pytest.raises(Refused):
            check_words(problem, letters, np.zeros_like(letters))
        accepted += all_accepted
    assert 60 < accepted < 600


def is_accepted(automaton: Automaton, word: Word) -> bool:
    """Whether a run with these letters satisfies the task: co-safe as soon as a state accepts."""
    q = automaton.initial
    for letter in word:
        if automaton.is_co_safe and automaton.accepting[q]:
            return True
        q = step(automaton, q, letter)
    return automaton.accepting[q]


def test_letters_lead_to_the_states_of_all_that_agree() -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        automaton = random_automaton(rng, CO_SAFE)
        known = {p: bool(rng.random() < 0.5) for p in range(2) if rng.random() < 0.6}
        for q, accepts in enumerate(automaton.accepting):
            reached = {q} if accepts else {step(automaton, q, letter) for letter in LETTERS if agrees(letter, known)}
            assert followed(automaton, {q}, known) == reached


@pytest.mark.parametrize(
    "change",
    [
        {"initial": 2}, {"initial": -1}, {"semantics": "safe"}, {"root": (0, -1, -1)}, {"root": (2, -1)},
        {"root": (0, -3)}, {"low": (1,)}, {"high": (-1, -1, -1)}, {"low": (0, -1)}, {"variable": (0, 2)},
        {"variable": (-1, 1)}, {"variable": (1, 1)}, {"high": (-1, 0)},
    ],
)  # fmt: skip
def test_automata_that_are_none_are_not_made(change: dict[str, Any]) -> None:
    right: dict[str, Any] = {
        "propositions": NAMES,
        "semantics": CO_SAFE,
        "initial": 0,
        "accepting": (False, True),
        "root": (0, -2),
        "variable": (0, 1),
        "low": (1, -1),
        "high": (-2, -2),
    }
    Automaton(**right)
    with pytest.raises(ValueError):
        Automaton(**{**right, **change})


@pytest.mark.parametrize(
    "text",
    ["a & |", "N[3] a", "F[5,3] a", "a b", "(a", "a)", "", "U a", "a U", "F[1,2,3] a", "X[1,2] a", "a $ b", "F[] a",
     "F[20000] a", "!" * 300 + "a", "true false", "a -> ", "G", "F[a] b", "1"],
)  # fmt: skip
def test_what_is_no_formula_is_not_read(text: str) -> None:
    with pytest.raises(ValueError):
        parse(text)


def test_operators_bind_as_the_format_says() -> None:
    for text, meant in (
        ("a -> b -> a", "a -> (b -> a)"),
        ("a U b U a", "a U (b U a)"),
        ("a & b | b & a", "(a & b) | (b & a)"),
        ("a U b & b R a", "(a U b) & (b R a)"),
        ("!a U b", "(!a) U b"),
        ("a <-> b -> a", "a <-> (b -> a)"),
        ("a | b -> a", "(a | b) -> a"),
        ("F a & b", "(F a) & b"),
        ("X[2] a", "X X a"),
        ("F[2] a", "F[0,2] a"),
    ):
        assert parse(text) == parse(meant), text
    with pytest.raises(Refused):
        wrong_automaton(random_automaton(np.random.default_rng(0), CO_SAFE), parse("F c"))


# Windows.


def with_regions(automaton: dict[str, Any], semantics: str, T: int, limits: Any, last: float = 0.0) -> Any:
    agent = {
        "name": "one", "states": ["x"], "inputs": ["u"], "dynamics": ["x + u"], "outputs": ["x"], "state_low": [-9.0],
        "state_high": [9.0], "input_low": [-1.0], "input_high": [1.0], "start_low": [0.0], "start_high": [last],
        "noise": [[0.1]],
    }  # fmt: skip
    regions = [{"name": name, "agent": 0, "low": [low], "high": [high]} for name, (low, high) in zip(NAMES, limits)]
    task = {"semantics": semantics, "automaton": automaton}
    return read_problem({"problem": {"horizon": T, "agents": [agent], "regions": regions, "pairs": [], "task": task}})


def table_of(own: Automaton) -> dict[str, Any]:
    lists = {key: [*getattr(own, key)] for key in ("accepting", "root", "variable", "low", "high")}
    return {"initial": own.initial, **lists}


def test_words_with_windows_are_all_accepted_or_refused() -> None:
    """Against all words: in every window a region holds at least once, elsewhere letters are what they say."""
    rng, accepted, windows = np.random.default_rng(6), 0, 0
    for _ in range(700):
        automaton = random_automaton(rng, str(rng.choice((CO_SAFE, FINITE_TRACE))))
        T = int(rng.integers(2, 5))
        # one region holds at the start, the other one does not
        problem = with_regions(table_of(automaton), automaton.semantics, T, [[-1.0, None], [0.5, None]])
        S = T if rng.random() < 0.8 else T - 1
        letters = rng.choice((-1, 0, 1, SOMETIME), (S + 1, 2), p=(0.25, 0.15, 0.2, 0.4)).astype(np.int64)
        faces = rng.integers(0, 2, (S + 1, 2)).astype(np.int64)
        start = [letter for letter in LETTERS if agrees(letter, {0: True, 1: False})]
        choices = [start, *([letter for letter in LETTERS if may(letter, row)] for row in letters[1:].tolist())]
        meets = windows_of(letters, faces)
        agreeing = [
            word
            for word in itertools.product(*choices)
            if all(any(NAMES[p] in word[t] for t in range(a, b + 1)) for p, a, b in meets)
        ]
        whole = automaton.is_co_safe or S == T
        right = whole and all(is_accepted(automaton, word) for word in agreeing)
        windows += len(meets) > 0
        accepted += right
        if right:
            check_words(problem, letters, faces)
        else:
            with pytest.raises(Refused):
                check_words(problem, letters, faces)
    assert windows > 300 and 80 < accepted < 600


def may(letter: frozenset[str], row: list[int]) -> bool:
    return all((NAMES[p] in letter) == (value > 0) for p, value in enumerate(row) if value in (-1, 1))


def windows_of(letters: np.ndarray, faces: np.ndarray) -> list[tuple[int, int, int]]:
    """Propositions, first and last times of runs of letters 2 with one face."""
    found = []
    for p in range(letters.shape[1]):
        t = 1
        while t < len(letters):
            end = t
            if letters[t, p] == SOMETIME:
                while end + 1 < len(letters) and letters[end + 1, p] == SOMETIME and faces[end + 1, p] == faces[t, p]:
                    end += 1
                found.append((p, t, end))
            t = end + 1
    return found


def test_what_is_known_of_a_letter_follows_from_the_regions() -> None:
    """Regions that are empty, or apart from one that holds, do not hold; of others nothing is known."""
    table = {"initial": 0, "accepting": [True], "root": [-1], "variable": [], "low": [], "high": []}
    letters = np.array([[0, 0], [1, 0], [0, 1], [-1, 0], [0, 0]])
    for limits, known in (
        ([[0.0, 1.0], [1.0, 2.0]], [{0: True, 1: False}, {0: False, 1: True}, {0: False}, {}]),
        ([[0.0, 1.0], [0.9, 2.0]], [{0: True}, {1: True}, {0: False}, {}]),
        ([[0.0, 1.0], [2.0, 2.0]], [{0: True, 1: False}, {0: False, 1: True}, {0: False, 1: False}, {1: False}]),
    ):
        problem = with_regions(table, CO_SAFE, 4, limits)
        for t, wanted in enumerate(known, start=1):
            found = known_at(problem, letters[t], t)
            assert {p: found[p] for p in wanted} == wanted and (t == 2 or found == wanted), (limits, t)


def test_networks_see_no_state_that_a_window_leaves_open() -> None:
    """Between the first and the last time of a window nobody knows yet whether its region was met."""
    table = {"initial": 0, "accepting": [False, False, True], "root": [0, 1, -3], "variable": [0, 1], "low": [-1, -2],
             "high": [-2, -3]}  # fmt: skip
    problem = with_regions(table, CO_SAFE, 5, [[0.5, None], [0.7, None]])  # first a, and then b
    letters, faces = np.zeros((6, 2), dtype=np.int64), np.zeros((6, 2), dtype=np.int64)
    letters[5, 1] = 1
    for value in (1, SOMETIME):
        letters[2:4, 0], letters[2:5, 1] = value, -1
        check_words(problem, letters, faces)
        letters[1, 0] = -1
        if value == 1:
            assert automaton_states(problem, letters) == [0, 0, 1, 1, 1, -1]
            continue
        with pytest.raises(Refused, match="not known at time 2"):
            automaton_states(problem, letters)


def test_more_windows_at_a_time_than_are_followed_are_refused() -> None:
    header = two_carts()[0]
    problem = read_problem(header)
    letters = np.zeros((5, 4), dtype=np.int64)
    letters[1:, 3] = SOMETIME  # a pair
    with pytest.raises(Refused, match="pair"):
        check_words(problem, letters, np.zeros((5, 4), dtype=np.int64))
