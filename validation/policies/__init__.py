"""Policies of any origin: given, learned, compared."""

from .actors import NotAnActor, load_actor
from .comparison import Comparison, compare
from .entrants import LEARNERS, Sources, given, label_of
from .probing import Attempt, Probe, probe
from .recording import Recording, record
from .rollout_policies import IdleController, RandomController, as_controller
from .standings import Leaderboard, Standing, judged, judging_plan, leaderboard
from .standings_page import page_of
from .tier_rule import tier_of
from .training import ALGORITHMS, Training, certificate_of, train

__all__ = [
    "ALGORITHMS",
    "Attempt",
    "Comparison",
    "IdleController",
    "LEARNERS",
    "Leaderboard",
    "NotAnActor",
    "Probe",
    "RandomController",
    "Recording",
    "Sources",
    "Standing",
    "Training",
    "as_controller",
    "certificate_of",
    "compare",
    "given",
    "judged",
    "judging_plan",
    "label_of",
    "leaderboard",
    "load_actor",
    "page_of",
    "probe",
    "record",
    "tier_of",
    "train",
]
