"""Every id through the checkers of the libraries: ``python benchmarks/conformance.py [ID ...] [--json PATH]``.

For each id: PettingZoo's tests of the parallel and of the turn-based environment, of their seeds and of the state;
Gymnasium's checker; that of Stable-Baselines3; making by name with both libraries; batches by `gymnasium.make_vec`; and
whole episodes, which must repeat with a seed, after pickling too. Warnings are failures. Prints what failed and how
many checks passed; `tests/envs/test_every_id_conforms.py` runs the same checks, so a new id has to pass all of them.
"""

from __future__ import annotations

import argparse
import io
import json
import pickle
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import Any

import gymnasium
import numpy as np
import pettingzoo
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test
from pettingzoo.test.state_test import state_test

import certigym as cg
from certigym.envs.suite.ids import gymnasium_id

UNBOUNDED = ".*(observation|state) space (minimum |maximum )?value is -?infinity"
"""The one warning that is no failure: states may leave workspaces, so spaces do not bound them."""


def parallel(id: str) -> None:
    """Run PettingZoo's test of parallel environments."""
    parallel_api_test(cg.parallel_env(id), num_cycles=60)


def parallel_seed(id: str) -> None:
    """Run PettingZoo's test of the seeds of parallel environments."""
    parallel_seed_test(lambda: cg.parallel_env(id))


def turns(id: str) -> None:
    """Run PettingZoo's test of turn-based environments, for some turns of every agent."""
    api_test(cg.aec_env(id), num_cycles=20)


def turns_seed(id: str) -> None:
    """Run PettingZoo's test of the seeds of turn-based environments."""
    seed_test(lambda: cg.aec_env(id), num_cycles=10)


def state(id: str) -> None:
    """Run PettingZoo's test of the state that central critics read."""
    state_test(cg.aec_env(id), cg.parallel_env(id))


def central(id: str) -> None:
    """Run Gymnasium's checker; windows, which need pygame, are left out."""
    check_env(cg.central_env(id), skip_render_check=True)


def stable_baselines(id: str) -> None:
    """Run the checker of Stable-Baselines3."""
    from stable_baselines3.common.env_checker import check_env as check

    check(cg.central_env(id), warn=True)


def names(id: str) -> None:
    """Make the environment by both of its names with both libraries, with an argument."""
    for name in (f"certigym/{id}", gymnasium_id(id)):
        assert gymnasium.make(name, horizon=3).unwrapped.problem.horizon == 3  # type: ignore[attr-defined]
        assert pettingzoo.make("parallel", name, horizon=3).problem.horizon == 3
        assert str(pettingzoo.make("aec", name)) == str(cg.parallel_env(id))


def batches(id: str) -> None:
    """Step a batch made by name past an end: spaces hold, a seed repeats, Gymnasium's wrapper counts the episodes."""
    records = []
    for _ in range(2):
        envs = gymnasium.make_vec(gymnasium_id(id), num_envs=3, horizon=4)
        counted = RecordEpisodeStatistics(envs)
        counted.action_space.seed(0)
        record: list[Any] = [counted.reset(seed=0)]
        assert record[0][0] in counted.observation_space
        for _ in range(6):
            actions = counted.action_space.sample()
            observations, rewards, terminated, truncated, infos = counted.step(actions)
            assert observations in counted.observation_space
            assert rewards.shape == terminated.shape == truncated.shape == (3,)
            # The wrapper adds how long an episode took, which no seed repeats.
            record.append((observations, rewards, terminated, truncated, infos["state"], infos["automaton_state"]))
        assert counted.episode_count >= 3
        records.append(record)
    assert data_equivalence(records[0], records[1])


def episodes(id: str) -> None:
    """Repeat whole episodes with a seed, 0 as well, and with a pickled environment."""
    env = cg.central_env(id)
    first, second = _episode(env, 0), _episode(env, 1)
    assert not data_equivalence(first, second)
    assert data_equivalence([first, second], [_episode(env, 0), _episode(env, 1)])
    assert data_equivalence(first, _episode(pickle.loads(pickle.dumps(env)), 0))


def _episode(env: Any, seed: int) -> list[Any]:
    """Return all that an episode under actions that are drawn with a seed tells."""
    rng = np.random.default_rng(0)
    record: list[Any] = [env.reset(seed=seed)]
    while len(record) == 1 or not (record[-1][2] or record[-1][3]):
        record.append(env.step(rng.uniform(-1.0, 1.0, env.action_space.shape)))
    return record


CHECKS: dict[str, Callable[[str], None]] = {
    "PettingZoo, parallel": parallel,
    "PettingZoo, parallel, seeds": parallel_seed,
    "PettingZoo, turns": turns,
    "PettingZoo, turns, seeds": turns_seed,
    "PettingZoo, state": state,
    "Gymnasium": central,
    "Stable-Baselines3": stable_baselines,
    "made by name": names,
    "batches": batches,
    "whole episodes": episodes,
}
"""The checks by name; each takes an id, and raises if something is wrong."""


def outcome(check: Callable[[str], None], id: str) -> str:
    """Return what a check says about an id: nothing if it passes."""
    with warnings.catch_warnings(), redirect_stdout(io.StringIO()):  # some checkers say that all is well
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", UNBOUNDED)
        try:
            check(id)
        except Exception as error:  # noqa: BLE001 (whatever a foreign checker raises is a finding)
            return f"{type(error).__name__}: {error}"
    return ""


def main() -> None:
    """Print a line for each check, and the number of all that passed."""
    parser = argparse.ArgumentParser(description="Every id through the checkers of the libraries.")
    parser.add_argument("ids", nargs="*", help="some ids (default: all)")
    parser.add_argument("--json", help="write the numbers to this file")
    options = parser.parse_args()
    ids = options.ids or cg.problem_ids()
    passed: dict[str, int] = {}
    for name, check in CHECKS.items():
        said = {id: outcome(check, id) for id in ids}
        passed[name] = sum(not text for text in said.values())
        print(f"{name:<30} {passed[name]:>4} of {len(ids)}", flush=True)
        for id, text in said.items():
            if text:
                print(f"    {id}: {text}")
    print(f"{'all':<30} {sum(passed.values()):>4} of {len(ids) * len(CHECKS)}")
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump({"ids": len(ids), "passed": passed}, file, indent=1)


if __name__ == "__main__":
    main()
