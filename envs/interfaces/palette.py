"""The colours and hatches of everything that is drawn: frames, films, figures, reports, cards take them from here.

Roles of regions have a colour and a hatch each, so that they are told apart without colour; agents have colours of
their own. A test simulates the usual colour deficiencies and measures how far apart the colours stay.
"""

from __future__ import annotations

from dataclasses import dataclass

from .task_roles import AVOIDED, FREE, KEPT, MIXED, REACHED, SHARED

AGENTS = ("#2458d8", "#dc0050", "#231f33", "#b07ae8", "#7a3b00", "#8a0a7a")
"""Colours of agents, taken in turn, on white."""

AGENTS_ON_DARK = ("#8973ff", "#ff3e70", "#caffda", "#e9c4ff", "#eeaf13", "#bc3e9a")
"""The same agents on a dark page."""


@dataclass(frozen=True)
class Look:
    """How regions of one role are drawn: the colour of rim and hatch, the hatch as matplotlib names it, a word."""

    color: str
    hatch: str
    word: str

    @property
    def rgb(self) -> tuple[int, int, int]:
        """The colour as three numbers from 0 to 255."""
        return rgb(self.color)


LOOKS = {
    REACHED: Look("#009e73", "/", "reach"),
    AVOIDED: Look("#d55e00", "x", "avoid"),
    KEPT: Look("#56b4e9", "-", "keep"),
    MIXED: Look("#e69f00", "|", "reach and avoid"),
    SHARED: Look("#cc79a7", "\\", "one at a time"),
    FREE: Look("#8a8f98", "", ""),
}
"""The look of each role; what the task does not ask about is grey and has no hatch."""


def rgb(color: str) -> tuple[int, int, int]:
    """Return a colour such as ``#2458d8`` as three numbers from 0 to 255."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def agent_color(number: int) -> str:
    """Return the colour of an agent on white; they come round again after the last one."""
    return AGENTS[number % len(AGENTS)]
