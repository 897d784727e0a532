"""The course of one episode, shared by the parallel and the centralised environment of a problem.

An episode is terminated (1) when the task is satisfied early (co-safe), (2) when an agent leaves its workspace, or (3)
when the automaton can no longer accept. It is truncated (4) at the horizon, where finite-trace tasks are judged. If the
start already decides, the first step returns the verdict and nothing moves.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..simulation import Behaviour, SingleSimulator, World
from ..simulation import batch_simulator as core
from ..tasks.problem import Problem
from .observation import INFOS, checked_option, checked_reset
from .rendering import Picture, checked_render_mode, verdict_text
from .shaping import REWARDS, Potential

RENDER_MODES = ("ansi", "rgb_array", "human")


class Episode:
    """One world of a problem and the rewards of its task.

    Parameters
    ----------
    problem : Problem
    reward : "sparse", "shaped" or "progress"
        1 on satisfaction; the others add differences of the potential of `shaping`.
    discount : float
        Discount factor of the learner, for the shaped reward; between 0 and 1.
    render_mode : None, "ansi", "rgb_array" or "human"
    caption : str
        A line shown in pictures.
    infos : "numbers" or "words"
        Infos hold numbers and arrays of fixed shape; "words" adds the names of the propositions that hold (`letter`).
    disturbance : "zero", "random", "periodic" or a function
        How bounded disturbances behave (`dynamics.disturbances`).
    """

    def __init__(
        self,
        problem: Problem,
        reward: str,
        discount: float,
        render_mode: str | None,
        caption: str = "",
        infos: str = "numbers",
        disturbance: Behaviour = "zero",
    ) -> None:
        self.problem = problem
        self.render_mode = checked_render_mode(render_mode, RENDER_MODES)
        self.caption = caption
        self.discount = checked_discount(discount)
        self._words = checked_option(infos, "infos", INFOS) == "words"
        self.dynamics = core.Dynamics.of(problem, disturbance)
        self.single_simulator = SingleSimulator.of(self.dynamics)
        self._reward = checked_option(reward, "reward", REWARDS)
        self._potential = None if reward == "sparse" else Potential.of(self.dynamics)
        self.level = 0.0
        self._world: World | None = None
        self._track: list[World] = []
        self._picture: Picture | None = None

    @property
    def world(self) -> World:
        """The current world; RuntimeError before the first `begin`."""
        if self._world is None:
            raise RuntimeError("call `reset` first")
        return self._world

    def begin(self, rng: np.random.Generator, options: dict[str, Any] | None) -> None:
        """Start an episode; `options["initial_state"]` replaces the problem's start; other keys are refused."""
        start = checked_reset(options).get("initial_state")
        dynamics = self.dynamics
        if start is not None:
            dynamics = core.Dynamics.of(self.problem.replace(initial_state=start), self.dynamics.disturbance)
        # The start is drawn by the batched core, so that one world and a batch of one agree.
        worlds = core.initial(dynamics, rng, 1)
        self._world = self.single_simulator.begin(worlds)
        self._track = [self._world]
        if self._potential is not None:
            self.level = self._level(worlds)
        self._show()

    def step(self, inputs: Any, rng: np.random.Generator) -> tuple[float, bool, bool]:
        """Advance one control step; return reward, terminated and truncated."""
        # A settled world stands still: it has ended already, or the start decided.
        world = self.world
        if not self.single_simulator.settled(world):
            world = self.single_simulator.step(
                world, inputs, rng.standard_normal(self.single_simulator.n_draws).tolist()
            )
            self._world = world
            if self.render_mode is not None:  # only pictures need the past
                self._track.append(world)
        terminated = self.single_simulator.settled(world)
        truncated = not terminated and world.time >= self.problem.horizon
        reward = float(self.single_simulator.satisfied(world))
        # Both pay differences of potentials; that of "shaped" is 0 in ended episodes.
        if self._potential is not None:
            before, forgets = self.level, self._reward == "shaped" and (terminated or truncated)
            self.level = 0.0 if forgets else self._level(self._batch(), before)
            reward += self.discount * self.level - before
        self._show()
        return reward, terminated, truncated

    def info(self) -> dict[str, Any]:
        """Return the entries of every info: automaton state, satisfaction, time; letter, if words are asked for."""
        world = self.world
        # Learners stack infos into arrays, so by default nothing here is text or changes its length.
        words = {"letter": self.single_simulator.names(world.letter)} if self._words else {}
        return {
            "automaton_state": world.q,
            "satisfied": self.single_simulator.satisfied(world),
            "time": world.time,
            **words,
        }

    def render(self) -> str | np.ndarray | None:
        """Return a line of text, a picture (height, width, 3), or nothing, by the render mode."""
        if self.render_mode == "ansi":
            return self._line()
        if self.render_mode == "rgb_array":
            return self._frame()
        return None

    def close(self) -> None:
        """Close the window of the render mode "human"."""
        if self._picture is not None:
            self._picture.close()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_picture": None}  # pictures hold fonts and windows; they are made again

    def _level(self, worlds: core.Worlds, before: float = 0.0) -> float:
        """Return the potential of a batch of one."""
        assert self._potential is not None
        if self._reward == "shaped":
            return float(self._potential.at(worlds)[0])
        return float(self._potential.progress(worlds, before)[0])

    def _batch(self) -> core.Worlds:
        """Return the current world as a batch of one."""
        world = self.world
        joint = np.concatenate([np.asarray(x, dtype=float) for x in world.states])[None]
        return core.Worlds(
            core.split_joint(self.dynamics, joint),
            np.array([world.q], dtype=np.int32),
            world.time,
            np.array([world.failed]),
            np.array([world.accepted]),
        )

    def _verdict(self) -> str:
        world = self.world
        over = self.single_simulator.settled(world) or world.time >= self.problem.horizon
        return verdict_text(self.single_simulator.satisfied(world), world.failed, over)

    def _line(self) -> str:
        """Return the current world as a line of text."""
        world = self.world
        named = zip(self.problem.agent_names, world.states)
        states = ", ".join(f"{name} {np.round(x, 3).tolist()}" for name, x in named)
        verdict = self._verdict()
        name = self.problem.automaton.state_names[world.q]
        return f"t={world.time}/{self.problem.horizon} q={name}{' ' if verdict else ''}{verdict}: {states}"

    def _frame(self) -> np.ndarray:
        """Return the current world as a picture."""
        if self._picture is None:
            self._picture = Picture(self.problem, self.caption)
        track = [[number for x in world.states for number in x] for world in self._track]
        world = self.world
        return self._picture.frame(np.array(track), world.q, self.single_simulator.names(world.letter), self._verdict())

    def _show(self) -> None:
        """Show the current world in the window of the render mode "human"."""
        if self.render_mode == "human":
            frame = self._frame()
            if self._picture is not None:
                self._picture.show(frame)


def checked_discount(value: Any) -> float:
    """Return a discount factor as a float, or raise ValueError."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise ValueError(f"`discount`: expected a number from 0 to 1, got {value!r}")
    return float(value)
