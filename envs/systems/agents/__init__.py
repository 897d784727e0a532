"""Linear agents, and agents of expressions.

Agents: linear systems and systems of expressions with noise, angles, and states that depend on neighbours.
"""

from .agent import LinearAgent, with_matrices
from .angles import TURN, wrapped
from .any_agent import AnyAgent, checked_name
from .box import Box
from .declaration import split_deviations
from .declared_names import MOST_OUTPUTS, TIME
from .expression_agent import Agent, with_expressions
from .neighbours import Place, neighbour, place_of, tied
from .products import linear, row_times
