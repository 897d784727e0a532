"""Guards: Boolean conditions on a letter, and how they join into the diagram of a state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .decision_diagram import FALSE, TRUE, DecisionDiagrams
from .normal_form import Term

MISSING = -1  # terminal: no guard holds
CONFLICT = -2  # terminal: guards with different targets hold


def propositional_diagram(term: Term, diagrams: DecisionDiagrams, memo: dict[Term, int]) -> int:
    """Return the Boolean function of a term without temporal operators."""
    found = memo.get(term)
    if found is None:
        if term.literal is not None:
            found = diagrams.literal(*term.literal)
        elif term.operator in ("true", "false"):
            found = TRUE if term.operator == "true" else FALSE
        else:
            parts = [propositional_diagram(part, diagrams, memo) for part in term.operands]
            found = diagrams.conjoin_all(parts) if term.operator == "&" else diagrams.disjoin_all(parts)
        memo[term] = found
    return found


def joined_guards(diagrams: DecisionDiagrams, guarded: Sequence[tuple[int, int]]) -> int:
    """Return the diagram that maps each letter to the target of its guard, to `MISSING` or to `CONFLICT`.

    Parameters
    ----------
    guarded : sequence of (int, int)
        Pairs of a Boolean function and a target (at least 0).
    """
    result = diagrams.terminal(MISSING)
    memo: dict[tuple[int, int], int] = {}
    for guard, target in guarded:
        replaced = {FALSE: diagrams.terminal(MISSING), TRUE: diagrams.terminal(target)}
        piece = diagrams.rebuild(guard, diagrams, replaced.get, {})
        result = diagrams.apply(_joined, result, piece, memo)
    return result


def _joined(a: int, b: int) -> int:
    if a == MISSING or a == b:
        return b
    return a if b == MISSING else CONFLICT


def completed(diagrams: DecisionDiagrams, root: int, target: int) -> int:
    """Return the diagram in which letters without a guard lead to `target`."""
    missing = diagrams.terminal(MISSING)

    def replace(n: int) -> int | None:
        if n == missing:
            return diagrams.terminal(target)
        return n if diagrams.is_terminal(n) else None

    return diagrams.rebuild(root, diagrams, replace, {})


def letter_text(assignment: Mapping[int, bool], propositions: Sequence[str]) -> str:
    """Return a cube of letters as text such as ``a & !b``."""
    parts = [("" if value else "!") + propositions[p] for p, value in sorted(assignment.items())]
    return " & ".join(parts) or "any letter"
