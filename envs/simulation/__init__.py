"""How problems move and are judged, one or many at a time.

How problems move and how they are judged, with the same bits for one world and for many.
"""

from .batch_simulator import Draws, Dynamics, Worlds, joint, letters, neighbours, split_joint
from .disturbances import BEHAVIOURS, Behaviour, checked_behaviour
from .single_simulator import SingleSimulator, World
