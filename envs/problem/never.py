"""Tasks that no run satisfies, or that runs satisfy by their end alone: why, and what to write instead."""

from __future__ import annotations

from ..logic import AutomatonSizeError, fitting, is_cut, may_accept, parse_formula, translate, with_time_left
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


def cut_by_the_end(problem: Problem) -> str:
    """Return what is not asked for as a window of a ``G`` reaches beyond the horizon, in words; "" if none does.

    A task that is judged at the horizon asks for nothing beyond it: ``F G[0,6] a`` is satisfied by one last ``a``.
    """
    text, horizon = problem.specification.formula, problem.horizon
    if text is None or problem.specification.semantics != "finite-trace" or not is_cut(parse_formula(text), horizon):
        return ""
    what = f"a window of `G` reaches beyond the horizon of {horizon} steps, where nothing is asked for"
    shorter = with_time_left(parse_formula(text), horizon)
    if is_cut(shorter, horizon):
        return f"{what}: give the task a longer `horizon`, or shorter windows"
    return f"{what}, so that less than all of it will do; write `{shorter}` for all of it"
