"""Models of other libraries as policies: ONNX, torch, Stable-Baselines3, and files for others to read."""

from .actor_files import NotAnActor, stored
from .bringing import RUN, as_policy, batchable, brought, certifiable, is_model
from .environments import sight_of
from .found import Found, Reader
from .local_policies import LocalBatch, LocalController
from .model_policies import OwnModels, TeamModels
from .sights import Sight
from .writing import is_written_policy, save_policy
from .written_feedback import WrittenPolicies

__all__ = [
    "Found",
    "LocalBatch",
    "LocalController",
    "NotAnActor",
    "OwnModels",
    "RUN",
    "Reader",
    "Sight",
    "TeamModels",
    "WrittenPolicies",
    "as_policy",
    "batchable",
    "brought",
    "certifiable",
    "is_model",
    "is_written_policy",
    "save_policy",
    "sight_of",
    "stored",
]
