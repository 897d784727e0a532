"""PettingZoo and Gymnasium environments, and rendering.

Problems as PettingZoo and Gymnasium environments, and their rendering: scenes, frames, a window, automata.
"""

from .automaton_drawing import automaton_to_dot, places
from .central_env import CentralEnv
from .device_team_env import DeviceTeamEnv
from .guard_texts import edges
from .nearest import checked_neighbours, common_sizes, nearest_bounds, nearest_seen
from .observation import AUTOMATON, SCALES, SCOPES, Bounds, checked_option, joint_bounds, relative_bounds
from .outlines import Drawer
from .palette import AGENTS, AGENTS_ON_DARK, LOOKS, agent_color
from .problem_env import ProblemEnv
from .rendering import Picture, verdict_text
from .scene import MOST_STRETCHED, Curve, Panel, Region, coordinate_name, have_one_scale, panels
from .shaping import Potential
from .specified import Specified
from .task_roles import AVOIDED, FREE, KEPT, MIXED, REACHED, SHARED, roles
from .tasks_env import TasksEnv
from .team_env import TeamEnv
from .vector_env import ProblemVectorEnv
