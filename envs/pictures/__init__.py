"""Pictures of a problem: scenes, rendered frames, a window, drawings of automata."""

from .automaton_drawing import automaton_to_dot, places
from .guard_texts import edges
from .outlines import Drawer
from .palette import AGENTS, AGENTS_ON_DARK, LOOKS, Look, agent_color
from .rendering import Picture, checked_render_mode, verdict_text
from .scene import MOST_STRETCHED, Curve, Panel, Region, coordinate_name, have_one_scale, panels
from .task_roles import AVOIDED, FREE, KEPT, MIXED, REACHED, roles

__all__ = [
    "AGENTS",
    "AGENTS_ON_DARK",
    "AVOIDED",
    "Curve",
    "Drawer",
    "FREE",
    "KEPT",
    "LOOKS",
    "MOST_STRETCHED",
    "Look",
    "MIXED",
    "REACHED",
    "Panel",
    "Picture",
    "Region",
    "agent_color",
    "automaton_to_dot",
    "checked_render_mode",
    "coordinate_name",
    "edges",
    "have_one_scale",
    "panels",
    "places",
    "roles",
    "verdict_text",
]
