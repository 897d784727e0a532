"""Settings of the learners: read from ``settings.toml``, completed for a problem, changed by the caller.

Nothing is hidden: a ``Training`` holds all settings that it used, and prints and saves them.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ...synthesis.extended_check.shields import Shield
from .views import View

FILE = Path(__file__).with_name("settings.toml")

NO_LEARNER_TAKES = ("steps", "seconds", "worlds", "hidden", "phases", "shield")
"""Settings that are ours; all others go to Stable-Baselines3."""

OF_PHASES = ("learning_rate", "deviation", "fixed", "spread", "care")
"""Settings that hold in all phases if they are given by name."""

LEAST_ROUNDS = 40
"""Rounds of PPO that a training should have: a short one gets by with fewer worlds side by side."""


@dataclass(frozen=True)
class Phase:
    """A part of a training; the fields are explained in ``settings.toml``."""

    share: float
    reward: str
    learning_rate: float
    deviation: float | None = None
    fixed: bool = False
    spread: float = 0.0
    care: float = 1.0


@dataclass(frozen=True)
class Piece:
    """A part of a phase: world steps, learning rates at beginning and end, and the phase's spread and care by then."""

    steps: int
    rates: tuple[float, float]
    spread: float = 0.0
    care: float = 1.0


@dataclass(frozen=True)
class Settings:
    """All settings of a training.

    Parameters
    ----------
    steps, worlds : int
        World steps of all worlds together, and worlds side by side.
    hidden : tuple of int
        Layers of actor and critic.
    learner : dict
        Keyword arguments of the learner of Stable-Baselines3.
    phases : tuple of Phase
    seconds : float or None
        Wall-clock time after which a training stops, if it has not taken its steps by then; cloning comes before.
    shield : Shield, optional
        What keeps a success probability while the learner acts.
    """

    steps: int
    worlds: int
    hidden: tuple[int, ...]
    learner: dict[str, Any]
    phases: tuple[Phase, ...]
    seconds: float | None = None
    shield: Shield | None = None

    @property
    def gamma(self) -> float:
        """Discount factor."""
        return float(self.learner["gamma"])

    @property
    def round(self) -> int:
        """World steps between two updates of PPO; for SAC, of all worlds."""
        return self.worlds * int(self.learner.get("n_steps", 1))

    def to_dict(self) -> dict[str, Any]:
        """Return everything as one table of JSON values."""
        ours = {"steps": self.steps, "worlds": self.worlds, "hidden": list(self.hidden), "seconds": self.seconds}
        return {**self.learner, **ours, "phases": [asdict(phase) for phase in self.phases]}


def settings_for(algorithm: str, view: View, *, warm: bool = False, **changes: Any) -> Settings:
    """Return the settings of a training.

    Parameters
    ----------
    algorithm : "ppo", "ippo", "mappo", "central-ppo" or "sac"
    view : SharedView or CentralView
    warm : bool
        Whether the training continues a clone.
    **changes
        Values that replace those of the file; None leaves a value. ``reward`` alone means one phase with that reward;
        those of ``OF_PHASES`` hold in all phases.
    """
    given = {name: value for name, value in changes.items() if value is not None}
    table = dict(_tables()["sac" if algorithm == "sac" else "ppo"])
    if algorithm == "sac" and ("deviation" in given or "fixed" in given):
        raise ValueError("`deviation`: expected only with learners of PPO; SAC chooses its own")
    if warm and algorithm != "sac":
        table |= _tables()["warm"]
    phases = tuple(Phase(**phase) for phase in table["phases"])
    # One reward for all of the training, from the start of the problem.
    if "reward" in given:
        phases = (replace(phases[0], share=1.0, reward=given.pop("reward"), spread=0.0, care=1.0),)
    of_phases = {name: given.pop(name) for name in OF_PHASES if name in given}
    for name in ("spread", "care"):
        if not 0.0 <= of_phases.get(name, 0.0) <= 1.0:
            raise ValueError(f"`{name}`: expected a number from 0 to 1, got {of_phases[name]!r}")
    phases = tuple(replace(phase, **of_phases) for phase in phases)
    table |= given
    worlds = int(table["worlds"])
    if "worlds" not in given and algorithm != "sac":
        worlds = int(np.clip(int(table["steps"]) // (LEAST_ROUNDS * _rounds(view)), 16, worlds))
    completed = _sizes(algorithm, view, worlds) | {"device": "cpu"}
    learner = {name: value for name, value in table.items() if name not in NO_LEARNER_TAKES}
    seconds = table.get("seconds")
    if seconds is not None and not seconds > 0.0:
        raise ValueError(f"`seconds`: expected a positive number, got {seconds!r}")
    return Settings(int(table["steps"]), worlds, tuple(table["hidden"]), {**completed, **learner}, phases, seconds)


def _sizes(algorithm: str, view: View, worlds: int) -> dict[str, Any]:
    """Return the settings that depend on the sizes of a problem."""
    if algorithm == "sac":
        return {"target_entropy": -2.0 * view.n_actions}
    # A round of PPO is split into eight batches.
    return {"n_steps": _rounds(view), "batch_size": max(64, worlds * _rounds(view) * view.rows // 8)}


def _rounds(view: View) -> int:
    """Return the steps of every world between two updates of PPO: about two episodes."""
    return int(np.clip(2 * view.problem.horizon, 16, 64))


@cache
def _tables() -> Mapping[str, Any]:
    """Return the file, read once."""
    with FILE.open("rb") as file:
        return tomllib.load(file)
