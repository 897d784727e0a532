"""A workspace cut into cells along edges of regions.

A workspace cut into cells along the edges of regions.
"""

from .agent_grids import (
    DEFAULT_TARGETS,
    MOST_CELLS,
    CellCounts,
    agent_grid,
    cells_of_agent,
    fewest_cells,
    region_boundaries,
)
from .axes_of_lattices import (
    CellAxis,
    LatticeAxis,
    MeanAxis,
    ScaleAxis,
    cell_points,
    deviations_of,
    lattice_axes,
    points_by_axis,
)
from .corners import corner_sides, hat_share, hats, of_cells, spread, to_places
from .grid import FloatArray, Grid
from .grid_noise import grid_laws, sharpness
from .labels import CellLabels, cell_labels, error_labels
from .lookup import axis_finder, cell_finder
from .noise_reach import NearWindow, near_windows
from .refusal import (
    FEWER,
    NoRunFound,
    RelationRefused,
    linear_agent,
    refuse_angles,
    refuse_shared_noise,
    refuse_uneven_noise,
    to_who_asked_for_none,
)
from .sizes import alike_text, shape_text
