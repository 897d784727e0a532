"""Agents whose expressions name states of others are simulated as they are, and certified whatever these do."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import Dynamics, SingleSimulator, batch_simulator
from team_problems import ring, room

FALSE_ALARM = 1e-6
"""Probability that a true claim is refuted here; the seeds are fixed."""


def test_simulation_is_that_of_an_independent_step() -> None:
    """200 worlds against a step written by hand; then one world at a time, bit by bit."""
    problem = ring(4)
    dynamics, rng = Dynamics.of(problem), np.random.default_rng(0)
    assert len(dynamics.blocks) == 1  # equal but for the names of their neighbours
    many = batch_simulator.initial(dynamics, rng, 200)
    single_simulator = SingleSimulator.of(dynamics)
    ones = [single_simulator.begin(batch_simulator.selected(many, np.array([k]))) for k in range(5)]
    for _ in range(4):
        [z], u = batch_simulator.noise(dynamics, rng, 200), rng.uniform(-0.5, 1.5, (1, 4, 200))
        x = many.states[0][0]
        expected = x + 0.1 * (np.roll(x, 1, axis=0) + np.roll(x, -1, axis=0) - 2 * x) - 0.5 + u[0] + 0.2 * z[0]
        many = batch_simulator.transition(dynamics, many, [u], [z])
        np.testing.assert_allclose(many.states[0][0], expected, rtol=1e-13)
        for k in range(5):
            ones[k] = single_simulator.step(ones[k], [[u[0, i, k]] for i in range(4)], z[0, :, k].tolist())
            assert [s[0] for s in ones[k].states] == many.states[0][0, :, k].tolist()


@pytest.mark.parametrize("told", [True, False])
def test_certificates_are_checked_and_hold(told: bool) -> None:
    """10,000 rollouts do not refute the bound, nor does a neighbour that does what it likes."""
    problem = ring(3, told)
    result = cg.synthesize(problem, cells=32, relation="boxes")
    assert cg.check(result.certificate)
    assert len({id(part.grid) for part in result.certificate.proof.agents}) == 1
    assert ("room_0 by room_2, room_1" in repr(result.certificate)) is told
    report = cg.validate(result.certificate, 10_000, seed=0, confidence=1.0 - FALSE_ALARM)
    assert report.verdict != "refuted"
    assert result.certificate.lower_bound > 0.5


def test_neighbours_count_as_disturbances_where_nothing_is_told() -> None:
    """The bound of a ring is the product of those of single rooms between disturbances as wide as the workspaces."""
    whole = cg.synthesize(ring(3, told=False), cells=32).certificate.lower_bound
    product = 1.0
    for i in range(3):
        ranges = {"left": [17, 25], "right": [17, 25]}
        means = ["warmth + 0.1*(left + right - 2*warmth) - 0.5 + heat"]
        alone = room(i, 3, False, dynamics=means, disturbances=ranges)
        problem = cg.Problem(
            name="one",
            horizon=6,
            agents=[alone],
            propositions={"comfort": cg.Proposition(alone.name, [19.0], [22.5])},
            specification=cg.Specification("G comfort", "finite-trace"),
        )
        product *= cg.synthesize(problem, cells=32).certificate.lower_bound
    assert whole == pytest.approx(product, abs=1e-9)


def test_controllers_act_alike_in_environments_and_batches() -> None:
    problem = ring(3)
    controller = cg.synthesize(problem, cells=32).controller
    env = cg.parallel_env(problem)
    observations, infos = env.reset(seed=3)
    controller.reset(observations, infos)
    dynamics = Dynamics.of(problem)
    batch = controller.batch(dynamics)
    for _ in range(4):
        actions = controller.act(observations, infos)
        states = np.concatenate([infos[name]["state"] for name in problem.agent_names])[None]
        here = replace(batch_simulator.initial_at(dynamics, states), time=int(infos["room_0"]["time"]))
        [inputs], _ = batch.act(here, batch.begin(here, np.random.default_rng(0)))
        assert inputs[0, :, 0].tolist() == [float(actions[name][0]) for name in problem.agent_names]
        observations, _, _, _, infos = env.step(actions)
    with pytest.raises(ValueError, match="`beside`"):
        controller.act({"room_0": observations["room_0"]}, {"room_0": infos["room_0"]})


def test_targets_need_what_is_told() -> None:
    """A certificate that cancels what nobody tells is refused."""
    told, untold = ring(3), ring(3, told=False)
    certificate = cg.synthesize(told, cells=32, relation="exact").certificate
    report = cg.check(replace(certificate, problem=untold))
    assert not report and "not `communicated`" in str(report)


def test_a_range_of_neighbours_that_is_too_small_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sabotage: the search thinks neighbours stay within nine tenths of their workspace."""
    problem = ring(3, told=False)
    true = cg.Agent.unknowns
    assert isinstance(true, property) and true.fget is not None
    of = true.fget
    narrow = {"neighbour 0": (17.4, 24.6), "neighbour 1": (17.4, 24.6)}
    with monkeypatch.context() as patch:
        patch.setattr(cg.Agent, "unknowns", property(lambda agent: {**of(agent), **narrow}))
        certificate = cg.synthesize(problem, cells=32).certificate
        assert cg.check(certificate)
    assert not cg.check(certificate)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dynamics": ["warmth + room_0.warmth + heat"], "communicated": None}, "states of other agents"),
        ({"communicated": ["nobody"]}, "`communicated`"),
        ({"dynamics": ["warmth + attic.warmth + heat"], "communicated": None}, "'attic'"),
        ({"dynamics": ["warmth + room_1.cold + heat"], "communicated": None}, "'room_1.cold'"),
        ({"outputs": ["warmth + room_1.warmth"]}, "unknown name 'room_1.warmth'"),
    ],
)
def test_mistakes_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cg.Problem(
            name="ring",
            horizon=3,
            agents=[room(0, 3, **changes), room(1, 3), room(2, 3)],
            propositions={"comfort": cg.Proposition("room_*", [19.0], [22.5])},
            specification=cg.Specification("G all(comfort)", "finite-trace"),
        )
