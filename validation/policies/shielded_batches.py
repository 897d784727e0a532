"""Batches of worlds behind a shield: the batched Gymnasium environment, and the one with an array per agent.

They are `ProblemVectorEnv` and `TeamEnv`, with the same spaces, rewards and ends. Infos of the first hold `budget`
(M,), `value` (M,) and `overridden` (M, I); the second has attributes of these names.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...envs.interfaces import ProblemVectorEnv, TeamEnv
from ...envs.simulation import Dynamics, Worlds
from ...envs.tasks.problem import Problem
from ...synthesis.extended_check.shields import Shield
from .watch import Watch


def states_of(dynamics: Dynamics, worlds: Worlds) -> tuple[np.ndarray, ...]:
    """Return the states (d_i, M) of every agent."""
    return tuple(worlds.states[block][:, place] for block, place in dynamics.position)


def times_of(worlds: Worlds) -> np.ndarray:
    """Return the time (M,) of every world."""
    return np.broadcast_to(np.asarray(worlds.time), (worlds.n_worlds,))


def inputs_of(dynamics: Dynamics, inputs: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Return inputs (m, n, M) per block as inputs (m_i, M) per agent."""
    return tuple(inputs[block][:, place] for block, place in dynamics.position)


def in_blocks(dynamics: Dynamics, inputs: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Return inputs (m_i, M) per agent as inputs (m, n, M) per block."""
    return tuple(np.stack([inputs[i] for i in block.agents], axis=1) for block in dynamics.blocks)


class ShieldedVectorEnv(ProblemVectorEnv):
    """Batch of worlds behind a shield; see the module docstring.

    Parameters
    ----------
    problem : Problem
    shield : Shield
    num_envs, render_mode, **options
        As for `ProblemVectorEnv`.
    """

    def __init__(
        self, problem: Problem, shield: Shield, num_envs: int = 1, render_mode: str | None = None, **options: Any
    ) -> None:
        super().__init__(problem, num_envs, render_mode, **options)
        self.shield, self._watch = shield, Watch(shield, num_envs)
        self._is_plain = False  # a shield sees worlds that begin before others move, and judges what moves them

    @property
    def budget(self) -> np.ndarray:
        """What is owed in every world, (M,)."""
        return self._watch.budget.copy()

    @property
    def value(self) -> np.ndarray:
        """The certified value of the present states, (M,)."""
        return self._watch.value.copy()

    @property
    def overridden(self) -> np.ndarray:
        """Whose proposals were not let through in the last step, bool (M, I)."""
        return self._watch.overridden.T.copy()

    def _begun(self, worlds: Worlds, which: np.ndarray) -> Worlds:
        begun = super()._begun(worlds, which)
        seen = states_of(self._dynamics, begun), begun.q, times_of(begun)
        self._watch.begin(*seen, which)
        return begun

    def _moved(self, worlds: Worlds, inputs: tuple[np.ndarray, ...], moving: np.ndarray) -> Worlds:
        dynamics = self._dynamics
        proposed = inputs_of(dynamics, inputs)
        applied = self._watch.judge(states_of(dynamics, worlds), worlds.q, times_of(worlds), moving, proposed)
        after = super()._moved(worlds, in_blocks(dynamics, applied), moving)
        self._watch.arrive(states_of(dynamics, after), after.q, times_of(after), moving)
        return after

    def _infos(self, which: np.ndarray) -> dict[str, Any]:
        more = {"budget": self.budget, "value": self.value, "overridden": self.overridden}
        return {**super()._infos(which), **more, **{f"_{name}": which.copy() for name in more}}


class ShieldedTeamEnv(TeamEnv):
    """Batch of worlds with one array per agent, behind a shield; see the module docstring.

    Parameters
    ----------
    problem : Problem
    shield : Shield
    num_envs, **options
        As for `TeamEnv`.
    """

    def __init__(self, problem: Problem, shield: Shield, num_envs: int = 1, **options: Any) -> None:
        super().__init__(problem, num_envs, **options)
        self.shield = shield
        own = ("observation", "neighbours", "scale", "automaton")
        rest = {name: value for name, value in self.options.items() if name not in own}
        self._batch: ShieldedVectorEnv = ShieldedVectorEnv(problem, shield, num_envs, autoreset_mode="SameStep", **rest)

    @property
    def budget(self) -> np.ndarray:
        """What is owed in every world, (M,)."""
        return self._batch.budget

    @property
    def value(self) -> np.ndarray:
        """The certified value of the present states, (M,)."""
        return self._batch.value

    @property
    def overridden(self) -> np.ndarray:
        """Whose proposals were not let through in the last step, bool (M, I)."""
        return self._batch.overridden
