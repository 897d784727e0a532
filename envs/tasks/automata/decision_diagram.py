"""Ordered decision diagrams with integer terminals: sets of letters and maps from letters, without listing letters.

A node is an integer of its manager. An inner node tests one Boolean variable (an integer; smaller ones are tested
first) and leads to ``low`` if it is false, to ``high`` if it is true; a terminal holds an integer value. Nodes are
hash-consed and reduced, so within one manager and one variable order two nodes are equal if and only if they denote the
same function (Bryant 1986). Every traversal uses an explicit stack, so a diagram over thousands of variables needs no
deep recursion. Nodes 0 and 1 are the terminals of value 0 (false) and 1 (true).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

FALSE = 0
TRUE = 1
_BELOW_ALL = 1 << 60  # the "variable" of terminals: larger than every real variable


class DiagramSizeError(ValueError):
    """Raised if a diagram grows beyond the manager's limit on nodes, or operations beyond that on steps."""


class DecisionDiagrams:
    """Manager of decision diagrams that share their nodes.

    Parameters
    ----------
    node_limit : int
        Largest number of nodes (dimensionless count); `DiagramSizeError` is raised beyond it. The default is about a
        gigabyte.
    step_limit : int, optional
        Largest number of steps of all operations together, beyond which `DiagramSizeError` is raised, too. Steps count
        pairs and nodes that are visited, so the same call always takes as many, on any machine.

    Examples
    --------
    >>> diagrams = DecisionDiagrams()
    >>> a, b = diagrams.literal(0), diagrams.literal(1)
    >>> a_and_b = diagrams.conjoin(a, b)
    >>> a_and_b == diagrams.negate(diagrams.disjoin(diagrams.negate(a), diagrams.negate(b)))
    True
    >>> diagrams.restrict(a_and_b, {0: True}) == b
    True
    """

    def __init__(self, node_limit: int = 5_000_000, step_limit: int | None = None) -> None:
        self._variable: list[int] = []
        self._low: list[int] = []
        self._high: list[int] = []
        self._inner: dict[tuple[int, int, int], int] = {}
        self._leaf: dict[int, int] = {}
        self._limit = node_limit
        self._steps_left = float("inf") if step_limit is None else float(step_limit)
        self._conjoin_memo: dict[tuple[int, int], int] = {}
        self._disjoin_memo: dict[tuple[int, int], int] = {}
        self._negate_memo: dict[int, int] = {}
        self.terminal(0)
        self.terminal(1)

    def __len__(self) -> int:
        return len(self._variable)

    # --- nodes ---------------------------------------------------------------------------------------------
    def terminal(self, value: int) -> int:
        """Return the terminal that holds `value`."""
        leaf = self._leaf.get(value)
        if leaf is None:
            leaf = self._leaf[value] = self._append(_BELOW_ALL, value, value)
        return leaf

    def node(self, variable: int, low: int, high: int) -> int:
        """Return the reduced node that tests `variable`; raise ValueError if a child does not test later ones."""
        # Equal children need no test, and equal nodes are made once: this is what makes diagrams canonical.
        if low == high:
            return low
        key = (variable, low, high)
        inner = self._inner.get(key)
        if inner is None:
            if variable >= self._variable[low] or variable >= self._variable[high]:
                raise ValueError(f"`variable`: expected less than the variables of both children, got {variable}")
            inner = self._inner[key] = self._append(variable, low, high)
        return inner

    def literal(self, variable: int, positive: bool = True) -> int:
        """Return the Boolean function of one variable, or of its negation."""
        return self.node(variable, FALSE, TRUE) if positive else self.node(variable, TRUE, FALSE)

    def is_terminal(self, n: int) -> bool:
        """Return whether node `n` is a terminal."""
        return self._variable[n] == _BELOW_ALL

    def value(self, n: int) -> int:
        """Return the value of terminal `n`."""
        if not self.is_terminal(n):
            raise ValueError(f"`n`: expected a terminal, got node {n}, which tests variable {self._variable[n]}")
        return self._low[n]

    def variable(self, n: int) -> int:
        """Return the variable that `n` tests; for a terminal a number larger than every variable."""
        return self._variable[n]

    def low(self, n: int) -> int:
        """Return the child of inner node `n` for a false variable."""
        return self._low[n]

    def high(self, n: int) -> int:
        """Return the child of inner node `n` for a true variable."""
        return self._high[n]

    def _append(self, variable: int, low: int, high: int) -> int:
        if len(self._variable) >= self._limit:
            raise DiagramSizeError(f"a decision diagram needs more than {self._limit} nodes")
        self._variable.append(variable)
        self._low.append(low)
        self._high.append(high)
        return len(self._variable) - 1

    # --- combining -----------------------------------------------------------------------------------------
    def apply(
        self,
        op: Callable[[int, int], int],
        f: int,
        g: int,
        memo: dict[tuple[int, int], int],
        shortcut: Callable[[int, int], int | None] | None = None,
    ) -> int:
        """Return the diagram of ``op(f(letter), g(letter))``.

        Parameters
        ----------
        op : callable
            Combines two terminal values into one.
        f, g : int
            Nodes.
        memo : dict
            Results per pair of nodes, reused as long as `op` and `shortcut` are the same.
        shortcut : callable, optional
            Maps two *nodes* to the result if it is known at once, else to None.
        """

        def base(a: int, b: int) -> int | None:
            if shortcut is not None and (result := shortcut(a, b)) is not None:
                return result
            if self._variable[a] == _BELOW_ALL and self._variable[b] == _BELOW_ALL:
                return self.terminal(op(self._low[a], self._low[b]))
            return None

        return self._combine(f, g, memo, base)

    def _combine(self, f: int, g: int, memo: dict[tuple[int, int], int], base: Callable[[int, int], int | None]) -> int:
        """Return the diagram that descends through `f` and `g` together until `base` knows the result."""
        variable, low, high = self._variable, self._low, self._high
        stack = [(f, g)]
        while stack:
            self._steps_left -= 1.0
            if self._steps_left < 0.0:
                raise DiagramSizeError("its decision diagrams take too many steps")
            a, b = key = stack[-1]
            if key in memo:
                stack.pop()
                continue
            result = base(a, b)
            if result is None:
                # Split both functions by the first variable that either tests; children come before their parent.
                top = min(variable[a], variable[b])
                in_a, in_b = variable[a] == top, variable[b] == top
                low_key = (low[a] if in_a else a, low[b] if in_b else b)
                high_key = (high[a] if in_a else a, high[b] if in_b else b)
                if low_key not in memo:
                    stack.append(low_key)
                    continue
                if high_key not in memo:
                    stack.append(high_key)
                    continue
                result = self.node(top, memo[low_key], memo[high_key])
            memo[key] = result
            stack.pop()
        return memo[f, g]

    def conjoin(self, f: int, g: int) -> int:
        """Return the conjunction of two Boolean functions."""
        return self._combine(f, g, self._conjoin_memo, _known_conjunction)

    def disjoin(self, f: int, g: int) -> int:
        """Return the disjunction of two Boolean functions."""
        return self._combine(f, g, self._disjoin_memo, _known_disjunction)

    def conjoin_all(self, nodes: Iterable[int]) -> int:
        """Return the conjunction of Boolean functions (true for no function); linear time for literals."""
        result = TRUE
        # From the bottom up, so that each literal is put on top of what there is.
        for n in sorted(set(nodes), key=self._variable.__getitem__, reverse=True):
            result = self.conjoin(n, result)
        return result

    def disjoin_all(self, nodes: Iterable[int]) -> int:
        """Return the disjunction of Boolean functions (false for no function); linear time for literals."""
        result = FALSE
        for n in sorted(set(nodes), key=self._variable.__getitem__, reverse=True):
            result = self.disjoin(n, result)
        return result

    def negate(self, f: int) -> int:
        """Return the negation of a Boolean function."""
        return self.rebuild(f, self, lambda n: 1 - n if n <= TRUE else None, self._negate_memo)

    def choose(self, variable: int, low: int, high: int) -> int:
        """Return "if `variable` then `high` else `low`", at any place of the variable in the order."""

        # Descend through both functions as far as the variable, and put the test there.
        def base(a: int, b: int) -> int | None:
            if self._variable[a] > variable and self._variable[b] > variable:
                return self.node(variable, a, b)
            if self._variable[a] == variable or self._variable[b] == variable:
                below_a = self._low[a] if self._variable[a] == variable else a
                below_b = self._high[b] if self._variable[b] == variable else b
                if self._variable[below_a] > variable and self._variable[below_b] > variable:
                    return self.node(variable, below_a, below_b)
            return None

        return self._combine(low, high, {}, base)

    # --- traversing ----------------------------------------------------------------------------------------
    def rebuild(
        self, f: int, target: DecisionDiagrams, replace: Callable[[int], int | None], memo: dict[int, int]
    ) -> int:
        """Return `f` rebuilt in manager `target` with some nodes replaced.

        Parameters
        ----------
        f : int
            Node of this manager.
        target : DecisionDiagrams
            Manager of the result, possibly this one.
        replace : callable
            Maps a node of this manager to the node of `target` that stands for it, or to None: rebuild it from
            its children. It must answer for every terminal.
        memo : dict
            Results per node, reused as long as `replace` is the same function.
        """
        stack = [f]
        while stack:
            self._steps_left -= 1.0
            if self._steps_left < 0.0:
                raise DiagramSizeError("its decision diagrams take too many steps")
            n = stack[-1]
            if n in memo:
                stack.pop()
                continue
            new = replace(n)
            if new is None:
                missing = [child for child in (self._low[n], self._high[n]) if child not in memo]
                if missing:
                    stack.extend(missing)
                    continue
                new = target.node(self._variable[n], memo[self._low[n]], memo[self._high[n]])
            memo[n] = new
            stack.pop()
        return memo[f]

    def restrict(self, f: int, assignment: Mapping[int, bool]) -> int:
        """Return the cofactor of `f`: the function that remains when some variables are set to values.

        Nodes that test later variables than all of these stay as they are: nothing below them is visited.
        """
        memo: dict[int, int] = {}
        last = max(assignment, default=-1)
        stack = [f]
        while stack:
            n = stack[-1]
            variable = self._variable[n]
            if n in memo or variable > last:
                memo[n] = memo.get(n, n)
                stack.pop()
                continue
            low, high = self._low[n], self._high[n]
            if variable in assignment:  # both children are the one that the value selects
                low = high = high if assignment[variable] else low
            missing = [child for child in (low, high) if child not in memo]
            if missing:
                stack.extend(missing)
                continue
            memo[n] = memo[low] if low == high else self.node(variable, memo[low], memo[high])
            stack.pop()
        return memo[f]

    def nodes(self, f: int) -> list[int]:
        """Return every node of `f`, in preorder with low before high."""
        seen: set[int] = set()
        order: list[int] = []
        stack = [f]
        while stack:
            n = stack.pop()
            if n in seen:
                continue
            seen.add(n)
            order.append(n)
            if self._variable[n] != _BELOW_ALL:
                stack.append(self._high[n])
                stack.append(self._low[n])
        return order

    def leaves(self, f: int) -> list[int]:
        """Return the distinct terminal values of `f`, in the order of a walk that takes low before high."""
        return [self._low[n] for n in self.nodes(f) if self._variable[n] == _BELOW_ALL]

    def support(self, f: int) -> set[int]:
        """Return the variables on which `f` depends."""
        return {self._variable[n] for n in self.nodes(f) if self._variable[n] != _BELOW_ALL}

    def paths(self, f: int) -> Iterator[tuple[dict[int, bool], int]]:
        """Yield (assignment, terminal value) for each path: disjoint cubes that cover all letters."""
        stack: list[tuple[int, tuple[tuple[int, bool], ...]]] = [(f, ())]
        while stack:
            n, path = stack.pop()
            variable = self._variable[n]
            if variable == _BELOW_ALL:
                yield dict(path), self._low[n]
            else:
                stack.append((self._high[n], (*path, (variable, True))))
                stack.append((self._low[n], (*path, (variable, False))))

    def find(self, f: int, value: int) -> dict[int, bool] | None:
        """Return an assignment that leads `f` to the terminal `value`, or None if no letter does."""
        # Note one parent of every node, then walk up from the terminal.
        parent: dict[int, tuple[int, bool]] = {}
        for n in self.nodes(f):
            if self._variable[n] != _BELOW_ALL:
                parent.setdefault(self._low[n], (n, False))
                parent.setdefault(self._high[n], (n, True))
        n = self._leaf.get(value, -1)
        if n != f and n not in parent:
            return None
        assignment: dict[int, bool] = {}
        while n != f:
            n, taken = parent[n]
            assignment[self._variable[n]] = taken
        return assignment


def _known_conjunction(a: int, b: int) -> int | None:
    """Return the conjunction if a terminal, or equality, decides it."""
    if a == FALSE or b == FALSE:
        return FALSE
    if a == TRUE or a == b:
        return b
    return a if b == TRUE else None


def _known_disjunction(a: int, b: int) -> int | None:
    """Return the disjunction if a terminal, or equality, decides it."""
    if a == TRUE or b == TRUE:
        return TRUE
    if a == FALSE or a == b:
        return b
    return a if b == FALSE else None
