"""Policies of any origin: given, learned, compared."""

from .actors import NotAnActor, load_actor
from .comparison import Comparison, compare
from .probing import Attempt, Probe, probe
from .rollout_policies import IdleController, RandomController, as_controller
from .training import ALGORITHMS, Training, certificate_of, train

__all__ = [
    "ALGORITHMS",
    "Attempt",
    "Comparison",
    "IdleController",
    "NotAnActor",
    "Probe",
    "RandomController",
    "Training",
    "as_controller",
    "certificate_of",
    "compare",
    "load_actor",
    "probe",
    "train",
]
