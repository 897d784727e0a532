"""Policies to compare with: learners of Stable-Baselines3 (the extra ``rl``), random inputs, and no effort at all.

``WorldsVecEnv``, ``shared_vec_env`` and ``central_vec_env`` are the worlds of a problem as a ``VecEnv`` of
Stable-Baselines3, which is loaded when one of them is first used.
"""

from importlib import import_module
from typing import Any

from .validation.policies import (
    ALGORITHMS,
    IdleController,
    Leaderboard,
    RandomController,
    Recording,
    Sources,
    Training,
    load_actor,
    record_tiers,
    smoothed,
    train,
)

VEC_ENVS = ("WorldsVecEnv", "central_vec_env", "shared_vec_env")

__all__ = [
    "ALGORITHMS",
    "IdleController",
    "Leaderboard",
    "RandomController",
    "Recording",
    "Sources",
    "Training",
    "load_actor",
    "record_tiers",
    "smoothed",
    "train",
]


def __getattr__(name: str) -> Any:
    if name in VEC_ENVS:
        return getattr(import_module(".validation.policies.learners", __package__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *VEC_ENVS})
