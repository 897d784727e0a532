"""From computed values to certified numbers.

``nominal``       all delta are 0: the probability of the continuous closed loop is at least the value, ``P >= V``, and
                  equal to it where nothing was lost at edges, to pruning or to rounding (THEORY sections 1 and 4).
``a-posteriori``  couple both systems: success can fail only if the relation is lost at a step that finds the run
                  undecided, and each such step costs at most ``Delta``. So ``P >= V - Delta * Theta`` with Theta the
                  expected number of undecided steps of the masked abstract chain, which is the sum over time of the
                  alive mass. The paper's own form counts steps until acceptance only and reads them off the depths of
                  the tree, ``sum_z v(z) (1 + Delta (T - depth z)) - Delta T``; it is never larger.
``robust tree``   every factor loses ``delta_i`` times its largest value at every step. The paper's plain
                  ``- delta_i`` is the same only while no factor exceeds 1, which is checked as it is computed.

Agents couple with independent coins: ``Delta = 1 - prod (1 - delta_i)``. What must be an upper bound is rounded up.
What floating point may have added to a nonnegative sum of products of n operations is below
``gamma(n) = n u / (1 - n u)`` of it (THEORY section 9), and is taken off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..models import AgentModel, JointModel, Policies
from ..relations import joint_delta
from ..search import Sweep, TrainSweep
from ..values import UNIT, Occupancy

SPARE = 1e-8
"""Added to the undecided mass of every step, so that a second, coarser computation of it does not exceed it."""

INFLATE = 1.0 + 1e-9
"""Factor on what is subtracted, far above the rounding of what it is subtracted from."""


@dataclass(frozen=True)
class Bound:
    """A certified lower bound and, if the value is exact, how far above it the truth can be.

    Parameters
    ----------
    name : str
        Which theorem it rests on.
    lower : float
        Lower bound on the satisfaction probability of the continuous closed loop.
    gap : float or None
        If not None, ``lower + gap`` is an upper bound on the same probability.
    """

    name: str
    lower: float
    gap: float | None = None


def relative_rounding(joint: JointModel, rank: int) -> float:
    """Upper bound on the relative error of the backward recursion, with a reserve for a second evaluation of it.

    A certificate is checked by a program that sums in another order and builds the kernel in another way; the reserve,
    ``1e-11`` per agent and ten more, keeps a right certificate from being refused for that.
    """
    n_agents = len(joint.models)
    n = joint.horizon * sum(s + 1 for s in joint.n_cells) + n_agents + rank + 2
    gamma = n * UNIT / (1.0 - n * UNIT)
    return 2.0 * gamma + 1e-11 * (n_agents + 10)


def nominal_bound(joint: JointModel, sweep: Sweep, aligned: bool, stranded: float = 0.0) -> Bound:
    """Bound of a value with delta = 0; ``aligned`` says that no value is lost at region and workspace edges.

    ``stranded`` bounds from above the probability of ever being, undecided, in a cell without an admissible choice: the
    value counts such runs as failed, the controller goes on with them.
    """
    relative = relative_rounding(joint, sweep.rank)
    lower = min(1.0, max(0.0, sweep.value * (1.0 - relative)))
    loss = joint.horizon * sum(model.kernel.loss for model in joint.models)
    gap = (sweep.value - lower) + sweep.value * relative + sweep.dropped + loss + stranded
    return Bound("nominal", lower, min(gap * (1 + 1e-12), 1.0 - lower) if aligned else None)


def train_bound(joint: JointModel, sweep: TrainSweep, above: float | None = None) -> Bound:
    """Bound of a value held as tensor trains: less its error and, where relations can be lost, ``Delta T``.

    A tenth of the tolerance is held back for a second evaluation, whose rounding may choose otherwise. ``above``, an
    upper bound on what the policies attain (see ``train_above``), gives the gap.
    """
    delta = joint_delta([model.delta for model in joint.models])
    reserve = sweep.terms.error + 0.1 * sweep.rounding.tolerance + relative_rounding(joint, sweep.rank)
    lower = min(1.0, max(0.0, sweep.value - reserve - delta * joint.horizon * INFLATE))
    if delta > 0 or above is None:
        return Bound("a-posteriori" if delta > 0 else "nominal", lower)
    loss = joint.horizon * sum(model.kernel.loss for model in joint.models)
    more = 0.1 * sweep.rounding.tolerance + relative_rounding(joint, sweep.rank) + loss
    return Bound("nominal", lower, float(min(max(0.0, above + more - lower) * (1 + 1e-12), 1.0 - lower)))


def a_posteriori_bound(joint: JointModel, sweep: Sweep, undecided: float) -> Bound:
    """``V - Delta * Theta``; ``undecided`` is an upper bound on Theta."""
    delta = joint_delta([model.delta for model in joint.models])
    value = sweep.value * (1.0 - relative_rounding(joint, sweep.rank))
    return Bound("a-posteriori", min(1.0, max(0.0, value - delta * undecided * INFLATE)))


def robust_bound(joint: JointModel, sweep: Sweep) -> Bound:
    """Bound of a value grown with ``robust_loss``."""
    return Bound("robust tree", min(1.0, max(0.0, sweep.value * (1.0 - relative_rounding(joint, sweep.rank)))))


def undecided_steps(joint: JointModel, occupancies: Sequence[Occupancy]) -> float:
    """Upper bound on Theta, the expected number of steps that find the task undecided, from the alive mass by time."""
    missing = sum(model.kernel.loss for model in joint.models)
    total = 0.0
    for t, occupancy in enumerate(occupancies):
        mass = sum(float(occupancy.masses(q).sum()) for q in range(joint.n_states) if not joint.absorbing[q])
        total += min(1.0, mass * INFLATE + occupancy.leftover + t * missing + SPARE)
    return total * INFLATE


def stranded_mass(joint: JointModel, policies: Policies, occupancies: Sequence[Occupancy]) -> float:
    """Upper bound on the probability of ever being undecided in a cell whose policy has no choice."""
    missing = sum(model.kernel.loss for model in joint.models)
    total = 0.0
    for t, occupancy in enumerate(occupancies):
        total += occupancy.leftover + t * missing
        for q, rows in enumerate(occupancy.terms.index):
            if joint.absorbing[q] or not len(rows):
                continue
            whole = np.array([own.sum(axis=1)[rows[:, i]] for i, own in enumerate(occupancy.terms.factors)])
            for i, own in enumerate(occupancy.terms.factors):
                idle = own[:, policies[i][t, q] < 0].sum(axis=1)[rows[:, i]]
                total += float((idle * np.prod(np.delete(whole, i, axis=0), axis=0)).sum())
    return total * INFLATE


def robust_loss(model: AgentModel, masked: NDArray, smoothed: NDArray) -> NDArray:
    """Smoothed factors (n, Z) less ``delta`` times the largest value of the masked factors (n, S), at least 0.

    A lower bound on what a factor is worth to the continuous agent, whatever its scale.
    """
    if model.delta == 0.0:
        return smoothed
    largest = masked.max(axis=1, initial=0.0)[:, None]
    return _less(smoothed, largest * (model.delta * INFLATE + 1e-11))


def plain_loss(model: AgentModel, masked: NDArray, smoothed: NDArray) -> NDArray:
    """The paper's operator: smoothed factors less ``delta``, at least 0; sound while no factor exceeds 1.

    Raises
    ------
    ValueError
        If a factor exceeds 1.
    """
    if model.delta == 0.0:
        return smoothed
    if masked.max(initial=0.0) > 1.0:
        raise ValueError("`masked`: the plain robust operator is unsound for factors above 1; use the scale-free form")
    return _less(smoothed, model.delta * INFLATE + 1e-11)


def _less(smoothed: NDArray, loss: NDArray | float) -> NDArray:
    """``max(0, smoothed - loss)``, in place: the array is fresh from smoothing and large."""
    smoothed -= loss
    return np.maximum(smoothed, 0.0, out=smoothed)
