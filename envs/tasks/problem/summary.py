"""How a problem prints itself: its sizes as a short tree or an HTML table, agents of one kind counted together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from ...systems.agents import AnyAgent
from ...systems.arguments import box_text, counted, names_text, tree_text

MOST_KINDS = 4
"""Kinds of agents that are written out: with the other rows they stay within a dozen lines."""


@dataclass(frozen=True)
class AgentKind:
    """Agents of equal sizes and workspaces.

    Attributes
    ----------
    names : tuple of str
    n_states, n_inputs : int
    workspace : str
        Their box, as text.
    """

    names: tuple[str, ...]
    n_states: int
    n_inputs: int
    workspace: str


def agent_kinds(agents: Sequence[AnyAgent]) -> list[AgentKind]:
    """Return the kinds of the agents, in the order in which they first appear."""
    # Equal texts are equal enough here: what a reader cannot tell apart is one kind.
    names: dict[tuple[int, int, str], list[str]] = {}
    for agent in agents:
        kind = (agent.n_states, agent.n_inputs, box_text(agent.state_low, agent.state_high))
        names.setdefault(kind, []).append(agent.name)
    return [AgentKind(tuple(members), *kind) for kind, members in names.items()]


def summary_text(title: str, agents: Sequence[AnyAgent], facts: Sequence[tuple[str, str]]) -> str:
    """Return a title, one line per kind of agents and one per fact, name and value."""
    kinds = agent_kinds(agents)
    rows = [("agents", _agents_text(kind)) for kind in kinds[:MOST_KINDS]]
    if len(kinds) > MOST_KINDS:
        rows.append(("agents", f"... and {counted(len(kinds) - MOST_KINDS, 'more kind')}, {len(agents)} in all"))
    return tree_text(title, [*rows, *facts])


def summary_html(title: str, agents: Sequence[AnyAgent], facts: Sequence[tuple[str, str]]) -> str:
    """Return the same as a table for notebooks, every text escaped."""
    kinds = agent_kinds(agents)
    lines = [
        "<table>",
        f"<caption>{escape(title)}</caption>",
        _html_row(("agents", "states", "inputs", "workspace"), "th"),
    ]
    for kind in kinds[:MOST_KINDS]:
        label = f"{len(kind.names)}: {names_text(kind.names)}" if len(kind.names) > 1 else names_text(kind.names)
        lines.append(_html_row((label, str(kind.n_states), str(kind.n_inputs), kind.workspace), "td"))
    if len(kinds) > MOST_KINDS:
        lines.append(_html_row((f"... and {counted(len(kinds) - MOST_KINDS, 'more kind')}", "", "", ""), "td"))
    for name, value in facts:
        lines.append(f'<tr><th>{escape(name)}</th><td colspan="3">{escape(value)}</td></tr>')
    return "\n".join([*lines, "</table>"])


def _agents_text(kind: AgentKind) -> str:
    each = " each" if len(kind.names) > 1 else ""
    sizes = f"{counted(kind.n_states, 'state')} and {counted(kind.n_inputs, 'input')}{each}"
    return f"{len(kind.names)} with {sizes}: {names_text(kind.names)}"


def _html_row(cells: Sequence[str], tag: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"
