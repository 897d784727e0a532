"""Expressions on the tube of a trajectory: a matrix, and ends of what it leaves out.

**Theorem.** For deviations e in a box W around a point x, ``f(x + e) - M e`` lies between the ends that are returned, M
the middle of the derivatives at x. *Proof.* By ``jets.off_linear``, for each expression; any M would do. Sums of
multiples of names are their own linear part: nothing is left out but what they are rounded by. QED
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .expressions import Tree, plain_sum
from .fields import Refused
from .intervals import add, interval
from .jets import Follow, Jet, Memory, jet, off_linear
from .rigorous import Array, U


def expanded(
    trees: Sequence[Tree],
    point: Array,
    places: dict[str, int],
    box: Array,
    t: int,
    free: int | None = None,
    follow: Follow | None = None,
) -> tuple[Array, Array]:
    """Return a matrix (p, v), and ends (2, p) of what trees are besides it, for deviations in a box (2, v) of a point.

    ``places`` says which of the v variables a name is, ``t`` the time, unless a variable is called so. The matrix has
    zeros beyond the first ``free`` variables; ``follow`` is how variables follow one another (``off_linear``).
    ``Refused`` if an expression is not defined on the box.
    """
    v = len(point)
    matrix, ends = np.zeros((len(trees), v)), np.zeros((2, len(trees)))
    sums = [plain_sum(tree) for tree in trees]
    bent = [p for p, terms in enumerate(sums) if terms is None]
    for p, terms in enumerate(sums):
        if terms is not None:
            matrix[p], ends[:, p] = _of_sum(terms, point, places, box, t, v if free is None else free)
    if bent:
        some = [trees[p] for p in bent]
        matrix[bent], ends[:, bent] = _of_jets(some, point, places, box, t, v if free is None else free, follow)
    return matrix, ends


def _of_sum(
    terms: Sequence[tuple[float, str]], point: Array, places: dict[str, int], box: Array, t: int, free: int
) -> tuple[Array, Array]:
    """Return the row of a sum of multiples of names, which leaves out nothing but what is not among the free ones."""
    row, values, exact = np.zeros(len(point)), [], len(terms) == 1
    for factor, name in terms:
        if name in places:
            row[places[name]] = factor
        at = point[places[name]] if name in places else float(t) if name else 1.0
        values.append(factor * at)
        exact &= abs(factor) == 1.0 or not name
    # sums of n products are rounded by at most n + 1 units of their sizes
    spare = 0.0 if exact else (len(terms) + 3.0) * U * float(np.abs(values).sum()) + 1e-290
    value, rest, row = float(np.sum(values)), row[free:], np.append(row[:free], np.zeros(len(point) - free))
    reach = np.where(rest > 0.0, rest * box[:, free:], rest * box[::-1, free:]).sum(axis=1)
    spare += (len(rest) + 3.0) * U * float((np.abs(rest) * np.abs(box[:, free:])).sum()) + 1e-290 * bool(rest.any())
    total = value + reach
    spare += 2.0 * U * float(np.abs(total).max()) if spare else 0.0
    return row, np.array([total[0] - spare, total[1] + spare])


def _of_jets(
    trees: Sequence[Tree],
    point: Array,
    places: dict[str, int],
    box: Array,
    t: int,
    free: int,
    follow: Follow | None,
) -> tuple[Array, Array]:
    """Return rows and ends of any expressions, by their jets at the point and on the box."""
    v = len(point)
    leaves: list[dict[str, Jet]] = []
    for around in (np.zeros_like(box), box):
        named = {
            name: Jet.variable(add(interval(point[k : k + 1]), around[:, k : k + 1]), np.eye(v)[:, k : k + 1])
            for name, k in places.items()
        }
        named.setdefault("t", Jet.variable(interval(np.full(1, float(t))), np.zeros((v, 1))))
        leaves.append(named)
    matrix, ends = np.zeros((len(trees), v)), np.zeros((2, len(trees)))
    memories: tuple[Memory, Memory] = {}, {}
    for p, tree in enumerate(trees):
        centre, around_jet = (jet(tree, own, memory) for own, memory in zip(leaves, memories))
        row = 0.5 * (centre.slope[0] + centre.slope[1])
        row[free:] = 0.0
        if not np.all(np.isfinite(row)):
            raise Refused(f"an expression has no slope on the nominal trajectory at time {t}: {str(tree)[:60]}")
        ends[:, p] = add(centre.value, off_linear(centre, around_jet, box[:, :, None], row, follow))[:, 0]
        matrix[p] = row[:, 0]
        if not np.all(np.isfinite(ends[:, p])):
            raise Refused(f"an expression is not known on the tube at time {t}: {str(tree)[:60]}")
    return matrix, ends
