"""The checker: reads a certificate file and proves its claim, with numpy alone and nothing else of the package.

Read it in this order: ``rigorous``, ``intervals``, ``expressions``, ``jets``; ``fields``, ``file``, ``distributions``,
``problem``; ``automaton``, ``formula``; ``letters``, ``angles``, ``constraints``, ``error_system``, ``networks``,
``feedbacks``, ``steps``, ``trajectories``; ``motions``, ``cells``, ``tree``, ``trains``, ``cell_proofs``; ``verdict``.
Each file begins with its theorem.
"""

from .angles import check_angles
from .automaton import followed
from .expressions import plain_sum
from .fields import Refused, Unreadable
from .file import FORMAT, MOST_BYTES, VERSION, Contents, parse_file, read_file
from .jets import value_on
from .letters import check_words, demands, known_at, known_at_start
from .motions import affine_dynamics
from .networks import Network, automaton_states, row_seen
from .problem import Agent as CheckedAgent
from .problem import Problem as CheckedProblem
from .problem import read_problem
from .steps import Joint, Trajectory, Tube
from .trajectories import failure_of, linear_forms, walk
from .trajectories import read_proof as read_trajectories
from .verdict import Verdict, bound_of, check, check_contents, shown
