"""Models of other libraries as policies: ONNX, torch, SB3.

Models of other libraries as policies: ONNX, torch, Stable-Baselines3, and files for others to read.
"""

from .actor_files import NotAnActor, stored
from .importers import RUN, as_policy, batchable, certifiable, is_model
from .layers import TORCH_ACTIVATIONS
from .local_policies import LocalBatch
from .model_policies import TeamModels
from .writing import is_written_policy, save_policy
from .written_feedback import SymbolicPolicies
