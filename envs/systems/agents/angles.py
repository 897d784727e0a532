"""States that are angles: points of a circle, which wrap.

The state is what the noise makes of the mean, less whole turns: a number of the workspace, which is one turn. So no
agent leaves its workspace by turning. For this to be the motion of a point of the circle, dynamics must be the same
a turn further on, ``f(x + 2 pi e) = f(x) + 2 pi j`` with whole numbers j for angles and 0 for other states, and so must
be scales of noise and outputs, apart from outputs that are the angle itself (docs/theory/angles.md).
"""

from __future__ import annotations

import math
from typing import Any

from ..arguments import shown
from ..backends import namespace
from ..expressions import Name, turns
from .declared_names import checked_names

TURN = 2.0 * math.pi
"""A turn, rounded."""

WORKSPACES = ((-math.pi, math.pi), (0.0, TURN))
"""Workspaces of angles: one turn, whose length as a double is not more than a true turn."""


def checked_angles(value: Any, states: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the states that are angles, or raise ValueError."""
    if value is None or (isinstance(value, list | tuple) and not len(value)):
        return ()
    named = checked_names(value, "angles")
    for name in named:
        if name not in states:
            raise ValueError(f"`angles`: expected names of states, got {shown(name)}; the states are {shown(states)}")
    if len(set(named)) < len(named):
        raise ValueError(f"`angles`: expected each state once, got {shown(named)}")
    return tuple(state for state in states if state in named)


def refuse_uneven(agent: Any) -> None:
    """Raise ValueError unless workspaces of angles are a turn, and everything is the same a turn further on."""
    for angle in agent.angles:
        k = agent.states.index(angle)
        ends = float(agent.state_low[k]), float(agent.state_high[k])
        if ends not in WORKSPACES:
            raise ValueError(
                f'`state_low`, `state_high`: expected one turn for the angle {angle!r}, from "-pi" to "pi" or from 0 '
                f'to "2*pi", got [{ends[0]:g}, {ends[1]:g}]'
            )
        for j, tree in enumerate(agent.timed_trees):
            grown = turns(tree, angle)
            is_angle = agent.states[j] in agent.angles
            if grown is None or (grown.denominator != 1 if is_angle else grown != 0):
                whole = "by whole turns" if is_angle else "by nothing"
                raise ValueError(
                    f"`dynamics[{j}]`: expected what grows {whole} when the angle {angle!r} grows by one, got "
                    f"{agent.dynamics[j]!r}; name angles in sums, and elsewhere in `sin` and `cos`, or leave {angle!r} "
                    "out of `angles`"
                )
        _refuse_scales_and_outputs(agent, angle)


def _refuse_scales_and_outputs(agent: Any, angle: str) -> None:
    texts = agent.noise_scale or ()
    for j, (tree, text) in enumerate(zip(agent.timed_scale_trees, texts, strict=True)):
        if turns(tree, angle) != 0:
            raise ValueError(
                f"`noise_scale[{j}]`: expected what is the same when the angle {angle!r} grows by a turn, got "
                f"{text!r}; name angles in `sin` and `cos`"
            )
    for j, (tree, text) in enumerate(zip(agent.output_trees, agent.output_expressions, strict=True)):
        if tree != Name(angle) and turns(tree, angle) != 0:
            raise ValueError(
                f"`outputs[{j}]`: expected the angle {angle!r} itself, or what is the same when it grows by a turn, "
                f"got {text!r}; say regions of angles by `heading`, and other shapes over other states (`of`)"
            )


def wrapped(x: Any, low: Any) -> Any:
    """Return angles less whole turns, from ``low`` to a turn beyond (rounded); the same bits for one and for many."""
    xp = namespace(x)
    inside = x - TURN * xp.floor((x - low) / TURN)
    # Rounding may leave a last digit outside: what is there is the end.
    return xp.minimum(xp.maximum(inside, low), low + TURN)
