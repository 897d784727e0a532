"""How much a sweep over value trees may leave out: limits of pruning."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """How much a sweep may leave out.

    Parameters
    ----------
    contribution : float
        Share of the value of one (time, state) that pruned terms may amount to.
    elsewhere : float
        A term is kept in spite of that if its share of the value averaged over all cells exceeds this.
    mass : float
        Share of the alive mass that may be dropped per step.
    rank : int
        Most terms per state, of the value and of the mass.
    """

    contribution: float = 1e-9
    elsewhere: float = 1e-3
    mass: float = 1e-9
    rank: int = 400
