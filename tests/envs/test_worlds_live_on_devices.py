"""Worlds on the arrays of another library move, read letters and pay as numpy's do, with the same noise to 1e-12."""

from __future__ import annotations

import os
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.interfaces import DeviceTeamEnv, Potential, TeamEnv
from certigym.envs.simulation import Dynamics, Worlds
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.systems.backends import LIBRARIES, device_put, numbers_beside, to_host
from certigym.validation.statistical_tests import clopper_pearson
from kinds import mostly_thorough

CLOSE = 1e-12
"""Difference allowed, relative and absolute: quantiles and elementary functions round differently by a few units."""

M = 40
"""Worlds of a test."""

LAWS: list[dict[str, Any]] = [
    {"law": "gaussian", "std": 0.1},
    {"law": "uniform", "low": -0.2, "high": 0.1},
    {"law": "triangular", "low": -0.2, "mode": 0.05, "high": 0.2},
    {"law": "laplace", "scale": 0.1},
    {"law": "logistic", "scale": 0.05},
    {"law": "truncated-gaussian", "spread": 0.2, "low": -0.3, "high": 0.1},
]
SPECIFICATIONS = [
    ("F a & G !b", "finite-trace"),
    ("G !b", "finite-trace"),
    ("F (a & F c)", "co-safe"),
    ("!b U (a & c)", "co-safe"),
    ("F c & (!b U a)", "co-safe"),
]


DEVICES = os.environ.get("CERTIGYM_DEVICE", "torch:cpu,jax:cpu").split(",")
"""`CERTIGYM_DEVICE=torch:cuda` or `jax:gpu` tests an accelerator of this machine."""


@pytest.fixture(params=DEVICES)
def device(request: pytest.FixtureRequest) -> str:
    name = str(request.param)
    pytest.importorskip("array_api_compat")
    library: ModuleType = pytest.importorskip(name.split(":")[0])
    if name.startswith("jax"):
        library.config.update("jax_enable_x64", True)
    return name


def linear_agent(rng: np.random.Generator, name: str) -> Any:
    d, m = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    matrix = rng.normal(size=(d, d))
    own_outputs = {} if rng.random() < 0.6 else {"output_matrix": rng.normal(size=(d, d)) + np.eye(d)}
    noise: dict[str, Any] = {"noise": [LAWS[k] for k in rng.integers(0, len(LAWS), d)]}
    if rng.random() < 0.4:
        factor = 0.2 * rng.normal(size=(d, d))
        noise = {"noise_covariance": 0.5 * (factor @ factor.T + (factor @ factor.T).T)}
    return cg.LinearAgent(
        name=name,
        A=matrix / max(1.0, float(np.abs(np.linalg.eigvals(matrix)).max())),
        B=rng.normal(size=(d, m)),
        **noise,
        offset=0.1 * rng.normal(size=d),
        state_low=[-2.0] * d,
        state_high=[2.0] * d,
        input_low=[-0.5] * m,
        input_high=[0.3] * m,
        initial_low=[-0.5] * d,
        initial_high=[0.5] * d,
        **own_outputs,
    )


def written_agent(rng: np.random.Generator, name: str, disturbed: bool) -> cg.Agent:
    wind = " + wind" if disturbed else ""
    return cg.Agent(
        name=name,
        states=["x", "y"],
        inputs=["u"],
        dynamics=[
            f"x + {rng.uniform(0.05, 0.2):.3f}*sin(y)*u + 0.1*min(x, y){wind}",
            "0.9*y + u/(1 + x**2) + 0.05*exp(-abs(x)) - 0.1*tanh(y)*max(u, 0.1)",
        ],
        disturbances={"wind": [-0.1, 0.05]} if disturbed else None,
        noise=[LAWS[k] for k in rng.integers(0, len(LAWS), 2)],
        state_low=[-2.0, -2.0],
        state_high=[2.0, 2.0],
        input_low=[-0.5],
        input_high=[0.3],
        initial_low=[-0.5, -0.5],
        initial_high=[0.5, 0.5],
        **({} if rng.random() < 0.5 else {"outputs": ["x + y", "sqrt(4 + x*y)"]}),
    )


def moved_by_another() -> cg.Agent:
    """An agent that is moved by a state and by the input of the written agent."""
    return cg.Agent(
        name="fourth",
        states=["x"],
        inputs=["v"],
        dynamics=["0.9*x + 0.2*second.u*second.x - 0.1*second.u + v"],
        noise=[LAWS[0]],
        state_low=[-2.0],
        state_high=[2.0],
        input_low=[-0.5],
        input_high=[0.3],
        initial_low=[-0.5],
        initial_high=[0.5],
    )


def random_problem(seed: int) -> cg.Problem:
    """Linear and written agents of any sizes, any laws of noise, regions of single agents and of a pair."""
    rng = np.random.default_rng(seed)
    agents: list[Any] = [linear_agent(rng, "first"), written_agent(rng, "second", seed % 2 == 0)]
    if rng.random() < 0.5:
        agents.append(agents[0].replace(name="third"))
    if seed % 2:
        agents.append(moved_by_another())
    propositions: dict[str, Any] = {}
    for name, agent in zip("ab", agents):
        propositions[name] = cg.Proposition(
            agent.name, rng.uniform(-1.0, 0.0, agent.n_outputs), rng.uniform(0.5, 1.5, agent.n_outputs)
        )
    propositions["c"] = cg.Proposition("first", [-0.5] * agents[0].n_outputs, [0.9] * agents[0].n_outputs)
    if seed % 3 == 0:
        propositions["c"] = cg.Pair(["first", "second"], low=[-0.6], high=[0.4], outputs=([0], [0]))
    return cg.Problem(
        agents=agents,
        propositions=propositions,
        specification=cg.Specification(*SPECIFICATIONS[seed % len(SPECIFICATIONS)]),
        horizon=12,
        name="random",
    )


def close(there: Any, here: Any) -> None:
    np.testing.assert_allclose(to_host(there), here, rtol=CLOSE, atol=CLOSE)


def same_worlds(there: Worlds, here: Worlds) -> None:
    """What is decided is the same; states are the same to rounding wherever they still count."""
    alive = ~here.failed
    for x, y in zip(there.states, here.states, strict=True):
        close(to_host(x)[..., alive], y[..., alive])
    for name in ("q", "failed", "accepted"):
        np.testing.assert_array_equal(to_host(getattr(there, name)), getattr(here, name))


@pytest.mark.parametrize("seed", range(6))
def test_random_problems_move_and_pay_alike(seed: int, device: str) -> None:
    problem, put, rng = random_problem(seed), device_put(device, LIBRARIES), np.random.default_rng(seed)
    behaviour = ("zero", "random", "periodic")[seed % 3]
    here, there = Dynamics.of(problem, behaviour), Dynamics.of(problem, behaviour, put)
    mine = Potential.of(here)
    other = Potential.of(there)
    ours = core.initial(here, rng, M)
    theirs = core.begin(there, tuple(map(put, ours.states)))
    same_worlds(theirs, ours)
    levels = np.linspace(0.0, 1.0, M)
    for step in range(problem.horizon):
        inputs = tuple(rng.uniform(-0.5, 0.3, (*block.input_low.shape[:2], M)) for block in here.blocks)
        normals = core.noise(here, rng, M)
        ours = core.transition(here, ours, inputs, normals)
        time = put(np.full(M, step))
        before = Worlds(theirs.states, theirs.q, time, theirs.failed, theirs.accepted)
        theirs = core.moved_on(there, before, tuple(map(put, inputs)), tuple(map(put, normals)))
        same_worlds(theirs, ours)
        close(other.at(theirs), mine.at(ours))
        close(other.at(theirs, own=True), mine.at(ours, own=True))
        close(other.progress(theirs, put(levels)), mine.progress(ours, levels))
        np.testing.assert_array_equal(to_host(core.satisfied(there, theirs)), core.satisfied(here, ours))
    assert ours.failed.any() or ours.accepted.any() or (np.ptp(ours.q) > 0), "the problem decides nothing"


OPTIONS: list[tuple[str, dict[str, Any]]] = [
    ("reach-avoid-v0", {}),
    ("meeting-v0", {"reward": "progress"}),
    ("patrol-recharge-v0", {"reward": "progress", "automaton": "number"}),
    ("door-formation-v0", {"reward": "shaped", "discount": 0.9, "observation": "joint"}),
    ("rendezvous-v0", {"observation": "neighbours", "reward": "shaped"}),
    ("swarm-v0", {"observation": "neighbours", "scale": "raw", "actions": "input"}),
    ("windy-delivery-v0", {"disturbance": "periodic", "automaton": "hidden"}),
]


class Fixed:
    """Numbers of a generator that are 0 instead of normal: all worlds move by their means."""

    def __init__(self, like: Any, numbers: Any) -> None:
        self.like, self.numbers = like, numbers

    def standard_normal(self, size: tuple[int, ...], /) -> Any:
        return self.like(np.zeros(size))

    def random(self, size: tuple[int, ...], /) -> Any:
        return self.like(np.full(size, 0.25))

    def spawn(self, count: int) -> list[Any]:
        return [self] * count


@mostly_thorough(("id", "options"), OPTIONS, first=3)
def test_steps_of_teams_tell_the_same(id: str, options: dict[str, Any], device: str) -> None:
    """Observations, rewards, ends, new episodes: step by step those of numpy where no noise differs."""
    here, there = cg.team_env(id, 6, **options), cg.team_env(id, 6, device=device, **options)
    assert isinstance(here, TeamEnv) and isinstance(there, DeviceTeamEnv)
    put, rng = device_put(device, LIBRARIES), np.random.default_rng(0)
    here._batch._np_random = Fixed(np.asarray, None)  # type: ignore[assignment]
    there._numbers = Fixed(put, None)
    ours, theirs, ends = here.reset(), there.reset(), 0
    for _ in range(min(45, 2 * here.problem.horizon + 5)):
        for name in ("rewards", "terminated", "truncated", "satisfied", "automaton_state", "time_left"):
            close(getattr(theirs, name), getattr(ours, name))
        for agent in here.agents:
            # Observations are single precision.
            seen, own = to_host(theirs.observations[agent]), ours.observations[agent]
            assert seen.dtype == own.dtype == np.float32
            np.testing.assert_allclose(seen, own, rtol=1e-6, atol=1e-6)
        sizes = zip(here.agents, here.problem.agents, strict=True)
        actions = {name: rng.uniform(-1.0, 1.0, (6, agent.n_inputs)) for name, agent in sizes}
        ours, theirs = here.step(actions), there.step({name: put(values) for name, values in actions.items()})
        ends += int(ours.ended.sum())
    assert ends > 0


def rate(env: Any, put: Any, seed: int, batches: int) -> tuple[int, int]:
    """Return successes and episodes of a fixed linear policy."""
    step, successes, episodes = env.reset(seed=seed), 0, 0
    horizon = env.problem.horizon
    for _ in range(batches * horizon):
        actions = {name: -0.7 * step.observations[name][:, : agent.n_inputs] for name, agent in team(env)}
        step = env.step(actions)
        successes, episodes = successes + int(step.satisfied.sum()), episodes + int(step.ended.sum())
    return successes, episodes


def team(env: Any) -> Any:
    return zip(env.agents, env.problem.agents, strict=True)


@pytest.mark.parametrize("id", ["reach-avoid-v0", "dubins-team-v0", "invariance-v0"])
def test_success_is_as_likely(id: str, device: str) -> None:
    """Limits at 1 - 5e-7 of both rates overlap: a false alarm of 1e-6 for each id, a gap of .04 is found."""
    limits = []
    for options in ({}, {"device": device}):
        env = cg.team_env(id, 2000, **options)
        successes, episodes = rate(env, None, 3, 5)
        assert episodes >= 10_000
        limits.append(clopper_pearson(successes, episodes, 1.0 - 5e-7))
    assert limits[0][0] <= limits[1][1] and limits[1][0] <= limits[0][1], limits


def test_random_numbers_are_made_on_the_device_and_follow_the_seed(device: str) -> None:
    put = device_put(device, LIBRARIES)
    drawn = [to_host(numbers_beside(put(np.zeros(1)), seed).standard_normal((1000, 100))) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert (drawn[0] != drawn[2]).all() and drawn[0].dtype == np.float64
    # 100,000 numbers: mean and variance within 5 of their deviations, a false alarm of 1e-6 for both.
    assert abs(drawn[0].mean()) < 5.1 / np.sqrt(1e5) and abs(drawn[0].var() - 1.0) < 5.1 * np.sqrt(2.0 / 1e5)


def test_noise_without_quantiles_on_devices_is_refused() -> None:
    pytest.importorskip("torch")
    agent = cg.make_problem("reach-avoid-v0").agents[0].replace(noise=[{"law": "student-t", "scale": 0.1, "df": 5.0}])
    problem = cg.Problem(
        agents=[agent],
        propositions={"a": cg.Proposition(agent.name, [0.0], [1.0])},
        specification=cg.Specification("F a", "co-safe"),
        horizon=3,
        name="t",
    )
    with pytest.raises(ValueError, match="`device`: expected noise with quantiles on devices, got student-t"):
        cg.team_env(problem, 4, device="torch:cpu")
