"""Guards: Boolean conditions on a letter, and the diagram of a state that joins them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .decision_diagram import FALSE, TRUE, DecisionDiagrams
from .normal_form import Term

MISSING = -1  # terminal: no guard holds
CONFLICT = -2  # terminal: guards with different targets hold


def propositional_diagram(term: Term, diagrams: DecisionDiagrams, memo: dict[Term, int]) -> int:
    """Return the Boolean function of a term without temporal operators."""
    node = memo.get(term)
    if node is None:
        if term.literal is not None:
            node = diagrams.literal(*term.literal)
        elif term.operator in ("true", "false"):
            node = TRUE if term.operator == "true" else FALSE
        else:
            nodes = [propositional_diagram(operand, diagrams, memo) for operand in term.operands]
            node = diagrams.conjoin_all(nodes) if term.operator == "&" else diagrams.disjoin_all(nodes)
        memo[term] = node
    return node


def joined_guards(diagrams: DecisionDiagrams, guarded: Sequence[tuple[int, int]]) -> int:
    """Return the diagram that maps each letter to the target of its guard, to `MISSING` or to `CONFLICT`.

    Parameters
    ----------
    guarded : sequence of (int, int)
        Pairs of a Boolean function and a target (at least 0).
    """
    result = diagrams.terminal(MISSING)
    memo: dict[tuple[int, int], int] = {}
    # Turn each guard into a map to its target, and lay the maps over each other.
    for guard, target in guarded:
        replaced = {FALSE: diagrams.terminal(MISSING), TRUE: diagrams.terminal(target)}
        piece = diagrams.rebuild(guard, diagrams, replaced.get, {})
        result = diagrams.apply(_joined, result, piece, memo)
    return result


def _joined(a: int, b: int) -> int:
    """Return the target of a letter under two maps; `MISSING` gives way, different targets conflict."""
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
    literals = [("" if value else "!") + propositions[p] for p, value in sorted(assignment.items())]
    return " & ".join(literals) or "any letter"
