"""The finite model of each agent, the guards of the task, and both joined."""

from .abstraction import (
    Abstraction,
    AgentModel,
    Relations,
    Settings,
    abstract,
    abstraction_of,
    alike_arrays,
    check_names,
    check_settings,
    has_full_rank,
    models_of,
    relations_of,
)
from .affine_choices import AffineChoices, Choices
from .agent_models import SNAPPED_POINTS
from .bends import Bends
from .box_choices import BoxChoices
from .box_kernel import BoxKernel
from .box_model import INPUT_LEVELS
from .choices import BAND_BYTES, InputMenu, Policies, StepPolicy, TargetWindows
from .joint import JointModel, join, spread_start, start_of
from .kernel import LATTICE_BLOCK, REACH_DEVIATIONS, Kernel
from .linear_kernel import HatKernel, LinearKernel, hat_table
from .network_model import NetworkChoices, network_abstraction, network_tables
from .written_choices import WrittenChoices

__all__ = [
    "Abstraction",
    "AffineChoices",
    "AgentModel",
    "BAND_BYTES",
    "Bends",
    "BoxChoices",
    "BoxKernel",
    "Choices",
    "INPUT_LEVELS",
    "HatKernel",
    "InputMenu",
    "JointModel",
    "Kernel",
    "LATTICE_BLOCK",
    "LinearKernel",
    "NetworkChoices",
    "Policies",
    "REACH_DEVIATIONS",
    "Relations",
    "SNAPPED_POINTS",
    "Settings",
    "StepPolicy",
    "TargetWindows",
    "WrittenChoices",
    "abstract",
    "abstraction_of",
    "alike_arrays",
    "check_names",
    "check_settings",
    "has_full_rank",
    "hat_table",
    "join",
    "models_of",
    "network_abstraction",
    "network_tables",
    "relations_of",
    "spread_start",
    "start_of",
]
