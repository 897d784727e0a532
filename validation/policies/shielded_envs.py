"""Environments of one world behind a shield: PettingZoo, tasks side by side, and the centralised Gymnasium one.

They are the environments of `certigym.envs.interfaces`, with the same spaces, rewards and ends. What is applied may be
another input than the one proposed. Infos say more: `budget` (the success probability that is still owed), `value` (the
certified value of the present state), and `overridden`: whether the last proposal was not let through, in the
centralised environment whether that of any agent was not.

`reset` refuses a start that the certificate does not cover.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...envs.interfaces import CentralEnv, ProblemEnv, TasksEnv
from ...envs.tasks.problem import Problem
from ...synthesis.extended_check.shields import ProductShield, Shield
from .watch import Watch


class OneWatch:
    """The watch over one world of an episode."""

    def __init__(self, shield: Shield) -> None:
        self.watch = Watch(shield, 1)
        self.fresh = True

    def judged(self, world: Any, inputs: list[list[float]]) -> list[list[float]]:
        """Return the inputs that are applied."""
        moving = np.array([not (world.failed or world.accepted)])
        proposed = tuple(np.array(u, dtype=float)[:, None] for u in inputs)
        return [u[:, 0].tolist() for u in self.watch.judge(*self._seen(world), moving, proposed)]

    def seen(self, world: Any) -> None:
        """Note the world after a reset or a step."""
        one = np.ones(1, dtype=bool)
        if self.fresh:
            self.watch.begin(*self._seen(world), one)
        else:
            self.watch.arrive(*self._seen(world), one)
        self.fresh = False

    @property
    def numbers(self) -> dict[str, float]:
        """Budget and value, for infos."""
        return {"budget": float(self.watch.budget[0]), "value": float(self.watch.value[0])}

    def _seen(self, world: Any) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
        states = tuple(np.array(x, dtype=float)[:, None] for x in world.states)
        return states, np.array([world.q]), np.array([world.time])


class ShieldedEnv(ProblemEnv):
    """Parallel environment behind a shield; see the module docstring.

    Parameters
    ----------
    problem : Problem
    shield : Shield
    render_mode, **options
        As for `ProblemEnv`.
    """

    def __init__(self, problem: Problem, shield: Shield, render_mode: str | None = None, **options: Any) -> None:
        super().__init__(problem, render_mode, **options)
        self.shield, self._guard = shield, OneWatch(shield)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Begin an episode; see `ProblemEnv.reset`."""
        self._guard.fresh = True
        return super().reset(seed, options)

    def _inputs(self, actions: dict[str, Any]) -> list[list[float]]:
        return self._guard.judged(self._episode.world, super()._inputs(actions))

    def _infos(self) -> dict[str, dict[str, Any]]:
        self._guard.seen(self._episode.world)
        overridden = self._guard.watch.overridden[:, 0].tolist()
        pairs = zip(super()._infos().items(), overridden, strict=True)
        return {name: {**info, **self._guard.numbers, "overridden": was} for (name, info), was in pairs}


class ShieldedTasksEnv(TasksEnv):
    """Parallel environment of independent tasks, each behind a shield of its own; its infos speak of its own task.

    Parameters
    ----------
    problem : Problem
    shield : ProductShield
    render_mode, **options
        As for `TasksEnv`.
    """

    def __init__(self, problem: Problem, shield: ProductShield, render_mode: str | None = None, **options: Any) -> None:
        super().__init__(problem, render_mode, **options)
        self.shield = shield
        pairs = zip(self.tasks, shield.parts, strict=True)
        self.tasks = tuple(ShieldedEnv(task.problem, part, render_mode, **task.options) for task, part in pairs)
        self._task_of = {name: task for task in self.tasks for name in task.possible_agents}


class ShieldedCentralEnv(CentralEnv):
    """Centralised environment behind a shield; see the module docstring.

    Parameters
    ----------
    problem : Problem
    shield : Shield
    render_mode, **options
        As for `CentralEnv`.
    """

    def __init__(self, problem: Problem, shield: Shield, render_mode: str | None = None, **options: Any) -> None:
        super().__init__(problem, render_mode, **options)
        self.shield, self._guard = shield, OneWatch(shield)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Begin an episode; see `CentralEnv.reset`."""
        self._guard.fresh = True
        return super().reset(seed=seed, options=options)

    def _inputs(self, joint_action: np.ndarray) -> list[list[float]]:
        return self._guard.judged(self._episode.world, super()._inputs(joint_action))

    def _info(self) -> dict[str, Any]:
        self._guard.seen(self._episode.world)
        return {**super()._info(), **self._guard.numbers, "overridden": bool(self._guard.watch.overridden.any())}
