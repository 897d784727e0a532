"""Agents whose expressions name inputs of others are simulated as they are, and certified whatever these apply."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg
from boiler_problems import boiler, boiler_problem, room
from certigym.envs.simulation import Dynamics, SingleSimulator, batch_simulator


def test_simulation_is_that_of_an_independent_step() -> None:
    """200 worlds against a step written by hand; then one world at a time, bit by bit."""
    problem = boiler_problem(3)
    dynamics, rng = Dynamics.of(problem), np.random.default_rng(0)
    many = batch_simulator.initial(dynamics, rng, 200)
    single_simulator = SingleSimulator.of(dynamics)
    ones = [single_simulator.begin(batch_simulator.selected(many, np.array([k]))) for k in range(5)]
    loss = np.array([0.1, 0.11, 0.12])[:, None]
    for _ in range(4):
        z, joint = batch_simulator.noise(dynamics, rng, 200), batch_simulator.joint(dynamics, many)
        heat, trims = rng.uniform(0.0, 3.0, (1, 200)), rng.uniform(-0.2, 0.3, (3, 200))
        all_inputs = np.concatenate([heat, trims])
        u = [all_inputs[block.agents][None] for block in dynamics.blocks]
        noises = np.zeros((4, 200))
        for block, normals in zip(dynamics.blocks, z):
            noises[block.agents] = normals[0]
        water = 0.6 * joint[:, 0] + 8.0 * heat[0] + 2.0 * noises[0]
        warmth = joint[:, 1:].T
        expected = warmth + loss * (12.0 - warmth) + 0.6 * heat + trims + 0.2 * noises[1:]
        many = batch_simulator.transition(dynamics, many, u, z)
        np.testing.assert_allclose(
            batch_simulator.joint(dynamics, many), np.stack([water, *expected], axis=1), rtol=1e-13
        )
        flat = np.concatenate([normals.reshape(-1, 200) for normals in z])
        for k in range(5):
            ones[k] = single_simulator.step(
                ones[k], [[value] for value in all_inputs[:, k].tolist()], flat[:, k].tolist()
            )
            assert [s[0] for s in ones[k].states] == batch_simulator.joint(dynamics, many)[k].tolist()


def test_what_moves_the_rooms_is_the_input_that_is_applied() -> None:
    """Actions beyond the box are clipped first: in every environment the rooms get what the boiler applies."""
    problem = boiler_problem(2).replace(disturbance_scale=0.0)
    for env in (cg.parallel_env(problem, actions="input"), cg.parallel_env(problem)):
        env.reset(seed=0)
        _, _, _, _, infos = env.step({name: np.array([99.0]) for name in problem.agent_names})
        for i in range(2):
            start = 19.0 + 0.5 * i
            expected = start + (0.1 + 0.01 * i) * (12.0 - start) + 0.6 * 3.0 + 0.3
            np.testing.assert_allclose(infos[f"room_{i}"]["state"], [expected], rtol=1e-12)
    vector = cg.vector_env(problem, 3, actions="input")
    vector.reset(seed=0)
    state = vector.step(np.full(vector.action_space.shape, 99.0))[4]["state"]
    np.testing.assert_allclose(state[:, 1], 19.0 - 0.7 + 1.8 + 0.3, rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dynamics": ["warmth + boiler.cold + trim"]}, "a state or an input of agent 'boiler'.*water, heat"),
        ({"dynamics": ["warmth + attic.heat + trim"]}, "'attic'"),
        ({"dynamics": ["warmth + room_0.trim"]}, "one of 'room_0' itself"),
        ({"communicated": ["boiler"]}, "inputs alone.*nobody is told of inputs"),
        ({"outputs": ["warmth + boiler.heat"]}, "unknown name 'boiler.heat'"),
    ],
)
def test_mistakes_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cg.Problem(
            name="boiler",
            horizon=3,
            agents=[boiler(), room(0, **changes)],
            propositions={"comfort": cg.Proposition("room_0", [18.0], [21.0])},
            specification=cg.Specification("G comfort", "finite-trace"),
        )


def test_targets_do_not_cancel_inputs_of_others() -> None:
    """Nobody can be told of an input that is chosen in the same step."""
    with pytest.raises(ValueError, match="nobody is told of inputs"):
        cg.synthesize(boiler_problem(1), cells=24, relation={"room_0": "exact", "boiler": "boxes"})
