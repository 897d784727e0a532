"""Short sums of products for Boolean functions with letters that do not matter.

The recursion is that of Minato ("Fast generation of prime-irredundant covers from binary decision diagrams", 1993): no
literal and no product of the result can be left out, as far as the order of variables lets the recursion see.
"""

from __future__ import annotations

from .decision_diagram import FALSE, TRUE, DecisionDiagrams

Cube = dict[int, bool]

_DEEPEST = 400
"""Most variables of a cover: the recursion is as deep as that, and Python allows for about 1000 calls."""


def cover(diagrams: DecisionDiagrams, lower: int, upper: int, most: int) -> list[Cube] | None:
    """Return few short cubes whose union holds all of ``lower`` and nothing beyond ``upper``.

    Parameters
    ----------
    diagrams : DecisionDiagrams
    lower, upper : int
        Nodes of Boolean functions, ``lower`` implies ``upper``. Letters of ``upper`` that are not in ``lower`` may be
        covered or not.
    most : int
        Largest number of products that are made on the way.

    Returns
    -------
    list of dict or None
        Cubes, each a map from variables to values; None if there would be more than ``most``, or if the functions test
        more than 400 variables.

    Examples
    --------
    >>> diagrams = DecisionDiagrams()
    >>> a, b = diagrams.literal(0), diagrams.literal(1)
    >>> cover(diagrams, diagrams.conjoin(a, diagrams.negate(b)), diagrams.disjoin(a, b), most=10)
    [{0: True}]
    """
    if len(diagrams.support(lower) | diagrams.support(upper)) > _DEEPEST:
        return None
    try:
        cubes, _ = _cover(diagrams, lower, upper, {}, [most])
    except _TooMany:
        return None
    return cubes


class _TooMany(Exception):
    """Raised where a cover has too many cubes."""


def _cover(
    diagrams: DecisionDiagrams,
    lower: int,
    upper: int,
    memo: dict[tuple[int, int], tuple[list[Cube], int]],
    left: list[int],
) -> tuple[list[Cube], int]:
    """Return the cubes between two functions, and the node of their union."""
    if lower == FALSE:
        return [], FALSE
    if upper == TRUE:
        return [{}], TRUE
    key = (lower, upper)
    if key in memo:
        return memo[key]
    top = min(diagrams.variable(lower), diagrams.variable(upper))
    (lower_0, lower_1), (upper_0, upper_1) = (_cofactors(diagrams, n, top) for n in key)
    # Letters that only a cube with the literal !v, or only one with v, may cover; the others need no literal of v.
    zeros, union_0 = _cover(diagrams, _without(diagrams, lower_0, upper_1), upper_0, memo, left)
    ones, union_1 = _cover(diagrams, _without(diagrams, lower_1, upper_0), upper_1, memo, left)
    rest = diagrams.disjoin(_without(diagrams, lower_0, union_0), _without(diagrams, lower_1, union_1))
    free, union = _cover(diagrams, rest, diagrams.conjoin(upper_0, upper_1), memo, left)
    left[0] -= len(zeros) + len(ones)
    if left[0] < 0:
        raise _TooMany
    cubes = [{top: False, **cube} for cube in zeros] + [{top: True, **cube} for cube in ones] + free
    whole = diagrams.disjoin(diagrams.choose(top, union_0, union_1), union)
    memo[key] = cubes, whole
    return cubes, whole


def _cofactors(diagrams: DecisionDiagrams, n: int, variable: int) -> tuple[int, int]:
    return (diagrams.low(n), diagrams.high(n)) if diagrams.variable(n) == variable else (n, n)


def _without(diagrams: DecisionDiagrams, f: int, g: int) -> int:
    return diagrams.conjoin(f, diagrams.negate(g))
