"""Models of other libraries brought into the forms that verbs take: what they are, what they see, and written files."""

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
    "WrittenPolicies",
    "RUN",
    "Found",
    "LocalBatch",
    "LocalController",
    "NotAnActor",
    "OwnModels",
    "Reader",
    "Sight",
    "TeamModels",
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
