"""Value iteration on grids whose vertices have inputs: its check, on the checker's intervals, jets and tables."""

from .backups import Backups, Images, contracted, failure_of
from .closed_loops import images_at, names_time, vertices_of

__all__ = ["Backups", "Images", "contracted", "failure_of", "images_at", "names_time", "vertices_of"]
