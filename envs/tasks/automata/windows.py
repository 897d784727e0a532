"""States that count steps, which of them may be met at what time, and windows that stick out of the horizon.

``G (F[1,6] a)``, judged at a horizon of 20 steps, asks at step 19 for an ``a`` within steps 20 to 25, and at step 20
for one beyond the end, where nothing is read: no word satisfies it. ``G[0,14] (F[1,6] a)`` asks for what fits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .automaton import Automaton
from .formula import Formula
from .rebuilt import successors


def met_in_time(automaton: Automaton, letters: int) -> NDArray[np.bool_]:
    """Return which states (letters, Q) some word may be in after 1, 2, ... letters (exact)."""
    known, here = dict[int, list[int]](), {automaton.initial}
    table = np.zeros((letters, automaton.n_states), dtype=bool)
    for row in table:
        known |= {q: sorted(successors(automaton, q)) for q in here if q not in known}
        here = {r for q in here for r in known[q]}
        row[list(here)] = True
    return table


def may_accept(automaton: Automaton, letters: int) -> bool:
    """Return whether some word of so many letters is accepted (exact)."""
    reached, known = {automaton.initial}, dict[int, set[int]]()
    for _ in range(letters):
        known |= {q: successors(automaton, q) for q in reached if q not in known}
        before, reached = reached, {r for q in reached for r in known[q]}
        if reached == before:
            break
    return any(bool(automaton.accepting[q]) for q in reached)


def ahead(formula: Formula) -> int:
    """Return how many steps ahead a formula looks at most, by its bounds."""
    deepest = max(map(ahead, formula.operands), default=0)
    own = formula.bounds[1] if formula.bounds else int(formula.operator == "X")
    return own + deepest


def fitting(formula: Formula, horizon: int) -> Formula:
    """Return a formula whose ``G`` without bounds ask only as long as what they ask for is within the horizon."""
    operands = tuple(fitting(operand, horizon) for operand in formula.operands)
    bounds, reach = formula.bounds, max(map(ahead, operands), default=0)
    if formula.operator == "G" and bounds is None and 0 < reach <= horizon:
        bounds = (0, horizon - reach)
    return Formula(formula.operator, operands, formula.name, bounds)
