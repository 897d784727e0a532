"""The task of the agents: a formula with its semantics, or an automaton."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...systems.arguments import names_arguments, shortened, shown
from ..automata import SEMANTICS, Automaton, Formula, FormulaError, NormalForm, parse_formula


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Specification:
    """The task of the agents: a formula with its semantics, or an automaton.

    Attributes
    ----------
    formula : str or None
        Temporal-logic formula over the propositions.
    semantics : str
        "co-safe" (satisfied as soon as the automaton accepts) or "finite-trace" (judged at the horizon). A formula that
        is given without them is co-safe if a finite prefix can prove it. Automata may be of "opposite" tasks, too.
    automaton : Automaton or None
        An automaton in place of a formula; it carries its semantics.

    Raises
    ------
    ValueError
        If not exactly one of formula and automaton is given, or the semantics are unknown or contradict.
    """

    formula: str | None
    semantics: str
    automaton: Automaton | None

    @names_arguments()
    def __init__(
        self, formula: str | None = None, semantics: str | None = None, *, automaton: Automaton | None = None
    ) -> None:
        if (formula is None) == (automaton is None):
            got = "none" if formula is None else "both"
            raise ValueError(f"`formula`: expected exactly one of a formula and an automaton, got {got}")
        if formula is not None and not isinstance(formula, str):
            raise ValueError(f"`formula`: expected text such as 'F goal', got {shown(formula)}")
        if automaton is not None and not isinstance(automaton, Automaton):
            raise ValueError(f"`automaton`: expected an Automaton, got {shown(automaton)}")
        # An automaton says its semantics; naming them as well is allowed, contradicting them is not.
        if semantics is None:
            semantics = usual_semantics(formula or "") if automaton is None else automaton.semantics
        if semantics not in SEMANTICS and (automaton is None or not automaton.reads_exits):
            raise ValueError(f"`semantics`: expected 'co-safe' or 'finite-trace', got {shown(semantics)}")
        if automaton is not None and automaton.semantics != semantics:
            raise ValueError(
                f"`semantics`: expected {automaton.semantics!r}, as the automaton says, got {semantics!r}; leave it out"
            )
        object.__setattr__(self, "formula", formula)
        object.__setattr__(self, "semantics", semantics)
        object.__setattr__(self, "automaton", automaton)

    def __repr__(self) -> str:
        task = repr(self.automaton) if self.formula is None else repr(shortened(self.formula, 200))
        return f"Specification({task}, {self.semantics})"

    @property
    def is_co_safe(self) -> bool:
        """Whether the task is satisfied as soon as its automaton accepts."""
        return self.semantics == "co-safe"

    def to_dict(self) -> dict[str, Any]:
        """Return the specification as plain values (exact)."""
        if self.automaton is not None:
            return {"automaton": self.automaton.to_dict()}
        return {"formula": self.formula, "semantics": self.semantics}


def usual_semantics(formula: str) -> str:
    """Return the semantics of a formula that is given without them: co-safe if a finite prefix can prove it.

    Examples
    --------
    >>> usual_semantics("F[0,9] goal"), usual_semantics("G all(safe)")
    ('co-safe', 'finite-trace')
    """
    try:
        read = parse_formula(formula)
        nodes, atoms, families = [read], dict[str, None](), dict[str, list[str]]()
        while nodes:
            node = nodes.pop()
            nodes += node.operands
            if node.operator == "atom":
                atoms[node.name] = None
            elif node.operator in ("all", "any"):
                families[node.name] = [_member(node)]
        names = [*atoms, *(name for members in families.values() for name in members)]
        NormalForm([*dict.fromkeys(names)], families, co_safe=True).read(read)
    except FormulaError:
        return "finite-trace"  # what is wrong in a formula is said where it is read
    return "co-safe"


def _member(family: Formula) -> str:
    """Return the name of a member: what a family has does not matter here."""
    return f"{family.name}_0"
