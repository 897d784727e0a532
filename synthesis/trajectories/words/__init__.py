"""Accepted words, read along a trajectory.

Accepted words: which letters of the automaton a trajectory goes through, and when.
"""

from .accepted_words import targets_of, without_needless
from .automaton_paths import AutomatonPath, Cube, Plan, automaton_paths_of, cubes_of, letters_of
from .safe_reach import Reach, whatever_others_do
from .segments import segmented_ways
from .timed_words import fastest_moves, spans_of, timed_ways
from .visits import HALVES, with_windows
