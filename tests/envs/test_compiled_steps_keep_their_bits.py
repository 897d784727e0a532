"""Compiled expressions give the bits of walks over their trees; worlds that move at once, those of worlds cut out."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import Dynamics, SingleSimulator
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.systems.expressions import Compiled, Name, Number, Operation, Tree, computed
from certigym.envs.systems.expressions.expression_tree import FUNCTIONS

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, 3.0, np.inf, -np.inf, np.nan, 1e308, 5e-324, 0.1]


def random_tree(rng: np.random.Generator, depth: int, leaves: list[Tree]) -> Tree:
    """An expression of every operation; parts come again, and powers are whole and real."""
    if depth == 0 or rng.random() < 0.1:
        return leaves[rng.integers(len(leaves))]
    name = str(rng.choice(["+", "-", "*", "/", "**", "negative", *sorted(set(FUNCTIONS) - {"clip"})]))
    count = 1 if name == "negative" else FUNCTIONS.get(name, 2)
    arguments = [random_tree(rng, depth - 1, leaves) for _ in range(count)]
    if name == "**":
        arguments[1] = Number(float(rng.choice([-3.0, -1.0, 0.0, 1.0, 2.0, 5.0, 0.5, 2.5])))
    tree = Operation(name, tuple(arguments))
    leaves.append(tree)
    return tree


def same(one: Any, other: Any) -> bool:
    """Whether numbers are the same, with the sign of 0; one NaN is like another."""
    a, b = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    unknown = np.isnan(a) & np.isnan(b)
    return bool((unknown | ((a == b) & (np.signbit(a) == np.signbit(b)))).all())


@pytest.mark.parametrize("seed", range(12))
def test_compiled_expressions_are_those_of_the_walk(seed: int) -> None:
    """12 times 3 expressions at 144 points, among them infinity, no numbers and both zeros."""
    rng = np.random.default_rng([20261201, seed])
    leaves: list[Tree] = [Name("a"), Name("b"), Number(2.0), Number(0.0), Number(-0.0), Number(0.3)]
    trees = [random_tree(rng, 4, leaves) for _ in range(3)]
    a, b = (np.array(row) for row in zip(*((x, y) for x in SPECIAL for y in SPECIAL)))
    expected = computed(trees, {"a": a, "b": b})
    compiled = Compiled(trees, [["a"], ["b"]])
    with np.errstate(all="ignore"):
        together = compiled.arrays([a], [b])
        alone = [compiled.numbers([x], [y]) for x, y in zip(a.tolist(), b.tolist())]
    for k, row in enumerate(expected):
        assert same(row, np.broadcast_to(together[k], row.shape))
        assert same(row, [values[k] for values in alone])


def test_equal_parts_are_computed_once_and_zeros_of_two_signs_are_two() -> None:
    x = Name("x")
    sine = Operation("sin", (x,))
    compiled = Compiled([Operation("+", (sine, sine)), Operation("*", (x, Number(0.0)))], [["x"]])
    assert sum("sin" in line for line in compiled._lines) == 1
    values = Compiled([Operation("*", (x, Number(0.0))), Operation("*", (x, Number(-0.0)))], [["x"]]).numbers([1.0])
    assert [str(value) for value in values] == ["0.0", "-0.0"]
    assert pickle.loads(pickle.dumps(compiled)).numbers([0.5]) == compiled.numbers([0.5])


def walker(rng: np.random.Generator, name: str, other: str | None, start: dict[str, Any]) -> cg.Agent:
    """An agent that turns, with a wind, noise that grows, the time, and a look at another one."""
    beside = "" if other is None else f" + 0.1*sin({other}.x)"
    pull, push = (f"{number:.3f}" for number in rng.uniform(0.1, 0.9, 2))
    return cg.Agent(
        name=name,
        states=["x", "y"],
        inputs=["u"],
        dynamics=[f"x + {pull}*cos(y)*u{beside}", f"max(y - {push}*x/(0.2 + y**2), -2) + 0.05*t + wind"],
        disturbances={"wind": [-0.1, 0.2]},
        noise=[{"law": "gaussian", "std": 0.3}, {"law": "laplace", "scale": 0.1}],
        noise_scale=["1 + 0.2*abs(x)", "1"],
        outputs=["x", "y - x**2"],
        state_low=[-3, -3],
        state_high=[3, 3],
        input_low=[-1],
        input_high=[1],
        **start,
    )


def random_problem(seed: int) -> cg.Problem:
    """Two walkers of a kind, one of its own and a linear agent, with starts that are points or boxes."""
    rng = np.random.default_rng([20261202, seed])
    starts: dict[str, Any] = {"initial_low": [-1, -1], "initial_high": [1, 1]}
    if seed % 2:
        starts = {"initial_state": [0.3, -0.2]}
    same_kind = np.random.default_rng(seed)
    first = walker(same_kind, "a", "b", starts)
    twin = walker(np.random.default_rng(seed), "c", "b", starts)
    alone = walker(rng, "b", None, starts)
    cart = cg.LinearAgent(
        name="d",
        A=np.eye(2) + 0.2 * rng.standard_normal((2, 2)),
        B=[[0.0], [0.5]],
        noise_covariance=[[0.05, 0.02], [0.02, 0.04]],
        state_low=[-2, -2],
        state_high=[2, 2],
        input_low=[-1],
        input_high=[1],
        **starts,
    )
    boxes = {name: cg.Proposition(name, [-0.5, -1.0], [1.5, 1.0]) for name in "abcd"}
    return cg.Problem(
        name="walkers",
        horizon=6,
        agents=[first, alone, twin, cart],
        propositions={f"p_{name}": box for name, box in boxes.items()},
        specification=cg.Specification("F (p_a & F (p_b | p_d)) | G p_c", "finite-trace"),
    )


def walked(dynamics: Dynamics, worlds: core.Worlds, inputs: Any, normals: Any) -> list[np.ndarray]:
    """The next states (d, M) agent by agent, as expressions were stepped before: by walks over their trees."""
    agents, states, result = dynamics.problem.agents, [], []
    winds = core.disturbances(dynamics, worlds, inputs, normals)
    for block, place in dynamics.position:
        states.append(worlds.states[block][:, place])
    for i, agent in enumerate(agents):
        block, place = dynamics.position[i]
        x, u, z = states[i], inputs[block][:, place], normals[block][: len(states[i]), place]
        z = agent.components(z)
        if isinstance(agent, cg.LinearAgent):
            rows = [agent.A[k, 0] * x[0] + agent.A[k, 1] * x[1] for k in range(2)]
            means = np.stack([row + agent.B[k, 0] * u[0] + agent.offset[k] for k, row in enumerate(rows)])
        else:
            assert isinstance(agent, cg.Agent)
            wind = winds[block]
            assert wind is not None
            beside = np.stack([states[1][0]]) if agent.others else None
            means = agent.mean(x, u, wind[:, place], beside, worlds.time)
            z = agent.scales(x, u, wind[:, place], worlds.time) * z
        factor = agent.noise_factor
        result.append(np.stack([means[k] + (factor[k, 0] * z[0] + factor[k, 1] * z[1]) for k in range(2)]))
    return result


@pytest.mark.parametrize("behaviour", ["zero", "random", "periodic"])
@pytest.mark.parametrize("seed", range(4))
def test_steps_are_those_of_the_walk(seed: int, behaviour: str) -> None:
    """40 worlds, five steps, all bits; the first three worlds also one at a time."""
    problem = random_problem(seed)
    dynamics, rng = Dynamics.of(problem, behaviour), np.random.default_rng(seed)
    worlds, alone = core.initial(dynamics, rng, 40), SingleSimulator.of(dynamics)
    ones = [alone.begin(core.selected(worlds, np.array([k]))) for k in range(3)]
    for _ in range(5):
        normals = core.noise(dynamics, rng, 40)
        inputs = [rng.uniform(-1, 1, (1, len(block.agents), 40)) for block in dynamics.blocks]
        expected = walked(dynamics, worlds, inputs, normals)
        worlds = core.transition(dynamics, worlds, inputs, normals)
        flat = np.concatenate([z.reshape(-1, 40) for z in normals])
        for k, one in enumerate(ones):
            chosen = [inputs[block][:, place, k].tolist() for block, place in dynamics.position]
            ones[k] = alone.step(one, chosen, flat[:, k].tolist())
            assert (ones[k].q, ones[k].failed) == (worlds.q[k], worlds.failed[k])
        for i, (block, place) in enumerate(dynamics.position):
            assert same(worlds.states[block][:, place], expected[i])
            assert all(same(one.states[i], expected[i][:, k]) for k, one in enumerate(ones))


@pytest.mark.parametrize("name", ["0", "1", "reach-avoid-v0", "package-delivery-v0", "room-network-v0"])
def test_worlds_that_move_all_at_once_are_those_cut_out(name: str) -> None:
    """Thirty steps of 50 worlds, of which some begin anew in each: the same draws and bits as with worlds cut out."""
    problem = cg.make_problem(name) if "-" in name else random_problem(int(name))
    dynamics, choose = Dynamics.of(problem, "random"), np.random.default_rng(1)
    rngs = np.random.default_rng(0), np.random.default_rng(0)
    worlds = replace(core.initial(dynamics, rngs[0], 50), time=np.zeros(50, dtype=np.int64))
    core.initial(dynamics, rngs[1], 50)
    for step in range(30):
        inputs = [choose.uniform(-1, 1, (b.n_inputs, len(b.agents), 50)) for b in dynamics.blocks]
        which = (worlds.time >= problem.horizon) | (choose.random(50) < (0.1, 0.0, 1.0, 0.9)[step % 4])
        if step % 4 == 1 and (worlds.time >= problem.horizon).any():
            which = worlds.time >= problem.horizon
        found = core.moved_or_begun(dynamics, worlds, inputs, which, rngs[0])
        expected = cut_out(dynamics, worlds, inputs, which, rngs[1])
        assert all(same(a, b) for a, b in zip(found.states, expected.states))
        for mark in ("q", "time", "failed", "accepted"):
            assert (getattr(found, mark) == getattr(expected, mark)).all(), mark
        assert rngs[0].random() == rngs[1].random()
        worlds = found


def cut_out(
    dynamics: Dynamics, worlds: core.Worlds, inputs: Any, which: np.ndarray, rng: np.random.Generator
) -> core.Worlds:
    """What `moved_or_begun` says it does: begun ones by `restart`, moved ones by `transition` of these alone."""
    begun = core.restart(dynamics, worlds, which, rng)
    going = np.flatnonzero(~which)
    before = core.Worlds(
        tuple(x[..., going] for x in worlds.states),
        worlds.q[going],
        worlds.time[going],
        worlds.failed[going],
        worlds.accepted[going],
    )
    after = core.transition(dynamics, before, [u[..., going] for u in inputs], core.noise(dynamics, rng, len(going)))
    states = tuple(x.copy() for x in begun.states)
    for x, new in zip(states, after.states):
        x[..., going] = new
    marks = {name: np.array(getattr(begun, name)) for name in ("q", "time", "failed", "accepted")}
    for name, values in marks.items():
        values[going] = getattr(after, name)
    return core.Worlds(states, **marks)
