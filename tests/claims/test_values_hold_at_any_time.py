"""What a certificate promises in the middle of a run: at a state, in an automaton state, with steps left."""

from __future__ import annotations

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.extended_check.claims import ValueInTime

FALSE_ALARM = 1e-6


@pytest.fixture(scope="module", params=["exact", "linear"])
def value(request: pytest.FixtureRequest) -> ValueInTime:
    problem = cg.make_problem("reach-avoid-v0", horizon=5)
    value = cg.value_in_time(cg.synthesize(problem, 60, relation=request.param).certificate)
    assert isinstance(value, ValueInTime)
    return value


def states_of(problem: cg.Problem, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    low = np.concatenate([agent.state_low for agent in problem.agents])
    high = np.concatenate([agent.state_high for agent in problem.agents])
    return low + rng.random((count, len(low))) * (high - low)


def letters_read(problem: cg.Problem, states: np.ndarray) -> np.ndarray:
    """Automaton states after the letters of joint states."""
    holds = [problem.labeling.class_at(i, states[:, columns].T) for i, columns in enumerate(problem.columns)]
    start = np.full(len(states), problem.automaton.initial)
    return np.asarray(problem.automaton.next_state(start, np.concatenate(holds)))


def test_with_all_steps_left_it_is_the_claim_of_the_certificate(value: ValueInTime) -> None:
    certificate = value.certificate
    states = states_of(certificate.problem, 300, 0)
    q = letters_read(certificate.problem, states)
    undecided = ~certificate.problem.automaton.absorbing[q]
    found = value.at(states, q, certificate.problem.horizon)
    np.testing.assert_array_equal(found[undecided], certificate.at(states)[undecided])
    assert np.all(found[~undecided] == certificate.problem.automaton.accepting[q[~undecided]])


def test_at_the_end_only_what_is_accepted_counts(value: ValueInTime) -> None:
    problem = value.certificate.problem
    states = states_of(problem, 50, 1)
    for q in range(problem.automaton.n_states):
        np.testing.assert_array_equal(value.at(states, q, 0), float(problem.automaton.accepting[q]))


def test_with_fewer_steps_left_it_is_what_those_policies_are_certified_for(value: ValueInTime) -> None:
    """The last steps of the policies are policies of the shorter task; a certificate of these says the same."""
    certificate = value.certificate
    short = certificate.problem.replace(horizon=3)
    tail = cg.synthesize(
        short,
        60,
        relation=certificate.proof.agents[0].relation["kind"],
        search=cg.SearchOptions(max_sweeps=0),
        start=certificate,
    )
    same = [
        np.array_equal(part.policy, whole.policy[2:])
        for part, whole in zip(tail.certificate.proof.agents, certificate.proof.agents, strict=True)
    ]
    assert all(same)
    states = states_of(short, 300, 2)
    q = letters_read(short, states)
    np.testing.assert_allclose(value.at(states, q, 3), tail.certificate.at(states), atol=1e-4)


@pytest.mark.thorough
def test_runs_from_the_middle_reach_what_is_promised(value: ValueInTime) -> None:
    """20,000 runs from each of some states with 3 steps left, against the limit at 1e-6 for the whole test."""
    certificate = value.certificate
    problem = certificate.problem
    states = states_of(problem, 12, 3)
    q = letters_read(problem, states)
    for state, at in zip(states, q, strict=True):
        bound = float(value.at(state, int(at), 3)[0])
        short = problem.replace(horizon=3, initial_state=state)
        tail = cg.synthesize(
            short,
            60,
            relation=certificate.proof.agents[0].relation["kind"],
            search=cg.SearchOptions(max_sweeps=0),
            start=certificate,
        ).certificate
        report = cg.validate(tail, 20_000, confidence=1.0 - FALSE_ALARM / 12)
        assert report.ci_high >= bound


@pytest.mark.parametrize(
    ("q", "steps_left", "words"),
    [(9, 1, "`q`: expected numbers from 0 to"), (0.5, 1, "`q`: expected a whole number"), (0, 6, "`steps_left`")],
)
def test_wrong_questions_are_refused(value: ValueInTime, q: object, steps_left: object, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        value.at(states_of(value.certificate.problem, 1, 0), q, steps_left)


def test_trains_are_read_too() -> None:
    problem = cg.make_problem("reach-avoid-v0", horizon=4)
    certificate = cg.synthesize(problem, 50, relation="exact", search=cg.SearchOptions(value="train")).certificate
    states = states_of(problem, 100, 4)
    q = letters_read(problem, states)
    undecided = ~problem.automaton.absorbing[q]
    found = cg.value_in_time(certificate).at(states, q, 4)
    np.testing.assert_array_equal(found[undecided], certificate.at(states)[undecided])
