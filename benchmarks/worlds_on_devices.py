"""Joint steps per second of `team_env` with its worlds on devices, beside numpy.

`python benchmarks/worlds_on_devices.py [DEVICE ...] [--json PATH]`, for example `torch:cpu torch:cuda jax:cpu`. A joint
step moves all agents of one world, ends and new episodes included. Numbers of worlds grow, because devices need many.
Time is wall-clock time, after a first step; a device is waited for before the clock is read. jax runs the compiled
step, whose random numbers are drawn outside of it.
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import certigym as cg
from certigym.envs.arrays import LIBRARIES, device_put
from measuring import save, show

IDS = ("reach-avoid-v0", "meeting-v0", "invariance-b-20-v0", "dubins-team-v0")
"""Two small teams, twenty agents, and agents written as expressions."""

WORLDS = (2_000, 20_000, 200_000)
SECONDS = 1.0


def rate(steps: Callable[[], Any], wait: Callable[[Any], Any], worlds: int) -> float:
    """Return joint steps per second: the best of three runs."""
    wait(steps())
    best = 0.0
    for _ in range(3):
        began, count, last = time.perf_counter(), 0, None
        while time.perf_counter() - began < SECONDS / 3:
            last = steps()
            count += worlds
        wait(last)
        best = max(best, count / (time.perf_counter() - began))
    return best


def measured(id: str, device: str, worlds: int) -> float:
    """Return joint steps per second of one problem on one device."""
    env: Any = cg.team_env(id, worlds, device=device)
    env.reset(seed=0)
    put = device_put(device, LIBRARIES)
    rng = np.random.default_rng(0)
    sizes = zip(env.agents, env.problem.agents, strict=True)
    actions = {name: put(rng.uniform(-1.0, 1.0, (worlds, agent.n_inputs))) for name, agent in sizes}
    if device.startswith("jax"):
        return rate(compiled(env, actions), lambda reward: reward.block_until_ready(), worlds)
    waiting = importlib.import_module("torch").cuda.synchronize if "cuda" in device else None
    return rate(lambda: env.step(actions).rewards, lambda _: waiting() if waiting else None, worlds)


def compiled(env: Any, actions: Any) -> Callable[[], Any]:
    """Return the step that jax has compiled."""
    state = env.state

    def pure(state: Any, actions: Any, drawn: Any) -> Any:
        following, step = env.advance(state, actions, drawn)
        return following, step.rewards, step.observations

    fast = importlib.import_module("jax").jit(pure)

    def steps() -> Any:
        nonlocal state
        state, rewards, _ = fast(state, actions, env.draw())
        return rewards

    return steps


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("devices", nargs="*", default=["torch:cpu"], metavar="DEVICE")
    parser.add_argument("--json", metavar="PATH")
    chosen = parser.parse_args()
    devices = chosen.devices
    if any(device.startswith("jax") for device in devices):
        importlib.import_module("jax").config.update("jax_enable_x64", True)
    rows = []
    for id in IDS:
        for worlds in WORLDS:
            numbers = {device: measured(id, device, worlds) / 1e6 for device in ("numpy", *devices)}
            ratios = {f"{device} / numpy": numbers[device] / numbers["numpy"] for device in devices}
            rows.append({"id": id, "worlds": worlds, **{f"{d} (M/s)": v for d, v in numbers.items()}, **ratios})
    show("million joint steps per second", rows)
    save({"worlds_on_devices": rows}, chosen.json)


if __name__ == "__main__":
    main()
