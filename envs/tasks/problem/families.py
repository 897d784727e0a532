"""Families of propositions: one declaration for many agents.

`safe` declared on the agent pattern `drone_*` becomes one proposition per agent whose name matches: `safe_0`,
`safe_1`, ..., named by what the `*` stands for. Formulas refer to them as `all(safe)` and `any(safe)`.

`near` declared on pairs of `drone_*` becomes one proposition per pair: `near_0_1`, `near_0_2`, ..., the agents in the
order of the problem. With `pairs = "neighbours"` only those next to each other in that order are paired. Declared on
`["leader", "drone_*"]` it becomes one proposition per agent that matches: `near_0`, `near_1`, ...
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any

from ...systems.agents import checked_name
from ...systems.arguments import shown
from ..automata import RESERVED
from ..regions import FLAT, SHAPES, Pair, Proposition

AnyProposition = Proposition | Pair

OF_AGENT, OF_PAIR = ("agent", "low", "high"), ("agents", "low", "high")
"""Keys that a proposition of one agent, and one about pairs, must have where they are boxes."""

BESIDES_AGENT, BESIDES_PAIR = ("of",), ("outputs", "pairs", "of")
"""Keys that they may have besides."""


def keys_of(value: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the keys that the table of a proposition must have, and those that it may have besides."""
    words = [key for key in value if key in SHAPES] if isinstance(value, Mapping) else []
    if about_pairs(value):
        other = "distance" if "distance" in value else words[0] if words else ""
        return ("agents", other) if other else OF_PAIR, BESIDES_PAIR
    return ("agent", words[0]) if words and not {"low", "high"} & {*value} else OF_AGENT, BESIDES_AGENT


def about_pairs(value: Any) -> bool:
    """Return whether a table of a proposition is about pairs."""
    return isinstance(value, Mapping) and "agents" in value


def refuse_shape(value: Mapping[str, Any], where: str) -> None:
    """Raise ValueError if a proposition about pairs is written as a shape that no difference can be in."""
    words = [key for key in value if key in SHAPES and key not in FLAT]
    if words:
        several = value["agents"] if isinstance(value["agents"], str) else "robot_*"
        raise ValueError(
            f"{where}: expected `low` and `high` of a difference, a `distance`, or a shape with flat faces "
            f"({', '.join(FLAT)}), got `{words[0]}`; other shapes are about one agent, or about each of several by "
            f'itself (`agent = "{several}"`); take one around it where a pair keeps apart, or one within it where it '
            "is to hold"
        )


def checked_propositions(propositions: Any, agents: Sequence[str] = ()) -> dict[str, AnyProposition]:
    """Return a mapping from valid names to propositions; a value may be a dict of the arguments of one.

    With one agent a box may be a pair (low, high), and a dict need not name the agent.

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
        value = _of_one_agent(value, agents)
        # A dict of the arguments stands for a proposition, as in problem files.
        if about_pairs(value):
            refuse_shape(value, f"`propositions.{name}`")
        required, besides = ({*keys} for keys in keys_of(value))
        if isinstance(value, Mapping) and required <= set(value) <= required | besides:
            value = (Pair if about_pairs(value) else Proposition)(**value)
        if not isinstance(value, AnyProposition):
            raise ValueError(
                f"`propositions.{name}`: expected a Proposition, a Pair, or a dict with agent (or agents), low and "
                f"high, or agent and a shape, got {shown(value)}"
            )
        checked[name] = value
    return checked


def _of_one_agent(value: Any, agents: Sequence[str]) -> Any:
    """Return a region with the only agent that there is, where it names none."""
    if len(agents) != 1:
        return value
    if isinstance(value, tuple | list) and len(value) == 2:
        return {"agent": agents[0], "low": value[0], "high": value[1]}
    if isinstance(value, Mapping) and not {"agent", "agents"} & {*value}:
        return {"agent": agents[0], **value}
    return value


def expand(
    propositions: Mapping[str, AnyProposition], agents: Sequence[str]
) -> tuple[dict[str, AnyProposition], dict[str, tuple[str, ...]]]:
    """Return the propositions with families expanded, and the members of each family in agent order.

    Raises
    ------
    ValueError
        If an agent is unknown, a pattern matches no agent, or two members have the same name.
    """
    declared_agents = frozenset(agents)
    members: dict[str, AnyProposition] = {}
    families: dict[str, tuple[str, ...]] = {}
    for name, proposition in propositions.items():
        matched: Mapping[str, AnyProposition]
        if isinstance(proposition, Pair):
            matched = _pairs(name, proposition, agents, declared_agents)
            if isinstance(proposition.agents, str) or "*" in "".join(proposition.agents):
                families[name] = tuple(matched)
        elif "*" in proposition.agent:
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


def _pairs(name: str, pair: Pair, agents: Sequence[str], declared: frozenset[str]) -> dict[str, Pair]:
    """Return the members of a proposition about pairs, by name: the pair itself if it names two agents."""
    if isinstance(pair.agents, str):
        named = list(_named(name, pair.agents, agents).items())
        # Each with each later one, or each with the next one; both in the order of the problem.
        reach = 1 if pair.pairs == "neighbours" else len(named)
        couples = [(a, b) for k, a in enumerate(named) for b in named[k + 1 : k + 1 + reach]]
        if not couples:
            raise ValueError(
                f"`propositions.{name}`: expected a pattern that matches at least two agents, got {shown(pair.agents)}"
            )
        return {f"{name}_{i}_{j}": pair.of(first, second) for (first, i), (second, j) in couples}
    starred = [k for k, agent in enumerate(pair.agents) if "*" in agent]
    if not starred:
        for agent in pair.agents:
            _check_agent(name, agent, declared)
        return {name: pair}
    pattern, other = pair.agents[starred[0]], pair.agents[1 - starred[0]]
    _check_agent(name, other, declared)
    members = {}
    for agent, middle in _named(name, pattern, agents).items():
        if agent != other:
            members[f"{name}_{middle}"] = pair.of(*((agent, other) if starred[0] == 0 else (other, agent)))
    if not members:
        raise ValueError(f"`propositions.{name}`: expected a pattern that matches another agent than {other!r}")
    return members


def _matches(name: str, family: Proposition, agents: Sequence[str]) -> dict[str, Proposition]:
    """Return the members of a family by name, one for each agent whose name matches the pattern."""
    named = _named(name, family.agent, agents)
    return {f"{name}_{middle}": family.of(agent) for agent, middle in named.items()}


def _named(name: str, pattern: str, agents: Sequence[str]) -> dict[str, str]:
    """Return the agents that a pattern matches, in order, each with what the `*` stands for."""
    prefix, suffix = pattern.split("*")
    named = {}
    for agent in agents:
        # The length test keeps prefix and suffix from overlapping, and the `*` from standing for nothing.
        if agent.startswith(prefix) and agent.endswith(suffix) and len(agent) > len(prefix) + len(suffix):
            named[agent] = agent[len(prefix) : len(agent) - len(suffix)]
    if not named:
        raise ValueError(
            f"`propositions.{name}`: expected a pattern that matches an agent, got {shown(pattern)}; "
            f"the agents are {', '.join(agents[:8])}"
        )
    return named


def _check_agent(name: str, agent: str, declared_agents: frozenset[str]) -> None:
    """Raise ValueError unless the agent of a proposition is declared; suggest the closest name."""
    if agent not in declared_agents:
        close = get_close_matches(agent, sorted(declared_agents), n=1)
        remedy = (
            f"; did you mean {close[0]!r}?" if close else f"; the agents are {', '.join(sorted(declared_agents)[:8])}"
        )
        copies = sorted(one for one in declared_agents if one.removeprefix(f"{agent}_").isdigit())
        if copies:
            remedy = (
                f"; there are {len(copies)} of it: write {agent + '_*'!r} for each of them, or {copies[0]!r} for one"
            )
        raise ValueError(f"`propositions.{name}`: expected the name of an agent, got {shown(agent)}{remedy}")
