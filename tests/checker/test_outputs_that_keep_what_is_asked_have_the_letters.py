"""Outputs that keep what letters ask for have these letters: regions, pairs, windows that are crossed, and angles.

Outputs are random points, many of them on or next to limits; propositions are decided by their definition. Whatever
keeps all that is asked at a time has the letters of the time; whatever keeps what is asked in a window meets the region
in it; an angle that keeps what is asked of its number has the letter in its turn.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from certificate_files import file_of, one_crane
from certigym.synthesis.checker import affine_dynamics, check_contents, parse_file, read_problem
from certigym.synthesis.checker.angles import check_angles, of_copies
from certigym.synthesis.checker.fields import Refused, Unreadable
from certigym.synthesis.checker.letters import SOMETIME, Demand, crossed, demands, jumps, known_at, known_at_start
from certigym.synthesis.checker.problem import TURN, Problem
from certigym.synthesis.checker.steps import _Reads

T = 5
ACCEPTS = {"initial": 0, "accepting": [True], "root": [-1], "variable": [], "low": [], "high": []}


def agent(name: str, states: list[str], **more: Any) -> dict[str, Any]:
    d = len(states)
    own = {
        "name": name, "states": states, "inputs": ["u"], "dynamics": [*states], "outputs": [*states],
        "state_low": [-9.0] * d, "state_high": [9.0] * d, "input_low": [-1.0], "input_high": [1.0],
        "start_low": [0.0] * d, "start_high": [0.0] * d, "noise": [[0.1]] * d,
    }  # fmt: skip
    return {**own, **more}


def problem_of(agents: list[Any], regions: list[Any] = (), pairs: list[Any] = ()) -> Problem:  # type: ignore[assignment]
    task = {"semantics": "co-safe", "automaton": ACCEPTS}
    data = {"horizon": T, "agents": agents, "regions": [*regions], "pairs": [*pairs], "task": task}
    return read_problem({"problem": data})


def keeps(demand: Demand, outputs: list[np.ndarray], strictly: bool = False) -> np.ndarray:
    """Which points keep a demand, computed with long numbers; outputs are (p, n) for each agent."""
    total = sum(np.longdouble(f) * outputs[i][k] for i, k, f in demand.parts)
    return np.asarray(((demand.low < total) | ((demand.low == total) & (not strictly))) & (total < demand.high))


def points(rng: np.random.Generator, limits: list[float], count: int, n: int) -> np.ndarray:
    """Points (count, n), many of them on or next to limits."""
    special = np.array([*limits, *np.nextafter(limits, -np.inf), *np.nextafter(limits, np.inf)])
    anywhere = rng.uniform(-3.0, 3.0, (count, n))
    return np.where(rng.random((count, n)) < 0.4, rng.choice(special, (count, n)), anywhere)


def test_regions_hold_and_do_not_hold_as_their_letters_say() -> None:
    rng, seen = np.random.default_rng(0), 0
    for _ in range(150):
        low = [None if rng.random() < 0.3 else float(rng.integers(-2, 2)) for _ in range(2)]
        high = [None if rng.random() < 0.3 else float(rng.integers(-1, 3)) for _ in range(2)]
        moved = [[b if b is None else b + t for b in high] for t in range(T + 1)]
        region = {"name": "r", "agent": 0, "low": low, "high": moved}
        problem = problem_of([agent("a", ["x", "y"])], [region])
        t = int(rng.integers(1, T + 1))
        y = points(rng, [-2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0], 2, 400)
        ends = [(-math.inf if a is None else a, math.inf if b is None else b) for a, b in zip(low, moved[t])]
        holds = np.all([(a <= own) & (own < b) for own, (a, b) in zip(y, ends, strict=True)], axis=0)
        for value, face in [(1, -1), *((-1, face) for face in range(-1, 6))]:
            letters, faces = np.zeros((T + 1, 1), np.int64), np.full((T + 1, 1), -1)
            letters[t], faces[t] = value, face
            try:
                asked = demands(problem, letters, faces, np.zeros((T + 1, 0)), t)
            except Refused:
                k, above = divmod(face, 2)
                assert not 0 <= k < 2 or not math.isfinite(ends[k][above])
                continue
            kept = np.all([keeps(demand, [y]) for demand in asked], axis=0) if asked else np.ones(400, dtype=bool)
            assert np.all(holds[kept] == (value > 0)), (low, moved[t], value, face)
            seen += int(kept.sum())
            assert value < 0 or np.array_equal(kept, holds)
    assert seen > 20_000


def test_pairs_hold_and_do_not_hold_as_their_letters_say() -> None:
    """Boxes, discs and balls of differences, in one to three dimensions, for any normal; radius 0 holds nowhere."""
    rng, seen = np.random.default_rng(1), {1: 0, -1: 0}
    for _ in range(250):
        count = int(rng.integers(1, 4))
        states = ["x", "y", "z"]
        axes = [rng.permutation(3)[:count].tolist() for _ in range(2)]
        pair: dict[str, Any] = {"name": "p", "agents": [1, 0], "outputs": axes}
        if rng.random() < 0.6:
            pair["radius"] = float(rng.choice((0.0, -1.0, 0.5, 1.0, 2.0)))
        else:
            pair["low"] = [None if rng.random() < 0.2 else float(rng.integers(-2, 1)) for _ in range(count)]
            pair["high"] = [None if rng.random() < 0.2 else float(rng.integers(-1, 3)) for _ in range(count)]
        problem = problem_of([agent("a", states), agent("b", states)], [], [pair])
        outputs = [points(rng, [-1.0, 0.0, 1.0], 3, 500) for _ in range(2)]
        if rng.random() < 0.5:  # near the face of a ball
            turned = rng.normal(size=(count, 500))
            turned *= (
                abs(pair.get("radius", 1.0)) / np.sqrt((turned**2).sum(axis=0)) * rng.choice([0.93, 1.0, 1.0001], 500)
            )
            outputs[1][axes[0]] = outputs[0][axes[1]] + turned
        z = [outputs[1][a].astype(np.longdouble) - outputs[0][b] for a, b in zip(*axes, strict=True)]
        if "radius" in pair:
            holds = (sum(own * own for own in z) < np.longdouble(pair["radius"]) ** 2) & (pair["radius"] > 0)
        else:
            ends = [
                (-math.inf if a is None else a, math.inf if b is None else b) for a, b in zip(pair["low"], pair["high"])
            ]
            holds = np.all([(a <= own) & (own < b) for own, (a, b) in zip(z, ends, strict=True)], axis=0)
        normal = rng.normal(size=count) if rng.random() < 0.7 else np.eye(count)[0] * rng.choice((-1.0, 1.0))
        if rng.random() < 0.1:
            normal = np.zeros(count)
        normals = np.tile(normal, (T + 1, 1))
        for value in (1, -1):
            letters = np.full((T + 1, 1), value)
            try:
                asked = demands(problem, letters, np.full((T + 1, 1), -1), normals, 2)
            except Refused:
                assert value < 0
                continue
            # a face itself is in the pair, and numbers without noise have to be off a limit
            kept = np.all([keeps(demand, outputs, value < 0) for demand in asked], axis=0) if asked else ~holds | True
            assert np.all(holds[kept] == (value > 0)), (pair, normal, value)
            seen[value] += int(kept.sum())
    assert min(seen.values()) > 2000


def test_every_pair_has_its_own_directions() -> None:
    """Directions stand pair by pair, in as many columns as outputs are compared."""
    agents = [agent("a", ["x", "y"]), agent("b", ["x", "y"])]
    pairs = [
        {"name": "p", "agents": [0, 1], "outputs": [[0, 1], [0, 1]], "radius": 1.0},
        {"name": "q", "agents": [0, 1], "outputs": [[1], [1]], "radius": 2.0},
    ]
    normals = np.tile([3.0, 4.0, -2.0], (T + 1, 1))
    letters = np.full((T + 1, 2), -1)
    first, second = demands(problem_of(agents, [], pairs), letters, np.full((T + 1, 2), -1), normals, 1)
    assert [f for _, _, f in first.parts] == [3.0, 4.0, -3.0, -4.0] and 5.0 <= first.low <= 5.0 + 1e-12
    assert second.parts == ((0, 1, -2.0), (1, 1, 2.0)) and 4.0 <= second.low <= 4.0 + 1e-12


def test_states_of_neighbours_are_read_where_they_stand() -> None:
    """Each state that is named has its own column of the joint error, in whatever order an expression names them."""
    moved = ["x + 0.1*b.w + 0.2*b.v", "y + b.w"]
    agents = [agent("a", ["x", "y"], dynamics=moved), agent("b", ["u_", "v", "w"], dynamics=["u_", "v", "w"])]
    reads = _Reads.of(problem_of(agents, []), 0, [np.arange(2), np.arange(2, 5)])
    named = {"x": 0, "y": 1, "b.v": 3, "b.w": 4}
    assert {name: reads.columns[reads.places[name]] for name in named} == named


def test_regions_of_other_agents_say_nothing_of_one() -> None:
    """That a region of one agent holds excludes those of this agent alone."""
    regions = [{"name": f"r{i}", "agent": i % 2, "low": [float(i)], "high": [i + 1.0]} for i in range(3)]
    problem = problem_of([agent("a", ["x"]), agent("b", ["x"])], regions)
    letters = np.zeros((T + 1, 3), np.int64)
    letters[1, 0] = 1
    assert known_at(problem, letters[1], 1) == {0: True, 2: False}


def test_a_window_that_is_crossed_is_met_at_some_time() -> None:
    """Random runs of two outputs through a region that moves: those that keep the demands and the jumps meet it."""
    rng, seen = np.random.default_rng(2), 0
    for _ in range(400):
        low = np.cumsum(rng.choice([-0.5, 0.0, 0.5], (T + 1, 2)), axis=0) + rng.normal(size=2)
        high = low + rng.uniform(0.3, 2.0, (1, 2)) + rng.choice([0.0, 0.3], (T + 1, 2))
        region = {"name": "r", "agent": 0, "low": low.tolist(), "high": high.tolist()}
        if rng.random() < 0.2:
            region["high"] = [[None, b] for b in high[:, 1].tolist()]
            high[:, 0] = np.inf
        problem = problem_of([agent("a", ["x", "y"])], [region])
        first = int(rng.integers(1, T))
        last = int(rng.integers(first, T + 1))
        letters, faces = np.zeros((T + 1, 1), np.int64), np.full((T + 1, 1), -1)
        letters[first : last + 1] = SOMETIME
        face = int(rng.integers(0, 4 if np.isfinite(high).all() else 1))
        faces[first : last + 1] = face
        n, (k, above) = 4000, divmod(face, 2)
        y = np.empty((T + 1, 2, n))
        start = high[first, k] + 1.0 if above else low[first, k] - 1.0
        steps = rng.uniform(-0.2, 1.5, (T + 1, n)) * (-1.0 if above else 1.0)
        y[:, k] = start + rng.uniform(-1.0, 1.0, n) + np.cumsum(steps, axis=0) * (np.arange(T + 1) >= first)[:, None]
        j = 1 - k
        width = np.minimum(high[:, j], low[:, j] + 3.0) - low[:, j]
        y[:, j] = low[:, j, None] + width[:, None] * rng.uniform(-0.03, 1.03, (T + 1, n))
        kept = np.ones(n, dtype=bool)
        for t in range(1, T + 1):
            for demand in crossed(problem, letters, faces, t):
                kept &= keeps(demand, [y[t]])
            for jump in jumps(problem, letters, faces, t):
                moved = y[t, k].astype(np.longdouble) - y[t - 1, k]
                kept &= (jump.low < moved) & (moved < jump.high)
        times = slice(first, last + 1)
        inside = np.all((low[times, :, None] <= y[times]) & (y[times] < high[times, :, None]), axis=1)
        assert np.any(inside, axis=0)[kept].all(), (face, first, last)
        seen += int(kept.sum())
    assert seen > 5000


def test_a_window_asks_no_more_than_it_needs() -> None:
    """Of a run that comes through a face, the far limit counts at first, the near one at last, no other between."""
    problem = problem_of([agent("a", ["x"])], [{"name": "r", "agent": 0, "low": [1.0], "high": [2.0]}])
    letters, faces = np.zeros((T + 1, 1), np.int64), np.zeros((T + 1, 1), np.int64)
    letters[2:5] = SOMETIME
    ends = [[(d.low, d.high) for d in crossed(problem, letters, faces, t)] for t in range(1, T + 1)]
    inf = math.inf
    assert ends == [[], [(-inf, 2.0)], [(-inf, inf)], [(1.0, inf)], []]
    assert [len(jumps(problem, letters, faces, t)) for t in range(1, T + 1)] == [0, 0, 1, 1, 0]
    assert [(d.low, d.high) for d in crossed(problem, letters, faces + 1, 2)] == [(1.0, inf)]
    assert [(d.low, d.high) for d in crossed(problem, letters, faces + 1, 4)] == [(-inf, 2.0)]
    faces[4] = 1  # another side is another window
    assert jumps(problem, letters, faces, 4) == []
    for face in (-1, 2, 7):
        with pytest.raises(Refused):
            crossed(problem, letters, faces * 0 + face, 3)


# The letter of time 0.


def test_letters_of_the_start_hold_on_all_of_its_box() -> None:
    """Known letters against corners, faces and inner points of boxes of starts, in rational numbers."""
    rng, known_ones = np.random.default_rng(3), 0
    for _ in range(250):
        boxes = []
        for _agent in range(2):
            low = rng.choice([-1.0, 0.0, 0.5, 1.0], 2) + rng.choice([0.0, 0.1, -1e-17])
            boxes.append((low, low + rng.choice([0.0, 0.25, 1.0], 2)))
        agents = [
            agent(name, ["x", "y"], start_low=low.tolist(), start_high=high.tolist(), outputs=["x", "y", "x + y"])
            for name, (low, high) in zip("ab", boxes, strict=True)
        ]
        limits = [float(rng.choice((-1.0, 0.0, 0.5, 1.0, 1.5, 2.0))) for _ in range(3)]
        region = {
            "name": "r",
            "agent": int(rng.integers(2)),
            "low": [limits[0], None, None],
            "high": [limits[1], None, 2.0],
        }
        radius = float(rng.choice((0.0, 0.5, 1.0, math.sqrt(2.0), 3.0)))
        pairs = [
            {"name": "p", "agents": [0, 1], "outputs": [[0, 1], [0, 1]], "radius": radius},
            {"name": "q", "agents": [1, 0], "outputs": [[1], [0]], "low": [limits[2] - 2.0], "high": [limits[0]]},
        ]
        known = known_at_start(problem_of(agents, [region], pairs))
        share = np.concatenate([rng.random((60, 4)), np.rint(rng.random((40, 4)))])
        for row in share:
            x = [
                [Fraction(a) + Fraction(float(s)) * (Fraction(b) - Fraction(a)) for a, b, s in zip(*box, part)]
                for box, part in zip(boxes, (row[:2], row[2:]), strict=True)
            ]
            own = x[int(str(region["agent"]))]
            letter = {0: limits[0] <= own[0] < limits[1] and own[0] + own[1] < 2}
            z = [a - b for a, b in zip(*x, strict=True)]
            letter[1] = z[0] ** 2 + z[1] ** 2 < Fraction(radius) ** 2
            letter[2] = limits[2] - 2.0 <= x[1][1] - x[0][0] < limits[0]
            assert all(letter[p] == holds for p, holds in known.items()), (known, letter, row)
        known_ones += len(known)
    assert known_ones > 200


def test_of_outputs_that_are_unbounded_or_not_defined_at_the_start_nothing_is_known() -> None:
    region = {"name": "r", "agent": 0, "low": [0.0, None], "high": [None, 1.0]}
    for output in ("exp(1e5 + x)", "log(x - 5)"):
        agents = [agent("a", ["x", "y"], outputs=[output, "y"]), agent("b", ["x", "y"])]
        pairs = [{"name": "p", "agents": [0, 1], "outputs": [[0], [0]], "radius": 1.0}]
        with np.errstate(all="ignore"):
            assert known_at_start(problem_of(agents, [region], pairs)) == {}


# Angles.


def turning(first: float, **more: Any) -> dict[str, Any]:
    return agent(
        "a", ["a", "y"], angles=["a"], state_low=[first, -9.0], state_high=[first + TURN - 1e-14, 9.0],
        start_low=[first + 1.0, 0.0], start_high=[first + 1.0, 0.0], **more,
    )  # fmt: skip


def test_angles_that_keep_what_is_asked_have_the_letters_in_their_turn() -> None:
    rng, seen = np.random.default_rng(4), {1: 0, -1: 0}
    for _ in range(300):
        first = float(rng.choice((-math.pi, 0.0, -1.0)))
        low, high = (None if rng.random() < 0.15 else float(rng.uniform(-4.0, 7.0)) for _ in range(2))
        region = {"name": "r", "agent": 0, "low": [low, None], "high": [high, None]}
        problem = problem_of([turning(first)], [region])
        value, face = (1, -1) if rng.random() < 0.5 else (-1, int(rng.integers(2)))
        letters, faces = np.full((T + 1, 1), value), np.full((T + 1, 1), face)
        try:
            asked = demands(problem, letters, faces, np.zeros((T + 1, 0)), 1)
        except Refused:
            continue
        nominal = float(rng.uniform(-20.0, 20.0))
        X = nominal + rng.uniform(-3.14, 3.14, 500)
        kept = np.ones(500, dtype=bool)
        for demand in asked:
            kept &= keeps(of_copies(problem, demand, np.array([nominal, 0.0])), [np.stack([X, X])])
        wrapped = first + np.mod(X.astype(np.longdouble) - first, 2 * np.longdouble("3.14159265358979323846"))
        holds = (wrapped >= (-math.inf if low is None else low)) & (wrapped < (math.inf if high is None else high))
        assert np.all(holds[kept] == (value > 0)), (low, high, value, nominal)
        seen[value] += int(kept.sum())
    assert min(seen.values()) > 4000


def test_demands_of_other_outputs_are_left_as_they_are() -> None:
    problem = problem_of([turning(0.0)])
    demand = Demand(((0, 1, 1.0),), 1.0, 2.0, "of y")
    assert of_copies(problem, demand, np.array([100.0, 0.0])) == demand


@pytest.mark.parametrize(
    "more",
    [
        {"dynamics": ["0.5*a", "y"]}, {"dynamics": ["a", "y + a"]}, {"dynamics": ["a", "y + sin(0.5*a)"]},
        {"dynamics": ["a*a", "y"]}, {"dynamics": ["a", "y + max(a, 0)"]}, {"dynamics": ["a", "abs(a)"]},
        {"dynamics": ["a + sin(a)*a", "y"]}, {"dynamics": ["a", "y + a**2"]}, {"dynamics": ["a + y*a", "y"]},
        {"outputs": ["a", "2*a"]}, {"outputs": ["a + y"]}, {"outputs": ["sin(a/2)"]},
        {"noise": [[0.1, 0.0], [0.0, 0.1]], "noise_scale": ["1", "a"]},
        {"noise": [[0.1, 0.0], [0.0, 0.1]], "noise_scale": ["1", "1+0.1*a"]},
    ],
)  # fmt: skip
def test_what_is_not_the_same_a_turn_further_on_is_refused(more: dict[str, Any]) -> None:
    with pytest.raises(Refused):
        check_angles(problem_of([turning(0.0, **more)]))


@pytest.mark.parametrize(
    "more",
    [
        {"dynamics": ["a + u", "y + sin(3*a) - cos(a) + tan(0.5*a)"]}, {"dynamics": ["3*a - y", "0.5*y"]},
        {"outputs": ["a", "cos(a)", "y*sin(2*a + y)"]}, {"dynamics": ["-a", "max(sin(a), y)"]},
        {"noise": [[0.1, 0.0], [0.0, 0.1]], "noise_scale": ["1", "2+sin(a)"]},
    ],
)  # fmt: skip
def test_what_repeats_with_a_turn_is_allowed(more: dict[str, Any]) -> None:
    check_angles(problem_of([turning(0.0, **more)]))


def test_angles_of_neighbours_and_in_pairs_are_refused() -> None:
    two = [turning(0.0), agent("b", ["x"], dynamics=["x + 0.1*a.a"])]
    with pytest.raises(Refused, match="another agent"):
        check_angles(problem_of(two))
    check_angles(problem_of([turning(0.0), agent("b", ["x"], dynamics=["x + 0.1*sin(a.a)"])]))
    pair = {"name": "p", "agents": [0, 1], "outputs": [[0], [0]], "low": [0.0], "high": [1.0]}
    with pytest.raises(Refused, match="pair"):
        check_angles(problem_of([turning(0.0), agent("b", ["x"])], [], [pair]))
    for wrong in ({"state_high": [TURN + 1e-12, 9.0]}, {"state_high": [3.0, 9.0]}, {"angles": ["z"]}):
        with pytest.raises(Unreadable):
            problem_of([turning(0.0) | wrong])


def test_nominal_angles_of_very_many_turns_are_refused() -> None:
    """Where a copy is would be off by more than is charged."""
    problem = problem_of([turning(0.0)], [{"name": "r", "agent": 0, "low": [1.0, None], "high": [2.0, None]}])
    demand = Demand(((0, 0, 1.0),), 1.0, 2.0, "r")
    of_copies(problem, demand, np.array([150.0, 0.0]))
    with pytest.raises(Refused):
        of_copies(problem, demand, np.array([1e6, 0.0]))


def test_a_trajectory_that_may_turn_half_around_is_refused() -> None:
    header, arrays = one_crane()
    wide = [own.copy() for own in arrays]
    wide[6][:, 0] = 3.3
    assert "half a turn" in check_contents(parse_file(file_of(header, wide))).reason
    header["problem"]["agents"][0]["noise_scale"] = ["1", "1 + a"]
    assert "not the same a turn" in check_contents(parse_file(file_of(header, arrays))).reason


# What is affine.


BENT = (
    "max(x, -1) + u", "abs(x + 1) + u", "x + u + x*u*v", "x + u + x*u*(x*v)", "x*u", "x/u", "sin(x)", "x + u + x**3",
    "x**1", "x + 0.1*u/3*v", "x + t", "clip(x, -9, 9) + u",
)  # fmt: skip


@pytest.mark.parametrize("text", BENT)
def test_targets_need_means_that_are_affine_everywhere(text: str) -> None:
    own = agent("a", ["x"], inputs=["u", "v"], input_low=[0.0] * 2, input_high=[0.0] * 2, dynamics=[text])
    with pytest.raises(Refused):
        affine_dynamics(problem_of([own]).agents[0])


def test_affine_means_have_their_matrices() -> None:
    text = ["2*x - y + 0.25*u + 1.5", "-y + x - u*0.5"]
    A, B, b = affine_dynamics(problem_of([agent("a", ["x", "y"], dynamics=text)]).agents[0])
    assert A.tolist() == [[2.0, -1.0], [1.0, -1.0]] and B.tolist() == [[0.25], [-0.5]] and b.tolist() == [1.5, 0.0]
