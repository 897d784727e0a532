"""A workspace cut into cells along the edges of regions."""

from .agent_grids import Cells, agent_grid, cells_of_agent, label_room, region_boundaries
from .grid import FloatArray, Grid, start_share
from .grid_dynamics import in_grid_coordinates
from .labels import CellLabels, cell_labels, error_labels
from .lookup import axis_finder, cell_finder
from .refusal import RelationRefused

__all__ = [
    "CellLabels",
    "Cells",
    "FloatArray",
    "Grid",
    "RelationRefused",
    "agent_grid",
    "axis_finder",
    "cell_finder",
    "cell_labels",
    "cells_of_agent",
    "error_labels",
    "in_grid_coordinates",
    "label_room",
    "region_boundaries",
    "start_share",
]
