"""Rows of terms that were united, united again: only those that are needed, with factors made for them alone."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from ...certificates.value_functions import IndexArray, Merges, sum_factors


def _runs(merges: Merges) -> Iterator[tuple[int, slice]]:
    """Return the agents one after the other in whose factors rows were united, and which unions these are."""
    ends = np.flatnonzero(np.diff(merges.agent)) + 1
    for first, last in pairwise([0, *ends.tolist(), len(merges.agent)]):
        if first < last:
            yield int(merges.agent[first]), slice(first, last)


def rows_behind(wanted: IndexArray, count: int, merges: Merges) -> tuple[IndexArray, Merges, IndexArray]:
    """Return what some of the rows that remain were united from, where no union left a rest.

    Parameters
    ----------
    wanted : (m,) array
        Numbers of the rows.
    count : int
        Number of rows before anything was united.
    merges : Merges

    Returns
    -------
    rows : (n,) array
        The rows that were united into them, and they themselves, in order.
    merges : Merges
        The unions of these, with rows numbered by their place among them.
    place : (m,) array
        Where the wanted rows are among them.
    """
    needed = np.zeros(count, dtype=bool)
    needed[wanted] = True
    for _, run in reversed([*_runs(merges)]):
        needed[merges.absorbed[run]] = needed[merges.into[run]]
    rows, number = np.flatnonzero(needed), np.cumsum(needed) - 1
    here = needed[merges.into]
    united = Merges(number[merges.into[here]], number[merges.absorbed[here]], merges.agent[here])
    return rows, united, number[wanted]


def unite_again(factors: list[Any], rows: IndexArray, merges: Merges) -> IndexArray:
    """Unite rows (L, I) as it was done before, with these factors, which are extended in place (exact)."""
    rows = rows.copy()
    for agent, run in _runs(merges):
        sum_factors(factors, rows, agent, merges.into[run], merges.absorbed[run])
    return rows
