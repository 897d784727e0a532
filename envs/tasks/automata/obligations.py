"""Obligations and their expansion: one letter of a temporal formula at a time.

An obligation (term, strong) says "the term holds from the next letter on". A strong one asks for a next letter; a weak
one also holds if the trace ends. Alternative sets of obligations are a positive Boolean function of obligation
variables, stored as a decision diagram. The expansion laws

    a U b  =  b | (a & next(a U b))         a R b  =  b & (a | weak next(a R b))

turn a term into a diagram over the propositions (on top) and obligations (below). The sub-diagrams below the
propositions say what remains to be done after each letter.

The diagram of an obligation is not its variable alone but the conjunction of the variables of all obligations that it
implies syntactically. The diagrams then denote f(interior(v)), where interior(v) drops every obligation some of whose
implications are missing. So functions that agree wherever the implications hold become the same node.
"""

from __future__ import annotations

from .decision_diagram import FALSE, TRUE, DecisionDiagrams
from .formula import FormulaError
from .guard_diagrams import propositional_diagram
from .normal_form import Term, Terms

_MAX_OBLIGATIONS = 2_500
"""Most obligations of a formula. A window F[a,b] unfolds into b of them, so bounds of two thousand letters fit."""

_ALL_PAIRS = 400
"""Number of obligations up to which all pairs are tested for implication (160,000 tests).

Above it only neighbours in chains of windows are tested.
"""

_MAX_IMPLICATION_DEPTH = 60
"""Deepest recursion of an implication test. To give up is safe: fewer states are equal before minimisation."""


class Obligations:
    """The obligations of one term, as variables above `n_propositions` in `diagrams`."""

    def __init__(self, diagrams: DecisionDiagrams, terms: Terms, n_propositions: int, co_safe: bool) -> None:
        self.diagrams = diagrams
        self.terms = terms
        self.n_propositions = n_propositions
        self.co_safe = co_safe
        self._node: dict[tuple[Term, bool], int] = {}
        self._order: list[tuple[Term, bool]] = []
        self._chain: list[int] = []
        self._expanded: dict[Term, int] = {}
        self._advanced: dict[int, int] = {FALSE: FALSE, TRUE: TRUE}
        self._implied: dict[tuple[Term, Term], bool] = {}

    def start(self, term: Term) -> int:
        """Return the diagram of "`term` holds from the next letter on", after finding all its obligations."""
        # All must be known before the first diagram: their order is that of the variables.
        seen = dict.fromkeys(self._split(term, True))
        pending = list(seen)
        for obligation in pending:  # grows while it is read
            for later in self._later(obligation[0]):
                if later not in seen:
                    seen[later] = None
                    pending.append(later)
            if len(seen) > _MAX_OBLIGATIONS:
                raise FormulaError(
                    f"the formula unfolds into more than {_MAX_OBLIGATIONS} obligations; use smaller bounds in F[a,b], "
                    "G[a,b], X[k]"
                )
        self._enter(pending)
        return self.next(term, True)

    def next(self, term: Term, strong: bool) -> int:
        """Return the diagram of "`term` holds from the next letter on"; & and | are taken apart."""
        if term.operator in ("&", "|") and not term.propositional:
            nodes = [self.next(operand, strong) for operand in self.terms.parts(term)]
            return self.diagrams.conjoin_all(nodes) if term.operator == "&" else self.diagrams.disjoin_all(nodes)
        # Weak true and strong false need no variable. Strong true asks for a letter, weak false for the end.
        if term is self.terms.true and not strong:
            return TRUE
        if term is self.terms.false and strong:
            return FALSE
        return self._node[term, strong]

    def expand(self, term: Term) -> int:
        """Return the diagram of `term` at the current letter, over propositions and obligations."""
        node = self._expanded.get(term)
        if node is None:
            node = self._expanded[term] = self._expand(term)
        return node

    def _expand(self, term: Term) -> int:
        """Return the diagram of a term that has not been expanded yet."""
        diagrams = self.diagrams
        if term.propositional:
            return propositional_diagram(term, diagrams, self._expanded)
        if term.operator in ("&", "|"):
            nodes = [self.expand(operand) for operand in term.operands]
            return diagrams.conjoin_all(nodes) if term.operator == "&" else diagrams.disjoin_all(nodes)
        if term.operator in ("U", "R"):  # the expansion laws of the module docstring
            left, right = self.expand(term.operands[0]), self.expand(term.operands[1])
            if term.operator == "U":
                return diagrams.disjoin(right, diagrams.conjoin(left, self.next(term, True)))
            return diagrams.conjoin(right, diagrams.disjoin(left, self.next(term, False)))
        # A window asks something of this letter, something of the later ones, or both.
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
        diagrams, advanced = self.diagrams, self._advanced
        stack = [f]
        while stack:
            n = stack[-1]
            if n not in advanced:
                low, high = diagrams.low(n), self._beyond_implied(n)
                missing = [child for child in (low, high) if child not in advanced]
                if missing:
                    stack.extend(missing)
                    continue
                # The function is positive: v ? high : low = low | (v & high).
                term = self._order[diagrams.variable(n) - self.n_propositions][0]
                advanced[n] = diagrams.disjoin(advanced[low], diagrams.conjoin(self.expand(term), advanced[high]))
            stack.pop()
        return advanced[f]

    def _beyond_implied(self, n: int) -> int:
        """Return what a node asks for beside its own obligation: what follows after the windows that this one implies.

        The expansion of a window implies those of the weaker windows of its chain, as diagrams, too. Without them a
        state with windows of T letters is advanced in T steps, and not in T for each of these letters.
        """
        diagrams = self.diagrams
        chain, after = self._chain[diagrams.variable(n) - self.n_propositions], diagrams.high(n)
        if diagrams.low(n) != FALSE:
            return after
        while after > TRUE and diagrams.low(after) == FALSE:
            if self._chain[diagrams.variable(after) - self.n_propositions] != chain:
                break
            after = diagrams.high(after)
        return after

    def holds_at_end(self, f: int) -> bool:
        """Return whether state `f` accepts if no letter follows: weak obligations hold, strong ones fail."""
        while f > TRUE:
            strong = self._order[self.diagrams.variable(f) - self.n_propositions][1]
            f = self.diagrams.low(f) if strong else self.diagrams.high(f)
        return f == TRUE

    # --- which obligations there are -----------------------------------------------------------------------
    def _strong(self, window: Term) -> bool:
        """Return whether what a window asks of later letters needs these letters to come."""
        return window.operator == "F[]" or self.co_safe

    def _unroll(self, window: Term) -> tuple[Term | None, Term | None]:
        """Return what a window asks of this letter, and what from the next letter on; None for nothing."""
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
            return [obligation for operand in self.terms.parts(term) for obligation in self._split(operand, strong)]
        if (term is self.terms.true and not strong) or (term is self.terms.false and strong):
            return []
        return [(term, strong)]

    def _later(self, term: Term) -> list[tuple[Term, bool]]:
        """Return the obligations in the expansion of `term`."""
        obligations: list[tuple[Term, bool]] = []
        seen: set[Term] = set()
        stack = [term]
        while stack:
            subterm = stack.pop()
            if subterm.propositional or subterm in seen:
                continue
            seen.add(subterm)
            if subterm.operator in ("U", "R"):
                obligations.append((subterm, subterm.operator == "U"))
            if subterm.bounds is None:
                stack.extend(reversed(subterm.operands))
                continue
            now, later = self._unroll(subterm)
            if now is not None:
                stack.append(now)
            if later is not None:
                obligations.extend(self._split(later, self._strong(subterm)))
        return obligations

    def _enter(self, obligations: list[tuple[Term, bool]]) -> None:
        """Number the obligations (windows over one body together, the stronger first) and make their nodes."""
        # The place at which the first obligation of each group stands keeps groups together.
        first: dict[tuple[str, int], int] = {}

        def key(item: tuple[int, tuple[Term, bool]]) -> tuple[int, int, int]:
            place, (term, strong) = item
            group = (term.operator, term.operands[0].serial) if term.bounds is not None else ("", term.serial)
            # A shorter F[] and a longer G[] are stronger.
            size = term.bounds[1] if term.bounds is not None else 0
            return first.setdefault(group, place), size if term.operator == "F[]" else -size, int(not strong)

        self._order = [obligation for _, obligation in sorted(enumerate(obligations), key=key)]
        # Windows over one body each of which implies the next have one number.
        for k, obligation in enumerate(self._order):
            linked = (
                k > 0
                and obligation[0].bounds is not None
                and key((0, obligation))[0] == key((0, self._order[k - 1]))[0]
            )
            chained = linked and self._leads_to(self._order[k - 1], obligation)
            self._chain.append(self._chain[-1] if chained else k)
        literals = [self.diagrams.literal(self.n_propositions + k) for k in range(len(self._order))]
        if len(self._order) <= _ALL_PAIRS:
            for a in self._order:
                self._node[a] = self.diagrams.conjoin_all(
                    literal for literal, b in zip(literals, self._order, strict=True) if self._leads_to(a, b)
                )
            return
        # Many obligations: go from the weakest to the strongest of a chain; each implies all that its weaker neighbour
        # does.
        after: tuple[Term, bool] | None = None
        for literal, a in zip(reversed(literals), reversed(self._order), strict=True):
            chained = after is not None and self._leads_to(a, after)
            self._node[a] = self.diagrams.conjoin(literal, self._node[after]) if chained and after else literal
            after = a

    # --- syntactic implication -----------------------------------------------------------------------------
    def _leads_to(self, a: tuple[Term, bool], b: tuple[Term, bool]) -> bool:
        """Return True only if obligation `a` implies obligation `b`."""
        return (a[1] or not b[1]) and self.implies(a[0], b[0])

    def implies(self, a: Term, b: Term, depth: int = 0) -> bool:
        """Return True only if every trace of at least one letter that satisfies `a` satisfies `b` (sufficient test)."""
        if a is b or a is self.terms.false or b is self.terms.true:
            return True
        if depth > _MAX_IMPLICATION_DEPTH:
            return False
        implied = self._implied.get((a, b))
        if implied is None:
            implied = self._implies(a, b, depth + 1)
            self._implied[a, b] = implied
        return implied

    def _implies(self, a: Term, b: Term, depth: int) -> bool:
        """Return whether some rule shows that `a` implies `b`."""
        # Without temporal operators, diagrams decide. Otherwise take the Boolean operators apart, the invertible ones
        # first, and then look for a temporal rule.
        if a.propositional and b.propositional:
            return self.diagrams.conjoin(self.expand(a), self.diagrams.negate(self.expand(b))) == FALSE
        if a.operator == "|":
            return all(self.implies(operand, b, depth) for operand in self.terms.parts(a))
        if b.operator == "&":
            return all(self.implies(a, operand, depth) for operand in self.terms.parts(b))
        if b.operator == "|" and any(self.implies(a, operand, depth) for operand in self.terms.parts(b)):
            return True
        if a.operator == "&" and any(self.implies(operand, b, depth) for operand in self.terms.parts(a)):
            return True
        return self._from(a, b, depth) or self._into(a, b, depth)

    def _from(self, a: Term, b: Term, depth: int) -> bool:
        """Return whether a rule that looks into `a` shows the implication."""
        if a.operator == "U":  # until holds only where one of its operands does
            return all(self.implies(operand, b, depth) for operand in a.operands)
        if a.operator == "R":  # release and an always-window from now on hold only where their body does
            return self.implies(a.operands[1], b, depth)
        if a.operator == "G[]" and a.bounds is not None and a.bounds[0] == 0:
            return self.implies(a.operands[0], b, depth)
        # b = F c: where a holds, its body holds later and implies F c there, hence F c now.
        if a.operator == "F[]" and b.operator == "U" and b.operands[0] is self.terms.true:
            return self.implies(a.operands[0], b, depth)
        return False

    def _into(self, a: Term, b: Term, depth: int) -> bool:
        """Return whether a rule that looks into `b` shows the implication."""
        # Until: a implies the goal now; or a is an until itself, and its operands imply the left side and b.
        if b.operator == "U":
            left, right = b.operands
            if self.implies(a, right, depth):
                return True
            if a.operator == "U":
                return self.implies(a.operands[0], left, depth) and self.implies(a.operands[1], b, depth)
            return False
        # Release: the right side must hold now, and the left side as well unless a is a stronger release.
        if b.operator == "R":
            left, right = b.operands
            if not self.implies(a, right, depth):
                return False
            if a.operator == "R" and self.implies(a.operands[0], left, depth):
                return True
            return left is not self.terms.false and self.implies(a, left, depth)
        if b.bounds is None:
            return False
        # Windows of one kind: an eventually-window may grow, an always-window may shrink.
        body = b.operands[0]
        if a.operator == b.operator and a.bounds is not None:
            inner, outer = (a.bounds, b.bounds) if b.operator == "F[]" else (b.bounds, a.bounds)
            within = outer[0] <= inner[0] and inner[1] <= outer[1]
            if within and self.implies(a.operands[0], body, depth):
                return True
        if b.operator == "F[]":
            return b.bounds[0] == 0 and self.implies(a, body, depth)
        # A weak always implies every weak window; a co-safe window is strong and asks for its letters to come.
        always = a.operator == "R" and a.operands[0] is self.terms.false
        return always and not self.co_safe and self.implies(a, body, depth)
