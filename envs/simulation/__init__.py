"""How problems move and how they are judged, with the same bits for one world and for many."""

from .disturbances import BEHAVIOURS, Against, Behaviour, checked_behaviour
from .one_world import OneWorld, World
from .worlds import Draws, Dynamics, Worlds, joint, letters, neighbours, split_joint

__all__ = [
    "Against",
    "BEHAVIOURS",
    "Behaviour",
    "Draws",
    "Dynamics",
    "OneWorld",
    "World",
    "Worlds",
    "checked_behaviour",
    "joint",
    "letters",
    "neighbours",
    "split_joint",
]
