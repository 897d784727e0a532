"""A problem: agents, propositions, specification and horizon, checked once; problem files; independent tasks."""

from .problem_file import load_problem, problem_from_dict, problem_from_toml
from .record import Problem, checked_problem
from .specification import Specification
from .split import split_axes
from .writing_out import Places, states_in_time, written_out

__all__ = [
    "Places",
    "Problem",
    "Specification",
    "checked_problem",
    "load_problem",
    "problem_from_dict",
    "problem_from_toml",
    "split_axes",
    "states_in_time",
    "written_out",
]
