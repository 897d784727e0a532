"""Problems that are hardly what was meant, in words, and what to write instead.

Tasks that no run satisfies, or that runs satisfy by their end alone; windows beyond the horizon; dynamics that look
like derivatives.
"""

from __future__ import annotations

from ...systems.agents import Agent
from ...systems.expressions import names_in
from ..automata import (
    AutomatonSizeError,
    Formula,
    fitting,
    is_cut,
    may_accept,
    parse_formula,
    translate,
    with_time_left,
)
from .record import Problem


def why_unsatisfiable(problem: Problem) -> str:
    """Return why no run up to the horizon satisfies the formula, whatever agents do, in words; "" if one may.

    Of letters all are taken for possible: what regions and dynamics rule out is not looked into.
    """
    if problem.groups:
        return next((why for task in problem.tasks if (why := why_unsatisfiable(task))), "")
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


def doubts(problem: Problem) -> tuple[str, ...]:
    """Return what in a problem is likely to be a slip, in words: nothing is refused for it, and no result changes."""
    return tuple(doubt for doubt in (*_derivatives(problem), _window_beyond(problem), cut_by_the_end(problem)) if doubt)


def _derivatives(problem: Problem) -> list[str]:
    """Return a line for each agent with dynamics of which none names its own state, as those of x' = u do not."""
    lines = []
    for agent in problem.written_agents:
        if not isinstance(agent, Agent) or not agent.inputs:
            continue
        own = [state in names_in(tree) for state, tree in zip(agent.states, agent.timed_trees, strict=True)]
        if not any(own):
            state, text = agent.states[0], agent.dynamics[0]
            lines.append(
                f"agent {agent.name}: `{state}` does not occur in its own next value `{text}`, nor does any other "
                f"state; dynamics are the states one step later, not derivatives: for {state}' = {text} write "
                f'"{state} + dt*({text})", with the length of a step in `parameters`'
            )
    return lines


def _window_beyond(problem: Problem) -> str:
    """Return which window of an `F` ends beyond the horizon, in words; "" if none does."""
    if problem.specification.formula is None:
        return ""
    horizon = problem.horizon
    beyond = _first_beyond(parse_formula(problem.specification.formula), horizon)
    if beyond is None:
        return ""
    return (
        f"`{beyond}` has a window beyond the horizon: runs end after {horizon} steps, and what comes later does not "
        f"count; give the task a longer `horizon`, or end the window at {horizon}"
    )


def _first_beyond(formula: Formula, horizon: int) -> Formula | None:
    """Return the first subformula ``F[a,b]`` with b beyond the horizon."""
    if formula.operator == "F" and formula.bounds is not None and formula.bounds[1] > horizon:
        return formula
    return next((found for one in formula.operands if (found := _first_beyond(one, horizon)) is not None), None)
