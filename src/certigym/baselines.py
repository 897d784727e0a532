"""Policies to compare with: learners of Stable-Baselines3 (the extra ``rl``), random inputs, and no effort at all."""

from .validation.policies import ALGORITHMS, IdleController, RandomController, Training, load_actor, train

__all__ = ["ALGORITHMS", "IdleController", "RandomController", "Training", "load_actor", "train"]
