"""The PettingZoo and Gymnasium shells of a Problem. They know no ids."""

from .central_env import CentralEnv
from .device_team_env import DeviceTeamEnv, TeamState
from .nearest import checked_neighbours, common_sizes, nearest_bounds, nearest_seen
from .observation import AUTOMATON, SCALES, SCOPES, Bounds, checked_option, joint_bounds, relative_bounds
from .problem_env import ProblemEnv
from .shaping import Potential
from .tasks_env import TasksEnv
from .team_env import TeamEnv, TeamStep
from .vector_env import ProblemVectorEnv

__all__ = [
    "AUTOMATON",
    "Bounds",
    "CentralEnv",
    "DeviceTeamEnv",
    "Potential",
    "ProblemEnv",
    "ProblemVectorEnv",
    "SCALES",
    "SCOPES",
    "TasksEnv",
    "TeamEnv",
    "TeamState",
    "TeamStep",
    "checked_neighbours",
    "checked_option",
    "common_sizes",
    "joint_bounds",
    "nearest_bounds",
    "nearest_seen",
    "relative_bounds",
]
