"""Values in the middle of a run, and shields, of certificates on grids of vertices."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.envs.simulation import Dynamics, Worlds, batch_simulator
from certigym.synthesis.extended_check.claims import VertexValues, greedy_disturbance
from certigym.synthesis.extended_check.shields import Shield, shield_of
from certigym.synthesis.extended_check.shields.shield_rule import Case, decentralised_choice
from certigym.synthesis.extended_check.shields.vertex_action_values import VertexActionValues
from certigym.synthesis.extended_check.vertex_grids import Backups
from shield_trials import anything, episodes, the_worst

FALSE_ALARM = 1e-6
"""Probability with which a statistical test here fails although all is right."""

EPISODES = 1_000


@cache
def certificate(kind: str) -> cg.Certificate:
    """Certificates on small grids: a room in the sun whose noise is of another law, a cart whose gusts grow."""
    room = cg.Agent(
        name="room", states=["T"], inputs=["u"], dynamics=["0.8*T + u + sun"], noise={"law": "laplace", "scale": 0.15},
        disturbances={"sun": [-0.1, 0.1]}, state_low=[-3], state_high=[3], input_low=[-0.5], input_high=[0.5],
        initial_state=[0.3],
    )  # fmt: skip
    cart = cg.Agent(
        name="cart", states=["x", "v"], inputs=["u"], dynamics=["x + 0.5*v", "0.9*v + 0.5*u"],
        noise_std=["0.1", "0.1 + 0.1*abs(v)"], state_low=[-2, -2], state_high=[2, 2], input_low=[-1], input_high=[1],
        initial_state=[-0.8, 0],
    )  # fmt: skip
    agent, region, formula, horizon = {
        "room": (room, cg.Proposition("room", [-1.0], [1.0]), "G goal", 6),
        "cart": (cart, cg.Proposition("cart", [0.4, -2.0], [1.6, 2.0]), "F goal", 8),
    }[kind]
    problem = cg.Problem(
        name=kind, agents=[agent], propositions={"goal": region}, specification=formula, horizon=horizon
    )
    found = cg.synthesize(problem, relation="vertices", effort=1.0).certificate
    assert found.lower_bound > 0.3
    return found


def made(kind: str, share: float, form: str = "joint") -> Shield:
    shield = shield_of(certificate(kind), share * certificate(kind).lower_bound, form)
    assert isinstance(shield, Shield) and isinstance(shield.values, VertexActionValues)
    return shield


def somewhere(problem: cg.Problem, count: int, seed: int) -> tuple[np.ndarray, int]:
    """Random states (count, d), and the automaton state that is undecided."""
    box, rng = problem.agents[0].workspace, np.random.default_rng(seed)
    states = box.low + (box.high - box.low) * rng.random((count, len(box.low)))
    return states, int(np.flatnonzero(~problem.automaton.absorbing)[0])


def refuted(success: np.ndarray, p: float) -> bool:
    """Whether so few successes have a probability below the false alarm if each has probability p or more."""
    return bool(binom.cdf(success.sum(), len(success), p) < FALSE_ALARM)


def stepped(problem: cg.Problem, worlds: Worlds, u: np.ndarray, wind: float, rng: np.random.Generator) -> Worlds:
    """Worlds one step later, under inputs (m, M) and disturbances that are all one end of their interval."""

    def ends(dynamics: Dynamics, worlds: Worlds, inputs: Any) -> tuple[np.ndarray | None, ...]:
        return (np.full((1, 1, worlds.n_worlds), wind) if problem.agents[0].disturbances else None,)

    dynamics = Dynamics.of(problem, ends)
    noise = batch_simulator.noise(dynamics, rng, worlds.n_worlds)
    return batch_simulator.transition(dynamics, worlds, (u[:, None],), noise)


def standing(problem: cg.Problem, x: np.ndarray, count: int, time: int) -> Worlds:
    """Worlds that are all at a state (d,) at a time, undecided but for its letter."""
    worlds = batch_simulator.initial_at(Dynamics.of(problem), np.repeat(x[None], count, axis=0))
    return replace(worlds, time=time)


WINDS = (-0.1, 0.1)


@pytest.mark.parametrize("kind", ["room", "cart"])
def test_runs_succeed_at_least_as_often_as_is_said_of_their_middle(kind: str) -> None:
    """From 6 states with 2 and 5 steps to go, 2,000 runs each; Hoeffding's limit at the false alarm for all of them."""
    held, count = certificate(kind), 2000
    problem, value, rng = held.problem, cg.value_in_time(held), np.random.default_rng(5)
    limit, over = np.sqrt(np.log(24 / FALSE_ALARM) / (2 * count)), list[float]()
    for left in (2, 5):
        for x in 0.5 * somewhere(problem, 6, left)[0]:
            for wind in WINDS:
                worlds = standing(problem, x, count, problem.horizon - left)
                said = float(value.at(x, int(worlds.q[0]), left)[0])
                for t in range(problem.horizon - left, problem.horizon):
                    u = held.controller.inputs(0, worlds.states[0][:, 0], worlds.q, t)
                    worlds = stepped(problem, worlds, u, wind, rng)
                success = float(np.mean(batch_simulator.satisfied(Dynamics.of(problem), worlds)))
                assert said <= success + limit
                over.append(success - said)
    assert min(over) < 0.1  # not far below, somewhere


@pytest.mark.parametrize("kind", ["room", "cart"])
def test_certified_inputs_are_worth_what_their_states_are(kind: str) -> None:
    shield = made(kind, 0.5)
    states, q = somewhere(shield.problem, 200, 1)
    x = (states.T,)
    for time in range(shield.problem.horizon):
        worth = shield.values.of_inputs(time, q, x, shield.certified_inputs(x, q, time))
        value = shield.values.of_states(x, np.full(200, q), np.full(200, time))
        assert np.all(worth >= value - 1e-6)
        assert worth.max() > 0.3


@pytest.mark.parametrize("kind", ["room", "cart"])
def test_inputs_are_worth_no_more_than_the_next_state_on_average(kind: str) -> None:
    """20 inputs, 4,000 next states each, for both ends of disturbances; Hoeffding's limit at the false alarm."""
    shield, rng, count, time = made(kind, 0.5), np.random.default_rng(3), 4000, 2
    problem, limit = shield.problem, np.sqrt(np.log(40 / FALSE_ALARM) / (2 * count))
    states, q = somewhere(problem, 20, 2)
    states[::2] *= 0.4
    inputs = anything(shield, (states.T,), np.full(20, q), np.full(20, time), rng)[0]
    worth = shield.values.of_inputs(time, q, (states.T,), (inputs,))
    assert worth.max() > 0.3
    for k, x in enumerate(states):
        for wind in WINDS:
            worlds = replace(standing(problem, x, count, time), q=np.full(count, q))
            worlds = stepped(problem, worlds, np.repeat(inputs[:, [k]], count, axis=1), wind, rng)
            value = shield.values.of_states((worlds.states[0][:, 0],), worlds.q, np.full(count, time + 1))
            assert worth[k] <= value.mean() + limit


@pytest.mark.parametrize(("kind", "form"), [("room", "joint"), ("cart", "decentralised")])
def test_nobody_can_break_the_promise(kind: str, form: str) -> None:
    shield = made(kind, 0.95, form)
    wind = greedy_disturbance(shield.values.certificate) if kind == "room" else "zero"
    for number, propose in enumerate((anything, the_worst)):
        found = episodes(shield, propose, EPISODES, number, disturbance=wind)
        assert not refuted(found["success"], shield.probability)
        assert found["slack"] >= 0.0
        assert np.all(found["budget"] <= found["success"])
        assert 0.0 < found["overridden"]


def test_what_disturbances_do_is_noticed_where_it_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """A shield that knows the middle of the sun alone is refuted by next states under both of its ends."""
    monkeypatch.setattr(Backups, "nodes", property(lambda steps: (np.zeros(2),)))
    with pytest.raises(AssertionError):
        test_inputs_are_worth_no_more_than_the_next_state_on_average("room")


def test_cells_that_are_given_up_are_worth_nothing() -> None:
    values, checked = VertexValues(certificate("cart")), 0
    for left, (_, given_up) in enumerate(values.tables):
        edges = values.steps.edges_at(len(values.tables) - 1 - left)
        middles = [0.5 * (axis[1:] + axis[:-1]) for axis in edges]
        for q, *cell in np.argwhere(given_up)[::50].tolist():
            at = np.array([[axis[k] for axis, k in zip(middles, cell, strict=True)]])
            assert values.at(at, np.array([q]), np.array([left]))[0] == 0.0
            checked += 1
    assert checked > 10


@pytest.mark.parametrize("worth", [0.0, np.nan])
def test_nobody_leaves_certified_inputs_that_are_worth_less_than_is_owed(worth: float) -> None:
    """Bounds on certified inputs may be a little below the value: then a proposal has nothing to be compared with."""

    class Short:
        def work(self, time: int, q: int) -> int:
            return 1

        def expected(self, time: int, q: int, i: int, states: Any, inputs: np.ndarray) -> np.ndarray:
            return np.where(inputs[:1] == 0.0, worth, 0.5)

    one = np.ones((1, 3))
    case = Case(0, 0, (one,), (one,), (0.0 * one,), (-one,), (one,), np.full(3, 1e-9))
    choice = decentralised_choice(Short(), case)  # type: ignore[arg-type]
    assert np.all(choice.overridden) and np.all(choice.inputs[0] == 0.0)
