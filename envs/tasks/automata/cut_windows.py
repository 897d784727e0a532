"""Windows that the end of a run cuts short, where a task is judged at the horizon.

``F G[0,6] a``, judged at a horizon of 20 steps, may begin at step 20: then step 20 is all of the window that is read,
and one letter ``a`` will do. ``F[0,14] G[0,6] a`` leaves time for all of it.
"""

from __future__ import annotations

from .formula import Formula
from .windows import ahead


def is_cut(formula: Formula, horizon: int, start: int = 0) -> bool:
    """Return whether a window of a ``G`` may reach beyond the horizon because of when an ``F`` begins, or by itself.

    Of what is negated, and of what is asked for until the end (``G`` without bounds), nothing is said. ``start`` is the
    last step at which the formula may be asked for.
    """
    operator, operands, bounds = formula.operator, formula.operands, formula.bounds
    if operator in ("!", "<->", "N", "R", "W", "M") or (operator == "G" and bounds is None):
        return False
    if operator == "->":
        return is_cut(operands[1], horizon, start)
    if operator == "U":
        return is_cut(operands[1], horizon, horizon)
    last = bounds[1] if bounds else horizon if operator == "F" else int(operator == "X")
    if operator == "G" and bounds and start + last > horizon:
        return True
    return any(is_cut(operand, horizon, min(start + last, horizon)) for operand in operands)


def with_time_left(formula: Formula, horizon: int) -> Formula:
    """Return a formula of which each ``F`` begins early enough for the windows inside it, where that can be."""
    operands = tuple(with_time_left(operand, horizon) for operand in formula.operands)
    bounds, reach = formula.bounds, max(map(ahead, operands), default=0)
    first, last = bounds or (0, horizon)
    stays = any(part.operator == "G" and part.bounds for part in formula.subformulas())
    if formula.operator == "F" and stays and first <= horizon - reach < last:
        bounds = (first, horizon - reach)
    return Formula(formula.operator, operands, formula.name, bounds)
