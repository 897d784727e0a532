"""The reward "progress" tells a good failure from a bad one, leads along the shortest tour, and keeps the task."""

from __future__ import annotations

from itertools import permutations, product
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.interfaces.shaping import DEATH, EASE, SURVIVAL, Potential
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


def test_progress_tells_a_good_failure_from_a_bad_one() -> None:
    """One step towards the goal and one away from it: "shaped" pays the same for both, "progress" does not."""
    problem = cg.make_problem("reach-avoid-v0", initial_state=[-10.0, -4.0], horizon=1)
    paid: dict[str, list[float]] = {}
    for reward in ("shaped", "progress"):
        envs = cg.vector_env(problem, 200, reward=reward)
        for action in (-1.0, 1.0):
            total, satisfied, _ = returns(envs, lambda o, a=action: np.tile([a, 0.0], (200, 1)), 0)
            assert not satisfied.any()
            paid.setdefault(reward, []).append(float(total.mean()))
    assert paid["shaped"][0] == pytest.approx(paid["shaped"][1])
    assert paid["progress"][1] > paid["progress"][0] + 0.05


def test_a_lost_task_keeps_its_level() -> None:
    """Survival counts for tasks that are judged at the horizon: whoever fails later has the larger return."""
    problem = cg.make_problem("invariance-v0", n_agents=1)
    envs = cg.vector_env(problem, 300, reward="progress")
    assert not problem.automaton.is_co_safe
    envs.reset(seed=0)
    total, over, times = np.zeros(300), np.zeros(300, dtype=bool), np.zeros(300)
    while not over.all():
        _, rewards, terminated, truncated, infos = envs.step(np.ones((300, 1)))
        total += np.where(over, 0.0, rewards)
        times[~over] = infos["time"][~over]
        over |= terminated | truncated
    lost = ~infos["satisfied"]
    assert lost.any()
    # Every step survived pays a share of the horizon; the step that loses costs, wherever it is.
    assert total[lost] == pytest.approx(SURVIVAL * (times[lost] - 1) / problem.horizon - DEATH)


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


def test_the_route_is_the_shortest_tour() -> None:
    """Against all orders of the four customers, with ways through the pond counted twice.

    Ways lead from the middle of home to that point of each square that is nearest to it.
    """
    problem = cg.make_problem("courier-v0")
    found, names = potential("courier-v0"), problem.automaton.propositions
    order, q = [], problem.automaton.initial
    while found.route[q].size:
        letter = np.isin(np.arange(len(names)), found.route[q])[:, None]
        order.append(names[int(found.route[q][0])])
        q = int(problem.automaton.next_state(np.array([q]), letter)[0])
    assert order[-1] == "home"

    pond = problem.propositions["pond"]

    def length(customers: tuple[str, ...]) -> float:
        total, at = 0.0, np.zeros(2)
        for name in (*customers, "home"):
            region = problem.propositions[name]
            there = np.clip(np.zeros(2), region.low, region.high)
            points = at + np.linspace(0.0, 1.0, 1001)[:, None] * (there - at)
            wet = ((pond.low < points) & (points < pond.high)).all(axis=1).any()
            total += (2.0 if wet else 1.0) * float((np.abs(there - at) / [12.0, 10.0]).mean())
            at = there
        return total

    assert length(tuple(order[:-1])) == pytest.approx(min(map(length, permutations(order[:-1]))))


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
