"""A problem of the suite as a task of BenchMARL: ``BenchmarlTask("meeting-v0", {})`` (needs benchmarl, no extra)."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from benchmarl.environments.pettingzoo.common import PettingZooClass
from benchmarl.experiment import Callback
from torchrl.envs import PettingZooWrapper

import certigym as cg


class TimeOver(Exception):
    """The time is over: an experiment fixes the number of its iterations before the first of them."""


class StopAfter(Callback):
    """Ends a training after some seconds of wall time, by `TimeOver`."""

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self.until = time.perf_counter() + seconds

    def on_train_end(self, training_td: Any, group: str) -> None:
        if time.perf_counter() > self.until:
            raise TimeOver


class BenchmarlTask(PettingZooClass):
    """A problem by its id, with options of `parallel_env`; the rest is as for all PettingZoo tasks."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], PettingZooWrapper]:
        """Return a function that makes the environment, with the joint state for central critics."""
        env = partial(cg.parallel_env, self.name, actions="unit", dtype="float32", **self.config)
        return lambda: PettingZooWrapper(env(), return_state=True, seed=seed, device=device)

    def supports_continuous_actions(self) -> bool:
        return True

    def supports_discrete_actions(self) -> bool:
        return False

    def has_state(self) -> bool:
        return True

    def has_render(self, env: Any) -> bool:
        return False

    def max_steps(self, env: Any) -> int:
        return cg.make_problem(self.name).horizon
