"""Which relations, cells and starts are tried.

Which ways to certify a task are tried: relations, cells, and from which policies to start.
"""

from .effort import Effort, OutOfTime
from .given_start import policies_from, settings_of
from .refinement_levels import Run, box_work, finer_levels, first_cells, linear_levels, linear_work, work_of
from .relation_choice import Tries, groups_of, has_linear_cells
from .search_bar import BAR, BEGINS, DESCRIBED, Status, Way, bar_of, shown_bound, sweep_bar
from .search_bar import show as show_status
from .strategies import GOOD, SOLVED, Results, Strategy, best_of, in_order, leading, refused, with_settings
from .weak_inputs import cells_where_scarce
