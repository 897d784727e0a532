"""Value iteration on grids whose vertices have inputs: which grids, which inputs; values are the checker's own."""

from .team_refinement import refuse_vertex_team, vertex_team_certificate
from .value_iteration import refuse_vertex_grid, refuse_without_guess, vertex_grid_certificate

__all__ = [
    "refuse_vertex_grid",
    "refuse_vertex_team",
    "refuse_without_guess",
    "vertex_grid_certificate",
    "vertex_team_certificate",
]
