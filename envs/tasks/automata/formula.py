"""Temporal-logic formulas as trees: how they print, and the error that points at a place in their text."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

MAX_DEPTH = 100
"""Deepest nesting: every recursion over a formula stays far from Python's limit of 1000 calls."""

MAX_BOUND = 100_000
"""Largest number in F[a,b], G[a,b], X[k]; the limits of the translation are met long before."""

CONSTANTS = ("true", "false")
FAMILY_OPERATORS = ("all", "any")
NEXT_LIKE = ("X", "N", "F", "G")
UNTIL_LIKE = ("U", "R", "W", "M")
RESERVED = frozenset((*CONSTANTS, *FAMILY_OPERATORS, *NEXT_LIKE, *UNTIL_LIKE))

# A larger number binds more tightly; the unary operators bind most tightly of all.
POWER = {"<->": 1, "->": 2, "|": 3, "&": 4, "U": 5, "R": 5, "W": 5, "M": 5}
UNARY_POWER = 6

_SHOWN = 100
"""Characters of the formula's line in an error: with indentation and dots it fits on a line of a terminal."""


def is_proposition_name(name: object) -> bool:
    """Return whether `name` can be written as an atom: letters, digits and underscores, but not an operator."""
    return isinstance(name, str) and bool(re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name)) and name not in RESERVED


class FormulaError(ValueError):
    """Raised if a formula cannot be read or translated.

    Attributes
    ----------
    problem : str
        What is wrong and what to write instead.
    text : str
        The formula as the user wrote it; empty if unknown.
    start, end : int
        The offending characters, ``text[start:end]``.
    """

    def __init__(self, problem: str, text: str = "", start: int = 0, end: int = 0) -> None:
        self.problem, self.text, self.start, self.end = problem, text, start, end
        super().__init__(problem + _pointer(text, start, end))

    # By default an exception is rebuilt from its message alone.
    def __reduce__(self) -> tuple[type[FormulaError], tuple[str, str, int, int]]:
        return FormulaError, (self.problem, self.text, self.start, self.end)


def _pointer(text: str, start: int, end: int) -> str:
    """Return the offending line with carets below it, cut to a window if it is long."""
    if not text:
        return ""
    # Cut the line out of the text, then a window around the place out of the line.
    left = text.rfind("\n", 0, start) + 1
    right = text.find("\n", start)
    line = text[left : right if right >= 0 else len(text)]
    column, width = start - left, max(1, end - start)
    cut = max(0, column - _SHOWN // 2)
    window = "".join(c if c.isprintable() else " " for c in line[cut : cut + _SHOWN])
    before, after = "..." if cut else "", "..." if cut + _SHOWN < len(line) else ""
    carets = "^" * max(1, min(width, cut + len(window) - column))
    return f"\n    {before}{window}{after}\n    {' ' * (len(before) + column - cut)}{carets}"


@dataclass(frozen=True)
class Formula:
    """Formula of linear temporal logic: an operator and its operands.

    Parameters
    ----------
    operator : str
        ``"atom"``, ``"true"``, ``"false"``, ``"all"``, ``"any"``, or the operator as it is written.
    operands : tuple of Formula
        Two or more for ``&`` and ``|``, two for other binary operators, one for unary ones.
    name : str
        Proposition of an atom, family of ``all`` and ``any``.
    bounds : tuple of int, optional
        ``(a, b)`` of ``F[a,b]`` and ``G[a,b]``; ``(k, k)`` of ``X[k]`` and ``N[k]``.
    span, text
        The text that the formula was read from, and its place there; ignored in comparisons.

    Raises
    ------
    FormulaError
        If it nests deeper than 100 levels.

    Examples
    --------
    >>> print(Formula("U", (Formula("atom", name="a"), Formula("atom", name="b"))))
    a U b
    """

    operator: str
    operands: tuple[Formula, ...] = ()
    name: str = ""
    bounds: tuple[int, int] | None = None
    span: tuple[int, int] = field(default=(0, 0), compare=False)
    text: str = field(default="", compare=False)
    depth: int = field(init=False, compare=False)

    def __post_init__(self) -> None:
        least, most = _arity(self.operator)
        if not least <= len(self.operands) <= most:
            raise ValueError(f"`operands`: wrong number for operator {self.operator!r}, got {len(self.operands)}")
        object.__setattr__(self, "depth", 1 + max((operand.depth for operand in self.operands), default=0))
        if self.depth > MAX_DEPTH:
            raise self.error(f"the formula nests deeper than {MAX_DEPTH} levels; chains of X can be written X[k]")

    def error(self, problem: str) -> FormulaError:
        """Return the error that points at this formula."""
        return FormulaError(problem, self.text, *self.span)

    def subformulas(self) -> Iterator[Formula]:
        """Yield this formula and all formulas below it, parents first, from left to right."""
        stack = [self]
        while stack:
            formula = stack.pop()
            yield formula
            stack.extend(reversed(formula.operands))

    @property
    def written(self) -> str:
        """The formula as it was written, where it was read from a text."""
        return self.text[slice(*self.span)] or str(self)

    def __str__(self) -> str:
        return _printed(self, 0)

    def __repr__(self) -> str:
        return f"Formula({str(self)!r})"


def _arity(operator: str) -> tuple[int, int]:
    """Return the least and largest number of operands; raise ValueError if the operator is unknown."""
    if operator in CONSTANTS or operator in FAMILY_OPERATORS or operator == "atom":
        return 0, 0
    if operator in NEXT_LIKE or operator == "!":
        return 1, 1
    if operator in ("&", "|"):
        return 2, 1 << 60  # no limit
    if operator in POWER:
        return 2, 2
    raise ValueError(f"`operator`: expected an operator of the formula syntax, got {operator!r}")


def _printed(formula: Formula, outer: int) -> str:
    """Return the text of `formula`, in parentheses if it binds weaker than `outer`."""
    operator, operands = formula.operator, formula.operands
    if operator in CONSTANTS:
        return operator
    if operator == "atom":
        return formula.name
    if operator in FAMILY_OPERATORS:
        return f"{operator}({formula.name})"
    if operator not in POWER:
        return _unary_text(formula) + _printed(operands[0], UNARY_POWER)
    power = POWER[operator]
    # Binary operators are right associative: only the last operand may bind as weakly as the operator. The operands of
    # & and | are a flat list, in which a nested one of the same kind needs its parentheses.
    texts = [_printed(operand, power + 1) for operand in operands[:-1]]
    is_chain = operator in ("&", "|")
    texts.append(_printed(operands[-1], power + 1 if is_chain else power))
    joined = f" {operator} ".join(texts)
    return f"({joined})" if power < outer else joined


def _unary_text(formula: Formula) -> str:
    """Return a unary operator with its bounds, as it stands before its operand."""
    if formula.operator == "!":
        return "!"
    if formula.bounds is None:
        return formula.operator + " "
    low, high = formula.bounds
    return f"{formula.operator}[{low}] " if formula.operator in ("X", "N") else f"{formula.operator}[{low},{high}] "
