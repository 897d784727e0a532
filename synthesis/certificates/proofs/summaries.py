"""How certificates print themselves: a claim with what it is about, as a short tree or an HTML table.

Lower bounds are rounded down and upper bounds up, so that what is printed holds too.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from ....envs.systems.arguments import counted, shortened
from ....envs.tasks.problem import Problem
from ...relations.grids import alike_text, shape_text
from .digits import shown_bound

MOST_TOLD = 3
"""Agents of which a summary says who tells them of states: a line has room for them."""


def certificate_facts(certificate: Any, claim: str | None = None) -> list[tuple[str, str]]:
    """Return the rows of a summary, name and value; the bound is rounded to the safe side, or told by ``claim``."""
    problem, proof = certificate.problem, certificate.proof
    agents = proof.agents_of(problem) if proof.has_cells else ()
    cells = alike_text(shape_text(part.grid.shape) for part in agents)
    return [
        ("horizon", counted(problem.horizon, "control step")),
        ("bound", claim or shown_bound(certificate.lower_bound, certificate.gap)),
        ("start", _start_text(certificate)),
        ("method", shortened(proof.method)),
        ("theorem", proof.bound),
        *([("cells", f"{cells} ({counted(len(agents), 'agent')})"), ("rank", str(proof.rank))] if agents else []),
        *proof.about.items(),
        *_told(problem),
    ]


def _start_text(certificate: Any) -> str:
    """Return what a claim says about its start, in words."""
    point = all(agent.initial.is_point for agent in certificate.problem.agents)
    return "from the initial state" if point else "on average over the initial boxes"


def _told(problem: Problem) -> list[tuple[str, str]]:
    """Return a row about the agents who are assumed to know states of others; no row if there are none."""
    named = ((agent.name, getattr(agent, "communicated", ())) for agent in problem.agents)
    told = [f"{name} by {', '.join(others)}" for name, others in named if others]
    if not told:
        return []
    more = f", and {len(told) - MOST_TOLD} more" if len(told) > MOST_TOLD else ""
    return [("told", f"states at every step: {shortened('; '.join(told[:MOST_TOLD]))}{more}")]


def task_text(problem: Problem) -> str:
    """Return the task of a problem in words."""
    return shortened(problem.specification.formula or "given as an automaton", 200)


def table_html(title: str, facts: Sequence[tuple[str, str]]) -> str:
    """Return a title and rows, name and value, as a table for notebooks, every text escaped."""
    rows = [f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in facts]
    return "\n".join(["<table>", f"<caption>{escape(title)}</caption>", *rows, "</table>"])


def certificate_html(
    title: str, certificate: Any, more: Sequence[tuple[str, str]] = (), claim: str | None = None
) -> str:
    """Return a certificate as a table for notebooks, with ``more`` rows below."""
    problem = certificate.problem
    return table_html(title, [("task", task_text(problem)), *certificate_facts(certificate, claim), *more])
