"""Pictures of a problem: scenes, rendered frames, a window, drawings of automata."""

from .automaton_drawing import automaton_to_dot, places
from .guard_texts import edges
from .outlines import Drawer
from .rendering import Picture, checked_render_mode, verdict_text
from .scene import Panel, Region, coordinate_name, panels

__all__ = [
    "Drawer",
    "Panel",
    "Picture",
    "Region",
    "automaton_to_dot",
    "checked_render_mode",
    "coordinate_name",
    "edges",
    "panels",
    "places",
    "verdict_text",
]
