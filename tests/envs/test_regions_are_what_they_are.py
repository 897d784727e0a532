"""Regions of every shape hold where geometry says so: in letters, simulators, files, checks and pictures alike.

Membership is computed here by other means: `hypot` for discs and balls, cross products for polygons, `atan2` for cones
and headings.
"""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import Dynamics, SingleSimulator
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.tasks.problem import problem_from_dict
from certigym.envs.tasks.regions import SHAPES
from certigym.synthesis.extended_check.steps.geometry import classes_in_boxes
from kinds import mostly_thorough

Point = np.ndarray
COUNT = 4000
"""Points at which a shape is compared with geometry: a wrong face is met by hundreds of them."""


def linear(name: str = "robot", d: int = 2, **changes: Any) -> cg.LinearAgent:
    """As many inputs as states, at most one metre per step."""
    data: dict[str, Any] = {
        "A": np.eye(d), "B": np.eye(d), "noise_covariance": 0.01 * np.eye(d), "state_low": [-5.0] * d,
        "state_high": [5.0] * d, "input_low": [-1.0] * d, "input_high": [1.0] * d, "initial_state": [-4.0] * d,
    }  # fmt: skip
    return cg.LinearAgent(name=name, **{**data, **changes})


def written(name: str = "robot", d: int = 2, **changes: Any) -> cg.Agent:
    """The same, written as expressions."""
    names = ["x", "y", "z"][:d]
    data: dict[str, Any] = {
        "states": names, "inputs": [f"u{k}" for k in range(d)],
        "dynamics": [f"{s} + u{k}" for k, s in enumerate(names)],
        "noise": [{"law": "gaussian", "std": 0.1}] * d, "state_low": [-5.0] * d, "state_high": [5.0] * d,
        "input_low": [-1.0] * d, "input_high": [1.0] * d, "initial_state": [-4.0] * d,
    }  # fmt: skip
    return cg.Agent(name=name, **{**data, **changes})


def problem_of(agent: Any, formula: str = "F p", horizon: int = 8, **shapes: Any) -> cg.Problem:
    kind = "finite-trace" if formula.startswith("G") else "co-safe"
    regions = {name: shape if isinstance(shape, cg.Proposition | cg.Pair) else cg.Proposition("robot", **shape)
               for name, shape in shapes.items()}  # fmt: skip
    agents = agent if isinstance(agent, list) else [agent]
    return cg.Problem(name="shapes", horizon=horizon, agents=agents, propositions=regions,
                      specification=cg.Specification(formula, kind))  # fmt: skip


def in_polygon(corners: list[list[float]], p: Point) -> bool:
    """Return whether a point lies on one side of all edges, by cross products."""
    signs = {
        (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0 for a, b in pairwise([*corners, corners[0]])
    }
    return len(signs) == 1


def in_cone(tip: list[float], axis: list[float], angle: float, p: Point) -> bool:
    """Return whether a point is seen from the tip within half an angle of the axis."""
    way = np.subtract(p, tip)
    cosine = float(way @ axis) / (float(np.linalg.norm(way)) * float(np.linalg.norm(axis)))
    return math.acos(max(-1.0, min(1.0, cosine))) <= 0.5 * angle


def turned(angle: float) -> float:
    return math.atan2(math.sin(angle), math.cos(angle)) % (2.0 * math.pi)


PENTAGON = [[-2.0, -1.0], [1.0, -2.5], [3.0, 0.5], [1.5, 3.0], [-1.5, 2.0]]
TRIANGLE = [[0.0, 1.5], [1.0, -1.0], [-1.0, -1.0]]
"""Against the clock, and with it."""

DISC = {"disc": {"centre": [1.0, -2.0], "radius": 1.5}}
IN_DISC: Callable[[Point], bool] = lambda p: math.hypot(p[0] - 1.0, p[1] + 2.0) < 1.5  # noqa: E731

SHAPED: dict[str, tuple[dict[str, Any], int, Callable[[Point], bool]]] = {
    "disc": (DISC, 2, IN_DISC),
    "ball": ({"ball": {"centre": [1, 0, -1], "radius": 2.5}}, 3, lambda p: math.dist(p, (1, 0, -1)) < 2.5),
    "ball of two": (
        {"ball": {"centre": [1, 0], "radius": 2, "of": [2, 0]}}, 3, lambda p: math.hypot(p[2] - 1, p[0]) < 2
    ),
    "box": ({"box": {"low": [-1], "high": [2], "of": 1}}, 2, lambda p: -1 <= p[1] < 2),
    "polygon": ({"polygon": {"corners": PENTAGON}}, 2, lambda p: in_polygon(PENTAGON, p)),
    "polygon with the clock": ({"polygon": {"corners": TRIANGLE}}, 2, lambda p: in_polygon(TRIANGLE, p)),
    "polygon turned": (
        {"polygon": {"corners": TRIANGLE, "of": [1, 0]}}, 2, lambda p: in_polygon(TRIANGLE, p[::-1])
    ),
    "halfspace": ({"halfspace": {"normal": [-1, 2], "offset": 1.5}}, 2, lambda p: -p[0] + 2 * p[1] <= 1.5),
    "polytope": (
        {"polytope": {"normals": [[1, 1, 1], [-1, 0, 0], [0, -2, 0]], "offsets": [2, 1, 3]}},
        3,
        lambda p: p.sum() <= 2 and -p[0] <= 1 and -2 * p[1] <= 3,
    ),
    "cone": (
        {"cone": {"tip": [-1, 0.5], "axis": [-1, 1], "angle": 1.2}}, 2, lambda p: in_cone([-1, 0.5], [-1, 1], 1.2, p)
    ),
    "wide cone": (
        {"cone": {"tip": [0, 1], "axis": [0, -2], "angle": 3.0}}, 2, lambda p: in_cone([0, 1], [0, -2], 3.0, p)
    ),
    "round cone": (
        {"cone": {"tip": [1, 0, -3], "axis": [-1, 1, 2], "angle": 1.4}},
        3,
        lambda p: in_cone([1, 0, -3], [-1, 1, 2], 1.4, p),
    ),
    "heading": (
        {"heading": {"of": 1, "from": 0.5, "to": 1.5}}, 2, lambda p: 0.5 <= turned(p[1]) < 1.5
    ),
    "heading through pi": (
        {"heading": {"of": 0, "from": "pi - 0.5", "to": "-pi + 0.7"}},
        2,
        lambda p: math.pi - 0.5 <= turned(p[0]) < math.pi + 0.7,
    ),
    "union": (
        {"union": [DISC, {"polygon": {"corners": TRIANGLE}}]}, 2, lambda p: IN_DISC(p) or in_polygon(TRIANGLE, p)
    ),
    "intersection": (
        {"intersection": [DISC, {"halfspace": {"normal": [1, 1], "offset": -1}}]},
        2,
        lambda p: IN_DISC(p) and p[0] + p[1] <= -1,
    ),
    "complement": ({"complement": {"polygon": {"corners": PENTAGON}}}, 2, lambda p: not in_polygon(PENTAGON, p)),
    "ring": (
        {"intersection": [{"disc": {"centre": [0, 0], "radius": 4}}, {"complement": DISC}]},
        2,
        lambda p: math.hypot(*p) < 4 and not IN_DISC(p),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SHAPED)
@pytest.mark.parametrize("kind", [linear, written])
def test_a_shape_holds_where_geometry_says(name: str, kind: Callable[..., Any]) -> None:
    table, d, inside = SHAPED[name]
    problem = problem_of(kind(d=d), p=table)
    points = np.random.default_rng(1).uniform(-5, 5, (COUNT, d))
    wanted = np.array([inside(p) for p in points])
    assert 0.01 < wanted.mean() < 0.99
    classes = problem.labeling.class_at(0, points.T)
    names = problem.labeling.names
    told = [problem.told(n for n, yes in zip(names, column, strict=True) if yes) for column in classes.T]
    assert [bool(own) for own in told] == wanted.tolist()


@pytest.mark.parametrize("name", SHAPED)
def test_runs_are_judged_by_what_is_written(name: str) -> None:
    """Batched worlds and single ones accept `F p` at a start that is inside, and at no other."""
    table, d, inside = SHAPED[name]
    problem = problem_of(linear(d=d), p=table)
    dynamics = Dynamics.of(problem)
    states = np.random.default_rng(2).uniform(-5, 5, (200, d))
    wanted = [inside(p) for p in states]
    worlds = core.initial_at(dynamics, states)
    assert core.satisfied(dynamics, worlds).tolist() == wanted
    single = SingleSimulator.of(dynamics)
    for k in range(40):
        world = single.begin(core.initial_at(dynamics, states[k : k + 1]))
        assert single.satisfied(world) == wanted[k]
        assert ("p" in single.names(world.letter)) == wanted[k]


@pytest.mark.parametrize("name", SHAPED)
@pytest.mark.parametrize("kind", [linear, written])
def test_no_cell_misses_a_class_that_its_points_have(name: str, kind: Callable[..., Any]) -> None:
    """Neither in the search's reading nor in the check's."""
    table, d, _ = SHAPED[name]
    problem = problem_of(kind(d=d), p=table)
    rng = np.random.default_rng(3)
    low = rng.uniform(-5, 4, (150, d))
    high = np.minimum(low + rng.uniform(0.01, 1.5, (150, d)), 5.0)
    points = low + rng.uniform(0, 1, (40, 150, d)) * (high - low)
    held = problem.labeling.class_at(0, np.moveaxis(points, -1, 0))  # (P, 40, 150)
    known, possible = problem.labeling.classes[0], problem.labeling.box_classes(0, low, high)
    checked, meets = classes_in_boxes(problem, 0, low, high, closed=False)
    for rows, where in ((known, possible), (checked, meets)):
        number = {row.tobytes(): k for k, row in enumerate(rows)}
        for s in range(150):
            assert all(where[s, number[held[:, k, s].copy().tobytes()]] for k in range(40))
        # Most boxes are surely in or surely out.
        assert (where.sum(axis=1) == 1).mean() > 0.25


def test_faces_of_neighbours_share_no_point() -> None:
    """Of two shapes on both sides of a line exactly one holds on it, as of boxes; a disc is open."""
    problem = problem_of(
        written(), left={"halfspace": {"normal": [1, 1], "offset": 0}},
        right={"halfspace": {"normal": [-1, -1], "offset": 0}}, disc={"disc": {"centre": [0, 0], "radius": 1}},
        rest={"complement": "disc"}, formula="F left",
    )  # fmt: skip
    labeling = problem.labeling
    on_line = np.array([[-1.0, 0.25, 2.0], [1.0, -0.25, -2.0]])
    held = dict(zip(labeling.names, labeling.class_at(0, on_line), strict=True))
    assert held["right"].all() and not held["left"].any()
    assert not labeling.class_at(0, np.array([[1.0], [0.0]]))[labeling.names.index("disc")].any()
    assert problem.told([]) == ["rest"]


def test_a_polygon_that_is_a_box_is_that_box() -> None:
    square = cg.Proposition("robot", polygon={"corners": [[1, 2], [3, 2], [3, 5], [1, 5]]})
    for kind in (linear, written):
        shaped, plain = problem_of(kind(), p=square), problem_of(kind(), p=cg.Proposition("robot", [1, 2], [3, 5]))
        assert shaped.fingerprint == plain.fingerprint
        assert shaped.agents[0].has_identity_output


def test_shapes_change_nothing_of_boxes_beside_them() -> None:
    """Cells along the faces of a box stay of one class, and a box at the upper edge of the workspace stays closed."""
    agent = linear()
    room = cg.Proposition("robot", [2, 2], [5, 5])
    problem = problem_of(agent, room=room, rock={"polygon": {"corners": TRIANGLE}}, p=DISC)
    place = problem.labeling.names.index("room")
    assert problem.labeling.class_at(0, np.array([[5.0], [5.0]]))[place].all()
    low, high = np.array([[2.0, 2.0], [1.0, 2.0]]), np.array([[3.0, 3.0], [2.0, 3.0]])
    known = problem.labeling.classes[0]
    for rows, where in (
        (known, problem.labeling.box_classes(0, low, high)),
        classes_in_boxes(problem, 0, low, high, False),
    ):
        assert rows[where[0]][:, place].all()
        assert not rows[where[1]][:, place].any()


@pytest.mark.parametrize("kind", [linear, written])
def test_a_linear_agent_with_faces_stays_linear_and_moves_the_same_with_discs(kind: Callable[..., Any]) -> None:
    agent = kind(**({"A": [[0.9, -0.1], [0, 1]], "offset": [0.5, -1]} if kind is linear else {}))
    faces, round_one = problem_of(agent, p={"polygon": {"corners": PENTAGON}}), problem_of(agent, p=DISC)
    assert type(faces.agents[0]) is type(agent)
    rng = np.random.default_rng(4)
    x, u = rng.uniform(-5, 5, (2, 50)), rng.uniform(-1, 1, (2, 50))
    for other in (faces, round_one):
        np.testing.assert_allclose(other.agents[0].mean(x, u), agent.mean(x, u), rtol=0, atol=1e-14)
        assert other.agents[0].noise_key == agent.noise_key
        np.testing.assert_allclose(other.agents[0].outputs(x)[:2], x, rtol=0, atol=0)


def everything() -> cg.Problem:
    shapes: Any = {f"p{k}": table for k, (table, d, _) in enumerate(SHAPED.values()) if d == 2}
    shapes |= {"both": {"union": ["p0", "p3"]}, "moving": {"halfspace": {"normal": [1, 0], "offset": "sin(t)"}}}
    return problem_of(written(), formula="F both", **shapes)


def test_problems_remember_shapes_as_they_were_written() -> None:
    problem = everything()
    data = json.loads(json.dumps(problem.to_dict()))
    assert data["propositions"]["p0"] == {"agent": "robot", **DISC}
    assert "outputs" not in data["agents"][0] and "added_outputs" not in data["agents"][0]
    for again in (problem_from_dict(data), pickle.loads(pickle.dumps(problem))):
        assert again.fingerprint == problem.fingerprint
        assert again.to_dict() == problem.to_dict()
    moved = problem.replace(initial_state=[0, 0], disturbance_scale=0.5)
    assert moved.to_dict()["agents"][0]["initial_low"] == [0.0, 0.0]
    assert not moved.agents[0].initial.low.any()
    assert problem_from_dict(moved.to_dict()).fingerprint == moved.fingerprint != problem.fingerprint


# --- the bounds


SABOTAGES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "a radius that is not squared": (DISC, {"disc": {"centre": [1.0, -2.0], "radius": 1.5**0.5}}),
    "a face that is forgotten": (
        {"polygon": {"corners": TRIANGLE}}, {"polytope": {"normals": [[0, -1], [2.5, 1]], "offsets": [1, 1.5]}}
    ),
    "a normal that is negated": (
        {"halfspace": {"normal": [1, 1], "offset": -3}}, {"halfspace": {"normal": [-1, -1], "offset": -3}}
    ),
    "a union that is read as an intersection": (
        {"union": [DISC, {"halfspace": {"normal": [1, 0], "offset": 1}}]},
        {"intersection": [DISC, {"halfspace": {"normal": [1, 0], "offset": 1}}]},
    ),
    "a complement that is ignored": ({"complement": DISC}, DISC),
}  # fmt: skip
"""What is meant, and what a wrong compiler would make of it."""


@pytest.mark.parametrize("name", SABOTAGES)
@mostly_thorough("formula", ["F[4,8] p", "F !p"])
def test_certificates_of_wrong_shapes_are_refused(name: str, formula: str) -> None:
    """As they are, and with the problem that is meant put in; the check grants what was certified for what is meant."""
    meant, made = SABOTAGES[name]
    right, wrong = (problem_of(linear(initial_state=[1, -2]), formula, p=table) for table in (meant, made))
    honest, false = (cg.synthesize(problem, relation="path").certificate for problem in (right, wrong))
    assert cg.check(honest, right)
    assert not cg.check(false, right)
    assert right.fingerprint != wrong.fingerprint


@pytest.mark.parametrize("name", SABOTAGES)
def test_geometry_notices_wrong_shapes(name: str) -> None:
    """Points of the tests above tell each of these apart."""
    meant, made = SABOTAGES[name]
    points = np.random.default_rng(1).uniform(-5, 5, (2, COUNT))
    held = []
    for table in (meant, made):
        problem = problem_of(linear(), p=table)
        classes, names = problem.labeling.class_at(0, points), problem.labeling.names
        held.append([bool(problem.told(n for n, yes in zip(names, c, strict=True) if yes)) for c in classes.T])
    assert np.mean(np.array(held[0]) != np.array(held[1])) > 0.005


# --- what is refused


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"polygon": {"corners": [[0, 0], [1, 1]]}}, "`polygon`: `corners`: expected 3 to 60 corners, got 2"),
        ({"polygon": {"corners": [[0, 0], [4, 0], [1, 1], [0, 4]]}}, "`union` of convex ones"),
        ({"polygon": {"corners": [[0, 1], [1, -1], [-1, 0.5], [1, 0.5], [-1, -1]]}}, "`union` of convex ones"),
        ({"polygon": {"corners": [["s", 0], [1, 0], [1, 1]]}}, "`polygon`: `corners[0][0]`"),
        ({"disc": {"centre": [0, 0], "radius": -1}}, "`disc`: `radius`: expected a number above 0, got -1"),
        ({"disc": {"centre": ["t", "x"], "radius": 1}}, "`disc`: `centre[1]`"),
        ({"disc": {"centre": [0, 0], "radius": 1, "of": ["x", "yy"]}}, "did you mean 'y'?"),
        ({"disc": {"centre": [20, 0], "radius": 1}}, "expected a region that meets the workspace"),
        ({"cone": {"tip": [0, 0], "axis": [1, 0], "angle": 4}}, "`angle`: expected the whole opening"),
        ({"cone": {"tip": [0, 0], "axis": [0, 0], "angle": 1}}, "`axis`: expected a vector with an entry other than 0"),
        ({"halfspace": {"normal": [0, 0], "offset": 1}}, "`normal`: expected a vector with an entry other than 0"),
        ({"polytope": {"normals": [[1, 0], [-1, 0]], "offsets": [0, -1]}}, "opposite ones that leave none"),
        ({"heading": {"of": ["x", "y"], "from": 0, "to": 1}}, "expected one state"),
        ({"union": ["p"]}, "at least two names"),
        ({"union": ["q", "other"]}, "which is about others; write `a | b` in the formula"),
        ({"union": ["q", {"disc": {"centre": [0, 0], "radius": 0}}]}, "`union`: `disc`: `radius`"),
        ({"complement": "circle"}, "circle -> turn -> circle"),
    ],
)
def test_what_cannot_be_is_refused_in_words(table: dict[str, Any], said: str) -> None:
    agents = [written(), written("second")]
    with pytest.raises(ValueError, match=r"[`:]") as caught:
        problem_of(
            agents, "F q", q=cg.Proposition("robot", [0, 0], [1, 1]), other=cg.Proposition("second", [0, 0], [1, 1]),
            circle={"complement": "turn"} if "circle" in table.values() else DISC,
            turn={"complement": "circle"} if "circle" in table.values() else DISC, p=table,
        )  # fmt: skip
    assert said in str(caught.value)
    assert "\n" not in str(caught.value) or str(caught.value).endswith("^")


def test_automata_by_hand_read_unions() -> None:
    data = problem_of(linear(), p=DISC, q={"union": ["p", {"box": {"low": [3, 3], "high": [5, 5]}}]}).to_dict()
    formula = {**data, "specification": {"formula": "F q", "semantics": "co-safe"}}
    steps = [["waits", "q", "done"], ["done", "true", "done"]]
    data["specification"] = {"semantics": "co-safe", "states": ["waits", "done"], "initial": "waits",
                             "accepting": ["done"], "transitions": steps, "otherwise": "waits"}  # fmt: skip
    one, other = problem_from_dict(data), problem_from_dict(formula)
    letters = np.random.default_rng(9).random((2, 50)) < 0.5
    reached = [p.automaton.next_state(np.full(50, p.automaton.initial), letters) for p in (one, other)]
    assert all(np.array_equal(p.automaton.accepting[q], letters.any(axis=0)) for p, q in zip((one, other), reached))


def test_shapes_are_deep_within_reason() -> None:
    table: dict[str, Any] = DISC
    for _ in range(100):
        table = {"complement": table}
    with pytest.raises(ValueError, match="lists and tables deep"):
        cg.Proposition("robot", **table)


def test_every_word_is_tried_here() -> None:
    words = {next(iter(table)) for table, _, _ in SHAPED.values()}
    assert words == {*SHAPES}
