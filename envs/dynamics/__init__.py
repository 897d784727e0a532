"""How worlds move and how they are judged, with the same bits for one world and for many."""

from .one_world import OneWorld, World
from .worlds import Draws, Dynamics, Worlds, joint

__all__ = [
    "Draws",
    "Dynamics",
    "OneWorld",
    "World",
    "Worlds",
    "joint",
]
