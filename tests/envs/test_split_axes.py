"""Agents split into independent axes: the same system and task, so the same runs; sound bounds, fewer policies."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

import certigym as cg
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.tasks.problem.split import axis_order, split_axes
from certigym.validation.statistical_tests.binomial import REFUTED
from problems import linear

FORMULAS = (
    ("!p U q", "co-safe"),
    ("F (p & X F q)", "co-safe"),
    ("any(r) & F[0,3] q", "co-safe"),
    ("G (!p | any(r)) & F all(r)", "finite-trace"),
)


def blocks(rng: np.random.Generator, d: int) -> list[list[int]]:
    """A random partition of the components."""
    colours = rng.integers(0, d, d)
    return [np.flatnonzero(colours == c).tolist() for c in np.unique(colours)]


def agent(rng: np.random.Generator, name: str, d: int, own: list[list[int]], identity: bool) -> cg.LinearAgent:
    """A random agent whose matrices respect the blocks; numbers are eighths, so that sums are exact."""
    A, covariance = np.zeros((d, d)), np.zeros((d, d))
    inputs, outputs = [], []
    for block in own:
        size = len(block)
        A[np.ix_(block, block)] = rng.integers(-8, 9, (size, size)) / 8
        covariance[np.ix_(block, block)] = np.eye(size) / 4 + 0.0625
        inputs.append(np.zeros((d, 1)))
        inputs[-1][block, 0] = rng.integers(-2, 3, size) / 2
        outputs.append(np.zeros((1, d)))
        outputs[-1][0, block] = rng.integers(-2, 3, size) / 2
    low = rng.integers(-3, 1, d) / 2
    return cg.LinearAgent(
        name=name,
        A=A,
        B=np.concatenate(inputs, axis=1)[:, rng.permutation(len(own))],
        noise_covariance=covariance,
        state_low=[-4.0] * d,
        state_high=[4.0] * d,
        input_low=[-1.0] * len(own),
        input_high=[1.0] * len(own),
        initial_low=low,
        initial_high=low + rng.integers(0, 2, d) / 2,
        offset=rng.integers(-2, 3, d) / 4,
        output_matrix=None if identity else np.concatenate(outputs)[rng.permutation(len(own))],
    )


def random_problem(seed: int, formula: tuple[str, str]) -> cg.Problem:
    rng = np.random.default_rng(seed)
    agents = []
    for i in range(2):
        d = int(rng.integers(1, 5))
        agents.append(agent(rng, f"a_{i}", d, blocks(rng, d), bool(rng.integers(0, 2))))

    def region(name: str, sizes: list[int]) -> cg.Proposition:
        low = rng.integers(-5, 3, max(sizes)) / 1.0
        return cg.Proposition(name, low, low + rng.integers(2, 7, max(sizes)))

    regions = {
        "p": region("a_0", [agents[0].n_outputs]),
        "q": region("a_1", [agents[1].n_outputs]),
    }
    if agents[0].n_outputs == agents[1].n_outputs:
        regions["r"] = region("a_*", [a.n_outputs for a in agents])
    else:
        formula = FORMULAS[seed % 2]
    task = cg.Specification(*formula)
    return cg.Problem(name="random", horizon=4, agents=agents, propositions=regions, specification=task)


def sorted_by_agent(dynamics: core.Dynamics, joint: np.ndarray, sizes: str) -> list[np.ndarray]:
    """Joint values (M, n) as one array (n, agents, M) per block of equal agents."""
    counts = [getattr(a, sizes) for a in dynamics.problem.agents]
    parts = np.split(joint, np.cumsum(counts)[:-1], axis=1)
    return [np.stack([parts[i].T for i in block.agents], axis=1) for block in dynamics.blocks]


@pytest.mark.thorough
@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), formula=st.sampled_from(FORMULAS))
def test_split_problems_run_as_the_originals_do(seed: int, formula: tuple[str, str]) -> None:
    """Same starts, noise and inputs: same states but for their order, same exits, same outcome at every step."""
    try:
        whole = random_problem(seed, formula)
    except ValueError:  # a region that misses what the outputs can be
        reject()
    parts = split_axes(whole)
    states, inputs = axis_order(whole)
    assert parts.n_states == whole.n_states and sorted(states) == list(range(whole.n_states))
    box = [np.concatenate([getattr(a.initial, side) for a in whole.agents]) for side in ("low", "high")]
    split_box = [np.concatenate([getattr(a.initial, side) for a in parts.agents]) for side in ("low", "high")]
    np.testing.assert_array_equal(np.array(split_box), np.array(box)[:, states])

    rng, n = np.random.default_rng(seed), 200
    one, other = core.Dynamics.of(whole), core.Dynamics.of(parts)
    start = np.round(8 * rng.uniform(-4.2, 4.2, (n, whole.n_states))) / 8
    worlds, split_worlds = core.initial_at(one, start), core.initial_at(other, start[:, states])
    for _ in range(whole.horizon):
        u = rng.integers(-8, 9, (n, sum(a.n_inputs for a in whole.agents))) / 8
        z = rng.integers(-16, 17, (n, whole.n_states)) / 8
        split_u = np.where(inputs >= 0, u[:, inputs], 0.0)
        worlds = core.transition(one, worlds, sorted_by_agent(one, u, "n_inputs"), sorted_by_agent(one, z, "n_states"))
        split_worlds = core.transition(
            other,
            split_worlds,
            sorted_by_agent(other, split_u, "n_inputs"),
            sorted_by_agent(other, z[:, states], "n_states"),
        )
        np.testing.assert_array_equal(core.joint(other, split_worlds), core.joint(one, worlds)[:, states])
        np.testing.assert_array_equal(split_worlds.failed, worlds.failed)
        np.testing.assert_array_equal(split_worlds.accepted, worlds.accepted)
        np.testing.assert_array_equal(core.satisfied(other, split_worlds), core.satisfied(one, worlds))


def test_automata_are_split_as_formulas_are() -> None:
    """A given automaton moves as before on all letters that the regions can make."""
    whole = cg.make_problem("cyclic-delivery-v0")
    parts = split_axes(whole)
    assert parts.n_agents == 2 * whole.n_agents and parts.specification.automaton is not None
    one, other = core.Dynamics.of(whole), core.Dynamics.of(parts)
    low = np.concatenate([a.state_low for a in whole.agents])
    high = np.concatenate([a.state_high for a in whole.agents])
    points = np.random.default_rng(0).uniform(low, high, (20_000, whole.n_states))
    read = [core.letters(d, core.split_joint(d, points)) for d in (one, other)]
    for q in range(whole.automaton.n_states):
        at = np.full(len(points), q)
        np.testing.assert_array_equal(parts.automaton.next_state(at, read[1]), whole.automaton.next_state(at, read[0]))


def test_regions_stay_half_open_at_the_upper_edge_of_outputs() -> None:
    """A block may have y = x where its agent has not: its regions must not be closed by that."""
    common: dict[str, Any] = {
        "name": "robot",
        "A": np.eye(2) / 2,
        "B": np.eye(2),
        "noise_covariance": np.eye(2) / 4,
        "state_low": [-1, -1],
        "state_high": [1, 1],
        "input_low": [-1, -1],
        "input_high": [1, 1],
        "initial_state": [0, 0],
    }
    robot = cg.LinearAgent(**common, output_matrix=[[1.0, 0.0]])
    task = cg.Specification("F top", "co-safe")
    regions = {"top": cg.Proposition("robot", [0.5], [1.0])}
    whole = cg.Problem(name="edge", horizon=3, agents=[robot], propositions=regions, specification=task)
    parts = split_axes(whole)
    assert parts.n_agents == 2 and list(parts.propositions) == ["top"]
    for x in (np.nextafter(1.0, 0.0), 1.0):
        letters = [p.labeling.letter(s) for p, s in ((whole, [[x, 0.0]]), (parts, [[x], [0.0]]))]
        np.testing.assert_array_equal(letters[0], letters[1])


def test_axes_without_inputs_and_coupled_agents() -> None:
    """An axis that no input moves becomes an agent with an input that is 0; coupled axes stay together."""
    drift = cg.LinearAgent(
        name="cart",
        A=[[0.5, 0.0], [0.0, 0.5]],
        B=[[1.0], [0.0]],
        noise_covariance=np.eye(2) / 4,
        state_low=[-1, -1],
        state_high=[1, 1],
        input_low=[-1],
        input_high=[1],
        initial_state=[0, 0],
    )
    safe = {"safe": cg.Proposition("cart", [-0.5, -1], [0.5, 1])}
    task = cg.Specification("G safe", "finite-trace")
    whole = cg.Problem(name="drift", horizon=3, agents=[drift], propositions=safe, specification=task)
    parts = split_axes(whole)
    assert parts.agent_names == ("cart_x0", "cart_x1") and list(parts.propositions) == ["safe"]
    assert not np.any(linear(parts.agents[1]).B) and parts.agents[1].input_box.high.tolist() == [0.0]
    assert [order.tolist() for order in axis_order(whole)] == [[0, 1], [0, -1]]
    assert split_axes(parts) is parts
    spiral = cg.make_problem("reach-avoid-planar-v0")
    assert split_axes(spiral) is spiral


@pytest.mark.thorough
def test_split_bounds_are_sound_and_no_better_than_the_optimum_of_whole_agents() -> None:
    """One agent: its dynamic program is optimal on its cells, and split policies are some of its own."""
    whole = cg.make_problem("package-delivery-single-v0", horizon=12)
    parts = split_axes(whole)
    kept = cg.synthesize(whole, 36, relation="exact")
    split = cg.synthesize(parts, 36, relation="exact")
    assert 0.5 * kept.certificate.lower_bound < split.certificate.lower_bound
    assert split.certificate.lower_bound <= kept.certificate.lower_bound * (1 + 1e-9)
    assert cg.check(split.certificate, parts)
    assert cg.validate(split, episodes=20_000, seed=0).verdict != REFUTED


def test_axes_with_correlated_noise_stay_together() -> None:
    values: dict[str, Any] = {
        "A": np.eye(2),
        "B": np.eye(2),
        "state_low": [-1, -1],
        "state_high": [1, 1],
        "input_low": [-1, -1],
        "input_high": [1, 1],
        "initial_state": [0, 0],
    }
    for correlation, expected in ((0.0, 2), (0.05, 1)):
        noise = [[0.1, correlation], [correlation, 0.1]]
        problem = cg.Problem(
            name="one",
            horizon=2,
            agents=[cg.LinearAgent(name="one", noise_covariance=noise, **values)],
            propositions={"g": cg.Proposition("one", [0, 0], [1, 1])},
            specification=cg.Specification("F g", "co-safe"),
        )
        assert cg.split_axes(problem).n_agents == expected
