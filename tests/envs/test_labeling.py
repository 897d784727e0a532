"""One membership: regions are half-open, closed at the workspace edge, and box_classes agrees with sampled points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import certigym as cg
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.tasks.regions.labeling import Labeling, Proposition
from kinds import ALL_IDS
from sample_problems import planar, scalar


def names(labeling: Labeling, *states: list[float]) -> set[str]:
    holds = labeling.letter(states)
    return {name for name, value in zip(labeling.names, holds) if value}


def test_zero_lies_on_the_edge_of_p1_and_p2_and_belongs_to_p1() -> None:
    labeling = cg.make_problem("reach-avoid-v0").labeling
    assert names(labeling, [0.0], [0.0]) == {"p1"}
    assert names(labeling, [np.nextafter(0.0, -1.0)], [0.0]) == {"p2"}
    assert names(labeling, [-5.0], [0.0]) == {"p2"}
    assert names(labeling, [np.nextafter(-5.0, -6.0)], [0.0]) == set()


def test_regions_are_closed_where_they_reach_the_edge_of_the_workspace() -> None:
    labeling = cg.make_problem("reach-avoid-v0").labeling
    assert names(labeling, [5.0], [-20.0]) == {"p1", "p3"}
    assert names(labeling, [5.0], [-15.0]) == {"p1"}
    inner = Labeling.of([scalar()], {"goal": Proposition("left", [0.0], [np.nextafter(5.0, 0.0)])})
    assert names(inner, [5.0]) == set()
    beyond = Labeling.of([scalar()], {"goal": Proposition("left", [0.0], [9.0])})
    assert names(beyond, [5.0]) == {"goal"}


def test_general_outputs_are_half_open_everywhere() -> None:
    agent = scalar(output_matrix=[[2.0]])
    labeling = Labeling.of([agent], {"goal": Proposition("left", [0.0], [10.0])})
    assert names(labeling, [5.0]) == set()
    assert names(labeling, [0.0]) == {"goal"}


def test_propositions_stand_agent_by_agent() -> None:
    problem = cg.make_problem("reach-avoid-n-v0", n_agents=3)
    expected = tuple(f"{family}_{i}" for i in range(3) for family in ("safe", "target"))
    assert problem.automaton.propositions == problem.labeling.names == tuple(problem.propositions) == expected
    assert [list(p) for p in problem.labeling.agent_propositions] == [[0, 1], [2, 3], [4, 5]]
    assert problem.families == {"safe": ("safe_0", "safe_1", "safe_2"), "target": ("target_0", "target_1", "target_2")}


def test_classes_of_ra2() -> None:
    problem = cg.make_problem("reach-avoid-v0")
    assert problem.labeling.classes[0].tolist() == [[False, False], [False, True], [True, False]]
    assert problem.labeling.classes[1].tolist() == [[False], [True]]
    low, high = np.array([[-20.0], [-6.0], [-5.0], [-1.0], [4.0]]), np.array([[-6.0], [-5.0], [0.0], [1.0], [5.0]])
    expected = [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]]
    assert problem.labeling.box_classes(0, low, high).astype(int).tolist() == expected


def test_flat_boxes_and_boxes_beyond_the_workspace() -> None:
    labeling = cg.make_problem("reach-avoid-v0").labeling
    low = np.array([[0.0], [-5.0], [5.0], [6.0], [-30.0], [-30.0], [5.0]])
    high = np.array([[0.0], [-5.0], [5.0], [7.0], [-21.0], [-20.0], [6.0]])
    expected = [[0, 0, 1], [0, 1, 0], [0, 0, 1], [0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 1]]
    assert labeling.box_classes(0, low, high).astype(int).tolist() == expected


def test_agent_without_propositions_has_one_class() -> None:
    labeling = Labeling.of([scalar(), planar()], {"goal": Proposition("left", [0.0], [5.0])})
    assert labeling.classes[1].shape == (1, 0)
    assert labeling.box_classes(1, [[0.0, 0.0]], [[1.0, 1.0]]).tolist() == [[True]]
    assert labeling.letter([[0.0], [0.0, 0.0]]).tolist() == [True]


grid = st.integers(-10, 10).map(float)


@st.composite
def boxes(draw: st.DrawFn, axes: int) -> tuple[list[float], list[float]]:
    corners = [sorted(draw(st.lists(grid, min_size=2, max_size=2, unique=True))) for _ in range(axes)]
    return [pair[0] for pair in corners], [pair[1] for pair in corners]


@given(data=st.data())
def test_box_classes_are_exactly_the_classes_of_the_points_for_identity_output(data: st.DataObject) -> None:
    agent = planar()
    regions = {f"r{k}": Proposition("planar", *data.draw(boxes(2))) for k in range(data.draw(st.integers(0, 4)))}
    labeling = Labeling.of([agent], regions)
    low, high = data.draw(boxes(2))
    possible = labeling.box_classes(0, [low], [high])[0]
    # All corners are integers: the half-integers and integers of the box show every class that it meets.
    axes = [np.arange(low[k], high[k] + (high[k] == 10.0) * 0.25, 0.5) for k in range(2)]
    points = np.stack(np.meshgrid(*axes), axis=0).reshape(2, -1)
    seen = {row.tobytes() for row in labeling.class_at(0, points).T}
    expected = {row.tobytes() for row, value in zip(labeling.classes[0], possible) if value}
    assert seen == expected


@given(data=st.data())
def test_box_classes_hold_the_classes_of_all_points_for_general_output(data: st.DataObject) -> None:
    entries = st.integers(-3, 3).map(lambda n: n / 3.0)
    matrix = [[data.draw(entries) for _ in range(2)] for _ in range(2)]
    agent = planar(output_matrix=matrix)
    regions = {}
    for k in range(3):
        low, high = data.draw(boxes(2))
        regions[f"r{k}"] = Proposition("planar", low, high)
    try:
        labeling = Labeling.of([agent], regions)
    except ValueError as error:  # the outputs cannot reach this region
        assert "meets the workspace" in str(error)
        return
    low, high = data.draw(boxes(2))
    possible = labeling.box_classes(0, [low], [high])[0]
    rng = np.random.default_rng(0)
    points = np.array(low)[:, None] + rng.random((2, 500)) * (np.array(high) - np.array(low))[:, None]
    points = np.concatenate([points, np.array([low, high]).T], axis=1)[:, :-1]
    allowed = {row.tobytes() for row, value in zip(labeling.classes[0], possible) if value}
    assert {row.tobytes() for row in labeling.class_at(0, points).T} <= allowed


@pytest.mark.parametrize("id", ALL_IDS)
def test_batched_letters_are_the_letters_of_single_states(id: str) -> None:
    problem = cg.make_problem(id)
    dynamics = core.Dynamics.of(problem)
    rng = np.random.default_rng(1)
    low = np.concatenate([agent.state_low for agent in problem.agents])
    high = np.concatenate([agent.state_high for agent in problem.agents])
    joint = np.round(low + rng.random((200, low.size)) * (high - low))  # integers: many lie on edges
    batch = core.letters(dynamics, core.split_joint(dynamics, joint))
    ends = np.cumsum([agent.n_states for agent in problem.agents])[:-1]
    for world, row in enumerate(joint):
        assert (problem.labeling.letter(np.split(row, ends)) == batch[:, world]).all()


def test_initial_automaton_state_is_known_where_the_start_has_one_letter() -> None:
    problem = cg.make_problem("reach-avoid-v0")
    two = problem.replace(initial_low=[-20.0, -5.0], initial_high=[0.5, -2.5])
    assert two.initial_q is None
    accepted = problem.replace(initial_state=[0.0, 0.0]).initial_q
    assert accepted is not None and problem.automaton.accepting[accepted]
    assert problem.replace(initial_state=[6.0, 0.0]).initial_q is None
