"""Formulas of linear temporal logic (LTL): that an automaton accepts no word that its formula does not.

Over words: ``!`` ``&`` ``|`` ``->`` ``<->``; ``X f`` (there is a next letter, and f holds from it on), ``N f`` (if
there is a next letter, f holds from it on), ``f U g``, ``f R g``, ``f W g``, ``f M g``, ``F f``, ``G f``, and with
steps counted ``X[k] f``, ``F[a,b] f``, ``G[a,b] f`` (``F[k]`` is ``F[0,k]``). Under *finite-trace* semantics the word
has T + 1 letters; a *co-safe* task is satisfied by a prefix if every infinite word that goes on from it satisfies the
formula.

**Theorem.** If ``wrong_automaton`` returns nothing, every word that the automaton accepts satisfies the formula.

*Proof.* What a formula asks of the rest of a word is a Boolean function of formulas that hold from the next letter on
(progression: ``f U g`` is ``g | f & X (f U g)``), kept as a reduced ordered decision diagram, so that equal functions
are the same number. All pairs (state, function) that words reach are visited, beginning with the letter of time 0.
Where a state accepts, the function must be true of the word that ends there: true for every continuation (co-safe), or
true where no next letter exists (finite-trace). From dead states no word is accepted. QED

The test is sound and not complete: equal languages whose functions differ are refused. Nothing is minimised, and no
translation is trusted. Reference: Bacchus and Kabanza, Annals of Mathematics and Artificial Intelligence 22 (1998).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, TypeAlias

from .automaton import Automaton
from .fields import NAME, Refused

Formula: TypeAlias = Any

TOKEN = re.compile(r"\s*(<->|->|[()!&|,\[\]]|[A-Za-z_][A-Za-z0-9_]*|[0-9]+)")
WORDS = frozenset(("true", "false", "X", "N", "F", "G", "U", "R", "W", "M"))
# How tightly operators bind; ``->`` and the temporal ones bind to the right.
POWER = {"<->": 1, "->": 2, "|": 3, "&": 4, "U": 5, "R": 5, "W": 5, "M": 5}
# Steps in a window, characters, levels of brackets, and nodes or pairs that are visited at most.
LARGEST_BOUND, LONGEST, DEEPEST, MOST = 10_000, 200_000, 200, 200_000


class _Parser:
    """Recursive descent over the tokens of a text."""

    def __init__(self, text: str) -> None:
        if len(text) > LONGEST:
            raise ValueError(f"the formula has more than {LONGEST} characters")
        self.tokens, self.at = [*TOKEN.findall(text), ""], 0
        if "".join(self.tokens) != re.sub(r"\s", "", text):
            raise ValueError("the formula holds a character that no formula has")

    def take(self, wanted: str = "") -> str:
        """Return the next token, which is the one that is wanted."""
        token = self.tokens[self.at]
        if not token or (wanted and token != wanted):
            raise ValueError(f"the formula has {token or 'its end'!r} where {wanted or 'more'!r} is expected")
        self.at += 1
        return token

    def binary(self, power: int, depth: int) -> Formula:
        """Return a formula whose operators bind at least so tightly."""
        left = self.unary(depth)
        while (own := POWER.get(self.tokens[self.at], 0)) >= power:
            token = self.take()
            left = (token, left, self.binary(*((own, depth + 1) if own in (2, 5) else (own + 1, depth))))
        return left

    def unary(self, depth: int) -> Formula:
        """Return a name, a formula in brackets, or one after a sign or a temporal operator."""
        if depth > DEEPEST:
            raise ValueError(f"the formula is nested deeper than {DEEPEST} levels")
        token = self.take()
        if token == "(":
            inner = self.binary(1, depth + 1)
            self.take(")")
            return inner
        if token in ("!", "X", "N", "F", "G"):
            bounds = self.bounds(token)
            inner = self.unary(depth + 1)
            if token != "X" or not bounds:
                return (token, inner, *bounds)
            for _ in range(bounds[0]):  # X[k] f is X .. X f
                inner = ("X", inner)
            return inner
        if not NAME.fullmatch(token) or token in WORDS - {"true", "false"}:
            raise ValueError(f"the formula has {token!r} where a name is expected")
        return {"true": True, "false": False}.get(token, token)

    def bounds(self, token: str) -> tuple[int, ...]:
        """Return the window of an operator, if there is one: [k] of F and G is [0, k]."""
        if self.tokens[self.at] != "[":
            return ()
        self.take("[")
        bounds = [int(self.take())]
        while self.tokens[self.at] == ",":
            self.take(",")
            bounds.append(int(self.take()))
        self.take("]")
        most = {"X": 1, "F": 2, "G": 2}.get(token, 0)
        if max(bounds) > LARGEST_BOUND or sorted(bounds) != bounds or len(bounds) > most:
            raise ValueError(f"the formula has a window {bounds} that no operator {token} has")
        return tuple(bounds) if len(bounds) == most else (0, *bounds)


def parse(text: str) -> Formula:
    """Return the formula of a text: a Boolean, a name, or a tuple (operator, operands .., bounds ..)."""
    parser = _Parser(text)
    formula = parser.binary(1, 0)
    if parser.tokens[parser.at]:
        raise ValueError(f"the formula has {parser.tokens[parser.at]!r} after its end")
    return formula


class _Diagrams:
    """Reduced ordered decision diagrams: 0, 1, and nodes (variable, low, high) by number."""

    def __init__(self) -> None:
        self.nodes: list[tuple[int, int, int]] = [(-1, 0, 0), (-1, 1, 1)]
        self.numbers: dict[tuple[int, int, int], int] = {}
        self.variables: dict[Formula, int] = {}
        self.meanings: list[Formula] = []
        self.memo: dict[tuple[int, int, int], int] = {}

    def node(self, variable: int, low: int, high: int) -> int:
        if low == high:
            return low
        key = variable, low, high
        if key not in self.numbers:
            if len(self.nodes) > MOST:
                raise Refused(f"the formula needs more than {MOST} nodes to be proved")
            self.numbers[key] = len(self.nodes)
            self.nodes.append(key)
        return self.numbers[key]

    def variable(self, meaning: Formula) -> int:
        """Return the diagram of a variable: a proposition, or a formula that holds from the next letter on."""
        if meaning not in self.variables:
            self.variables[meaning] = len(self.meanings)
            self.meanings.append(meaning)
        return self.node(self.variables[meaning], 0, 1)

    def ite(self, f: int, g: int, h: int) -> int:
        """Return (f and g) or (not f and h)."""
        if f < 2:
            return g if f else h
        if (f, g, h) not in self.memo:
            v = min(self.nodes[n][0] for n in (f, g, h) if n > 1)
            low, high = ([self.side(n, v, s) for n in (f, g, h)] for s in (1, 2))
            self.memo[f, g, h] = self.node(v, self.ite(*low), self.ite(*high))
        return self.memo[f, g, h]

    def side(self, f: int, v: int, side: int) -> int:
        return self.nodes[f][side] if f > 1 and self.nodes[f][0] == v else f


SHORT: dict[str, Callable[..., Formula]] = {
    "F": lambda a: ("U", True, a),
    "G": lambda a, *window: ("!", ("F", ("!", a), *window)),
    "M": lambda a, b: ("U", b, ("&", a, b)),
    "R": lambda a, b: ("!", ("U", ("!", a), ("!", b))),
    "W": lambda a, b: ("!", ("U", ("!", b), ("&", ("!", a), ("!", b)))),
}
"""What operators are short for; F with a window is not."""


class _Progression(_Diagrams):
    """What formulas ask of the rest of a word, letter by letter."""

    def __init__(self, propositions: tuple[str, ...]) -> None:
        super().__init__()
        self.P, self.asked = len(propositions), dict[Formula, int]()
        for name in propositions:  # propositions come first in the order of variables
            self.variable(name)
        self.after: dict[int, int] = {}

    def now(self, f: Formula) -> int:
        """Return what a formula asks from a letter on, over propositions there and formulas at the next letter."""
        if f not in self.asked:
            self.asked[f] = self._now(f)
        return self.asked[f]

    def _now(self, f: Formula) -> int:
        if isinstance(f, bool):
            return int(f)
        if isinstance(f, str):
            if f not in self.variables:
                raise Refused(f"the formula names {f!r}, which is no proposition")
            return self.variable(f)
        operator, a, *rest = f
        # Promises are variables: what holds from the next letter on.
        if operator == "X":
            return self.variable(f)
        if operator == "N":
            return self.ite(self.variable(("X", ("!", a))), 0, 1)
        if operator == "!":
            return self.ite(self.now(a), 0, 1)
        if operator == "F" and rest:
            # F[a,b] f: later, while a > 0; then f holds now, or within what is left of the window
            low, high = rest
            if low or high:
                later = self.variable(("X", ("F", a, max(low - 1, 0), high - 1)))
                return later if low else self.ite(self.now(a), 1, later)
            return self.now(a)
        # f U g holds if g does, or f does and it holds from the next letter on.
        if operator == "U":
            return self.ite(self.now(rest[0]), 1, self.ite(self.now(a), self.variable(("X", f)), 0))
        # The others are short for these.
        if operator in SHORT:
            return self.now(SHORT[operator](a, *rest))
        x, y = self.now(a), self.now(rest[0])
        # f holds and what then; f fails and what then
        then, otherwise = {"&": (y, 0), "|": (1, y), "->": (y, 1), "<->": (y, self.ite(y, 0, 1))}[operator]
        return self.ite(x, then, otherwise)

    def stepped(self, f: int) -> int:
        """Return a function over formulas at the next letter as one over the propositions of that letter."""
        if f < 2:
            return f
        if f not in self.after:
            v, low, high = self.nodes[f]
            promised = self.now(self.meanings[v][1])  # the f of X f
            self.after[f] = self.ite(promised, self.stepped(high), self.stepped(low))
        return self.after[f]

    def holds_at_end(self, f: int) -> bool:
        """Return whether a function is true where no next letter exists: every X is false there."""
        while f > 1:  # the side on which a variable is false
            f = self.nodes[f][1]
        return bool(f)


def wrong_automaton(automaton: Automaton, formula: Formula) -> str:
    """Return which state accepts a word that the formula does not; an empty text if none does."""
    progression, dead = _Progression(automaton.propositions), automaton.dead()
    # The word of no letter: a co-safe automaton that accepts it accepts every word.
    before = progression.variable(("X", formula))
    if automaton.is_co_safe and automaton.accepting[automaton.initial] and progression.now(formula) != 1:
        return f"state {automaton.initial} accepts before any letter, and the formula is not always true"
    # Every pair of a state and of what the formula still asks, that some word leads to.
    stack = _letters(progression, automaton, automaton.initial, progression.stepped(before))
    seen: set[tuple[int, int]] = set()
    while stack:
        pair = q, f = stack.pop()
        if pair in seen or dead[q]:
            continue
        seen.add(pair)
        if len(seen) > MOST:
            raise Refused(f"the formula needs more than {MOST} pairs to be proved")
        if automaton.accepting[q] and not (f == 1 if automaton.is_co_safe else progression.holds_at_end(f)):
            return f"state {q} accepts a word that does not satisfy the formula"
        # a function that is true stays so, and a co-safe run that has accepted is done
        if f != 1 and not (automaton.is_co_safe and automaton.accepting[q]):
            stack += _letters(progression, automaton, q, progression.stepped(f))
    return ""


def _letters(progression: _Progression, automaton: Automaton, q: int, f: int) -> list[tuple[int, int]]:
    """Return the states and functions that letters lead to: the two diagrams over propositions, side by side."""
    d, pairs = progression, []
    stack, seen = [(automaton.root[q], f)], set[tuple[int, int]]()
    while stack:
        entry, f = place = stack.pop()
        if place in seen:
            continue
        seen.add(place)
        tests = [automaton.variable[entry]] if entry >= 0 else []
        tests += [d.nodes[f][0]] if f > 1 and d.nodes[f][0] < progression.P else []
        if not tests:
            pairs.append((-1 - entry, f))
            continue
        # Both diagrams go on at the smaller proposition.
        p = min(tests)
        here = entry >= 0 and automaton.variable[entry] == p
        entries = (automaton.low[entry], automaton.high[entry]) if here else (entry, entry)
        stack += zip(entries, (d.side(f, p, 1), d.side(f, p, 2)), strict=True)
    return pairs
