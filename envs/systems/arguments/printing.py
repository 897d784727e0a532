"""Short texts for the `__repr__` of records: sizes and ranges, never whole arrays.

Numbers are rounded to six digits here, so these texts are for reading and for nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence

from .checks import FloatArray

MOST_AXES = 4
"""Intervals of a box that are written out: a line holds about as many."""

MOST_NAMES = 4
"""Names of a list that are written out."""


def tree_text(title: str, rows: Sequence[tuple[str, object]]) -> str:
    """Return a title and one line per row, name and value, drawn as the branches of a tree in ASCII.

    Examples
    --------
    >>> print(tree_text("Pair", [("left", 1), ("right", "two")]))
    Pair
    |-- left   1
    `-- right  two
    """
    width = max((len(name) for name, _ in rows), default=0)
    branches = ["|--"] * (len(rows) - 1) + ["`--"]
    lines = [f"{branch} {name:<{width}}  {value}" for branch, (name, value) in zip(branches, rows)]
    return "\n".join([title, *lines])


def counted(n: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun: "1 state", "2 states"."""
    return f"{n} {noun if n == 1 else plural or noun + 's'}"


def shortened(text: str, limit: int = 120) -> str:
    """Return a text on one line, cut off with dots if it is longer than `limit` characters."""
    # Only the beginning is split: formulas may have half a million characters.
    line = " ".join(text[: 2 * limit].split())
    return line if len(line) <= limit and len(text) <= 2 * limit else f"{line[: limit - 3]}..."


def names_text(names: Sequence[str]) -> str:
    """Return names as a list, or the first ones and the last if there are many."""
    listed = [shortened(name, 40) for name in names[: MOST_NAMES - 1]]
    if len(names) <= MOST_NAMES:
        return ", ".join([*listed, *(shortened(name, 40) for name in names[MOST_NAMES - 1 :])])
    return f"{', '.join(listed)}, ..., {shortened(names[-1], 40)}"


def matrix_text(rows: Sequence[FloatArray] | FloatArray) -> str:
    """Return a matrix in square brackets, without the digits that rounding leaves behind."""
    return "[" + ", ".join("[" + ", ".join(f"{v:.12g}" for v in row) + "]" for row in rows) + "]"


def vector_text(values: FloatArray) -> str:
    """Return a vector in round brackets."""
    return "(" + ", ".join(f"{v:g}" for v in values) + ")"


def box_text(low: FloatArray, high: FloatArray, closed: bool = True) -> str:
    """Return a box as a product of intervals, equal ones as a power: "[-1, 1]^2 x [0, 4]".

    Parameters
    ----------
    low, high : np.ndarray, shape (d,)
        Corners.
    closed : bool
        Whether the upper faces belong to the box; the lower ones always do.
    """
    # Gather runs of equal intervals, so that a box of twenty equal axes is one factor.
    end = "]" if closed else ")"
    factors: list[tuple[str, int]] = []
    for a, b in zip(low, high):
        interval = f"[{a:g}, {b:g}{end}"
        if factors and factors[-1][0] == interval:
            factors[-1] = (interval, factors[-1][1] + 1)
        else:
            factors.append((interval, 1))
    texts = [interval if power == 1 else f"{interval}^{power}" for interval, power in factors]
    more = [f"... ({len(low)} axes)"] if len(texts) > MOST_AXES else []
    return " x ".join([*texts[:MOST_AXES], *more])
