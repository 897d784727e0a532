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
    ahead,
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
    shorter, needed = fitting(formula, problem.horizon), ahead(formula)
    if shorter == formula and needed > problem.horizon:
        return f"{why}: it looks {needed} steps ahead; give the task a longer `horizon`, or end its windows sooner"
    if shorter == formula:
        return f"{why}: it contradicts itself"
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
            names, texts = agent.states, agent.dynamics
            written = ", ".join(f'"{name} + dt*({text})"' for name, text in zip(names[:2], texts[:2], strict=True))
            more = ", ..." if len(names) > 2 else ""
            lines.append(
                f"agent {agent.name}: `{names[0]}` does not occur in its own next value `{texts[0]}`; dynamics are the "
                f"states one step later, not derivatives: for {names[0]}' = {texts[0]} write dynamics = "
                f"[{written}{more}] and `parameters = {{ dt = 0.1 }}`, the length of a step"
            )
    return lines


def _window_beyond(problem: Problem) -> str:
    """Return which window of an `F` or `U` ends beyond the horizon, in words; "" if none does."""
    if problem.specification.formula is None:
        return ""
    horizon = problem.horizon
    beyond = _first_beyond(parse_formula(problem.specification.formula), horizon)
    if beyond is None:
        return ""
    return (
        f"`{beyond.written}` has a window beyond the horizon: runs end after {horizon} steps, and what comes later "
        f"does not count; give the task a longer `horizon`, or end the window at {horizon}"
    )


def _first_beyond(formula: Formula, horizon: int) -> Formula | None:
    """Return the first subformula ``F[a,b]``, or X over one, with b beyond the horizon."""
    bounds, operator = formula.bounds, formula.operator
    if operator == "F" and bounds is not None and bounds[1] > horizon:
        return formula
    left = horizon - bounds[1] if bounds is not None and operator in ("X", "N") else horizon
    return next((found for one in formula.operands if (found := _first_beyond(one, left)) is not None), None)
