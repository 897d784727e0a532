"""The finite model of each agent, the guards of the task, and both joined."""

from .abstraction import (
    Abstraction,
    AgentModel,
    Cells,
    Relations,
    Settings,
    abstract,
    alike_arrays,
    check_names,
    check_settings,
    has_full_rank,
    models_of,
    relations_of,
)
from .agent_models import FINE
from .choices import BAND_BYTES, Choices, InputMenu, Law, Laws, TargetWindows
from .joint import JointModel, join, start_of
from .kernel import BLOCK, REACH, Kernel, gaussian_table

__all__ = [
    "Abstraction",
    "AgentModel",
    "BAND_BYTES",
    "BLOCK",
    "Cells",
    "Choices",
    "FINE",
    "InputMenu",
    "JointModel",
    "Kernel",
    "Law",
    "Laws",
    "REACH",
    "Relations",
    "Settings",
    "TargetWindows",
    "abstract",
    "alike_arrays",
    "check_names",
    "check_settings",
    "gaussian_table",
    "has_full_rank",
    "join",
    "models_of",
    "relations_of",
    "start_of",
]
