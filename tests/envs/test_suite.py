"""The suite problems are what their pages say: numbers, starts and, point by point, the tasks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import batch_simulator as core
from kinds import mostly_thorough
from problems import linear


def read(problem: cg.Problem, q: str, points: np.ndarray) -> list[str]:
    """Names of the automaton states after reading the letters of joint states (M, D) in state `q`."""
    automaton = problem.automaton
    dynamics = core.Dynamics.of(problem)
    states = np.full(len(points), automaton.state_names.index(q))
    letters = core.letters(dynamics, core.split_joint(dynamics, points))
    return [automaton.state_names[k] for k in automaton.next_state(states, letters)]


def package_rule(q: str, point: np.ndarray) -> str:
    """The table of the page, on coordinates (x, y) of four robots."""
    x, y = point[0::2], point[1::2]
    if q == "init":
        return "carrying" if (y >= 0).all() else "failed" if (y >= 0).any() else "init"
    lost = (x >= -10) & (x < -5) & (y >= -10) & (y < -5)
    slots = [-20, -14, -8, -2, np.inf]
    if lost.any():
        return "init"
    if (y < -15).all() and all(slots[k] <= x[k] < slots[k + 1] for k in range(4)):
        return "done"
    bands = [(-5, np.inf), (-15, -10)]
    if any(((y >= low) & (y < high)).all() for low, high in bands):
        return "carrying"
    in_row = ((y >= -10) & (y < -5)).all()
    return "carrying" if in_row and not ((x >= -10) & (x < -5)).any() else "failed"


@pytest.mark.parametrize("id", ["package-delivery-v0", "package-delivery-eased-v0"])
def test_package_delivery_follows_its_table(id: str) -> None:
    problem = cg.make_problem(id)
    rng = np.random.default_rng(0)
    n = 4000
    points = np.empty((n, 8))
    points[:, 0::2] = rng.integers(-20, 6, (n, 4)) + rng.choice([0.0, 0.5], (n, 4)) * (rng.random((n, 4)) < 0.5)
    slots = np.stack([rng.integers(low, high, n) for low, high in [(-20, -14), (-14, -8), (-8, -2), (-2, 6)]], axis=1)
    points[:, 0::2] = np.where(rng.random((n, 1)) < 0.3, slots, points[:, 0::2])
    bands = np.array([[-20, -15], [-15, -10], [-10, -5], [-5, 6], [0, 6]])[rng.integers(0, 5, n)]
    one_band = rng.integers(bands[:, :1], bands[:, 1:], (n, 4))
    points[:, 1::2] = np.where(rng.random((n, 1)) < 0.7, one_band, rng.integers(-20, 6, (n, 4)))
    points = np.minimum(points, 5.0)
    seen = set()
    for q in ("init", "carrying"):
        expected = [package_rule(q, point) for point in points]
        assert read(problem, q, points) == expected
        seen |= {(q, target) for target in expected}
    assert len(seen) == 7  # every row of the table was met
    assert set(read(problem, "done", points)) == {"done"} and set(read(problem, "failed", points)) == {"failed"}


def test_invariance_has_two_settings_and_two_states() -> None:
    problem = cg.make_problem("invariance-20-v0")
    assert problem.n_agents == 20 and problem.automaton.n_states == 2 and problem.automaton.semantics == "finite-trace"
    agents = {s: cg.make_problem("invariance-v0", setting=s).agents[0] for s in "AB"}
    values = {s: [float(m[0, 0]) for m in (linear(a).A, linear(a).B, a.noise_covariance)] for s, a in agents.items()}
    assert values == {"A": [0.9, 0.5, 0.25], "B": [1.0, 1.0, 1.0]}
    assert cg.make_problem("invariance-v0", n_agents=4).fingerprint == cg.make_problem("invariance-4-v0").fingerprint


@pytest.mark.parametrize("n_agents", [1, 2, 1000])
def test_families_of_any_size(n_agents: int) -> None:
    problem = cg.make_problem("reach-avoid-n-v0", n_agents=n_agents)
    dynamics = core.Dynamics.of(problem)
    points = np.full((3, n_agents), 4.0)
    points[1, -1] = 1.0
    points[2, 0] = -6.0
    worlds = core.initial_at(dynamics, points)
    assert worlds.accepted.tolist() == [False, True, False]
    assert problem.automaton.dead[worlds.q].tolist() == [False, False, True]


def word(problem: cg.Problem, points: np.ndarray) -> bool:
    """Whether the task is satisfied by the letters of joint points (T + 1, D), whatever the dynamics."""
    automaton = problem.automaton
    letters = core.letters(core.Dynamics.of(problem), core.split_joint(core.Dynamics.of(problem), points))
    q = np.asarray(automaton.initial)
    for t in range(len(points)):
        q = automaton.next_state(q, letters[:, t])
    return bool(automaton.accepting[q])


def within(x: np.ndarray, low: tuple[float, ...], high: tuple[float, ...]) -> bool:
    return all(a <= value < b for value, a, b in zip(x, low, high))


def until(points: np.ndarray, holds: Callable[[np.ndarray], bool], goal: Callable[[np.ndarray], bool]) -> bool:
    """Whether the goal is met at some point, and the condition at all points before."""
    for x in points:
        if goal(x):
            return True
        if not holds(x):
            return False
    return False


def meeting(points: np.ndarray) -> bool:
    def clear(x: np.ndarray) -> bool:
        return not any(within(x[k : k + 2], (-2, -2), (2, 4)) for k in (0, 2))

    def met(x: np.ndarray) -> bool:
        rooms = [((-6, 4), (-3, 7)), ((3, 4), (6, 7))]
        return any(within(x[:2], *room) and within(x[2:], *room) for room in rooms)

    def home(x: np.ndarray) -> bool:
        return within(x[:2], (-7, -7), (-4, -4)) and within(x[2:], (4, -7), (7, -4))

    return any(
        met(points[t]) and all(map(clear, points[:t])) and until(points[t:], clear, home) for t in range(len(points))
    )


def formation(points: np.ndarray) -> bool:
    robots = [slice(0, 2), slice(2, 4), slice(4, 6)]

    def safe(x: np.ndarray) -> bool:
        at_wall = [-1 <= x[r][0] < 1 for r in robots]
        in_door = [wall and -1.5 <= x[r][1] < 1.5 for wall, r in zip(at_wall, robots)]
        return at_wall == in_door and sum(in_door) <= 1

    def formed(x: np.ndarray) -> bool:
        slots = [((5, -1), (7, 1)), ((3, 1), (5, 3)), ((3, -3), (5, -1))]
        return all(within(x[r], *slot) for r, slot in zip(robots, slots))

    def ordered(ahead: slice, behind: slice) -> bool:
        return until(points, lambda x: not within(x[behind], (-1, -1.5), (1, 1.5)), lambda x: bool(x[ahead][0] >= 1))

    return until(points, safe, formed) and all(ordered(a, b) for a, b in zip(robots[:-1], robots[1:]))


def patrol(points: np.ndarray) -> bool:
    guarded = all(any(-1 <= value < 1 for value in x) for x in points)
    docked = [(points[:, 0] >= -6) & (points[:, 0] < -3), (points[:, 1] >= 3) & (points[:, 1] < 6)]
    return guarded and all(dock[t : t + 5].any() for dock in docked for t in range(len(points) - 4))


def cyclic(points: np.ndarray) -> bool:
    carrying = False
    for x in points:
        robots = x.reshape(4, 2)
        if not carrying:
            carrying = all(within(r, (-2, -2), (2, 2)) for r in robots)
        elif any(within(r, (-10, -12), (-6, 0)) for r in robots):
            carrying = False
        elif all(within(r, (-18, -4), (-14, 0)) for r in robots):
            return True
    return False


def planar(points: np.ndarray) -> bool:
    def clear(x: np.ndarray) -> bool:
        return not within(x[:2], (-2, -2), (2, 2)) and not within(x[2:], (0, 5), (2, 7))

    return until(points, clear, lambda x: within(x[:2], (3, 3), (5, 5)) and within(x[2:], (-5, -5), (-3, -3)))


def kinematic(points: np.ndarray) -> bool:
    return until(points, lambda x: not (-5 <= x[0] < 0 and x[2] < -15), lambda x: bool(x[0] >= 0))


def parking(points: np.ndarray) -> bool:
    return until(points, lambda x: not within(x, (4, 0), (11, 4)), lambda x: within(x, (4, -4), (11, 0)))


def single_delivery(points: np.ndarray) -> bool:
    def delivered(rest: np.ndarray) -> bool:
        return until(rest, lambda x: not within(x, (0, -5), (1, 1)), lambda x: within(x, (-4, -4), (-2, -3)))

    return any(within(x, (5, -1), (7, 1)) and delivered(points[t:]) for t, x in enumerate(points))


PLACES: dict[str, list[tuple[float, ...]]] = {
    "meeting-v0": [(-5, 5, -5, 5), (4, 5, 4, 5), (-5, 5, 4, 5), (-5, -5, 5, -5), (0, 0, 5, 5), (-7, 0, 7, 0)],
    "door-formation-v0": [
        (-3, 0, -5, 0, -7, 0),
        (0, 0, -5, 0, -7, 0),
        (3, 0, -2, 0, -5, 0),
        (3, 0, 0, 0, -5, 0),
        (6, 0, 4, 2, -2, 0),
        (6, 0, 4, 2, 0, 0),
        (6, 0, 4, 2, 4, -2),
        (0, 0, 0, 0, -7, 0),
        (0, 3, -5, 0, -7, 0),
    ],
    "patrol-recharge-v0": [(0, 0), (0, 4), (-4, 0), (-4, 4), (0.5, 2), (0, 3), (-6, -1)],
    "cyclic-delivery-v0": [(0,) * 8, (-16, -2) * 4, (-8, -3) * 4, (-12, 2) * 4, (1, -2) * 4, (-14.5, -0.5) * 4],
    "reach-avoid-planar-v0": [(-4, -4, 4, 4), (0, 0, 4, 4), (4, 4, 1, 6), (4, 4, -4, -4), (2, 2, 2, 7), (3, 3, -5, -5)],
    "reach-avoid-kinematic-v0": [(-10, 0, 0, 1), (-5, 1, -15, 0), (-5, 1, -16, 0), (0, 2, -20, 0), (-1, 0, -14, 3)],
    "car-park-planar-v0": [(-4, -5), (4, 0), (5, -2), (10, -4), (10, 3.9), (3.9, -1), (4, 4)],
    "package-delivery-single-v0": [(-5, -5), (5, 0), (6, 0.9), (0.5, 0), (-3, -3.5), (-2, -3), (2, 2)],
}
ORACLES = {
    "meeting-v0": meeting,
    "door-formation-v0": formation,
    "patrol-recharge-v0": patrol,
    "cyclic-delivery-v0": cyclic,
    "reach-avoid-planar-v0": planar,
    "reach-avoid-kinematic-v0": kinematic,
    "car-park-planar-v0": parking,
    "package-delivery-single-v0": single_delivery,
}


@mostly_thorough("id", ORACLES, first=2)
def test_tasks_mean_what_their_pages_tell(id: str) -> None:
    """Random words of places, half of them biased to the order of the list, against the task in plain Python."""
    problem = cg.make_problem(id)
    places = np.array(PLACES[id], dtype=float)
    rng = np.random.default_rng(0)
    verdicts = []
    for k in range(600):
        n = int(rng.integers(1, 12))
        order = np.sort(rng.integers(0, len(places), n)) if k % 2 else rng.integers(0, len(places), n)
        points = places[order]
        if k % 3 == 0:
            points = points + rng.choice([0.0, 0.0, 0.0, 0.0, 1.0, -1.0], points.shape)
        low = np.concatenate([agent.state_low for agent in problem.agents])
        high = np.concatenate([agent.state_high for agent in problem.agents])
        points = np.clip(points, low, high)
        verdicts.append(word(problem, points))
        assert verdicts[-1] == ORACLES[id](points), points
    assert 15 <= sum(verdicts) <= 585


def test_the_chain_keeps_its_known_probabilities() -> None:
    """Fixed seed, n = 100,000, false alarm 1e-6 over 2 claims (Hoeffding): within .9 % of the known values."""
    n = 100_000
    gap = np.sqrt(np.log(2.0 / (1e-6 / 2.0)) / (2.0 * n))
    for horizon, known in ((6, 0.626213), (10, 0.430846)):
        dynamics = core.Dynamics.of(cg.make_problem("decoupled-chain-v0", n_agents=1, horizon=horizon))
        rng = np.random.default_rng(horizon)
        worlds = core.initial(dynamics, rng, n)
        still = [np.ones((1, 1, n))]  # any input: B = 0
        for _ in range(horizon):
            worlds = core.transition(dynamics, worlds, still, core.noise(dynamics, rng, n))
        assert abs(core.satisfied(dynamics, worlds).mean() - known) <= gap
    assert cg.make_problem("decoupled-chain-14-v0").n_agents == 14


def test_classics_have_the_numbers_of_the_literature() -> None:
    zones = cg.make_problem("building-automation-v0").agents
    whole = np.zeros((4, 4))
    for k, zone in enumerate(zones):
        whole[np.ix_([k, k + 2], [k, k + 2])] = linear(zone).A
    assert whole.tolist() == [
        [0.6682, 0, 0.02632, 0],
        [0, 0.683, 0, 0.02096],
        [1.0005, 0, -0.000499, 0],
        [0, 0.8004, 0, 0.1996],
    ]
    assert [linear(zone).offset.tolist() for zone in zones] == [[3.3378, 13.0207], [2.9272, 10.4166]]
    chain = linear(cg.make_problem("integrator-chain-v0", dimension=3).agents[0])
    assert np.allclose(chain.A, np.array([[1, 0.1, 0.005], [0, 1, 0.1], [0, 0, 1]])) and chain.n_inputs == 1
    assert np.allclose(chain.B[:, 0], np.array([0.1**3 / 6, 0.005, 0.1]))
    assert cg.make_problem("car-park-v0").agents[0].noise_covariance.tolist() == [[1.0]]
    sizes = {
        id: cg.make_problem(id).n_agents for id in ("reach-avoid-20-v0", "invariance-b-20-v0", "invariance-b-100-v0")
    }
    assert sizes == {"reach-avoid-20-v0": 20, "invariance-b-20-v0": 20, "invariance-b-100-v0": 100}
    assert linear(cg.make_problem("invariance-b-20-v0").agents[0]).A.tolist() == [[1.0]]


def test_the_kinematic_delivery_follows_the_table_on_positions() -> None:
    problem = cg.make_problem("package-delivery-kinematic-v0")
    assert problem.n_states == 16 and problem.automaton.state_names[problem.initial_q or 0] == "carrying"
    plain = cg.make_problem("package-delivery-v0")
    rng = np.random.default_rng(5)
    positions = rng.integers(-20, 6, (3000, 8)).astype(float)
    positions[:1000, 1::2] = rng.integers(0, 6, (1000, 4))
    joint = np.empty((3000, 16))
    joint[:, 0::2], joint[:, 1::2] = positions, rng.uniform(-5, 5, (3000, 8))
    for q in ("init", "carrying"):
        assert read(problem, q, joint) == read(plain, q, positions)


def test_rooms_exchange_warmth_with_their_neighbours() -> None:
    """One step without noise, by hand; every number of rooms is one block."""
    for n in (3, 8, 100):
        problem = cg.make_problem("room-network-v0", n_agents=n, disturbance_scale=0.0)
        dynamics = core.Dynamics.of(problem)
        assert [len(block.agents) for block in dynamics.blocks] == [n]
        x = np.linspace(19.0, 22.0, n)
        worlds = core.initial_at(dynamics, x[None])
        after = core.transition(dynamics, worlds, [np.full((1, n, 1), 0.7)], [np.zeros((1, n, 1))])
        expected = x + 0.05 * (np.roll(x, 1) + np.roll(x, -1) - 2 * x) + 0.05 * (5 - x) + 0.7
        np.testing.assert_allclose(after.states[0][0, :, 0], expected, rtol=1e-13)


def test_vehicles_are_pulled_by_the_one_ahead() -> None:
    problem = cg.make_problem("platoon-v0", n_agents=4, disturbance_scale=0.0)
    dynamics = core.Dynamics.of(problem)
    start = np.array([[1.0, 0.5, 0.0, -0.5, 0.2, 0.0, -1.0, 1.0]])
    worlds = core.initial_at(dynamics, start)
    inputs = [np.full((1, len(block.agents), 1), 0.25) for block in dynamics.blocks]
    still = [np.zeros((2, len(block.agents), 1)) for block in dynamics.blocks]
    after = core.joint(dynamics, core.transition(dynamics, worlds, inputs, still))[0].reshape(4, 2)
    place, speed = start.reshape(4, 2).T
    pull = 0.1 * (place[:-1] - place[1:]) + 0.1 * (speed[:-1] - speed[1:])
    np.testing.assert_allclose(after[:, 0], place + 0.5 * speed, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(after[:, 1], speed + np.append(0.0, pull) + 0.25, rtol=1e-13, atol=1e-13)
