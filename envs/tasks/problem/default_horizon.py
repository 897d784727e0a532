"""How many steps a task has whose file says no horizon: as many as its windows ask for, or enough without a deadline.

A co-safe task that is satisfied within some steps stays satisfied: what is certified of them holds of any number, and
of no deadline (docs/theory/bounds.md, "Safety without a deadline" has what holds of other tasks).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..automata import Formula, FormulaError, ahead, parse_formula
from .specification import usual_semantics

NO_DEADLINE = 100
"""Steps of a co-safe task without a deadline: most are done in a fifth of that, and paths end where the task does."""

_MISSING = (
    "the problem: `horizon` is missing; write how many control steps the task has, such as `horizon = 20`: it asks for "
    "something until the end"
)


def default_horizon(specification: Any) -> int:
    """Return the steps of a task that says no horizon, from its specification as a file has it.

    Raises
    ------
    ValueError
        If the task is judged at the horizon and has no windows that say when that is.

    Examples
    --------
    >>> default_horizon("F (shelf & F dock)"), default_horizon("G[0,20] safe & F[8,12] dock")
    (100, 20)
    """
    table = specification if isinstance(specification, Mapping) else {"formula": specification}
    text, semantics = table.get("formula"), table.get("semantics")
    if not isinstance(text, str):
        if semantics == "finite-trace":
            raise ValueError(_MISSING)
        return NO_DEADLINE
    try:
        formula = parse_formula(text)
    except FormulaError:
        return NO_DEADLINE  # what is wrong in a formula is said where it is read
    # Beyond the last letter that windows read nothing matters.
    if _has_windows_alone(formula):
        return max(1, ahead(formula))
    if (semantics or usual_semantics(text)) != "co-safe":
        raise ValueError(_MISSING)
    return max(NO_DEADLINE, 2 * ahead(formula))


def _has_windows_alone(formula: Formula) -> bool:
    """Return whether a formula is decided after some number of letters: all it asks for has a last time."""
    if formula.operator in ("U", "R", "W", "M") or (formula.operator in ("F", "G") and formula.bounds is None):
        return False
    return all(map(_has_windows_alone, formula.operands))
