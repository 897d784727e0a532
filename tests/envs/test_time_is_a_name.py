"""The time as a name in dynamics, noise and regions: every simulator, letters, files, pictures mean the same."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import Dynamics, SingleSimulator, split_joint
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.tasks.problem import states_in_time, unrolled_in_time
from certigym.envs.tasks.regions import Labeling
from timed_problems import band, follow, robot, still


def written(horizon: int = 12) -> cg.Problem:
    """Two agents with drifts, noises and regions that change, and a linear one."""
    first = robot("first", noise_scale=["0.5 + 0.2*cos(t)"])
    return cg.Problem(
        name="written", horizon=horizon, agents=[first, robot("second", dynamics=["0.9*x + u*cos(t)"]), still("third")],
        propositions={
            "a": cg.Proposition("first", ["sin(t) - 1"], ["sin(t) + 1"]),
            "b": cg.Proposition("second", [-1], ["0.1*t"]),
            "c": cg.Proposition("third", [-2], [2]),
        },
        specification=cg.Specification("G (a | b | c)", "finite-trace"),
    )  # fmt: skip


def by_hand(x: np.ndarray, u: np.ndarray, z: np.ndarray, t: int) -> np.ndarray:
    """One step of the three agents, written out."""
    return np.array([
        x[0] + u[0] + 0.4 * math.sin(0.9 * t) + (0.5 + 0.2 * math.cos(t)) * 0.3 * z[0],
        0.9 * x[1] + u[1] * math.cos(t) + 0.3 * z[1],
        x[2] + u[2] + 0.3 * z[2],
    ])  # fmt: skip


def letter_by_hand(x: np.ndarray, t: int) -> list[bool]:
    return [math.sin(t) - 1 <= x[0] < math.sin(t) + 1, -1 <= x[1] < 0.1 * t, -2 <= x[2] < 2]


def test_batches_and_single_worlds_move_and_read_letters_as_it_is_written() -> None:
    problem, rng, count = written(), np.random.default_rng(0), 50
    dynamics = Dynamics.of(problem)
    states = rng.uniform(-1, 1, (count, 3))
    worlds = core.initial_at(dynamics, states)
    single = SingleSimulator.of(dynamics)
    ones = [single.begin(core.initial_at(dynamics, states[k : k + 1])) for k in range(5)]
    for t in range(problem.horizon):
        u, normals = rng.uniform(-1, 1, (3, count)), core.noise(dynamics, rng, count)
        z = np.concatenate([each.reshape(-1, count) for each in normals])
        inputs = tuple(u[block.agents][None] for block in dynamics.blocks)
        worlds = core.transition(dynamics, worlds, inputs, normals)
        wanted = by_hand(states.T, u, z, t).T
        states = core.joint(dynamics, worlds)
        assert np.allclose(states, wanted, rtol=0.0, atol=1e-12)
        holds = core.letters(dynamics, worlds.states, worlds.time)
        for k in range(count):
            assert holds[:, k].tolist() == letter_by_hand(states[k], t + 1)
        for k, world in enumerate(ones):
            ones[k] = single.step(world, u[:, k : k + 1].tolist(), z[:, k].tolist())
            assert np.array_equal(np.concatenate(ones[k].states), states[k])  # bit by bit
            assert (ones[k].q, ones[k].failed) == (int(worlds.q[k]), bool(worlds.failed[k]))


def test_worlds_at_times_of_their_own_read_regions_and_dynamics_of_these() -> None:
    problem, rng, count = written(), np.random.default_rng(1), 40
    dynamics = Dynamics.of(problem)
    states, times = rng.uniform(-1, 1, (count, 3)), rng.integers(0, problem.horizon, count)
    inputs = tuple(np.full((1, len(b.agents), count), 0.3) for b in dynamics.blocks)
    normals = core.noise(dynamics, rng, count)
    from dataclasses import replace

    mixed = core.transition(dynamics, replace(core.initial_at(dynamics, states), time=times), inputs, normals)
    for k in range(count):
        one = replace(core.initial_at(dynamics, states[k : k + 1]), time=int(times[k]))
        alone = core.transition(dynamics, one, [u[..., :1] for u in inputs], [z[..., k : k + 1] for z in normals])
        assert np.array_equal(core.joint(dynamics, mixed)[k], core.joint(dynamics, alone)[0])
        letters = core.letters(dynamics, mixed.states, mixed.time)[:, k]
        assert np.array_equal(letters, core.letters(dynamics, alone.states, alone.time)[:, 0])


@pytest.mark.parametrize("device", ["torch:cpu", "jax:cpu"])
def test_worlds_on_devices_mean_the_same(device: str) -> None:
    from certigym.envs.systems.backends import device_put, to_host

    pytest.importorskip(device.split(":")[0])
    problem, rng, count = written(), np.random.default_rng(2), 30
    put = device_put(device, ("torch", "jax"))
    host, there = Dynamics.of(problem), Dynamics.of(problem, put=put)
    states = rng.uniform(-1, 1, (count, 3))
    here = core.initial_at(host, states)
    away = core.begin(there, tuple(put(x) for x in split_joint(host, states)))
    for _ in range(5):
        normals = core.noise(host, rng, count)
        inputs = [np.full((1, len(b.agents), count), 0.2) for b in host.blocks]
        here = core.transition(host, here, inputs, normals)
        away = core.moved_on(there, away, [put(u) for u in inputs], [put(z) for z in normals])
        for x, y in zip(here.states, away.states):
            assert np.allclose(x, to_host(y), rtol=0.0, atol=1e-12)
        assert np.array_equal(here.q, to_host(away.q))


def test_the_letter_of_the_start_is_that_of_time_zero() -> None:
    region = cg.Proposition("robot", ["1 - 2*t"], [3])  # 0.2 is not in it at time 0, and is later
    problem = follow(robot(), region, formula="F band")
    assert not problem.labeling.at(0).letter([np.array([0.2])])[0]
    assert problem.labeling.at(1).letter([np.array([0.2])])[0]
    assert problem.initial_q == problem.automaton.initial
    assert problem.replace(initial_state=[1.5]).initial_q != problem.automaton.initial


def test_corners_over_all_times_are_those_of_each_time() -> None:
    region = cg.Proposition("robot", ["2*sin(0.37*t)*exp(-t/9) - 0.1"], ["2 + tanh(t)"])
    low, high = region.over(np.arange(200.0))
    for t in range(200):
        assert np.array_equal(low[:, t], region.at(t).low) and np.array_equal(high[:, t], region.at(t).high)


def test_regions_may_be_empty_and_pass_beyond_the_workspace() -> None:
    region = cg.Proposition("robot", ["3 + t"], ["4 + 2*t - 3*max(0, t - 1)"])  # [3, 4], [4, 6), then nothing
    problem = follow(robot(), region, formula="F band")
    at = [problem.labeling.at(t).class_at(0, np.array([[3.0, 3.5, 4.0]]))[0].tolist() for t in range(3)]
    assert at == [[True, True, True], [False, False, False], [False, False, False]]
    # Classes and letters agree wherever the region is.
    for t in range(6):
        labeling, x = problem.labeling.at(t), np.linspace(-4, 4, 33)[None]
        classes, points = labeling.classes[0], labeling.class_at(0, x).T
        boxes = labeling.box_classes(0, x.T, x.T)
        for point, possible in zip(points, boxes, strict=True):
            assert possible[[row.tolist() == point.tolist() for row in classes].index(True)]


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (["x"], [1], "low"),
        (["1/(t - 3)"], [5], "finite corners at every time"),
        (["20 + t"], ["30 + t"], "meets the workspace"),
    ],
)
def test_mistakes_in_regions_are_told(low: Any, high: Any, words: str) -> None:
    with pytest.raises(ValueError, match="(?s)" + words.replace("(", "[(]")):
        follow(robot(), cg.Proposition("robot", low, high))


def test_expressions_of_numbers_alone_are_numbers() -> None:
    region = cg.Proposition("robot", ["-pi"], ["2*pi"])
    assert not region.moves and region.high[0] == 2 * math.pi
    assert not follow(robot(dynamics=["x + u"]), region).names_time


def test_what_is_declared_hides_the_time() -> None:
    agent = robot(states=["t"], dynamics=["t + u"])
    assert not agent.names_time and agent.at(3) is agent
    number = robot(parameters={"t": 0.5})
    assert not number.names_time
    assert robot().at(2).mean(np.zeros((1, 1)), np.zeros((1, 1)))[0, 0] == pytest.approx(0.4 * math.sin(1.8))


def test_agents_of_different_steps_are_different() -> None:
    keys = {robot().at(t).model_key for t in range(5)} | {robot().model_key, robot().with_clock(5).model_key}
    assert len(keys) == 7


def test_nothing_passes_the_time_over() -> None:
    agent, problem = robot(), follow(robot())
    with pytest.raises(ValueError, match="name the time"):
        _ = agent.trees
    with pytest.raises(ValueError, match="name the time"):
        agent.mean(np.zeros((1, 1)), np.zeros((1, 1)))
    labeling: Labeling = problem.labeling
    for ask in (lambda: labeling.low[0], lambda: labeling.classes, lambda: labeling.letter([np.zeros(1)])):
        with pytest.raises(ValueError, match="stand still"):
            ask()
    with pytest.raises(ValueError, match="stands still"):
        _ = problem.propositions["band"].low


def test_other_expressions_are_other_problems() -> None:
    others = [follow(robot(), band(shift=1)), follow(robot(dynamics=["x + u + 0.4*sin(0.9*t + 0.1)"]))]
    assert len({problem.fingerprint for problem in (follow(robot()), *others)}) == 3


def test_problems_written_out_read_the_same_words() -> None:
    region, other = cg.Proposition("robot", ["t - 2"], ["t"]), cg.Proposition("robot", ["max(-1, -t)"], ["2 - t"])
    rng = np.random.default_rng(3)
    for formula in ("F (band & F[1,3] other)", "G (band | other)", "!other U band", "G (band -> F other)"):
        problem = follow(still(), region, horizon=5, formula=formula, other=other)
        base = unrolled_in_time(problem)
        table = states_in_time(problem, base)
        for x in rng.uniform(-4, 4, (200, problem.horizon + 1)):
            q, b = problem.automaton.initial, base.automaton.initial
            for t in range(problem.horizon + 1):
                point = [np.array([x[t]])]
                q = int(problem.automaton.next_state(np.asarray(q), problem.labeling.at(t).letter(point)))
                b = int(base.automaton.next_state(np.asarray(b), base.labeling.letter(point)))
                assert table[t, q] == b
            assert problem.automaton.accepting[q] == base.automaton.accepting[b]


def test_another_problem_is_not_the_one_that_is_written_out() -> None:
    problem = follow(still())
    for other in (follow(still(), band(shift=1)), follow(still(), horizon=5), follow(still(), formula="F band")):
        with pytest.raises(ValueError):
            states_in_time(problem, unrolled_in_time(other))


@pytest.mark.parametrize(
    ("asked", "proved"), [("G (band & other)", "G (band | other)"), ("F (band & other)", "F band")]
)
def test_a_task_that_is_easier_is_not_the_one_that_is_written_out(asked: str, proved: str) -> None:
    other = cg.Proposition("robot", ["-t"], [2])
    for own, base in ((asked, proved), (proved, asked)):
        problem = follow(still(), horizon=4, formula=own, other=other)
        with pytest.raises(ValueError, match=r"satisfied where the task is not|two states"):
            states_in_time(problem, unrolled_in_time(follow(still(), horizon=4, formula=base, other=other)))


@pytest.mark.parametrize("formula", ["G (band_t0 | !band_t0)", "F (band_t0 & !band_t0)"])
def test_what_is_always_or_never_satisfied_is_not_the_task(formula: str) -> None:
    problem = follow(still(), horizon=4)
    base = cg.Problem(
        name="always", horizon=4, agents=problem.agents, propositions=unrolled_in_time(problem).propositions,
        specification=cg.Specification(formula, "finite-trace"),
    )  # fmt: skip
    with pytest.raises(ValueError, match="satisfied where the task is not"):
        states_in_time(problem, base)
