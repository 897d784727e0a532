"""Reader of the Hanoi Omega-Automata format, version 1: it reads the text; `hoa` says what it means for a task.

Reference: https://adl.github.io/hoaf/ (Babiak et al., CAV 2015).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from .decision_diagram import FALSE, TRUE, DecisionDiagrams

_MAX_NESTING = 100
"""Deepest nesting of a label, far from Python's limit on recursion."""

# Headers that the format defines; of others, those with a capital letter may change the meaning, and are refused.
_HEADERS = ("HOA", "States", "Start", "AP", "Alias", "Acceptance", "acc-name", "tool", "name", "properties")

# One group per kind of token, in this order.
_KINDS = ("string", "marker", "header", "alias", "name", "number", "symbol", "stray")
_TOKEN = re.compile(
    r'\s*(?:("(?:\\.|[^"\\])*")|(--BODY--|--END--|--ABORT--)|([A-Za-z_][\w-]*:)|(@[\w-]+)|([A-Za-z_][\w-]*)|([0-9]+)'
    r"|([\[\](){}!&|])|(\S))",
    re.ASCII | re.DOTALL,
)
# Comments nest, so they are removed by counting; a string may hold what looks like a comment.
_STRING_OR_COMMENT = re.compile(r'"(?:\\.|[^"\\])*"|/\*', re.DOTALL)
_COMMENT_EDGE = re.compile(r"/\*|\*/")


@dataclass(frozen=True)
class HoaToken:
    """A piece of the text: its kind, its characters and its line (from 1)."""

    kind: str
    text: str
    line: int

    def is_a(self, *kinds: str) -> bool:
        """Return whether it is of one of some kinds."""
        return self.kind in kinds


@dataclass
class HoaState:
    """A state as written: its label and marks, and its edges (label, target, marks); labels are diagrams."""

    number: int
    label: int | None
    marks: set[int]
    edges: list[tuple[int | None, int, set[int]]] = field(default_factory=list)


@dataclass
class HoaText:
    """An automaton as written, before any meaning is given to it."""

    starts: list[list[int]] = field(default_factory=list)
    n_states: int | None = None
    atoms: list[str] | None = None
    acceptance: str = ""
    aliases: dict[str, int] = field(default_factory=dict)
    states: dict[int, HoaState] = field(default_factory=dict)


def hoa_error(problem: str, line: int | None = None) -> ValueError:
    """Return the error for a HOA text."""
    return ValueError(f"`hoa`{'' if line is None else f', line {line}'}: {problem}")


class HoaReader:
    """Recursive-descent reader of one automaton.

    Parameters
    ----------
    text : str
        One automaton.
    diagrams : DecisionDiagrams
        Manager for the labels.
    variable_of : callable
        Maps the name of an atomic proposition to its variable.
    """

    def __init__(self, text: str, diagrams: DecisionDiagrams, variable_of: Callable[[str], int]) -> None:
        self.tokens = _tokens(text)
        self.at = 0
        self.diagrams = diagrams
        self.variable_of = variable_of
        self.hoa = HoaText()
        self.variables: list[int] = []

    def read(self) -> HoaText:
        """Return the automaton; raise ValueError if the text is not one automaton in HOA version 1."""
        if self._take("header", "HOA: v1 at the beginning").text != "HOA:" or self._advance().text != "v1":
            raise hoa_error("expected HOA: v1 at the beginning", 1)
        while self._token.is_a("header"):
            self._header(self._advance())
        self._symbol("--BODY--")
        while self._token.text == "State:":
            self._state()
        self._symbol("--END--")
        if not self._token.is_a("end"):
            raise hoa_error("expected one automaton, more text follows after --END--", self._token.line)
        return self.hoa

    # --- tokens --------------------------------------------------------------------------------------------
    @property
    def _token(self) -> HoaToken:
        return self.tokens[self.at]

    def _advance(self) -> HoaToken:
        token = self.tokens[self.at]
        self.at = min(self.at + 1, len(self.tokens) - 1)
        return token

    def _take(self, kind: str, what: str) -> HoaToken:
        if not self._token.is_a(kind):
            raise hoa_error(f"expected {what}, got {self._token.text[:40] or 'the end'!r}", self._token.line)
        return self._advance()

    def _symbol(self, text: str) -> None:
        if self._token.text != text:
            raise hoa_error(f"expected {text}, got {self._token.text[:40] or 'the end'!r}", self._token.line)
        self._advance()

    def _number(self, what: str) -> int:
        token = self._take("number", what)
        if len(token.text) > 9:
            raise hoa_error(f"expected a number below 10^9, got {token.text[:40]}", token.line)
        return int(token.text)

    # --- headers -------------------------------------------------------------------------------------------
    def _header(self, token: HoaToken) -> None:
        """Read the content of one header."""
        name = token.text[:-1]
        if name not in _HEADERS and name[0].isupper():
            raise hoa_error(f"the header {name}: is unknown, and its capital letter says that it matters", token.line)
        if name == "States":
            self.hoa.n_states = self._number("the number of states")
        elif name == "Start":
            self.hoa.starts.append(self._conjunction())
        elif name == "AP":
            self._atoms(token)
        elif name == "Alias":
            alias = self._take("alias", "an alias such as @a").text
            self.hoa.aliases[alias] = self._expression(0)
        else:
            words: list[str] = []
            while not self._token.is_a("header", "marker", "end"):
                words.append(self._advance().text)
            if name == "Acceptance":  # the other headers say nothing that is needed
                self.hoa.acceptance = " ".join(words)

    def _atoms(self, token: HoaToken) -> None:
        """Read the number and the names of the atomic propositions."""
        if self.hoa.atoms is not None:
            raise hoa_error("expected one AP: header, got two", token.line)
        count = self._number("the number of atomic propositions")
        self.hoa.atoms = []
        for _ in range(count):
            written = self._take("string", f"{count} quoted names after AP:").text
            self.hoa.atoms.append(re.sub(r"\\(.)", r"\1", written[1:-1], flags=re.DOTALL))
        if len(set(self.hoa.atoms)) < count:
            raise hoa_error("expected different atomic propositions, got one twice", token.line)
        # Labels name propositions by their position in this header.
        self.variables = [self.variable_of(name) for name in self.hoa.atoms]

    def _conjunction(self) -> list[int]:
        """Read states joined by &, which only alternating automata have more than one of."""
        states = [self._number("a state")]
        while self._token.text == "&":
            self._advance()
            states.append(self._number("a state"))
        return states

    # --- body ----------------------------------------------------------------------------------------------
    def _state(self) -> None:
        """Read a state and its edges."""
        line = self._advance().line
        label = self._label()
        number = self._number("a state")
        if self._token.is_a("string"):
            self._advance()
        if number in self.hoa.states:
            raise hoa_error(f"expected state {number} once, got it twice", line)
        state = HoaState(number, label, self._marks())
        self.hoa.states[number] = state
        while self._token.text == "[" or self._token.is_a("number"):
            line = self._token.line
            label = self._label()
            targets = self._conjunction()
            if len(targets) > 1:
                raise hoa_error("expected one target per edge, got a conjunction (alternation)", line)
            state.edges.append((label, targets[0], self._marks()))

    def _marks(self) -> set[int]:
        marks: set[int] = set()
        if self._token.text == "{":
            self._advance()
            while self._token.is_a("number"):
                marks.add(self._number("an acceptance set"))
            self._symbol("}")
        return marks

    def _label(self) -> int | None:
        if self._token.text != "[":
            return None
        self._advance()
        expression = self._expression(0)
        self._symbol("]")
        return expression

    def _expression(self, depth: int) -> int:
        """Read a Boolean expression: a disjunction of conjunctions of factors."""
        if depth > _MAX_NESTING:
            raise hoa_error(f"a label nests deeper than {_MAX_NESTING} levels", self._token.line)
        result = self._product(depth)
        while self._token.text == "|":
            self._advance()
            result = self.diagrams.disjoin(result, self._product(depth))
        return result

    def _product(self, depth: int) -> int:
        """Read a conjunction of factors."""
        result = self._factor(depth)
        while self._token.text == "&":
            self._advance()
            result = self.diagrams.conjoin(result, self._factor(depth))
        return result

    def _factor(self, depth: int) -> int:
        """Read a constant, an alias, a proposition or an expression in parentheses, possibly negated."""
        negative = False
        while self._token.text == "!":
            self._advance()
            negative = not negative
        token = self._advance()
        if token.text == "(":
            result = self._expression(depth + 1)
            self._symbol(")")
        elif token.is_a("name") and token.text in ("t", "f"):
            result = TRUE if token.text == "t" else FALSE
        elif token.is_a("alias") and token.text in self.hoa.aliases:
            result = self.hoa.aliases[token.text]
        elif token.is_a("number") and len(token.text) < 10 and int(token.text) < len(self.variables):
            result = self.diagrams.literal(self.variables[int(token.text)])
        else:
            choices = f"t, f, a declared alias or a number below {len(self.variables)}"
            raise hoa_error(f"expected {choices} in a label, got {token.text[:40] or 'the end'!r}", token.line)
        return self.diagrams.negate(result) if negative else result


def _tokens(text: str) -> list[HoaToken]:
    """Return the tokens of a text, and one for its end."""
    text = _without_comments(text)
    tokens: list[HoaToken] = []
    # Lines are counted from token to token, so that long texts are read in linear time.
    at, line, counted = 0, 1, 0
    while match := _TOKEN.match(text, at):
        at = match.end()
        group = match.lastindex or len(_KINDS)
        line += text.count("\n", counted, match.start(group))
        counted = match.start(group)
        tokens.append(HoaToken(_KINDS[group - 1], match.group(group), line))
    tokens.append(HoaToken("end", "", line))
    return tokens


def _without_comments(text: str) -> str:
    """Return `text` with its (nested) comments replaced by blanks; line breaks stay."""
    pieces: list[str] = []
    depth = at = 0
    while match := (_COMMENT_EDGE if depth else _STRING_OR_COMMENT).search(text, at):
        if depth:
            pieces.append("\n" * text.count("\n", at, match.start()))
            depth += 1 if match.group() == "/*" else -1
        elif match.group() == "/*":
            pieces.append(text[at : match.start()] + " ")
            depth = 1
        else:
            pieces.append(text[at : match.end()])
        at = match.end()
    if depth:
        raise hoa_error("a comment /* is not closed")
    return "".join(pieces) + text[at:]
