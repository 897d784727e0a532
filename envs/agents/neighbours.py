"""States of other agents in the expressions of an agent: `leader.position`.

An agent knows the names alone. A problem ties them to its agents, and with that to the workspaces in which they stay:
when an agent leaves its workspace the task is violated, so nothing is asked of what moves after that. Inside an agent's
trees these names are `neighbour 0`, `neighbour 1`, ... in the order in which they occur, so that agents in equal places
have equal dynamics.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from .any_agent import AnyAgent
from .checks import shown

_DOTTED = re.compile(r"(?<![A-Za-z0-9_.])[A-Za-z_][A-Za-z0-9_]*\.[A-Za-z_][A-Za-z0-9_]*")


def states_of_others(texts: Sequence[str]) -> tuple[str, ...]:
    """Return the names of other agents' states in expressions, in the order in which they occur first.

    Examples
    --------
    >>> states_of_others(["x + 0.1*leader.x", "leader.v - tail.x + leader.x"])
    ('leader.x', 'leader.v', 'tail.x')
    """
    return tuple(dict.fromkeys(name for text in texts for name in _DOTTED.findall(text)))


def neighbour(k: int) -> str:
    """Return the name of the k-th of them in trees: no text has a name with a blank."""
    return f"neighbour {k}"


def place_of(name: str, agents: Sequence[AnyAgent]) -> tuple[int, int]:
    """Return agent and component of a state such as `leader.position`.

    Raises
    ------
    ValueError
        If there is no such agent, or its states have no such name.
    """
    owner, state = name.split(".")
    names = [agent.name for agent in agents]
    if owner not in names:
        raise ValueError(f"`agents`: expected agents for {name!r} among {', '.join(names[:8])}, got {shown(owner)}")
    states = getattr(agents[names.index(owner)], "states", ())
    if state not in states:
        known = f"one of {', '.join(states)}" if states else "none: only agents with expressions have names for states"
        raise ValueError(f"`agents`: expected a state of agent {owner!r} ({known}), got {name!r}")
    return names.index(owner), states.index(state)


def tied(agents: Sequence[AnyAgent]) -> tuple[AnyAgent, ...]:
    """Return the agents, those whose expressions name states of others tied to these.

    Raises
    ------
    ValueError
        If there is no such state.
    """
    named = [getattr(agent, "others", ()) for agent in agents]
    return tuple(_tied(agent, names, agents) if names else agent for agent, names in zip(agents, named))


def _tied(agent: Any, names: Sequence[str], agents: Sequence[AnyAgent]) -> AnyAgent:
    places = [place_of(name, agents) for name in names]
    low = [float(agents[i].state_low[k]) for i, k in places]
    high = [float(agents[i].state_high[k]) for i, k in places]
    tied_agent: AnyAgent = agent.tied_to(tuple(zip(low, high)))
    return tied_agent
