"""The reward "progress" pays a success more than any failure, each agent for its own share, and leads around walls."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.interfaces.shaping import EASE, SURVIVAL, Potential
from certigym.envs.interfaces.tour import CELLS, Tour, cells_of, detours
from certigym.envs.simulation import batch_simulator as core

IDS = ["reach-avoid-v0", "patrol-recharge-v0", "package-delivery-v0", "meeting-v0", "building-automation-v0"]


def returns(envs: Any, policy: Any, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Undiscounted returns of one episode per world, whether each was satisfied, and the last joint states."""
    observations, infos = envs.reset(seed=seed)
    total, over = np.zeros(envs.num_envs), np.zeros(envs.num_envs, dtype=bool)
    satisfied, last = np.zeros(envs.num_envs, dtype=bool), infos["state"].copy()
    while not over.all():
        observations, rewards, terminated, truncated, infos = envs.step(policy(observations))
        total += np.where(over, 0.0, rewards)
        ended = (terminated | truncated) & ~over
        satisfied[ended], last[~over] = infos["satisfied"][ended], infos["state"][~over]
        over |= ended
    return total, satisfied, last


def test_agents_earn_half_of_what_they_do_themselves_and_half_of_what_the_team_does() -> None:
    """What one of four robots does changes its own reward by 1/2 + 1/8 of the difference, those of others by 1/8."""
    own, team = [], []
    for action in (-0.2, 0.2):
        joint = np.tile([action, *np.zeros(7)], (50, 1))
        envs = cg.vector_env("swarm-v0", 50, reward="progress", credit="own")
        envs.reset(seed=0)
        rewards = envs.step(joint)[1]
        own.append(envs.own_rewards)
        assert rewards == pytest.approx(envs.own_rewards.mean(axis=0))
        plain = cg.vector_env("swarm-v0", 50, reward="progress")
        plain.reset(seed=0)
        team.append(plain.step(joint)[1])
        assert team[-1] == pytest.approx(rewards, abs=1e-12)
    gained = own[1] - own[0]
    assert (np.abs(gained[0]) > 0.001).all()
    assert gained[1:] == pytest.approx(np.tile(gained[0] / 5.0, (3, 1)))
    sparse = cg.vector_env("swarm-v0", 5, credit="own")
    sparse.reset(seed=0)
    assert sparse.step(np.zeros((5, 8)))[1].shape == (5,) and sparse.own_rewards.shape == (4, 5)
    with pytest.raises(ValueError, match="`credit`"):
        cg.vector_env("swarm-v0", 5, credit="all")


@pytest.mark.parametrize("id", IDS)
def test_a_success_earns_more_than_any_failure(id: str) -> None:
    """The proof on the page of learned policies: h on success, at most h - 1 - loss or h - 2 on failure."""
    problem = cg.make_problem(id)
    found = potential(id)
    envs = cg.vector_env(id, 2000, reward="progress")
    first = envs.reset(seed=0)[1]["state"]
    begun = found.progress(core.initial_at(core.Dynamics.of(problem), first))
    rng, shape = np.random.default_rng(0), envs.action_space.shape
    total, satisfied, _ = returns(envs, lambda _: rng.uniform(-1.0, 1.0, shape), 0)
    ease = EASE + SURVIVAL if found.is_survival else 0.0
    earned = total + begun
    assert earned[satisfied] == pytest.approx(1.0 + found.parts + ease)
    assert (earned[~satisfied] <= found.parts + ease - found.loss() + 1e-9).all()
    assert (earned > -found.loss() - 1e-9).all()


def potential(id: str) -> Potential:
    return Potential.of(core.Dynamics.of(cg.make_problem(id)))


@pytest.mark.parametrize("id", ["patrol-recharge-v0", "building-automation-v0"])
def test_ease_is_the_chance_under_letters_at_random(id: str) -> None:
    """Against the sum over all letters, two steps before the horizon and earlier."""
    problem = cg.make_problem(id)
    automaton, found = problem.automaton, potential(id).ease
    count, last = len(automaton.propositions), problem.horizon
    letters = np.array(list(product([False, True], repeat=count))).T
    chance = automaton.accepting.astype(float)
    for time in range(last, last - 4, -1):
        alive = chance > 0.0
        logs = np.log(chance[alive])
        span = logs.max() - logs.min()
        assert found[time, alive] == pytest.approx((logs - logs.min()) / span if span else np.ones_like(logs))
        assert not found[time, ~alive].any()
        following = [automaton.next_state(np.full(letters.shape[1], q), letters) for q in range(automaton.n_states)]
        chance = np.array([chance[states].mean() for states in following])


@pytest.mark.parametrize("id", ["car-slalom-v0", "package-delivery-single-v0"])
def test_ways_lead_around_what_loses_the_task(id: str) -> None:
    """For linear agents and for written ones: each cell is one step behind its nearest neighbour."""
    dynamics, found = core.Dynamics.of(cg.make_problem(id)), potential(id)
    q = next(q for q, letter in enumerate(found.route) if found.avoided[q] and letter.size)
    ((agent, tables),) = detours(dynamics, found.route, found.avoided).items()
    ways = tables[q].reshape(CELLS, CELLS)
    padded = np.pad(ways, 1, constant_values=np.inf)
    nearest = np.minimum.reduce([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
    free = (ways > 0.0) & (ways < ways.max())
    assert free.sum() > CELLS and ways[free] == pytest.approx(nearest[free] + 0.5 / CELLS)
    number, place = dynamics.position[agent]
    start = cells_of(dynamics.blocks[number], [place])(dynamics.blocks[number].initial_low)[0]
    straight = Tour.of(dynamics)._way({}, frozenset(found.route[q].tolist()), frozenset())
    assert ways.ravel()[start[0]] > straight + (0.1 if id == "car-slalom-v0" else -1.0 / CELLS)
