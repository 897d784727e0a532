"""States and inputs of other agents in the expressions of an agent: `leader.position`, `boiler.heat`.

An agent knows the names alone. A problem ties them to its agents, and with that to the workspaces and input boxes in
which they stay: when an agent leaves its workspace the task is violated, so nothing is asked of what moves after that.
An input is the one that is applied in the same step. Inside an agent's trees these names are `neighbour 0`, `neighbour
1`, ... in the order in which they occur, so that agents in equal places have equal dynamics.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from ..arguments import shown
from .any_agent import AnyAgent


class Place(NamedTuple):
    """Where the number stands that a name such as `leader.position` or `boiler.heat` means."""

    agent: int
    """Position of its agent in the problem."""
    component: int
    """Component of the state, or of the input, of that agent."""
    is_input: bool
    """Whether it is an input."""


_DOTTED = re.compile(r"(?<![A-Za-z0-9_.])[A-Za-z_][A-Za-z0-9_]*\.[A-Za-z_][A-Za-z0-9_]*")


def states_of_others(texts: Sequence[str]) -> tuple[str, ...]:
    """Return the names of other agents' states and inputs in expressions, in the order in which they occur first.

    Examples
    --------
    >>> states_of_others(["x + 0.1*leader.x", "leader.v - tail.x + leader.x"])
    ('leader.x', 'leader.v', 'tail.x')
    """
    return tuple(dict.fromkeys(name for text in texts for name in _DOTTED.findall(text)))


def neighbour(k: int) -> str:
    """Return the name of the k-th of them in trees: no text has a name with a blank."""
    return f"neighbour {k}"


def place_of(name: str, agents: Sequence[AnyAgent]) -> Place:
    """Return where a state such as `leader.position`, or an input such as `boiler.heat`, stands.

    Raises
    ------
    ValueError
        If there is no such agent, or neither its states nor its inputs have such a name.
    """
    owner, part = name.split(".")
    names = [agent.name for agent in agents]
    if owner not in names:
        raise ValueError(f"`agents`: expected agents for {name!r} among {', '.join(names[:8])}, got {shown(owner)}")
    i = names.index(owner)
    states, inputs = (getattr(agents[i], kind, ()) for kind in ("states", "inputs"))
    if part not in (*states, *inputs):
        known = "none: only agents with expressions have names for them"
        known = f"one of {', '.join((*states, *inputs))}" if states else known
        raise ValueError(f"`agents`: expected a state or an input of agent {owner!r} ({known}), got {name!r}")
    # No name of an agent is both a state and an input.
    return Place(i, states.index(part), False) if part in states else Place(i, inputs.index(part), True)


def tied(agents: Sequence[AnyAgent]) -> tuple[AnyAgent, ...]:
    """Return the agents, those whose expressions name states or inputs of others tied to these.

    Raises
    ------
    ValueError
        If there is no such state or input, or an agent is to be told of states that its expressions do not name.
    """
    named = [getattr(agent, "others", ()) for agent in agents]
    return tuple(_tied(agent, names, agents) if names else agent for agent, names in zip(agents, named))


def _tied(agent: Any, names: Sequence[str], agents: Sequence[AnyAgent]) -> AnyAgent:
    places = [place_of(name, agents) for name in names]
    ranges = tuple(_range_of(agents[place.agent], place) for place in places)
    told = {agents[place.agent].name for place in places if not place.is_input}
    for owner in agent.communicated:
        if owner not in told:
            raise ValueError(
                f"`communicated`: expected agents whose states `dynamics` name, got {owner!r}, of whom agent "
                f"{agent.name!r} names inputs alone; nobody is told of inputs, as they are chosen in the same step"
            )
    tied_agent: AnyAgent = agent.tied_to(ranges, tuple(place.is_input for place in places))
    return tied_agent


def _range_of(owner: AnyAgent, place: Place) -> tuple[float, float]:
    """Return the interval in which a state or an input of an agent lies."""
    low, high = (owner.input_low, owner.input_high) if place.is_input else (owner.state_low, owner.state_high)
    return float(low[place.component]), float(high[place.component])
