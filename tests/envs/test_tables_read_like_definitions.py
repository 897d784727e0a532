"""What tables decide about worlds is what the definitions decide, and worlds left behind change no outcome."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.interfaces.observation import joint_bounds
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.simulation import tables as reading
from certigym.envs.simulation.batch_simulator import Dynamics, Worlds
from certigym.envs.suite.catalogue import problem_ids
from certigym.validation.statistical_tests.chunks import frames
from certigym.validation.statistical_tests.loop import Loop
from certigym.validation.statistical_tests.mismatch import Mismatch
from certigym.validation.statistical_tests.rollouts import stream
from kinds import mostly_thorough
from problems import two_agents
from sample_problems import mixed_problem, planar

SMALL = ["reach-avoid-v0", "reach-avoid-planar-v0"]


def planar_pair() -> cg.Problem:
    """Two planar agents with boxes of their own, met in turns: edges are shared by no two agents."""
    return cg.Problem(
        name="pair",
        horizon=5,
        agents=[planar(), planar(name="other", state_low=[-7.0, -9.5])],
        propositions={
            "here": cg.Proposition("planar", [-5.0, -5.0], [5.0, 10.0]),
            "there": cg.Proposition("planar", [4.0, 1.25], [9.0, 8.0]),
            "away": cg.Proposition("other", [-12.0, -1.5], [-1.0, 2.5]),
            "near": cg.Proposition("other", [-3.0, -3.0], [3.0, 3.0]),
        },
        specification=cg.Specification("G (here -> X (near | away)) & F there", "finite-trace"),
    )


def critical(dynamics: Dynamics, rng: np.random.Generator, n_worlds: int) -> tuple[np.ndarray, ...]:
    """States inside and outside, on every edge and beside it, infinite and not a number."""
    states = []
    for block in dynamics.blocks:
        low, high = block.state_low, block.state_high
        x = low + (high - low) * rng.uniform(-0.05, 1.05, size=(*low.shape[:2], n_worlds))
        edges = [low, high]
        for k, owner in enumerate(block.owners):
            for corner in (block.region_low, block.region_high):
                edge = np.where(np.isfinite(corner[:, k]), corner[:, k], high[:, owner])
                edges.append(np.broadcast_to(edge[:, None], low.shape))
        kind = rng.integers(0, 4 * len(edges), size=x.shape)
        for k, edge in enumerate(edges):
            for step, beside in enumerate((edge, np.nextafter(edge, -np.inf), np.nextafter(edge, np.inf))):
                x = np.where(kind == 3 * k + step, beside, x)
        x[rng.random(x.shape) < 0.01] = np.nan
        x[rng.random(x.shape) < 0.01] = np.inf
        x[rng.random(x.shape) < 0.01] = -np.inf
        states.append(x)
    return tuple(states)


def problems() -> list[cg.Problem]:
    suite = [cg.make_problem(name) for name in problem_ids()]
    suite = [problem for problem in suite if not problem.labeling.pairs]  # pairs are not read agent by agent
    # Nor are there tables where propositions speak of outputs that are not the states.
    suite = [problem for problem in suite if all(agent.has_identity_output for agent in problem.agents)]
    return [*suite, planar_pair(), two_agents("G (b -> X d)", "finite-trace")]


@mostly_thorough("problem", problems(), first=17, ids=lambda problem: problem.name)
def test_tables_and_definitions_judge_all_worlds_alike(problem: cg.Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    dynamics, plain = Dynamics.of(problem), Dynamics.of(problem)
    assert dynamics.reader is not None
    monkeypatch.setitem(plain.__dict__, "reader", None)
    rng, n_worlds = np.random.default_rng(20), 3000
    q = rng.integers(0, problem.automaton.n_states, size=n_worlds).astype(np.int32)
    failed = (rng.random(n_worlds) < 0.2) & ~dynamics.accepting[q]
    before = Worlds(critical(dynamics, rng, n_worlds), q, 0, failed, dynamics.accepting[q] & ~failed)
    for states in (before.states, *(critical(dynamics, rng, n_worlds) for _ in range(3))):
        ours, theirs = (core._read(d, states, 1, before.q, before.failed, before.accepted) for d in (dynamics, plain))
        for name in ("q", "failed", "accepted"):
            mine, definition = getattr(ours, name), getattr(theirs, name)
            assert mine.dtype == definition.dtype
            np.testing.assert_array_equal(mine, definition, err_msg=name)
        before = theirs


@pytest.mark.parametrize(
    "problem", [cg.make_problem("reach-avoid-v0"), planar_pair()], ids=lambda problem: problem.name
)
def test_starts_are_judged_once_only_if_all_of_them_are_judged_alike(problem: cg.Problem) -> None:
    low, high = joint_bounds(problem.agents)
    rng, alike = np.random.default_rng(4), []
    for wide in [0.02] * 15 + [1.0] * 15:  # small boxes, and large ones
        ends = np.sort(low + (high - low) * (rng.random(len(low)) + [[0.0], [wide]]).clip(0.0, 1.0), axis=0)
        dynamics = Dynamics.of(problem.replace(initial_low=ends[0], initial_high=ends[1]))
        begun = core.initial(dynamics, rng, 4000)
        seen = set(zip(begun.q.tolist(), begun.failed.tolist(), begun.accepted.tolist()))
        alike.append(dynamics.first is not None)
        assert seen == {dynamics.first} if alike[-1] else len(seen) > 1
    assert 5 < sum(alike) < 25


def test_there_are_no_tables_where_they_would_not_do(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Dynamics.of(mixed_problem()).reader is None  # outputs are not the states
    assert Dynamics.of(two_agents("true", "co-safe")).reader is None  # accepted before the first letter
    monkeypatch.setattr(reading, "MOST_ENTRIES", 50)
    assert Dynamics.of(two_agents()).reader is None
    assert Dynamics.of(cg.make_problem("swarm-v0")).reader is None  # propositions about pairs
    assert Dynamics.of(cg.make_problem("car-slalom-v0")).reader is None  # outputs are some of the states


@mostly_thorough(
    ("name", "mismatch"),
    [
        *((name, None) for name in SMALL),
        ("reach-avoid-v0", Mismatch(noise_scale=3.0, actuator_bias=0.3)),
        ("patrol-recharge-v0", Mismatch(delay=1)),
    ],
)
def test_leaving_settled_worlds_changes_no_outcome(
    name: str, mismatch: Mismatch | None, synthesized: Callable[..., cg.Synthesis]
) -> None:
    """Chunks side by side, without the worlds that are settled, against each chunk to the end with all of them."""
    problem = cg.make_problem(name)
    controller = synthesized(
        problem,
        12 if "planar" in name or "door" in name else 30,
        relation="quick",
        search=cg.SearchOptions(max_sweeps=0),
    ).controller
    loop = Loop(problem, controller, seed=4, chunk=150, mismatch=mismatch)
    dynamics, policy = loop.arranged
    parts = list(stream(loop, 1000))
    assert [len(part.success) for part in parts] == [150] * 6 + [100]
    for number, part in enumerate(parts):
        *_, last = frames(loop, dynamics, policy, number)
        count = len(part.success)
        np.testing.assert_array_equal(part.success, core.satisfied(dynamics, last.worlds)[:count])
        assert part.inadmissible == int(last.inadmissible[:count].sum())


class Restless:
    """Inputs beyond the box, from the state alone."""

    def batch(self, dynamics: Dynamics) -> Restless:
        return self

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> None:
        return None

    def selected(self, memory: None, which: np.ndarray) -> None:
        return None

    def act(self, worlds: Worlds, memory: Any) -> tuple[tuple[np.ndarray, ...], Any]:
        return tuple(np.where(np.sin(40 * x) > 0.9, 9.0, -x) for x in worlds.states), None


def test_inadmissible_inputs_are_counted_while_the_task_is_open() -> None:
    problem = two_agents(horizon=6)
    runs = cg.rollout(problem, Restless(), 1200, seed=1, chunk=400)
    loop = Loop(problem, Restless(), seed=1, chunk=400)
    dynamics, policy = loop.arranged
    asked, success = np.zeros((2, 3, 400), dtype=bool)
    for number in range(3):
        for frame in frames(loop, dynamics, policy, number):
            worlds = frame.worlds
            settled = worlds.failed | worlds.accepted | problem.automaton.dead[worlds.q]
            (u,), _ = policy.act(worlds, None)
            beyond = (np.abs(u) > 2.0).any(axis=(0, 1))
            asked[number] |= beyond & ~settled & (worlds.time < problem.horizon)
        success[number] = worlds.accepted
    assert 0 < runs.inadmissible == int(asked.sum()) < 1200
    np.testing.assert_array_equal(runs.success, success.ravel())


def test_selected_worlds_are_the_same_worlds() -> None:
    dynamics = Dynamics.of(mixed_problem())
    worlds = core.initial(dynamics, np.random.default_rng(3), 9)
    which = np.array([1, 2, 7])
    some = core.selected(worlds, which)
    assert some.n_worlds == 3 and some.time == 0
    for name in ("q", "failed", "accepted"):
        np.testing.assert_array_equal(getattr(some, name), getattr(worlds, name)[which])
    for x, y in zip(some.states, worlds.states):
        np.testing.assert_array_equal(x, y[..., which])
