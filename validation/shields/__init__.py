"""Environments and policies behind shields, which keep a success probability whoever proposes the inputs."""

from .behind import shield
from .shielded_batches import ShieldedTeamEnv, ShieldedVectorEnv
from .shielded_envs import ShieldedCentralEnv, ShieldedEnv, ShieldedTasksEnv
from .shielded_policy import ShieldedController

__all__ = [
    "ShieldedCentralEnv",
    "ShieldedController",
    "ShieldedEnv",
    "ShieldedTasksEnv",
    "ShieldedTeamEnv",
    "ShieldedVectorEnv",
    "shield",
]
