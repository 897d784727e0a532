"""Propositions about pairs are what they say: boxes for differences, the same for one world and for many."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import SingleSimulator
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.tasks.problem.problem_file import problem_from_dict, problem_from_toml
from certigym.envs.tasks.regions import REFUSAL
from pair_problems import followers, mover

FILE = """
name = "pairs"
horizon = 4
[[agents]]
name = "drone"
copies = 3
A = [[1.0]]
B = [[1.0]]
noise_covariance = [[0.1]]
state_low = [-9.0]
state_high = [9.0]
input_low = [-1.0]
input_high = [1.0]
initial_state = [0.0]
[propositions]
near = { agents = "drone_*", low = [-1.0], high = [1.0] }
next = { agents = "drone_*", low = [0.0], high = [1.0], pairs = "neighbours" }
tied = { agents = ["drone_1", "drone_*"], low = [-2.0], high = [2.0] }
one = { agents = ["drone_2", "drone_0"], low = [-2.0], high = [2.0], outputs = [[0], [0]] }
[specification]
formula = "G (any(near) | all(tied))"
semantics = "finite-trace"
"""


def holds(problem: cg.Problem, *states: list[float]) -> set[str]:
    letter = problem.labeling.letter(states)
    return {name for name, value in zip(problem.labeling.names, letter) if value}


def test_the_box_of_a_difference_is_half_open_and_directed() -> None:
    problem = followers("G !any(near)", near=([-1.0], [2.0]))
    assert holds(problem, [1.0], [2.0]) == {"near_0_1", "goal"}
    assert holds(problem, [1.0], [np.nextafter(2.0, 3.0)]) == {"goal"}
    assert "near_0_1" not in holds(problem, [3.0], [1.0])
    assert "near_0_1" in holds(problem, [np.nextafter(3.0, 2.0)], [1.0])


def test_families_are_named_by_what_the_star_stands_for() -> None:
    problem = problem_from_toml(FILE)
    assert problem.families["near"] == ("near_0_1", "near_0_2", "near_1_2")
    assert problem.families["next"] == ("next_0_1", "next_1_2")
    assert problem.families["tied"] == ("tied_0", "tied_2")
    assert problem.propositions["tied_2"].agents == ("drone_1", "drone_2")  # type: ignore[union-attr]
    assert problem.labeling.names == tuple(problem.propositions) == problem.automaton.propositions
    again = problem_from_dict(problem.to_dict())
    assert again.fingerprint == problem.fingerprint == pickle.loads(pickle.dumps(problem)).fingerprint


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"agents": ["agent_0", "agent_9"], "low": [-1.0], "high": [1.0]}, "did you mean 'agent_0'|got 'agent_9'"),
        ({"agents": ["agent_0", "agent_0"], "low": [-1.0], "high": [1.0]}, "two different agents"),
        ({"agents": ["agent_0", "agent_1"], "low": [1.0], "high": [1.0]}, "less than `high`"),
        ({"agents": ["agent_0", "agent_1"], "low": [-1.0] * 2, "high": [1.0] * 2}, "as both agents have outputs"),
        ({"agents": ["agent_0", "agent_1"], "low": [50.0], "high": [51.0]}, "differences of agent_0 and agent_1"),
        ({"agents": "agent_0*", "low": [-1.0], "high": [1.0]}, "a pattern that matches"),
        ({"agents": ["agent_0", "agent_1"], "low": [-1.0], "high": [1.0], "outputs": [[0], [1]]}, "below 1, got 1"),
    ],
)
def test_mistakes_are_named(value: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cg.Problem(
            name="wrong",
            horizon=2,
            agents=[mover("agent_0", [0.0]), mover("agent_1", [1.0])],
            propositions={"near": value},
            specification=cg.Specification("true", "finite-trace"),
        )


def mixed() -> cg.Problem:
    """Agents of two kinds, so that pairs cross blocks; outputs are no states, and one agent is an expression."""
    shear = mover("shear", [0.0, 1.0], output_matrix=[[1.0, 0.3], [0.7, -1.1], [0.1, 0.2]])
    bent = cg.Agent(
        name="bent",
        states=["x"],
        inputs=["u"],
        dynamics=["0.9*x + u"],
        noise=[{"law": "gaussian", "std": 0.4}],
        state_low=[-4.0],
        state_high=[4.0],
        input_low=[-1.0],
        input_high=[1.0],
        initial_state=[0.5],
    )
    return cg.Problem(
        name="mixed",
        horizon=9,
        agents=[mover("agent_0", [-1.0]), shear, mover("agent_1", [1.0]), bent],
        propositions={
            "near": cg.Pair("agent_*", [-1.0], [1.0]),
            "bound": cg.Pair(["shear", "agent_*"], [-0.5], [0.9], outputs=[[1], [0]]),
            "last": cg.Pair(["bent", "shear"], [-1.0], [0.4], outputs=[[0], [2]]),
        },
        specification=cg.Specification("G (any(near) | !all(bound) | !last)", "finite-trace"),
    )


def test_one_world_and_many_have_the_same_letters() -> None:
    problem = mixed()
    dynamics = core.Dynamics.of(problem)
    one, rng = SingleSimulator.of(dynamics), np.random.default_rng(3)
    worlds = core.initial(dynamics, rng, 200)
    singles = [one.begin(core.selected(worlds, np.array([m]))) for m in range(200)]
    met = set()
    for _ in range(9):
        inputs = [rng.uniform(-1.0, 1.0, size=(*block.input_low.shape[:2], 200)) for block in dynamics.blocks]
        normals = core.noise(dynamics, rng, 200)
        worlds = core.transition(dynamics, worlds, inputs, normals)
        letters = core.letters(dynamics, worlds.states)
        for m in range(200):
            drawn = np.concatenate([z[..., m].ravel() for z in normals]).tolist()
            asked = [inputs[b][:, k, m].tolist() for b, k in dynamics.position]
            singles[m] = one.step(singles[m], asked, drawn)
            assert singles[m].q == worlds.q[m] and singles[m].failed == worlds.failed[m]
            if not singles[m].failed:
                assert singles[m].letter == sum(1 << p for p in np.flatnonzero(letters[:, m]))
                met.add(singles[m].letter)
        states = core.joint(dynamics, worlds)
        by_hand = [states[:, 0] - states[:, 3], states[:, 1] * 0.7 + states[:, 2] * -1.1 - states[:, 0]]
        names = problem.labeling.names
        assert np.array_equal(letters[names.index("near_0_1")], (by_hand[0] >= -1.0) & (by_hand[0] < 1.0))
        assert np.array_equal(letters[names.index("bound_0")], (by_hand[1] >= -0.5) & (by_hand[1] < 0.9))
    assert len(met) > 6


@pytest.mark.thorough
def test_agents_that_a_pair_ties_have_one_task() -> None:
    agents = [mover(f"agent_{i}", [0.0]) for i in range(24)]
    goals = {f"goal_{i}": cg.Proposition(f"agent_{i}", [1.0], [2.0]) for i in range(24)}
    near = {f"near_{i}": cg.Pair([f"agent_{i}", f"agent_{i + 1}"], [-1.0], [1.0]) for i in range(0, 24, 2)}
    formula = " & ".join([*(f"F {name}" for name in goals), *(f"G !{name}" for name in near)])
    problem = cg.Problem(
        name="many",
        horizon=4,
        agents=agents,
        propositions={**goals, **near},
        specification=cg.Specification(formula, "finite-trace"),
    )
    assert [group.agents for group in problem.groups] == [(i, i + 1) for i in range(0, 24, 2)]
    assert all(task.labeling.names[2].startswith("near") for task in problem.tasks)
    with pytest.raises(ValueError, match="one by one"):
        cg.synthesize(problem)


@pytest.mark.parametrize(
    "verb",
    [
        lambda problem: cg.abstract(problem),
        lambda problem: cg.synthesize(problem, relation="linear"),
        lambda problem: cg.synthesize(problem, search=cg.SearchOptions(stationary=True)),
        lambda problem: cg.certify(problem, lambda state, q, t: [0.0, 0.0], cells=8, relation="linear"),
        lambda problem: problem.labeling.classes,
        lambda problem: problem.labeling.box_classes(0, [[0.0]], [[1.0]]),
        lambda problem: [region.agent for region in problem.propositions.values()],
    ],
)
def test_what_does_not_know_pairs_says_so(verb: Any) -> None:
    agents = [mover("agent_0", [-2.0, 0.0]), mover("agent_1", [2.0, 0.0])]
    problem = cg.Problem(
        name="apart",
        horizon=3,
        agents=agents,
        propositions={"near": cg.Pair("agent_*", [-1.0, -1.0], [1.0, 1.0])},
        specification=cg.Specification("G !any(near)", "finite-trace"),
    )
    with pytest.raises(ValueError, match="pairs"):
        verb(problem)
    assert "pairs" in REFUSAL
