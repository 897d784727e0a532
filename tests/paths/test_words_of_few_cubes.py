"""Words of few cubes: accepted, whatever agrees with them, and enough where an automaton counts or says too little."""

from __future__ import annotations

from itertools import groupby, islice, product
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import SOMETIME, changed
from certigym.synthesis.trajectories.chance_constraints.linearization_errors import LinearizationErrors
from certigym.synthesis.trajectories.words import automaton_paths as words
from certigym.synthesis.trajectories.words.accepted_words import is_accepted, without_needless
from certigym.synthesis.trajectories.words.automaton_paths import automaton_paths_of
from certigym.synthesis.trajectories.words.segments import segmented_ways
from fleet_problems import wrong_paths
from kinds import mostly_thorough


def robot(**changes: Any) -> cg.LinearAgent:
    given: dict[str, Any] = {
        "name": "robot", "A": [[1.0]], "B": [[1.0]], "noise_covariance": [[0.01]], "state_low": [-5.0],
        "state_high": [5.0], "input_low": [-0.8], "input_high": [0.8], "initial_state": [-4.0],
    }  # fmt: skip
    return cg.LinearAgent(**given | changes)


def task(formula: str, horizon: int, semantics: str = "finite-trace", **agents: Any) -> cg.Problem:
    return cg.Problem(
        name="words",
        horizon=horizon,
        agents=[*({"robot": robot()} | agents).values()],
        propositions={
            "here": cg.Proposition("robot", low=[1.0], high=[3.0]),
            "lane": cg.Proposition("robot", low=[-0.7], high=[0.7]),
            **({"busy": cg.Proposition("other", low=[-1.5], high=[1.5])} if "other" in agents else {}),
        },
        specification=cg.Specification(formula, semantics=semantics),
    )


@pytest.mark.parametrize(
    ("formula", "semantics"),
    [
        ("F[0,14] G[0,5] here", "finite-trace"),
        ("F (lane & F here)", "co-safe"),
        ("(!lane U here) | G !lane", "finite-trace"),
    ],
)
def test_every_word_is_accepted_whatever_agrees_with_it(formula: str, semantics: str) -> None:
    problem = task(formula, 20, semantics)
    found = list(islice(segmented_ways(problem), 60))
    assert len(found) > 3
    for way, times in found:
        steps = times[-1] if problem.automaton.is_co_safe else problem.horizon
        letters = way.letters(times, steps, len(problem.automaton.propositions))
        assert letters is not None
        assert is_accepted(problem, letters)


def test_automata_that_count_steps_have_paths() -> None:
    """F[0,14] G[0,5] has some sixty states and no stays: ways through the automaton alone find nothing."""
    problem = task("F[0,14] G[0,5] here", 20)
    result = cg.synthesize(problem, relation="path")
    assert result.certificate.lower_bound > 0.9999
    assert cg.check(result.certificate, problem)


@pytest.mark.thorough
def test_one_waits_until_nobody_is_in_the_lane() -> None:
    """The loop of `!(lane & busy) U here` is read beside the lane at first, and in it later."""
    lift = cg.LinearAgent(
        name="other", A=[[1.0]], offset=[0.4], noise_covariance=[[1e-4]],
        state_low=[-9.0], state_high=[9.0], initial_state=[-2.0],
    )  # fmt: skip
    problem = task("!(lane & busy) U here", 16, "co-safe", other=lift)
    busy = LinearizationErrors(problem).letters[:, list(problem.automaton.propositions).index("busy")]
    positions = -2.0 + 0.4 * np.arange(17)
    np.testing.assert_array_equal(busy, np.where((positions >= -1.5) & (positions < 1.5), 1, -1))
    result = cg.synthesize(problem, relation="path")
    assert result.certificate.lower_bound > 0.99
    assert cg.check(result.certificate, problem)


def test_what_was_forbidden_up_to_a_jump_is_not_asked_for_after_it() -> None:
    """With `!lane U (busy & X F lane)` nothing is said of the lane between the jump and the end."""
    other = robot(name="other")
    problem = task("!lane U (busy & X F lane)", 9, "co-safe", other=other)
    lane, busy = (list(problem.automaton.propositions).index(name) for name in ("lane", "busy"))
    letters = np.zeros((10, len(problem.automaton.propositions)), dtype=np.int8)
    letters[1:, lane] = -1
    letters[5, busy], letters[9, lane] = 1, 1
    less = without_needless(problem, letters)
    np.testing.assert_array_equal(less[:, lane], [0, -1, -1, -1, -1, 0, 0, 0, 0, 1])
    assert is_accepted(problem, less)


FORMULAS = (
    ("F (lane & F here)", "co-safe"),
    ("!lane U here", "co-safe"),
    ("G (lane -> X here)", "finite-trace"),
    ("G !(lane & here)", "finite-trace"),
)


@mostly_thorough(("formula", "semantics"), FORMULAS, first=3)
def test_a_word_is_accepted_if_every_word_that_agrees_is(formula: str, semantics: str) -> None:
    """Against all words of four letters, one after the other."""
    problem, rng, outcomes = task(formula, 4, semantics), np.random.default_rng(8), set[bool]()
    automaton, n = problem.automaton, len(problem.automaton.propositions)

    def leads_to_acceptance(word: tuple[tuple[bool, ...], ...]) -> bool:
        q = problem.initial_q
        assert q is not None
        for letter in word:
            q = int(automaton.next_state(q, np.array(letter)))
        return bool(automaton.accepting[q])

    words_of_four = list(product(product((False, True), repeat=n), repeat=4))
    for _ in range(60):
        letters = rng.choice([-1, 0, 0, 1], size=(5, n)).astype(np.int8)
        if rng.random() < 0.5:  # something holds at some time of a window
            begin, end = sorted(rng.choice(np.arange(1, 6), size=2, replace=False))
            letters[begin:end, rng.integers(n)] = SOMETIME
        agreeing = [word for word in words_of_four if _agrees(word, letters)]
        expected = all(map(leads_to_acceptance, agreeing))
        assert is_accepted(problem, letters) == expected
        outcomes.add(expected)
    assert outcomes == {False, True}


@mostly_thorough(("formula", "semantics"), FORMULAS, first=2)
def test_the_check_follows_every_word_that_agrees(formula: str, semantics: str) -> None:
    """Against all words of four letters: states that one letter leads to are followed all, and none is made up."""
    fast = {"robot": robot(input_low=[-4.0], input_high=[4.0])}
    problem, rng, outcomes = task(formula, 4, semantics, **fast), np.random.default_rng(9), list[bool]()
    automaton, n = problem.automaton, len(problem.automaton.propositions)
    certificate = cg.synthesize(problem, relation="path").certificate
    here, lane = (automaton.propositions.index(name) for name in ("here", "lane"))
    words_of_four = list(product(product((False, True), repeat=n), repeat=4))
    for _ in range(40):
        letters = rng.choice([-1, 0, 0, 1], size=(5, n)).astype(np.int8)
        letters[0] = certificate.proof.letters[0]
        # Both regions are apart: where one is said to hold the other one does not.
        for p, q in ((here, lane), (lane, here)):
            letters[(letters[:, p] > 0) & (letters[:, q] > 0), q] = -1
        told = letters.copy()
        told[told[:, here] > 0, lane] = told[told[:, lane] > 0, here] = -1
        expected = True
        for word in words_of_four:
            if _agrees(word, told):
                state = problem.initial_q or 0
                for letter in word:
                    state = int(automaton.next_state(np.int64(state), np.array(letter)))
                expected = expected and bool(automaton.accepting[state])
        forged = changed(certificate, letters=letters)
        assert forged.proof.n_steps == 4
        assert (not any("accepted" in reason for reason in wrong_paths(forged)[0])) == expected
        outcomes.append(expected)
    assert {*outcomes} == {False, True}


def _agrees(word: tuple[tuple[bool, ...], ...], letters: np.ndarray) -> bool:
    """Whether a word has what letters ask for, and in each window, a run of ``SOMETIME``, what is to be met in it."""
    read, asked = np.array([(False,) * letters.shape[1], *word]), letters.copy()
    asked[0] = 0
    if np.any(read[asked == 1] != True) or np.any(read[asked == -1]):  # noqa: E712 arrays
        return False
    for p in range(letters.shape[1]):
        for is_window, group in groupby(
            range(1, len(letters)), key=[bool(x) for x in letters[:, p] == SOMETIME].__getitem__
        ):
            if is_window and not read[[*group], p].any():
                return False
    return True


@pytest.mark.parametrize(("formula", "semantics"), FORMULAS)
def test_as_much_is_left_out_as_one_by_one(formula: str, semantics: str) -> None:
    problem = task(formula, 8, semantics)
    for way in islice(automaton_paths_of(problem), 4):
        times = way.spread(8)
        letters = way.letters(times, 8, len(problem.automaton.propositions))
        if letters is None or not is_accepted(problem, letters):
            continue
        expected = letters.copy()
        stays = np.cumsum(np.any(np.diff(letters, axis=0, prepend=letters[:1]) != 0, axis=1))
        stays[0] = stays[1]
        for value, p in product((-1, 1), range(letters.shape[1])):
            asked = expected[:, p] == value
            for part in [asked, *(asked & (stays == stay) for stay in np.unique(stays[asked]))]:
                less = expected.copy()
                less[part, p] = 0
                expected = less if is_accepted(problem, less) else expected
        np.testing.assert_array_equal(without_needless(problem, letters), expected)


@pytest.mark.thorough
def test_errands_of_several_agents_are_done_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """Too many beginnings to look at them all: those that end soonest are found all the same."""
    regions = {"a": (1.0, 2.0), "b": (-1.0, 0.0), "home": (-4.8, -3.2)}
    problem = cg.Problem(
        name="errands",
        horizon=20,
        agents=[robot(name=f"r_{k}") for k in range(4)],
        propositions={
            f"{name}_{k}": cg.Proposition(f"r_{k}", low=[low], high=[high])
            for name, (low, high) in regions.items()
            for k in range(4)
        },
        specification=cg.Specification(
            " & ".join(f"F (a_{k} & F b_{k})" for k in range(4)) + " & F (home_0 & home_1 & home_2 & home_3)",
            semantics="co-safe",
        ),
    )
    # At the start all are at home; a and b take a jump each.
    monkeypatch.setattr(words, "MOST_SEQUENCES", 2)
    assert len(next(automaton_paths_of(problem)).jumps) == 2
    result = cg.synthesize(problem, relation="path")
    assert result.certificate.lower_bound > 0.9999
    assert cg.check(result.certificate, problem)
