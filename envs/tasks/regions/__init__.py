"""Regions, propositions, pairs, and labels of points.

Regions and atomic propositions: shapes, pairs of agents, and the labeling of points.
"""

from .headings import heading_of
from .labeling import MOVING_REFUSAL, Labeling, contains, inside, of_hint
from .pair import FLAT, REFUSAL, Pair, PairRegion, holds
from .pieces import Combined, Form, Frame, Limit, Piece
from .proposition import Proposition
from .shapes import SHAPES
from .timed_corners import DECIMALS
