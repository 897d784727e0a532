"""Expressions on the tube of a trajectory: a matrix, and ends of what it leaves out.

**Theorem.** For deviations e in a box W around a point x, ``f(x + e) - M e`` lies between the ends that are returned, M
the middle of the derivatives at x. *Proof.* By ``jets.off_linear``, for each expression; any M would do. QED
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .expressions import Tree
from .fields import Refused
from .intervals import add, interval
from .jets import Follow, Jet, Memory, jet, off_linear
from .rigorous import Array


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

    Parameters
    ----------
    trees : sequence of Tree
    point : (v,) array
    places : dict
        Which of the v variables a name is.
    box : (2, v) array
        Around 0.
    t : int
        The time, unless a variable is called ``t``.
    free : int, optional
        The matrix has zeros beyond the first ``free`` variables; default: all of them.
    follow : Follow, optional
        How variables follow one another (``off_linear``).

    Raises
    ------
    Refused
        If an expression is not defined on the box.
    """
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
        row[v if free is None else free :] = 0.0
        if not np.all(np.isfinite(row)):
            raise Refused(f"an expression has no slope on the nominal trajectory at time {t}: {str(tree)[:60]}")
        ends[:, p] = add(centre.value, off_linear(centre, around_jet, box[:, :, None], row, follow))[:, 0]
        matrix[p] = row[:, 0]
        if not np.all(np.isfinite(ends[:, p])):
            raise Refused(f"an expression is not known on the tube at time {t}: {str(tree)[:60]}")
    return matrix, ends
