"""Affine maps around networks hold every mean, lose second order, and no changed map passes the check."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.systems.agents import LinearAgent
from certigym.synthesis.extended_check.steps.network_enclosures import network_maps
from certigym.synthesis.relations.kinds import AffineBoxes, MapRelation, NetworkMaps, NetworkPolicy, check_description
from certigym.synthesis.relations.kinds.linear_means import linear_means
from certigym.synthesis.verbs.raw_networks import certify_network
from certigym.validation.policies.actors import SharedActor
from certigym.validation.policies.views import SharedView
from kinds import mostly_thorough
from network_problems import RNG, means_at, network, proportional, reach
from problems import cart, linear, scalar_agent

SHAPES = [
    ([8], "tanh", False),
    ([16, 16], "tanh", True),
    ([16, 16], "relu", False),
    ([8, 8, 8], "relu", True),
]


def maps_of(policy: NetworkPolicy, agent: LinearAgent) -> NetworkMaps:
    """Maps of an agent that a network moves."""
    return NetworkMaps(linear_means(agent), policy)


@pytest.mark.parametrize("hidden, activation, squashed", SHAPES)
@mostly_thorough("make", [lambda: scalar_agent("a"), cart])
def test_no_point_of_a_cell_leaves_its_map(
    hidden: list[int], activation: str, squashed: bool, make: Callable[[], LinearAgent]
) -> None:
    """Dense samples of closed cells, corners among them, lie within what maps leave: in the search and in the check."""
    agent = make()
    problem, d = reach(agent, horizon=2), agent.n_states
    view = SharedView(problem)
    actor = SharedActor(problem, network([view.size, *hidden, view.n_actions], activation, squashed))
    part = certify_network(problem, actor, 12 if d == 1 else 6).certificate.proof.agents[0]
    relation = part.relation_of(agent)
    assert isinstance(relation, MapRelation) and relation.means is not None
    low, high = part.grid.low, part.grid.high
    maps = relation.means.around(low, high, relation.input_set)
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * d)).reshape(d, -1).T
    shares = np.concatenate([RNG.random((100, d)), corners])
    for mode in range(2 * problem.automaton.n_states):
        t, q = divmod(mode, problem.automaton.n_states)
        z, gain, rho = network_maps(linear(agent), part, np.arange(part.grid.n_cells), mode)
        # Both have the same slopes; what the check encloses lies inside what the search does.
        assert np.allclose(gain, maps.gain[:, mode], atol=1e-8)
        assert np.all(np.abs(z - maps.centre[:, mode]) + rho <= maps.rest[:, mode])
        offsets = (shares - 0.5) * (high - low)[:, None]
        points = 0.5 * (low + high)[:, None] + offsets
        means = means_at(problem, actor, 0, points.reshape(-1, d).T, q, t).T.reshape(points.shape)
        for centre, slope, rest in ((z, gain, rho), (maps.centre[:, mode], maps.gain[:, mode], maps.rest[:, mode])):
            left = means - centre[:, None] - np.einsum("skj,spj->spk", slope, offsets)
            # The agent's own sum is rounded in double precision, which is not part of the maps of the check.
            assert np.all(np.abs(left) <= rest[:, None] + 1e-12)


def test_what_maps_leave_is_of_second_order() -> None:
    """With cells half as wide, what maps leave falls to about a quarter."""
    problem = reach(scalar_agent("a"))
    actor = SharedActor(problem, network([SharedView(problem).size, 16, 16, 1], "tanh", True))
    agent, rests = linear(problem.agents[0]), []
    for cells in (24, 48):
        edges = np.linspace(-4.0, 4.0, cells + 1)[:, None]
        input_set = np.zeros((problem.automaton.n_states, 1))
        boxes = maps_of(actor.agent_policy(0), agent).around(edges[:-1], edges[1:], input_set)
        rests.append(boxes.rest[:, 0].mean())
    assert rests[1] < 0.35 * rests[0]


def test_stable_relus_leave_rounding() -> None:
    """Where no relu has its kink in a cell, and nothing is clipped, the closed loop is affine."""
    problem = reach(scalar_agent("a"))
    net = network([SharedView(problem).size, 8, 1], "relu", scale=0.2)
    boxes = maps_of(SharedActor(problem, net).agent_policy(0), linear(problem.agents[0]))
    edges = np.linspace(-4.0, 4.0, 401)[:, None]
    rest = boxes.around(edges[:-1], edges[1:], np.zeros((1, 1))).rest[:, 0, 0]
    assert np.sum(rest > 1e-5) <= 8 + 2  # one cell for each kink, and the two ends of clipping
    assert np.median(rest) < 1e-6


@pytest.mark.thorough
def test_remainders_of_what_rounding_takes_are_stored_below_what_the_check_computes() -> None:
    """With many cells the search takes more off a step than the check, and remainders of 1e-9 are larger for it."""
    problem = cg.make_problem("reach-avoid-v0")
    cells = {"agent_0": 40, "agent_1": 1000}
    certificate = certify_network(problem, proportional(problem), cells).certificate
    largest = certificate.proof.terms.factors[1].max(axis=1)
    assert largest.max() > 0.8 and largest[largest > 0.0].min() < 1e-8
    assert cg.check(certificate)


def smaller(boxes: AffineBoxes) -> AffineBoxes:
    return dataclasses.replace(boxes, rest=0.99 * boxes.rest)


def nothing_left(boxes: AffineBoxes) -> AffineBoxes:
    return dataclasses.replace(boxes, rest=0.0 * boxes.rest)


def of_the_next_cell(boxes: AffineBoxes) -> AffineBoxes:
    return dataclasses.replace(boxes, gain=np.roll(boxes.gain, 1, axis=0))


def no_slope(boxes: AffineBoxes) -> AffineBoxes:
    return dataclasses.replace(boxes, gain=0.0 * boxes.gain)


@pytest.mark.parametrize("change", [smaller, nothing_left, of_the_next_cell, no_slope])
def test_maps_that_are_wrong_are_refused(
    change: Callable[[AffineBoxes], AffineBoxes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bounds that rest on wrong maps: what is left too small by a hundredth, slopes of another cell, or none."""
    problem = reach(scalar_agent("a"))
    actor, true = proportional(problem), NetworkMaps.around
    right = certify_network(problem, actor, 40)
    assert cg.check(right)
    monkeypatch.setattr(NetworkMaps, "around", lambda self, *arguments: change(true(self, *arguments)))
    wrong = certify_network(problem, actor, 40).certificate
    monkeypatch.undo()
    assert change is of_the_next_cell or wrong.lower_bound > right.certificate.lower_bound
    report = cg.check(wrong)
    assert not report, change.__name__


def test_squashing_that_was_left_out_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Maps of the search that clip where the network is squashed, so that it seems to act more strongly."""
    problem = reach(scalar_agent("a"))
    clipped = proportional(problem)
    actor = SharedActor(problem, dataclasses.replace(clipped.network, squashed=True))
    right, true = certify_network(problem, actor, 60), NetworkMaps.around

    def unsquashed(self: NetworkMaps, *arguments: Any) -> AffineBoxes:
        plain = dataclasses.replace(self.policy, network=dataclasses.replace(self.policy.network, squashed=False))
        return true(dataclasses.replace(self, policy=plain), *arguments)

    monkeypatch.setattr(NetworkMaps, "around", unsquashed)
    wrong = certify_network(problem, actor, 60).certificate
    monkeypatch.undo()
    assert wrong.proof.agents[0].relation["network"]["squashed"] and wrong.lower_bound > right.certificate.lower_bound
    assert cg.check(right) and not cg.check(wrong)


def test_files_with_other_choices_than_modes_are_refused() -> None:
    """A menu that is longer than there are times and automaton states."""
    problem = reach(scalar_agent("a"))
    part = certify_network(problem, proportional(problem), 30).certificate.proof.agents[0]
    check_description(part.relation, problem.agents[0])
    with pytest.raises(ValueError, match="other choices"):
        check_description({**part.relation, "menu": [*part.relation["menu"], [0.0]]}, problem.agents[0])
    with pytest.raises(ValueError, match="reach"):
        check_description({**part.relation, "reach": [10**9]}, problem.agents[0])
