"""Every best response is the maximum over all admissible choices of its cell, ties to the incumbent."""

from __future__ import annotations

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.abstraction.models.input_sets import InputSet
from certigym.synthesis.abstraction.models.target_windows import TargetWindows
from certigym.synthesis.verbs.abstract import abstract
from problems import scalar_agent


def plane(A: list[list[float]], B: list[list[float]]) -> cg.LinearAgent:
    m = len(B[0])
    return cg.LinearAgent(
        name="one",
        A=A,
        B=B,
        noise_covariance=[[0.2, 0.0], [0.0, 0.3]],
        state_low=[-2, -3],
        state_high=[2, 3],
        input_low=[-2.0] * m,
        input_high=[2.5] * m,
        initial_state=[0, 0],
    )


AGENTS = {
    "scalar": scalar_agent("one"),
    "diagonal": plane([[0.9, 0.0], [0.0, 0.7]], [[0.5, 0.0], [0.0, -0.8]]),
    "swapped": plane([[0.9, 0.0], [0.0, 0.7]], [[0.0, 0.5], [0.6, 0.0]]),
    "coupled": plane([[0.9, 0.3], [-0.2, 0.7]], [[0.5, 0.0], [0.0, 0.6]]),
    "skew": plane([[0.9, 0.0], [0.0, 0.7]], [[0.5, 0.2, 0.1], [0.1, 0.4, 0.3]]),
}


OPTIONS = {"exact": cg.SearchOptions(), "paper": cg.SearchOptions(epsilon=0.3)}


@pytest.mark.parametrize(("name", "relation"), [*((name, "exact") for name in AGENTS), ("scalar", "paper")])
@pytest.mark.parametrize("n_objectives", [1, 3])
def test_best_choices_are_the_brute_force_maxima(name: str, relation: str, n_objectives: int) -> None:
    agent = AGENTS[name]
    region = cg.Proposition("one", [0.5] * agent.n_states, [1.5] * agent.n_states)
    problem = cg.Problem(
        name="p",
        horizon=1,
        agents=[agent],
        propositions={"g": region},
        specification=cg.Specification("F g", "co-safe"),
    )
    choices = (
        abstract(problem, 40 if name == "scalar" else [13, 11], relation=relation, search=OPTIONS[relation])
        .models[0]
        .choices
    )
    assert isinstance(choices, InputSet | TargetWindows)
    kernel_size = int(np.prod(choices.shape)) if isinstance(choices, TargetWindows) else int(choices.leads_to.max()) + 1
    rng = np.random.default_rng(0)
    table = rng.integers(0, 6, size=(n_objectives, kernel_size)).astype(float)
    n_cells = len(choices.resting_choice)
    weights = rng.integers(1, 4, size=(n_cells, n_objectives)).astype(float)
    found = choices.best(weights, table, choices.resting_choice)
    for s in range(n_cells):
        if isinstance(choices, InputSet):
            options = choices.leads_to[s]
            assert weights[s] @ table[:, options[found[s]]] == (weights[s] @ table[:, options]).max()
            continue
        everything = np.arange(kernel_size)
        allowed = everything[choices.admissible(np.full(kernel_size, s), everything)]
        window = np.unravel_index(everything, choices.shape)
        if choices.relation.is_box:
            boxed = np.all([(i >= a) & (i < b) for i, a, b in zip(window, choices.low[s], choices.high[s])], axis=0)
            np.testing.assert_array_equal(everything[boxed], allowed)
        assert (found[s] < 0) == (len(allowed) == 0)
        if len(allowed):
            assert found[s] in allowed
            assert weights[s] @ table[:, found[s]] == (weights[s] @ table[:, allowed]).max()


def test_the_incumbent_stays_where_nothing_is_better() -> None:
    problem = cg.Problem(
        name="p",
        horizon=1,
        agents=[scalar_agent("one")],
        propositions={"g": cg.Proposition("one", [0.5], [1.5])},
        specification=cg.Specification("F g", "co-safe"),
    )
    choices = abstract(problem, 40).models[0].choices
    assert isinstance(choices, TargetWindows)
    flat = np.ones((1, int(np.prod(choices.shape))))
    policy = choices.resting_choice
    np.testing.assert_array_equal(choices.best(np.ones((40, 1)), flat, policy), policy)
    np.testing.assert_array_equal(choices.best(np.ones((40, 1)), flat * (1 + 1e-14), policy), policy)


@pytest.mark.parametrize(("name", "relation"), [("diagonal", "exact"), ("scalar", "paper")])
def test_cells_of_no_weight_keep_their_choice_and_do_not_disturb_others(name: str, relation: str) -> None:
    agent = AGENTS[name]
    problem = cg.Problem(
        name="p",
        horizon=1,
        agents=[agent],
        propositions={"g": cg.Proposition("one", [0.5] * agent.n_states, [1.5] * agent.n_states)},
        specification=cg.Specification("F g", "co-safe"),
    )
    choices = (
        abstract(problem, 1200 if name == "scalar" else [40, 30], relation=relation, search=OPTIONS[relation])
        .models[0]
        .choices
    )
    assert isinstance(choices, InputSet | TargetWindows)
    points = int(np.prod(choices.shape)) if isinstance(choices, TargetWindows) else int(choices.leads_to.max()) + 1
    rng = np.random.default_rng(1)
    table, policy = rng.random((3, points)), choices.resting_choice.copy()
    weights = rng.random((1200, 3))
    everywhere = choices.best(weights, table, policy)
    weights[100:] = 0.0
    without = policy.copy()
    without[500] = -1
    found = choices.best(weights, table, without)
    np.testing.assert_array_equal(found[:100], everywhere[:100])
    np.testing.assert_array_equal(np.delete(found, 500)[100:], np.delete(policy, 500)[100:])
    assert found[500] >= 0
