"""The search for good policies on tensor trains, where value trees would grow too many terms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...abstraction.models import JointModel, Policies
from ...certificates.value_functions import Occupancy
from ...certificates.value_functions import start_value as train_start_value
from .paths import perturbed, staged_starts
from .search_settings import Search
from .train_ascent import TrainLimits, TrainSweep, sweep_trains

SEARCH_ROUNDING, REPORTED_ROUNDING, PAIR_ROUNDING = 1e-2, 1e-4, 1e-7
"""What rounding of trains may change, as a share of the value: during the search, for what is reported, and that for
two agents, whose rank is that of a matrix."""

FAILURE_ROUNDING = 0.05
"""The same for what is reported, as a share of the probability of failing, where that is less."""

LEFT_OUT_SHARE = 1e-2
"""Share of the mass of each step that may lie on cells which trains leave out, as a share of the tolerance."""

TOLERANCES = (1e-9, 0.5)
"""Least and largest tolerance of trains: floating point keeps no smaller one, and a larger one says nothing."""

RESTART_SEED = 1
"""Seed of the perturbed starts."""


class TrainAscent:
    """Ascent on tensor trains, evaluated with a fine rounding in the end."""

    def __init__(self, joint: JointModel, start: Occupancy, spread: Occupancy, search: Search, most: float) -> None:
        self.joint, self.start, self.spread, self.how, self.most = joint, start, spread, search, most
        self.values: list[float] = []
        self.starts: dict[str, float] = {}
        self.gain = 0.0
        self.best: TrainSweep | None = None

    def search(self, starts: dict[str, Policies], naive: Policies) -> TrainSweep:
        """Return the best policies from several starts, or those of the first one if no sweeps are to be made."""
        for name, policies in starts.items():
            if self.how.max_sweeps and not self.is_good:
                self.run(name, policies, self.how.max_sweeps)
        # One sweep from every staged start; continue with the best two.
        if not self.is_good and self.how.max_sweeps >= 2:
            staged = staged_starts(self.joint, self.start, naive)
            tried = [(name, self.run(name, policies, 1)) for name, policies in staged]
            for k, (name, outcome) in enumerate(sorted(tried, key=lambda one: -one[1].value)[:2]):
                if k == 0 or not self.is_good:
                    self.run(name, outcome.policies, self.how.max_sweeps - 1)
        rng = np.random.default_rng(RESTART_SEED)
        for k in range(self.how.restarts):
            if self.best is not None and not self.is_solved:
                self.run(f"perturbed start {k + 1}", perturbed(self.best.policies, rng), self.how.max_sweeps)
        policies = next(iter(starts.values())) if self.best is None else self.best.policies
        return self.evaluated(policies)

    def evaluated(self, policies: Policies) -> TrainSweep:
        """Return the value of frozen policies, rounded as finely as what is reported should be."""
        value = self.most if self.best is None else max(self.best.value, 1e-6)
        tolerance = _tolerance(min(self.fine * value, max(FAILURE_ROUNDING * (1.0 - value), 1e-3 * self.fine)))
        # Not a share of the tolerance alone: that may be more than the fine rounding where the value is next to 0.
        limits = TrainLimits(tolerance, LEFT_OUT_SHARE * min(self.fine, tolerance / value))
        gains = [0.0]
        outcome = sweep_trains(self.joint, policies, self.spread, limits, improve=False, watch=gains.append)
        self.gain = max(gains)
        return replace(outcome, value=train_start_value(self.start, outcome.terms))

    def run(self, name: str, policies: Policies, sweeps: int) -> TrainSweep:
        """Sweep from ``policies`` until nothing improves; return the last sweep."""
        last, outcome = 0.0, self.best
        for _ in range(sweeps):
            # A margin of one cell: answers may move the mass a little beyond the cells it visits now.
            limits = TrainLimits(self.tolerance, margin=1)
            outcome = sweep_trains(self.joint, policies, self.spread, limits, improve=True)
            outcome = replace(outcome, value=train_start_value(self.start, outcome.terms))
            self.values.append(outcome.value)
            self.starts[name] = max(outcome.value, self.starts.get(name, 0.0))
            self.best = outcome if self.best is None or outcome.value > self.best.value else self.best
            self.how.tell(name, self.best.value)
            if outcome.value <= last + limits.tolerance or self.is_solved:
                break
            last, policies = outcome.value, outcome.policies
        assert outcome is not None
        return outcome

    @property
    def is_good(self) -> bool:
        """Whether the best is so near the upper bound that no further start is tried."""
        least = min(self.how.good_share * self.most, self.how.enough)
        return self.best is not None and self.best.value >= least

    @property
    def tolerance(self) -> float:
        """What a sweep may round: a share of the value at first, then of what may be left to gain."""
        left = self.most if self.best is None else self.most - self.best.value
        return _tolerance(max(SEARCH_ROUNDING * left, self.fine * self.most))

    @property
    def fine(self) -> float:
        """Rounding of what is reported, as a share of the value."""
        return REPORTED_ROUNDING if len(self.joint.models) > 2 else PAIR_ROUNDING

    @property
    def is_solved(self) -> bool:
        """Whether more sweeps are not worth their time."""
        least = min((1 - 2 * self.fine) * self.most, self.how.enough)
        return self.best is not None and self.best.value >= least


def _tolerance(wanted: float) -> float:
    """Return the wanted tolerance, or the nearest one that makes sense."""
    return float(np.clip(wanted, *TOLERANCES))
