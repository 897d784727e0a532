"""A problem, checked once, and its file.

A problem: agents, propositions, specification and horizon, checked once; problem files; independent tasks.
"""

from .complement import complement_inside, complement_of
from .joint_noise import JOINT_NOISE_REFUSAL
from .problem_file import load_problem, policy_in_file, problem_from_dict, problem_from_toml
from .record import Problem, checked_problem
from .specification import Specification
from .start_boxes import crossed_starts
from .time_unrolled import Places, states_in_time, unrolled_in_time
from .unreachable import OutOfReach, out_of_reach
from .unrolling import Unrolled, unrolled
from .unsatisfiable import cut_by_the_end, doubts, why_unsatisfiable
