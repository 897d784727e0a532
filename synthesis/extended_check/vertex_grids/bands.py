"""Sums along one axis with weights of which only those near the diagonal are not 0, as weights of noise are."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...checker.rigorous import Array

ROWS = 8  # rows that a block has at least
BESIDE = 400  # numbers of a table that take as long as one more block


@dataclass(frozen=True, eq=False)
class Bands:
    """A table (rows, columns) as blocks of rows, each with the columns beside which it has nothing but zeros."""

    rows: int
    blocks: list[tuple[slice, slice, Array]]

    @classmethod
    def of(cls, table: Array) -> Bands:
        """Cut a table into blocks: rows that follow one another are joined where that costs less than another block."""
        blocks = [(rows, columns, table[rows, columns].copy()) for rows, columns in _cut(table != 0.0)]
        return cls(len(table), blocks)

    @property
    def size(self) -> int:
        """How many numbers it holds."""
        return sum(table.size for _, _, table in self.blocks)

    def along(self, W: Array, k: int) -> Array:
        """Return numbers (.., rows, ..): sums of numbers (.., columns, ..) along axis k, each row with its weights."""
        before, after = math.prod(W.shape[:k]), math.prod(W.shape[k + 1 :])
        flat, result = W.reshape(before, W.shape[k], after), np.zeros((before, self.rows, after))
        for rows, columns, table in self.blocks:
            if after == 1:
                result[:, rows, 0] = flat[:, columns, 0] @ table.T
            else:
                np.matmul(table, flat[:, columns], out=result[:, rows])
        return result.reshape(*W.shape[:k], self.rows, *W.shape[k + 1 :])


def _cut(used: Any) -> Iterator[tuple[slice, slice]]:
    """Yield rows and columns of blocks that hold all that is used of a table; rows without any are in none."""
    block: tuple[int, int, int, int] | None = None
    for start in range(0, len(used), ROWS):
        columns = np.flatnonzero(used[start : start + ROWS].any(axis=0))
        if not len(columns):
            continue
        own = start, min(start + ROWS, len(used)), int(columns[0]), int(columns[-1]) + 1
        if block is not None:
            both = block[0], own[1], min(block[2], own[2]), max(block[3], own[3])
            if _numbers(both) <= _numbers(block) + _numbers(own) + BESIDE:
                block = both
                continue
            yield slice(*block[:2]), slice(*block[2:])
        block = own
    if block is not None:
        yield slice(*block[:2]), slice(*block[2:])


def _numbers(block: tuple[int, int, int, int]) -> int:
    return (block[1] - block[0]) * (block[3] - block[2])
