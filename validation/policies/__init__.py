"""Policies of any origin: given, learned, compared."""

from .actors import NotAnActor, load_actor
from .comparison import Comparison, compare
from .rollout_policies import IdleController, RandomController, as_controller
from .training import ALGORITHMS, Training, train

__all__ = [
    "ALGORITHMS",
    "Comparison",
    "IdleController",
    "NotAnActor",
    "RandomController",
    "Training",
    "as_controller",
    "compare",
    "load_actor",
    "train",
]
