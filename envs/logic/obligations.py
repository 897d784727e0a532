"""Obligations and their expansion: one letter of a temporal formula at a time.

An obligation (term, strong) says "the term holds from the next letter on": strong ones want a next letter, weak ones
hold also where the trace ends. A set of alternatives of obligations is a positive Boolean function of obligation
variables, kept as a decision diagram. The expansion laws

    a U b  =  b | (a & next(a U b))         a R b  =  b & (a | weak next(a R b))

turn a term into a diagram over the propositions (on top) and obligations (below): the sub-diagrams below the
propositions are what remains to be done after each letter.

An obligation is entered not as its variable alone but as the conjunction of the variables of all obligations that
it implies syntactically. The diagrams then denote f(interior(v)), where interior(v) keeps an obligation only with
all it implies; so functions that agree wherever the implications hold become the same node.
"""

from __future__ import annotations

from .decision_diagram import FALSE, TRUE, DecisionDiagrams
from .formula import FormulaError
from .guard_diagrams import propositional_diagram
from .normal_form import Term, Terms

_MAX_OBLIGATIONS = 2_500
_ALL_PAIRS = 400  # up to here implications are sought between all obligations, above only within chains of windows
_MAX_IMPLICATION_DEPTH = 60


class Obligations:
    """The obligations of one term, as variables above `n_propositions` in `diagrams`."""

    def __init__(self, diagrams: DecisionDiagrams, terms: Terms, n_propositions: int, co_safe: bool) -> None:
        self.diagrams = diagrams
        self.terms = terms
        self.n_propositions = n_propositions
        self.co_safe = co_safe
        self._node: dict[tuple[Term, bool], int] = {}
        self._order: list[tuple[Term, bool]] = []
        self._expanded: dict[Term, int] = {}
        self._advanced: dict[int, int] = {FALSE: FALSE, TRUE: TRUE}
        self._implied: dict[tuple[Term, Term], bool] = {}

    def start(self, term: Term) -> int:
        """Return the diagram of "`term` holds from the next letter on", after finding all its obligations."""
        found = dict.fromkeys(self._split(term, True))
        pending = list(found)
        for obligation in pending:  # grows while it is read
            for later in self._later(obligation[0]):
                if later not in found:
                    found[later] = None
                    pending.append(later)
            if len(found) > _MAX_OBLIGATIONS:
                raise FormulaError(
                    f"the formula unfolds into more than {_MAX_OBLIGATIONS} obligations; use smaller bounds in F[a,b], "
                    "G[a,b], X[k]"
                )
        self._enter(pending)
        return self.next(term, True)

    def next(self, term: Term, strong: bool) -> int:
        """Return the diagram of "`term` holds from the next letter on"; & and | stay outside."""
        if term.operator in ("&", "|") and not term.propositional:
            nodes = [self.next(part, strong) for part in self.terms.parts(term)]
            return self.diagrams.conjoin_all(nodes) if term.operator == "&" else self.diagrams.disjoin_all(nodes)
        if term is self.terms.true and not strong:
            return TRUE
        if term is self.terms.false and strong:
            return FALSE
        return self._node[term, strong]

    def expand(self, term: Term) -> int:
        """Return the diagram of `term` at the current letter, over propositions and obligations."""
        found = self._expanded.get(term)
        if found is None:
            found = self._expanded[term] = self._expand(term)
        return found

    def _expand(self, term: Term) -> int:
        diagrams = self.diagrams
        if term.propositional:
            return propositional_diagram(term, diagrams, self._expanded)
        if term.operator in ("&", "|"):
            nodes = [self.expand(part) for part in term.operands]
            return diagrams.conjoin_all(nodes) if term.operator == "&" else diagrams.disjoin_all(nodes)
        if term.operator in ("U", "R"):
            left, right = self.expand(term.operands[0]), self.expand(term.operands[1])
            if term.operator == "U":
                return diagrams.disjoin(right, diagrams.conjoin(left, self.next(term, True)))
            return diagrams.conjoin(right, diagrams.disjoin(left, self.next(term, False)))
        now, later = self._unroll(term)
        after = self.next(later, self._strong(term)) if later is not None else None
        if now is None:
            return after if after is not None else TRUE
        if after is None:
            return self.expand(now)
        join = diagrams.disjoin if term.operator == "F[]" else diagrams.conjoin
        return join(self.expand(now), after)

    def advance(self, f: int) -> int:
        """Return the state diagram `f` expanded at one letter: each obligation is replaced by its expansion."""
        diagrams, done = self.diagrams, self._advanced
        stack = [f]
        while stack:
            n = stack[-1]
            if n not in done:
                low, high = diagrams.low(n), diagrams.high(n)
                missing = [child for child in (low, high) if child not in done]
                if missing:
                    stack.extend(missing)
                    continue
                term = self._order[diagrams.variable(n) - self.n_propositions][0]
                done[n] = diagrams.disjoin(done[low], diagrams.conjoin(self.expand(term), done[high]))
            stack.pop()
        return done[f]

    def holds_at_end(self, f: int) -> bool:
        """Return whether state `f` accepts if no letter follows: weak obligations hold, strong ones fail."""
        while f > TRUE:
            strong = self._order[self.diagrams.variable(f) - self.n_propositions][1]
            f = self.diagrams.low(f) if strong else self.diagrams.high(f)
        return f == TRUE

    # --- which obligations there are -----------------------------------------------------------------------
    def _strong(self, window: Term) -> bool:
        return window.operator == "F[]" or self.co_safe

    def _unroll(self, window: Term) -> tuple[Term | None, Term | None]:
        """Return what a window asks of this letter, and of the next letter on."""
        assert window.bounds is not None
        low, high = window.bounds
        body = window.operands[0]
        if high == 0:
            return body, None
        later = self.terms.window(window.operator, (max(low - 1, 0), high - 1), body)
        return (body if low == 0 else None), later

    def _split(self, term: Term, strong: bool) -> list[tuple[Term, bool]]:
        """Return the obligations in ``next(term, strong)``."""
        if term.operator in ("&", "|") and not term.propositional:
            return [found for part in self.terms.parts(term) for found in self._split(part, strong)]
        if (term is self.terms.true and not strong) or (term is self.terms.false and strong):
            return []
        return [(term, strong)]

    def _later(self, term: Term) -> list[tuple[Term, bool]]:
        """Return the obligations in the expansion of `term`."""
        found: list[tuple[Term, bool]] = []
        seen: set[Term] = set()
        stack = [term]
        while stack:
            part = stack.pop()
            if part.propositional or part in seen:
                continue
            seen.add(part)
            if part.operator in ("U", "R"):
                found.append((part, part.operator == "U"))
            if part.bounds is None:
                stack.extend(reversed(part.operands))
                continue
            now, later = self._unroll(part)
            if now is not None:
                stack.append(now)
            if later is not None:
                found.extend(self._split(later, self._strong(part)))
        return found

    def _enter(self, obligations: list[tuple[Term, bool]]) -> None:
        """Number the obligations (windows over one body together, the stronger first) and make their nodes."""
        first: dict[tuple[str, int], int] = {}

        def key(item: tuple[int, tuple[Term, bool]]) -> tuple[int, int, int]:
            place, (term, strong) = item
            group = (term.operator, term.operands[0].serial) if term.bounds is not None else ("", term.serial)
            size = term.bounds[1] if term.bounds is not None else 0
            return first.setdefault(group, place), size if term.operator == "F[]" else -size, int(not strong)

        self._order = [obligation for _, obligation in sorted(enumerate(obligations), key=key)]
        literals = [self.diagrams.literal(self.n_propositions + k) for k in range(len(self._order))]
        if len(self._order) <= _ALL_PAIRS:
            for a in self._order:
                self._node[a] = self.diagrams.conjoin_all(
                    literal for literal, b in zip(literals, self._order, strict=True) if self._leads_to(a, b)
                )
            return
        after: tuple[Term, bool] | None = None
        for literal, a in zip(reversed(literals), reversed(self._order), strict=True):
            chained = after is not None and self._leads_to(a, after)
            self._node[a] = self.diagrams.conjoin(literal, self._node[after]) if chained and after else literal
            after = a

    # --- syntactic implication -----------------------------------------------------------------------------
    def _leads_to(self, a: tuple[Term, bool], b: tuple[Term, bool]) -> bool:
        return (a[1] or not b[1]) and self.implies(a[0], b[0])

    def implies(self, a: Term, b: Term, depth: int = 0) -> bool:
        """Return True only if every trace (of at least one letter) that satisfies `a` satisfies `b`."""
        if a is b or a is self.terms.false or b is self.terms.true:
            return True
        if depth > _MAX_IMPLICATION_DEPTH:
            return False
        found = self._implied.get((a, b))
        if found is None:
            found = self._implies(a, b, depth + 1)
            self._implied[a, b] = found
        return found

    def _implies(self, a: Term, b: Term, depth: int) -> bool:
        if a.propositional and b.propositional:
            return self.diagrams.conjoin(self.expand(a), self.diagrams.negate(self.expand(b))) == FALSE
        if a.operator == "|":
            return all(self.implies(part, b, depth) for part in self.terms.parts(a))
        if b.operator == "&":
            return all(self.implies(a, part, depth) for part in self.terms.parts(b))
        if b.operator == "|" and any(self.implies(a, part, depth) for part in self.terms.parts(b)):
            return True
        if a.operator == "&" and any(self.implies(part, b, depth) for part in self.terms.parts(a)):
            return True
        return self._from(a, b, depth) or self._into(a, b, depth)

    def _from(self, a: Term, b: Term, depth: int) -> bool:
        """Apply the rules that look into `a`."""
        if a.operator == "U":  # a holds only where one of its operands does
            return all(self.implies(part, b, depth) for part in a.operands)
        if a.operator == "R":
            return self.implies(a.operands[1], b, depth)
        if a.operator == "G[]" and a.bounds is not None and a.bounds[0] == 0:
            return self.implies(a.operands[0], b, depth)
        if a.operator == "F[]" and b.operator == "U" and b.operands[0] is self.terms.true:
            return self.implies(a.operands[0], b, depth)
        return False

    def _into(self, a: Term, b: Term, depth: int) -> bool:
        """Apply the rules that look into `b`."""
        if b.operator == "U":
            left, right = b.operands
            if self.implies(a, right, depth):
                return True
            if a.operator == "U":
                return self.implies(a.operands[0], left, depth) and self.implies(a.operands[1], b, depth)
            return False
        if b.operator == "R":
            left, right = b.operands
            if not self.implies(a, right, depth):
                return False
            if a.operator == "R" and self.implies(a.operands[0], left, depth):
                return True
            return left is not self.terms.false and self.implies(a, left, depth)
        if b.bounds is None:
            return False
        body = b.operands[0]
        if a.operator == b.operator and a.bounds is not None:
            inner, outer = (a.bounds, b.bounds) if b.operator == "F[]" else (b.bounds, a.bounds)
            within = outer[0] <= inner[0] and inner[1] <= outer[1]
            if within and self.implies(a.operands[0], body, depth):
                return True
        if b.operator == "F[]":
            return b.bounds[0] == 0 and self.implies(a, body, depth)
        always = a.operator == "R" and a.operands[0] is self.terms.false
        return always and not self.co_safe and self.implies(a, body, depth)
