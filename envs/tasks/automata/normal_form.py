"""Negation normal form: the form of formulas on which the translators work.

A `Term` is built from literals, ``&``, ``|``, ``U`` (until), ``R`` (release) and the windows ``F[]``, ``G[]``. All
other operators are written with these (X = F[1,1], N = G[1,1], F a = true U a, G a = false R a,
a W b = b R (a | b), a M b = b U (a & b)). Negations are pushed to the literals by the dualities of the semantics:

- finite traces: not X a = N not a, and ``G[]`` reaches only as far as the trace does;
- co-safe: the dualities of infinite words, where not X a = X not a. Afterwards only U, F, M, X and windows may remain:
  then, and only then, does every satisfying word have a finite prefix that proves it. Any other formula is refused: the
  dualities of finite traces would make it accept words whose continuations violate the task.

Terms are interned: equal terms are the same object.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from .formula import NEXT_LIKE, UNTIL_LIKE, Formula, is_proposition_name

# The operator of the negated formula, with negated operands.
_DUAL = {"&": "|", "|": "&", "U": "R", "R": "U", "W": "M", "M": "W", "F": "G", "G": "F", "X": "N", "N": "X"}
_DUAL |= {"true": "false", "false": "true", "all": "any", "any": "all"}


@dataclass(frozen=True, eq=False)
class Term:
    """An interned formula in negation normal form; compare terms with ``is``."""

    operator: str  # "true", "false", "literal", "&", "|", "U", "R", "F[]", "G[]"
    operands: tuple[Term, ...]
    literal: tuple[int, bool] | None  # (proposition index, positive)
    bounds: tuple[int, int] | None  # of windows
    propositional: bool  # whether no temporal operator occurs in it
    serial: int  # position in the order in which terms were made


class Terms:
    """Table of interned terms; it simplifies terms while it builds them."""

    def __init__(self) -> None:
        self._table: dict[tuple[object, ...], Term] = {}
        self.true = self._make("true")
        self.false = self._make("false")

    def _make(
        self,
        operator: str,
        operands: tuple[Term, ...] = (),
        literal: tuple[int, bool] | None = None,
        bounds: tuple[int, int] | None = None,
    ) -> Term:
        """Return the term with these fields, the same object each time."""
        key = (operator, operands, literal, bounds)
        term = self._table.get(key)
        if term is None:
            propositional = operator not in ("U", "R", "F[]", "G[]") and all(a.propositional for a in operands)
            term = Term(operator, operands, literal, bounds, propositional, len(self._table))
            self._table[key] = term
        return term

    def literal(self, proposition: int, positive: bool) -> Term:
        """Return the term which says that proposition number `proposition` holds, or that it does not."""
        return self._make("literal", literal=(proposition, positive))

    def join(self, operator: str, operands: Iterable[Term]) -> Term:
        """Return the conjunction (``&``) or disjunction (``|``)."""
        neutral, absorbing = (self.true, self.false) if operator == "&" else (self.false, self.true)
        # Flatten nested ones, drop repetitions and the neutral constant, and order by serial: equal sets, equal terms.
        flat: dict[int, Term] = {}
        for operand in operands:
            for member in operand.operands if operand.operator == operator else (operand,):
                flat[member.serial] = member
        flat.pop(neutral.serial, None)
        if absorbing.serial in flat:
            return absorbing
        members = tuple(flat[serial] for serial in sorted(flat))
        if not members:
            return neutral
        return members[0] if len(members) == 1 else self._make(operator, members)

    def until(self, operator: str, left: Term, right: Term) -> Term:
        """Return ``left U right`` or ``left R right``."""
        # a U true = true, a U false = false, and so for R; false U b = b, true R b = b.
        if right in (self.true, self.false):
            return right
        if left is (self.false if operator == "U" else self.true):
            return right
        return self._make(operator, (left, right))

    def window(self, operator: str, bounds: tuple[int, int], body: Term) -> Term:
        """Return the window ``F[]`` or ``G[]`` with these bounds; a window of a window is one window."""
        low, high = bounds
        if high == 0 or body is (self.false if operator == "F[]" else self.true):
            return body
        if body.operator == operator and body.bounds is not None:
            return self.window(operator, (low + body.bounds[0], high + body.bounds[1]), body.operands[0])
        return self._make(operator, (body,), bounds=bounds)

    def parts(self, term: Term) -> list[Term]:
        """Return the operands of a conjunction or disjunction, the propositional ones joined into one."""
        plain = [operand for operand in term.operands if operand.propositional]
        temporal = [operand for operand in term.operands if not operand.propositional]
        return ([self.join(term.operator, plain)] if plain else []) + temporal


class NormalForm:
    """Reader of formulas into terms.

    Parameters
    ----------
    propositions : sequence of str
        Declared names; their order numbers them.
    families : mapping
        Members of each family.
    co_safe : bool
        Whether the formula is read with co-safe semantics.
    """

    def __init__(self, propositions: Sequence[str], families: Mapping[str, Sequence[str]], co_safe: bool) -> None:
        self.terms = Terms()
        self.co_safe = co_safe
        self._index = {name: i for i, name in enumerate(propositions)}
        self._families = families
        # By the id of a formula. The formula is stored as well: while it lives, no other one can get its id.
        self._memo: dict[tuple[int, bool], tuple[Formula, Term]] = {}

    def read(self, formula: Formula, positive: bool = True) -> Term:
        """Return the term of `formula`, or of its negation.

        Raises
        ------
        FormulaError
            If a name is not declared, or a co-safe formula is not syntactically co-safe.
        """
        key = (id(formula), positive)
        entry = self._memo.get(key)
        if entry is None:
            entry = self._memo[key] = (formula, self._read(formula, positive))
        return entry[1]

    def _read(self, formula: Formula, positive: bool) -> Term:
        """Return the term of a formula that has not been read yet, or of its negation."""
        operator, operands = formula.operator, formula.operands
        if operator == "!":
            return self.read(operands[0], not positive)
        if operator == "atom":
            return self.terms.literal(self._proposition(formula), positive)
        if operator == "->":
            sides = [self.read(operands[0], not positive), self.read(operands[1], positive)]
            return self.terms.join("|" if positive else "&", sides)
        if operator == "<->":
            return self._equivalence(formula, positive)
        # From here on a negation is the dual operator with negated operands.
        if not positive:
            operator = _DUAL[operator]
        if operator in ("all", "any"):
            members = [self.terms.literal(i, positive) for i in self._members(formula)]
            return self.terms.join("&" if operator == "all" else "|", members)
        if operator in ("true", "false"):
            return self.terms.true if operator == "true" else self.terms.false
        if self.co_safe:
            operator = self._co_safe_operator(formula, operator)
        terms = [self.read(operand, positive) for operand in operands]
        if operator in ("&", "|"):
            return self.terms.join(operator, terms)
        return self._temporal(operator, terms, formula.bounds)

    def _temporal(self, operator: str, operands: list[Term], bounds: tuple[int, int] | None) -> Term:
        """Return the term of a temporal operator, written with U, R and windows (see the module docstring)."""
        terms = self.terms
        left, right = operands[0], operands[-1]
        if operator in ("X", "N"):
            return terms.window("F[]" if operator == "X" else "G[]", bounds or (1, 1), left)
        if operator in ("F", "G") and bounds is not None:
            return terms.window(operator + "[]", bounds, left)
        if operator == "F":
            return terms.until("U", terms.true, left)
        if operator == "G":
            return terms.until("R", terms.false, left)
        if operator == "W":
            return terms.until("R", right, terms.join("|", operands))
        if operator == "M":
            return terms.until("U", right, terms.join("&", operands))
        return terms.until(operator, left, right)

    def _equivalence(self, formula: Formula, positive: bool) -> Term:
        # Both hold or both fail; for the negation exactly one holds.
        left, right = formula.operands
        cases = [(True, positive), (False, not positive)]
        terms = self.terms
        return terms.join("|", [terms.join("&", [self.read(left, a), self.read(right, b)]) for a, b in cases])

    def _co_safe_operator(self, formula: Formula, operator: str) -> str:
        """Return `operator`, read over infinite words; refuse it if a finite prefix cannot prove it."""
        if formula.operator == "N":
            raise formula.error(
                "N (weak next) is not co-safe: it is about where a finite trace ends. Write X, or use "
                'semantics "finite-trace"'
            )
        if operator == "N":
            return "X"  # a negated X: over infinite words, not X a = X not a
        if operator in ("R", "W") or (operator == "G" and formula.bounds is None):
            how = f"{formula.operator} is" if operator == formula.operator else f"a negated {formula.operator} is"
            raise formula.error(
                f"not co-safe: {how} a promise about all letters to come, which no finite prefix can prove. "
                f'Bound it, as in G[0,10], or end it, as in "a U goal", or use semantics "finite-trace"'
            )
        return operator

    def _proposition(self, formula: Formula) -> int:
        name = formula.name
        if name not in self._index:
            raise formula.error(f"unknown proposition {name!r}; {self._advice(name)}")
        return self._index[name]

    def _members(self, formula: Formula) -> list[int]:
        name = formula.name
        if name not in self._families:
            declared = ", ".join(list(self._families)[:10]) or "none"
            raise formula.error(f"unknown family {name!r}; declared families: {declared}")
        return [self._index[member] for member in self._families[name]]

    def _advice(self, name: str) -> str:
        """Return what to write instead of an unknown name."""
        if name in self._families:
            return f"it is a family: write all({name}), any({name}) or one member such as {self._families[name][0]}"
        # `Fgoal` is an atom; the writer may have meant `F goal`.
        operators, rest = "", name
        while rest and rest[0] in NEXT_LIKE + UNTIL_LIKE:
            operators, rest = operators + rest[0] + " ", rest[1:]
            if rest in self._index:
                return f"operators need a space: {operators}{rest}"
        close = difflib.get_close_matches(name, list(self._index)[:5000], n=3)  # a second's work at most
        if close:
            return f"did you mean {' or '.join(close)}?"
        return f"declared: {', '.join(list(self._index)[:10]) or 'none'}"


def check_names(propositions: Sequence[str], families: Mapping[str, Sequence[str]]) -> None:
    """Raise ValueError unless propositions differ and can be written in formulas, and families have members."""
    if isinstance(propositions, str) or not isinstance(propositions, Sequence):
        raise ValueError(f"`propositions`: expected a list of names, got {propositions!r}")
    if not isinstance(families, Mapping):
        raise ValueError(f"`families`: expected a mapping from names to lists of propositions, got {families!r}")
    for name in propositions:
        if not is_proposition_name(name):
            raise ValueError(f"`propositions`: expected names of letters, digits and _, and no operator, got {name!r}")
    if len(set(propositions)) != len(propositions):
        raise ValueError("`propositions`: expected different names, got one twice")
    declared = set(propositions)
    for family, members in families.items():
        if isinstance(members, str) or not isinstance(members, Sequence):
            raise ValueError(f"`families`: expected a list of members of {family!r}, got {members!r}")
        if not members:
            raise ValueError(f"`families`: expected members of {family!r}, got none")
        for member in members:
            if member not in declared:
                raise ValueError(f"`families`: expected declared propositions, got {member!r} in {family!r}")
