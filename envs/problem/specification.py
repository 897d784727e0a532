"""The task of the agents: a formula with its semantics, or an automaton."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..agents import shortened, shown
from ..logic import SEMANTICS, Automaton


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Specification:
    """The task of the agents: a formula with its semantics, or an automaton.

    Attributes
    ----------
    formula : str or None
        Temporal-logic formula over the propositions.
    semantics : str
        "co-safe" (satisfied as soon as the automaton accepts) or "finite-trace" (judged at the horizon).
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
        if semantics is None and automaton is not None:
            semantics = automaton.semantics
        if semantics not in SEMANTICS:
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
