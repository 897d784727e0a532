"""Agents that remember act by the definition, side by side as alone, and worlds that leave change no other world."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.simulation.batch_simulator import Dynamics
from certigym.synthesis.certificates.controllers.controller import Controller
from certigym.synthesis.relations.kinds.coupled import CoupledRelation, couple
from certigym.validation.statistical_tests.streams import Streams
from problems import scalar_agent, two_agents


def three() -> cg.Problem:
    """Two scalar agents that share grid and relation, and one of other dynamics."""
    lines = [agent.replace(initial_state=[0.2]) for agent in two_agents(noise_covariance=[[0.6]], offset=[0.15]).agents]
    return cg.Problem(
        name="three",
        horizon=6,
        agents=[scalar_agent("lead", A=[[0.8]], noise_covariance=[[0.6]], offset=[-0.1]), *lines],
        propositions={
            "goal": cg.Proposition("lead", [-2.0], [3.0]),
            "one": cg.Proposition("one", [0.0], [3.0]),
            "two": cg.Proposition("two", [-3.0], [0.0]),
        },
        specification=cg.Specification("F (goal & one & F two)", "co-safe"),
    )


CASES: dict[str, tuple[cg.Problem, Any, dict[str, Any]]] = {
    "three agents, F = 0": (three(), 48, {"relation": "paper", "search": cg.SearchOptions(epsilon=0.3, feedback=-0.4)}),
    "paper, F = 0": (
        two_agents(horizon=5, noise_covariance=[[0.6]]),
        48,
        {"relation": "paper", "search": cg.SearchOptions(epsilon=0.3, feedback=-0.4)},
    ),
    "paper": (
        two_agents(horizon=5, noise_covariance=[[0.6]]),
        64,
        {"relation": "paper", "search": cg.SearchOptions(epsilon=0.1)},
    ),
}
DRAWING = {"paper"}


@cache
def case(name: str) -> tuple[cg.Problem, Controller]:
    problem, cells, settings = CASES[name]
    search = replace(settings.get("search", cg.SearchOptions()), max_sweeps=0)
    controller = cg.synthesize(problem, cells, **{**settings, "search": search}).controller
    assert isinstance(controller, Controller)
    return problem, controller


def anywhere(problem: cg.Problem, rng: np.random.Generator, n_worlds: int) -> core.Worlds:
    """Worlds that start in the workspace, or a little outside."""
    low, high = (np.concatenate([getattr(a, side) for a in problem.agents]) for side in ("state_low", "state_high"))
    states = rng.uniform(1.1 * low, 1.1 * high, size=(n_worlds, problem.n_states))
    return core.initial_at(Dynamics.of(problem), states)


class Defined:
    """Memory and inputs of one agent in one world, number by number (docs/theory/relations.md, "Errors")."""

    def __init__(self, controller: Controller, i: int) -> None:
        self.agent = controller.agents[i]
        assert isinstance(self.agent.relation, CoupledRelation)
        self.relation, self.centres, self.lost = self.agent.relation, self.agent.grid.centres, False
        self.last: tuple[np.ndarray, ...] | None = None
        self.cell = 0

    def nearest(self, point: np.ndarray) -> int:
        edges = self.agent.grid.edges
        held = np.array([min(max(x, e[0]), e[-1]) for x, e in zip(point, edges)])
        return int(self.agent.grid.cell_of(held[:, None])[0])

    def act(self, state: np.ndarray, q: int, time: int, uniform: float) -> np.ndarray:
        r, edges = self.relation, self.agent.grid.edges
        point = state
        if self.last is None:
            self.cell = self.nearest(point)
            self.lost = not all(e[0] <= x <= e[-1] for x, e in zip(point, edges))
        else:
            before, u, mean = self.last
            noise = point - (r.A @ before + r.B @ u + r.drift)
            if np.any(r.coupling):
                scale = np.sqrt(r.covariance)
                w, move = noise / scale, r.coupling @ (before - self.centres[self.cell]) / scale
                ratio = np.exp(0.5 * (w @ w - (w + move) @ (w + move)))
                noise = scale * (w + move if uniform <= ratio else w - 2 * move * (w @ move) / (move @ move))
            landed = mean + noise
            cell = self.nearest(landed)
            inside = all(e[0] <= x <= e[-1] for x, e in zip(landed, edges))
            kept = inside and bool(r.related((point - self.centres[cell])[:, None])[0])
            self.lost = self.lost or not kept
            self.cell = cell if kept else self.nearest(point)
        policy = self.agent.policy
        choice = max(int(policy[min(time, len(policy) - 1), q, self.cell]), 0)
        error = np.clip(point - self.centres[self.cell], -r.reach, r.reach)
        u = np.clip(r.inputs[choice] + r.feedback @ error, r.input_low, r.input_high)
        assert self.agent.input_set is not None
        index = np.unravel_index(self.agent.input_set[self.cell, choice], tuple(len(own) for own in self.agent.lattice))
        mean = np.array([own[k] for own, k in zip(self.agent.lattice, index)])
        self.last = point, u, mean
        return u


@pytest.mark.parametrize("name", CASES)
def test_batches_do_what_the_definition_says(name: str) -> None:
    problem, controller = case(name)
    dynamics, n_worlds, rng = Dynamics.of(problem), 60, np.random.default_rng(8)
    gaps = [np.where(rng.random(agent.policy.shape) < 0.1, -1, agent.policy) for agent in controller.agents]
    agents = (replace(agent, policy=policy.astype(np.int32)) for agent, policy in zip(controller.agents, gaps))
    controller = Controller(problem, tuple(agents))
    policy, worlds = controller.batch(dynamics), anywhere(problem, rng, n_worlds)
    memory, draws = policy.begin(worlds, np.random.default_rng(9)), np.random.default_rng(9)
    alone = [[Defined(controller, i) for _ in range(n_worlds)] for i in range(problem.n_agents)]
    for time in range(problem.horizon):
        inputs, memory = policy.act(worlds, memory)
        for block, groups, memories, x, u in zip(
            dynamics.blocks, policy.blocks, memory.groups, worlds.states, inputs, strict=True
        ):
            for group, own in zip(groups, memories, strict=True):
                assert own is not None
                uniform = draws.random((len(group.members), n_worlds)) if name in DRAWING else None
                for k, place in enumerate(group.members):
                    for w, agent in enumerate(alone[block.agents[place]]):
                        chance = 0.0 if uniform is None else uniform[k, w]
                        expected = agent.act(x[:, place, w], int(worlds.q[w]), time, chance)
                        np.testing.assert_allclose(u[:, place, w], expected, rtol=1e-9, atol=1e-9)
                        assert own.cells[k, w] == agent.cell and own.lost[k, w] == agent.lost
        worlds = core.transition(dynamics, worlds, inputs, core.noise(dynamics, rng, n_worlds))
    lost = memory.lost
    assert lost is not None and lost.any() and not lost.all()
    assert draws.bit_generator.state == memory.rng.bit_generator.state  # type: ignore[attr-defined]


def test_streams_draw_what_their_chunks_would_draw_alone() -> None:
    seeds, size = [np.random.SeedSequence(7, spawn_key=(k,)) for k in range(4)], 5
    streams, alone = Streams(seeds, size), [np.random.default_rng(seed) for seed in seeds]
    which = np.arange(20)
    for left in (which, np.array([0, 3, 5, 6, 7, 8, 9, 19]), np.array([3, 6, 19]), np.array([19])):
        if len(left) < 20:
            streams.keep(left)
        for name, lead in (("standard_normal", (2, 3)), ("random", (3,))):
            whole = np.concatenate([getattr(rng, name)((*lead, size)) for rng in alone], axis=-1)
            np.testing.assert_array_equal(getattr(streams, name)((*lead, len(left))), whole[..., left])


def test_mirrored_noise_is_that_of_the_definition() -> None:
    rng = np.random.default_rng(2)
    w, move = rng.standard_normal((2, 3, 4000)), rng.normal(scale=0.7, size=(2, 3, 4000))
    move[:, 0, :9], uniform = 0.0, rng.random((3, 4000))
    accepted = uniform <= np.exp(-((w * move).sum(axis=0) + 0.5 * (move**2).sum(axis=0)))
    length = np.where((move**2).sum(axis=0) > 0, (move**2).sum(axis=0), 1.0)
    expected = np.where(accepted, w + move, w - 2 * move * (w * move).sum(axis=0) / length)
    np.testing.assert_allclose(couple(w, move, uniform), expected, rtol=1e-12, atol=1e-12)
    assert 0.1 < np.mean(~accepted) < 0.5
