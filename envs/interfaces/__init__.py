"""The PettingZoo and Gymnasium shells of a Problem. They know no ids."""

from .central_env import CentralEnv
from .device_team_env import DeviceTeamEnv, TeamState
from .observation import checked_option
from .problem_env import ProblemEnv
from .shaping import Potential
from .tasks_env import TasksEnv
from .team_env import TeamEnv, TeamStep
from .vector_env import ProblemVectorEnv

__all__ = [
    "CentralEnv",
    "DeviceTeamEnv",
    "Potential",
    "ProblemEnv",
    "ProblemVectorEnv",
    "TasksEnv",
    "TeamEnv",
    "TeamState",
    "TeamStep",
    "checked_option",
]
