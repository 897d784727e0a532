"""The PettingZoo and Gymnasium shells of a Problem. They know no ids."""

from .central_env import CentralEnv
from .observation import checked_option
from .problem_env import ProblemEnv
from .tasks_env import TasksEnv
from .vector_env import ProblemVectorEnv

__all__ = [
    "CentralEnv",
    "ProblemEnv",
    "ProblemVectorEnv",
    "TasksEnv",
    "checked_option",
]
