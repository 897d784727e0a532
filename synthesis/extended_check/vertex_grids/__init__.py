"""Value iteration on grids whose vertices have inputs: its check, on the checker's intervals, jets and tables."""

from .backups import FARTHEST, KEPT, NEAR, Backups, failure_of
from .bands import Bands
from .closed_loops import corners_of, images_at, names_time, vertices_of
from .coordinates import Independent, independent
from .images import Images, hats_at
from .lattices import Lattice, LatticeImages
from .noise_bounds import Noise, Normal
from .teams import Kinds, VertexKernel, alone, kinds_of, team_failure, team_value
from .turns import NARROWEST, ROOM, numbers_in

__all__ = [
    "FARTHEST",
    "KEPT",
    "NARROWEST",
    "NEAR",
    "ROOM",
    "Backups",
    "Bands",
    "Images",
    "Kinds",
    "VertexKernel",
    "Independent",
    "Lattice",
    "LatticeImages",
    "corners_of",
    "failure_of",
    "hats_at",
    "images_at",
    "independent",
    "names_time",
    "numbers_in",
    "alone",
    "kinds_of",
    "team_failure",
    "team_value",
    "vertices_of",
    "Noise",
    "Normal",
]
