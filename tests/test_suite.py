"""The suite problems are what their pages say: numbers, starts and, point by point, the tasks."""

from __future__ import annotations

import numpy as np
import pytest

import certigym as cg
from certigym.envs import dynamics as core


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


def test_package_delivery_begins_as_published() -> None:
    problem = cg.make_problem("package-delivery-v0")
    assert problem.horizon == 20 and problem.automaton.semantics == "co-safe"
    assert problem.automaton.state_names[problem.initial_q or 0] == "carrying"
    third = [-18.0875, -7.2875, -16.8625, -7.2875, -13.5375, -7.2875, -11.8625, -7.2875]
    assert problem.automaton.state_names[problem.replace(initial_state=third).initial_q or 0] == "init"
    assert problem.agents[0].noise_covariance.tolist() == [[0.25]]
    assert cg.make_problem("package-delivery-eased-v0").agents[7].noise_covariance.tolist() == [[0.01]]


def test_invariance_has_two_settings_and_two_states() -> None:
    problem = cg.make_problem("invariance-20-v0")
    assert problem.n_agents == 20 and problem.automaton.n_states == 2 and problem.automaton.semantics == "finite-trace"
    agents = {s: cg.make_problem("invariance-v0", setting=s).agents[0] for s in "AB"}
    values = {s: [float(m[0, 0]) for m in (a.A, a.B, a.noise_covariance)] for s, a in agents.items()}
    assert values == {"A": [0.9, 0.5, 0.25], "B": [1.0, 1.0, 1.0]}
    assert cg.make_problem("invariance-v0", n_agents=4).fingerprint == cg.make_problem("invariance-4-v0").fingerprint


def test_reach_avoid_accepts_what_its_formula_says() -> None:
    problem = cg.make_problem("reach-avoid-v0")
    assert problem.automaton.n_states == 3 and problem.horizon == 7
    dynamics = core.Dynamics.of(problem)
    for point, verdict in (
        ([0.0, -20.0], "accepted"),
        ([-5.0, -15.0], "open"),
        ([-5.0, -15.5], "dead"),
        ([-5.5, -20.0], "open"),
    ):
        worlds = core.initial_at(dynamics, np.array([point]))
        dead = bool(problem.automaton.dead[worlds.q[0]])
        assert ("accepted" if worlds.accepted[0] else "dead" if dead else "open") == verdict


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
