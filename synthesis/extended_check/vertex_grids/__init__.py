"""Value iteration on grids whose vertices have inputs: its check, on the checker's intervals, jets and tables."""

from .backups import Backups, Images, failure_of, hats_at
from .closed_loops import corners_of, images_at, names_time, vertices_of

__all__ = ["Backups", "Images", "corners_of", "failure_of", "hats_at", "images_at", "names_time", "vertices_of"]
