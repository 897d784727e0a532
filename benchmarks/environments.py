"""Environment steps per CPU second, beside a classic-control environment of Gymnasium in the same run.

`python benchmarks/environments.py [ID] [--seconds S] [--json PATH]`, or `--ratios` for ratios to environments of
others: these are taken in turns, since the speed of a machine changes while it measures. A joint step moves all
agents of one world; resets count, because episodes end. Actions are drawn before the clock starts. CPU time is that of
the process (one core; numpy's threads have nothing to do in arrays of this size).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

import certigym as cg
from certigym.envs.dynamics import worlds as core

CHUNK = 2000


def rate(steps: Callable[[], int], seconds: float) -> float:
    """Return steps per CPU second: the best of three runs, each of a third of the time."""
    steps()
    best = 0.0
    for _ in range(3):
        began, count = time.process_time(), 0
        while (passed := time.process_time() - began) < seconds / 3:
            count += steps()
        best = max(best, count / passed)
    return best


def batch_core(problem: cg.Problem) -> Callable[[], int]:
    dynamics, rng = core.Dynamics.of(problem), np.random.default_rng(0)
    inputs = []
    for block in dynamics.blocks:
        shape = (*block.input_low.shape[:2], CHUNK)
        inputs.append(block.input_low + (block.input_high - block.input_low) * rng.random(shape))

    def steps() -> int:
        worlds = core.initial(dynamics, rng, CHUNK)
        for _ in range(problem.horizon):
            worlds = core.transition(dynamics, worlds, inputs, core.noise(dynamics, rng, CHUNK))
        return CHUNK * problem.horizon

    return steps


def batched(envs: Any) -> Callable[[], int]:
    envs.action_space.seed(0)
    envs.reset(seed=0)
    actions = [envs.action_space.sample() for _ in range(4)]

    def steps() -> int:
        for action in actions:
            envs.step(action)
        return len(actions) * int(envs.num_envs)

    return steps


def teams(problem: cg.Problem, n_worlds: int = CHUNK, **options: Any) -> Callable[[], int]:
    team = cg.team_env(problem, n_worlds, **options)
    team.reset(seed=0)
    rng = np.random.default_rng(0)
    sizes = dict(zip(team.agents, (agent.n_inputs for agent in problem.agents), strict=True))
    actions = [{name: rng.uniform(-1, 1, (n_worlds, size)) for name, size in sizes.items()} for _ in range(4)]

    def steps() -> int:
        for action in actions:
            team.step(action)
        return len(actions) * n_worlds

    return steps


def parallel(problem: cg.Problem, **options: Any) -> Callable[[], int]:
    return joint_steps(cg.parallel_env(problem, **options))


def joint_steps(env: Any) -> Callable[[], int]:
    """Return 500 joint steps of an environment of PettingZoo, whosever it is."""
    for agent in env.possible_agents:
        env.action_space(agent).seed(0)
    actions = [{agent: env.action_space(agent).sample() for agent in env.possible_agents} for _ in range(64)]

    def steps() -> int:
        count = 0
        while count < 500:
            env.reset()
            while env.agents:
                env.step(actions[count % 64])
                count += 1
        return count

    return steps


def scalar(env: Any) -> Callable[[], int]:
    env.action_space.seed(0)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(64)]

    def steps() -> int:
        for k in range(500):
            _, _, terminated, truncated, _ = env.step(actions[k % 64])
            if terminated or truncated:
                env.reset()
        return 500

    return steps


def frames(problem: cg.Problem) -> Callable[[], int]:
    env = cg.parallel_env(problem, render_mode="rgb_array")
    env.reset(seed=0)

    def steps() -> int:
        for _ in range(20):
            env.render()
        return 20

    return steps


def measure(id: str, seconds: float) -> dict[str, float]:
    problem = cg.make_problem(id)
    shaped = cg.vector_env(problem, CHUNK, reward="shaped")
    return {
        "batch core (joint steps)": rate(batch_core(problem), seconds),
        f"VectorEnv, {CHUNK} worlds": rate(batched(cg.vector_env(problem, CHUNK)), seconds),
        f"VectorEnv, {CHUNK} worlds, shaped": rate(batched(shaped), seconds),
        f"TeamEnv, {CHUNK} worlds": rate(teams(problem), seconds),
        f"TeamEnv, {CHUNK} worlds, joint": rate(teams(problem, observation="joint"), seconds),
        f"TeamEnv, {CHUNK} worlds, raw states": rate(teams(problem, scale="raw", automaton="number"), seconds),
        "VectorEnv, 64 worlds": rate(batched(cg.vector_env(problem, 64)), seconds),
        "ParallelEnv (joint steps)": rate(parallel(problem), seconds),
        "ParallelEnv, full observation": rate(parallel(problem, observation="full"), seconds),
        "centralised env": rate(scalar(cg.central_env(problem)), seconds),
        "Gymnasium Pendulum-v1": rate(scalar(gymnasium.make("Pendulum-v1").unwrapped), seconds),
        "Gymnasium CartPole-v1": rate(scalar(gymnasium.make("CartPole-v1").unwrapped), seconds),
        "Gymnasium CartPole-v1, 2000 worlds": rate(batched(gymnasium.make_vec("CartPole-v1", CHUNK)), seconds),
        "pictures (rgb_array)": rate(frames(problem), seconds),
    }


def spread_of_three() -> Callable[[], int]:
    """Simple spread of MPE2, three agents (`pip install mpe2`)."""
    from mpe2 import simple_spread_v3

    return joint_steps(simple_spread_v3.parallel_env(N=3, max_cycles=25))


def in_turns(one: Callable[[], int], other: Callable[[], int], seconds: float) -> float:
    """Return how many steps one takes for each step of the other: the median of nine pairs of short measurements."""
    one(), other()
    return float(np.median([rate(one, seconds / 9) / rate(other, seconds / 9) for _ in range(9)]))


RATIO_WORLDS = 1024


def ratios(seconds: float) -> dict[str, float]:
    """Return the ratios; that to MPE2 only where it is installed."""
    single = parallel(cg.make_problem("reach-avoid-v0"))
    numbers = {
        "dubins-team-v0 to reach-avoid-v0, one world": in_turns(
            parallel(cg.make_problem("dubins-team-v0")), single, seconds
        )
    }
    try:
        numbers["room-network-v0 to MPE2's spread of three"] = in_turns(
            parallel(cg.make_problem("room-network-v0")), spread_of_three(), seconds
        )
    except ImportError:
        print("mpe2 is not installed: one ratio less")
    poles = batched(gymnasium.make_vec("CartPole-v1", RATIO_WORLDS))
    for id in ("reach-avoid-v0", "dubins-team-v0"):
        problem = cg.make_problem(id)
        several = batched(cg.vector_env(problem, RATIO_WORLDS))
        numbers[f"vector_env of {RATIO_WORLDS} {id} to CartPole's"] = in_turns(several, poles, seconds)
        team = teams(problem, RATIO_WORLDS)
        numbers[f"team_env of {RATIO_WORLDS} {id} to CartPole's"] = in_turns(team, poles, seconds)
    return numbers


def main() -> None:
    parser = argparse.ArgumentParser(description="Environment steps per CPU second.")
    parser.add_argument("id", nargs="?", default="reach-avoid-v0")
    parser.add_argument("--seconds", type=float, default=2.0, help="CPU seconds for each row (default: 2)")
    parser.add_argument("--json", help="write the numbers to this file")
    parser.add_argument("--ratios", action="store_true", help="measure ratios to environments of others instead")
    options = parser.parse_args()
    if options.ratios:
        for name, value in ratios(options.seconds).items():
            print(f"{name:<55} {value:>6.2f}")
        return
    numbers = measure(options.id, options.seconds)
    print(f"{options.id}: per CPU second")
    for name, value in numbers.items():
        print(f"{name:<40} {value:>14,.0f}")
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump({"id": options.id, "per_cpu_second": numbers}, file, indent=1)


if __name__ == "__main__":
    main()
