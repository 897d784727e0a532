"""Value iteration weighted by occupancy.

Value iteration of one agent at a time, weighted by occupancy: starts, coordinate ascent, relaxations.
"""

from .coordinate_ascent import Stage, Sweep, start_value, sweep
from .limits import Limits
from .multistart import FINAL, MANY_TERMS, RELAXED, SearchResult, find_policies
from .occupancy import forward
from .relaxation import Relaxation, favourable_successors, relax, relax_one, relaxed_policies, upper_bound
from .search_settings import Search
from .stationary import stationary_best
from .train_ascent import TrainSweep
from .train_backward import backward
from .tree import Candidates, assemble, candidates, terminal_terms
