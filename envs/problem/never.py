"""Tasks that no run satisfies, whatever agents do: why, and what to write instead."""

from __future__ import annotations

from ..logic import AutomatonSizeError, fitting, may_accept, parse_formula, translate
from .record import Problem


def why_never(problem: Problem) -> str:
    """Return why no run up to the horizon satisfies the formula, whatever agents do, in words; "" if one may.

    Of letters all are taken for possible: what regions and dynamics rule out is not looked into.
    """
    if problem.groups:
        return next((why for task in problem.tasks if (why := why_never(task))), "")
    if may_accept(problem.automaton, problem.horizon + 1):
        return ""
    why = f"no run of {problem.horizon} steps satisfies the formula, whatever agents do"
    if problem.specification.formula is None:
        return why
    formula = parse_formula(problem.specification.formula)
    shorter = fitting(formula, problem.horizon)
    if shorter == formula:
        return f"{why}: it contradicts itself, or asks for more steps than the horizon has"
    try:
        task = translate(str(shorter), tuple(problem.written), problem.specification.semantics, problem.families)
    except AutomatonSizeError:
        return why
    if not may_accept(task, problem.horizon + 1):
        return why
    return f"{why}: near its end a window is beyond the horizon, where nothing is read; write `{shorter}`"
