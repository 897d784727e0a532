"""Actors of which nothing is certified become smoother ones that do about the same; others stay as they are."""

from __future__ import annotations

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.relations.kinds import Network
from certigym.validation.policies import smoothed, smoothing
from certigym.validation.policies.actors import CentralActor, SharedActor, TeamActor

torch = pytest.importorskip("torch", reason="needs the extra `rl`")

EPISODES = 20_000


def carts(n: int) -> cg.Problem:
    """Carts that are to stop in a place at the same time."""
    agents = [
        cg.LinearAgent(
            name=f"a{k}", A=[[1.0, 0.4], [0.0, 0.9]], B=[[0.0], [0.4]], noise=[0.03, 0.08],
            state_space=([-4, -3], [4, 3]), input_space=(-2, 2), start=[-1.5 - k, 0.0],
        )
        for k in range(n)
    ]  # fmt: skip
    goals = {f"g{k}": cg.Proposition(f"a{k}", [-0.7, -1.5], [0.9, 1.5]) for k in range(n)}
    return cg.Problem(name="carts", horizon=14, agents=agents, propositions=goals,
                      specification=cg.Specification(f"F ({' & '.join(goals)})"))  # fmt: skip


def rough(inputs: int, columns: int, pairs: list[tuple[int, int]]) -> Network:
    """Tanh layers ``-0.9 x - 0.9 v`` of pairs of scaled states; neurons bend much, and cancel in pairs."""
    first, last = np.zeros((48, columns)), np.zeros((inputs, 48))
    for k, (x, v) in enumerate(pairs):
        first[8 * k : 8 * k + 2, x], first[8 * k : 8 * k + 2, v] = 1.2, 0.9
        last[k, 8 * k : 8 * k + 2] = -0.75
        # two steep neurons of opposite signs add nothing, and the enclosure does not know it
        first[8 * k + 2 : 8 * k + 4, x] = 9.0
        last[k, 8 * k + 2], last[k, 8 * k + 3] = 8.0, -8.0
    zeros = np.zeros(48, np.float32), np.zeros(inputs, np.float32)
    return Network((first.astype(np.float32), last.astype(np.float32)), zeros, "tanh", False)


@pytest.fixture(autouse=True)
def few_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(smoothing, "ROUNDS", 900)
    monkeypatch.setattr(smoothing, "EPISODES", 150)


@pytest.mark.thorough
def test_smoother_actors_are_certified_and_succeed() -> None:
    """A central network of two carts whose neurons cancel, which the enclosure does not know."""
    problem = carts(2)
    columns = problem.n_states + problem.automaton.n_states + 1
    actor = CentralActor(problem, rough(2, columns, [(0, 1), (2, 3)]))
    found = smoothed(actor)
    assert isinstance(found.tried["as trained"], str) or found.tried["as trained"] < 0.9
    assert found.certified is not None and found.certified.certificate.lower_bound > 0.9
    assert len(found.actor.network.biases[0]) in (24, 12, 8)  # type: ignore[union-attr]
    assert cg.check(found.certified.certificate, problem)
    rate = cg.rollout(problem, found.actor, episodes=EPISODES, seed=0).successes / EPISODES
    assert rate >= found.certified.certificate.lower_bound - 0.01


def test_what_is_certified_stays_as_it_is() -> None:
    problem = carts(1)
    layers = (np.array([[-1.2, -0.9, 0.0, 0.0, 0.0, 0.0]], np.float32),), (np.zeros(1, np.float32),)
    actor = SharedActor(problem, Network(*layers, "tanh", False))
    found = smoothed(actor)
    assert found.actor is actor and list(found.tried) == ["as trained"]
    with pytest.raises(ValueError, match="one network for all agents"):
        smoothed(TeamActor(carts(2), (actor.network, actor.network)))
