"""Families of propositions: one declaration for many agents.

`safe` declared on the agent pattern `drone_*` becomes one proposition per agent whose name matches: `safe_0`,
`safe_1`, ..., named by what the `*` stands for. Formulas refer to them as `all(safe)` and `any(safe)`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any

from ..agents import Proposition, checked_name, shown
from ..logic import RESERVED


def checked_propositions(propositions: Any) -> dict[str, Proposition]:
    """Return a mapping from valid names to propositions; a value may be a dict of the arguments of `Proposition`.

    Raises
    ------
    ValueError
        If a name is malformed or reserved, or a value is not a proposition.
    """
    if not isinstance(propositions, Mapping):
        raise ValueError(f"`propositions`: expected a mapping from names to propositions, got {shown(propositions)}")
    checked = {}
    for name, value in propositions.items():
        checked_name(name, "propositions")
        if name in RESERVED:
            raise ValueError(f"`propositions.{name}`: expected a name, got a word of the formula language; rename it")
        # A dict of the three arguments stands for a proposition, as in problem files.
        if isinstance(value, Mapping) and set(value) == {"agent", "low", "high"}:
            value = Proposition(**value)
        if not isinstance(value, Proposition):
            raise ValueError(
                f"`propositions.{name}`: expected a Proposition or a dict with agent, low and high, got {shown(value)}"
            )
        checked[name] = value
    return checked


def expand(
    propositions: Mapping[str, Proposition], agents: Sequence[str]
) -> tuple[dict[str, Proposition], dict[str, tuple[str, ...]]]:
    """Return the propositions with families expanded, and the members of each family in agent order.

    Raises
    ------
    ValueError
        If an agent is unknown, a pattern matches no agent, or two members have the same name.
    """
    declared_agents = frozenset(agents)
    members: dict[str, Proposition] = {}
    families: dict[str, tuple[str, ...]] = {}
    for name, proposition in propositions.items():
        if "*" in proposition.agent:
            matched = _matches(name, proposition, agents)
            families[name] = tuple(matched)
        else:
            _check_agent(name, proposition.agent, declared_agents)
            matched = {name: proposition}
        for member, value in matched.items():
            if member in members:
                raise ValueError(f"`propositions.{name}`: expected new names, got {member!r} a second time; rename one")
            members[member] = value
    # A formula could not tell a family from a member of the same name.
    for name in families:
        if name in members:
            raise ValueError(f"`propositions.{name}`: expected new names, got a family and a member of this name")
    return members, families


def _matches(name: str, family: Proposition, agents: Sequence[str]) -> dict[str, Proposition]:
    """Return the members of a family by name, one for each agent whose name matches the pattern."""
    prefix, suffix = family.agent.split("*")
    members = {}
    for agent in agents:
        # The length test keeps prefix and suffix from overlapping, and the `*` from standing for nothing.
        if agent.startswith(prefix) and agent.endswith(suffix) and len(agent) > len(prefix) + len(suffix):
            middle = agent[len(prefix) : len(agent) - len(suffix)]
            members[f"{name}_{middle}"] = Proposition(agent, family.low, family.high)
    if not members:
        raise ValueError(
            f"`propositions.{name}`: expected a pattern that matches an agent, got {shown(family.agent)}; "
            f"the agents are {', '.join(agents[:8])}"
        )
    return members


def _check_agent(name: str, agent: str, declared_agents: frozenset[str]) -> None:
    """Raise ValueError unless the agent of a proposition is declared; suggest the closest name."""
    if agent not in declared_agents:
        close = get_close_matches(agent, sorted(declared_agents), n=1)
        remedy = f"; did you mean {close[0]!r}?" if close else ""
        raise ValueError(f"`propositions.{name}`: expected the name of an agent, got {shown(agent)}{remedy}")
