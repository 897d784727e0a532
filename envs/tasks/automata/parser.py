"""The parser of temporal-logic formulas.

Syntax, from the tightest binding to the loosest::

    true false  a  all(family) any(family)  (...)
    ! X N F G  X[k] N[k] F[a,b] G[a,b]          next X, weak next N, eventually F, always G
    U R W M  U[a,b]                             until, release, weak until, strong release; right associative
    &
    |
    ->                                          right associative
    <->                                         right associative

``&&``, ``||`` and ``~`` are read as ``&``, ``|`` and ``!``. Names are letters, digits and underscores. An operator of
one letter is read as an operator only when it stands alone, so ``Fa`` is an atom. ``F[a,b] f`` means that f holds at
one of the letters a, ..., b, counted from now (0 = now). ``f U[a,b] g`` stands for ``G[0,a-1] f & X[a] ((f U g) &
F[0,b-a] g)``: the first g comes in time.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from .formula import (
    CONSTANTS,
    FAMILY_OPERATORS,
    MAX_BOUND,
    MAX_DEPTH,
    NEXT_LIKE,
    POWER,
    RESERVED,
    Formula,
    FormulaError,
    is_proposition_name,
)

__all__ = ["Formula", "FormulaError", "is_proposition_name", "parse_formula"]

MAX_LENGTH = 500_000
"""Most characters: a formula over thousands of agents that is written out, which still parses in seconds."""

# A name, a number, a symbol of the syntax, or any other character (an error).
_TOKEN = re.compile(r"[ \t\r\n]*(?:([A-Za-z_][A-Za-z0-9_]*)|([0-9]+)|(<->|->|&&|\|\||[!~&|()\[\],])|(\S))")
_SPELLING = {"&&": "&", "||": "|", "~": "!"}
# What users of other notations write, and what it is here.
_HINTS = {
    "and": "write & for and",
    "or": "write | for or",
    "not": "write ! for not",
    "implies": "write -> for implies",
    "iff": "write <-> for if and only if",
    "0": "write false",
    "1": "write true",
    "<": "the operators with < are <->; eventually is written F; numbers are compared in `[propositions]`",
    ">": 'numbers are compared in `[propositions]`, such as `fast = { agent = "car", low = [2], high = [9] }`',
    "=": "implication is written ->, equivalence <->; numbers are compared in `[propositions]`",
    "-": "the operators with - are -> and <->",
    "[": "bounds follow one of X, N, F, G, U; always is written G",
    ":": "bounds are written with a comma: F[0,3]",
    **dict.fromkeys(("eventually", "finally"), "write F for eventually"),
    **dict.fromkeys(("always", "globally"), "write G for always"),
    "until": "write U for until",
    "next": "write X for next",
}


@dataclass(frozen=True)
class _Token:
    kind: str  # "name", "number", "symbol" or "end"
    text: str
    start: int
    end: int

    def is_a(self, kind: str) -> bool:
        return self.kind == kind


def parse_formula(text: str) -> Formula:
    """Return the formula written in `text`.

    Raises
    ------
    FormulaError
        If the text is not a formula; the message points at the place.

    Examples
    --------
    >>> parse_formula("!a U b & c").operator
    '&'
    """
    if not isinstance(text, str):
        raise ValueError(f"`formula`: expected a string, got {type(text).__name__}")
    if len(text) > MAX_LENGTH:
        raise FormulaError(f"the formula is longer than {MAX_LENGTH} characters; write families as all(...), any(...)")
    parser = _Parser(text)
    try:
        formula = parser.binary(0)
    except FormulaError as error:
        raise error.with_traceback(None) from None  # leaves out the hundreds of frames of a deep nest
    if not parser.token.is_a("end"):
        raise parser.unexpected("expected an operator or the end of the formula", after=parser.before())
    return formula


def _tokens(text: str) -> list[_Token]:
    """Return the tokens of a formula, and one for its end."""
    tokens: list[_Token] = []
    at = 0
    while match := _TOKEN.match(text, at):
        at = match.end()
        group = match.lastindex or 4
        word = match.group(group)
        kind = ("name", "number", "symbol", "stray")[group - 1]
        tokens.append(_Token(kind, _SPELLING.get(word, word), match.start(group), at))
    tokens.append(_Token("end", "", len(text.rstrip()), len(text.rstrip())))
    return tokens


class _Parser:
    """Operator-precedence parser (Pratt): one token of look-ahead."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens = _tokens(text)
        self.at = 0
        self.depth = 0

    @property
    def token(self) -> _Token:
        return self.tokens[self.at]

    def advance(self) -> _Token:
        token = self.tokens[self.at]
        self.at = min(self.at + 1, len(self.tokens) - 1)
        return token

    def error(self, problem: str, token: _Token) -> FormulaError:
        return FormulaError(problem, self.text, token.start, token.end)

    def before(self) -> str:
        """Return the last token that was read: `not a` reads `not` as a name, and stumbles over `a`."""
        return self.tokens[self.at - 1].text if self.at else ""

    def unexpected(self, problem: str, after: str = "") -> FormulaError:
        token = self.token
        if token.is_a("end"):
            return self.error(f"{problem}, but the formula ends here" if self.text.strip() else "empty formula", token)
        hint = _HINTS.get(token.text) or (_HINTS.get(after) if token.is_a("name") or token.text == "(" else None)
        shown = token.text if len(token.text) <= 40 else token.text[:40] + "..."
        return self.error(f"{problem}, got {shown!r}" + (f"; {hint}" if hint else ""), token)

    def expect(self, symbol: str, problem: str) -> _Token:
        if not self.token.is_a("symbol") or self.token.text != symbol:
            raise self.unexpected(problem)
        return self.advance()

    def make(
        self,
        operator: str,
        start: int,
        operands: tuple[Formula, ...] = (),
        name: str = "",
        bounds: tuple[int, int] | None = None,
    ) -> Formula:
        return Formula(operator, operands, name, bounds, (start, self.tokens[self.at - 1].end), self.text)

    def binary(self, least: int) -> Formula:
        """Read operands joined by binary operators that bind at least as tightly as `least`."""
        self.depth += 1
        if self.depth > 2 * MAX_DEPTH:
            raise self.error(f"the formula nests deeper than {MAX_DEPTH} levels", self.token)
        # Precedence climbing: the right operand takes in all that binds at least as tightly as its operator.
        start = self.token.start
        left = self.unary()
        while not self.token.is_a("end") and POWER.get(self.token.text, -1) >= least:
            token = self.advance()
            operator, power = token.text, POWER[token.text]
            bounds = self.bounds(token) if operator == "U" and self.token.text == "[" else None
            operands = [left]
            if operator in ("&", "|"):
                # A chain of one operator becomes one node, so that long conjunctions do not nest.
                operands.append(self.binary(power + 1))
                while self.token.text == operator:
                    self.advance()
                    operands.append(self.binary(power + 1))
            else:
                operands.append(self.binary(power))
            left = self.until(operands, bounds, start) if bounds else self.make(operator, start, tuple(operands))
        self.depth -= 1
        return left

    def until(self, operands: list[Formula], bounds: tuple[int, int], start: int) -> Formula:
        """Return ``f U[a,b] g`` in the operators that there are."""
        (before, goal), (first, last) = operands, bounds
        in_time = self.make("F", start, (goal,), bounds=(0, last - first))
        then = self.make("&", start, (self.make("U", start, (before, goal)), in_time))
        if first == 0:
            return then
        stays = self.make("G", start, (before,), bounds=(0, first - 1))
        return self.make("&", start, (stays, self.make("X", start, (then,), bounds=(first, first))))

    def unary(self) -> Formula:
        """Read prefix operators and what they apply to."""
        # Collect the prefixes in a loop: a long chain of them needs no recursion.
        prefixes: list[tuple[str, int, tuple[int, int] | None]] = []
        while self.token.text in NEXT_LIKE or self.token.text == "!":
            token = self.advance()
            bounded = token.text != "!" and self.token.text == "["
            prefixes.append((token.text, token.start, self.bounds(token) if bounded else None))
        formula = self.primary()
        for operator, start, bounds in reversed(prefixes):
            formula = self.make(operator, start, (formula,), bounds=bounds)
        return formula

    def primary(self) -> Formula:
        """Read a constant, an atom, a family or a formula in parentheses."""
        token = self.token
        if token.text in CONSTANTS:
            self.advance()
            return self.make(token.text, token.start)
        if token.text in FAMILY_OPERATORS:
            self.advance()
            self.expect("(", f"expected ({token.text} of a family is written {token.text}(family))")
            if not is_proposition_name(self.token.text):
                raise self.unexpected("expected the name of a family")
            name = self.advance().text
            self.expect(")", "expected )")
            return self.make(token.text, token.start, name=name)
        if token.is_a("name") and token.text not in RESERVED:
            self.advance()
            return self.make("atom", token.start, name=token.text)
        if token.text == "(":
            self.advance()
            formula = self.binary(0)
            if self.token.text != ")":
                problem = f"expected an operator or ) for the ( at character {token.start + 1}"
                raise self.unexpected(problem, after=self.before())
            self.advance()
            return formula
        raise self.unexpected("expected a formula")

    def bounds(self, operator: _Token) -> tuple[int, int]:
        """Read ``[k]`` after X or N, ``[a,b]`` after F, G or U."""
        self.expect("[", "expected [")
        low = high = self.bound(operator)
        if operator.text in ("F", "G", "U"):
            if self.token.text == "]":  # F[3] means one or the other elsewhere
                advice = f"{operator.text}[0,{low}] looks at the next {low} letters too, X[{low}] {low} letters ahead"
                raise self.error(f"expected two bounds: {advice}", self.token)
            self.expect(",", "expected a comma between two bounds")
            at = self.token
            high = self.bound(operator)
            if high < low:
                raise self.error(f"expected an upper bound of at least {low}, got {high}", at)
        elif self.token.text == ",":
            raise self.unexpected(f"expected one number in {operator.text}[k]; windows are written F[a,b], G[a,b]")
        self.expect("]", "expected ]")
        return low, high

    def bound(self, operator: _Token) -> int:
        """Read one number between the brackets."""
        token = self.token
        if not token.is_a("number"):
            form = f"{operator.text}[a,b]" if operator.text in ("F", "G", "U") else f"{operator.text}[k]"
            hint = f"; without a bound write {operator.text} alone" if token.is_a("name") else ""
            if token.text == "<":
                raise self.error(
                    f"expected a whole number of letters in {form}; at most 10 is {operator.text}[0,10]", token
                )
            raise self.unexpected(f"expected a whole number of letters in {form}{hint}")
        self.advance()
        if len(token.text) > 18 or int(token.text) > MAX_BOUND:
            raise self.error(f"expected a bound of at most {MAX_BOUND}", token)
        return int(token.text)
