"""A model of each agent, guards, and both joined.

The finite model of each agent, the guards of the task, and both joined.
"""

from .action_tables import TIE, ActionTable, Policies, StepPolicy, best_offered, gather, shifted
from .agent_models import reaches_every_mean
from .box_choices import BoxChoices
from .finite_models import (
    RELATIONS,
    Abstraction,
    AgentModel,
    Relations,
    Settings,
    abstraction_of,
    check_names,
    lost_beside,
    models_of,
    relations_of,
)
from .guards import compile_guards
from .joint import JointModel, cell_masks, count_of_decisions, join, spread_start, start_of
from .network_model import network_abstraction, network_tables
from .surroundings import surrounded
