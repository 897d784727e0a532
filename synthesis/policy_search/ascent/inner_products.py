"""Products over all agents but one, and sums of products over mass terms and value terms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...certificates.value_functions import IndexArray, add_rows
from ...relations.grids import FloatArray

PRODUCTS_AT_ONCE = 4_000_000
"""Products of a mass term and a value term that are formed at once: 32 MB."""


class Others:
    """Products of per-agent arrays over all agents but one, the agents being replaced one after the other."""

    def __init__(self, factors: Sequence[FloatArray]) -> None:
        # `before` is the product over agents that were replaced; `after` ends with that over agents still to come.
        self.before = np.ones_like(factors[0])
        self.after = [self.before]
        for factor in reversed(factors[1:]):
            self.after.append(self.after[-1] * factor)

    def product(self) -> FloatArray:
        """Return the product over the agents other than the current one."""
        return self.before * self.after[-1]

    def replace(self, factor: FloatArray) -> None:
        """Set the current agent's factor and go on to the next agent."""
        self.before = self.before * factor
        self.after.pop()


def inner_products(inner: Sequence[FloatArray], mass_rows: IndexArray, rows: IndexArray) -> FloatArray:
    """Return ``sum_k prod_i inner[i][mass_rows[k, i], rows[l, i]]`` for every term l, in chunks of mass terms."""
    total = np.zeros(len(rows))
    chunk = max(1, PRODUCTS_AT_ONCE // max(1, len(rows)))
    for first in range(0, len(mass_rows), chunk):
        chosen = mass_rows[first : first + chunk]
        product = inner[0][chosen[:, 0]][:, rows[:, 0]]
        for i in range(1, len(inner)):
            product *= inner[i][chosen[:, i]][:, rows[:, i]]
        total += product.sum(axis=0)
    return total


def collected(values: FloatArray, rows: IndexArray, n_rows: int, columns: IndexArray, n_columns: int) -> FloatArray:
    """Sum entries of ``values`` that share a row number and a column number: (K, L) -> (n_rows, n_columns)."""
    if n_columns < len(columns) or not np.array_equal(columns, np.arange(n_columns)):
        values = add_rows(values.T, columns, n_columns).T
    if n_rows < len(rows) or not np.array_equal(rows, np.arange(n_rows)):
        values = add_rows(values, rows, n_rows)
    return values
