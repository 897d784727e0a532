"""From computed values to certified numbers (docs/theory/bounds.md).

``nominal``       all delta are 0: the probability of the continuous closed loop is at least the value, ``P >= V``, and
                  equal to it where nothing was lost at edges, to pruning or to rounding ("Nominal").
``a-posteriori``  couple both systems: success can fail only if the relation is lost at a step that finds the run
                  undecided, and each such step costs at most ``Delta``. So ``P >= V - Delta * Theta``, where Theta is
                  the expected number of undecided steps of the masked abstract chain: the sum over time of the alive
                  mass ("A-posteriori"). The paper's own form counts steps until acceptance only and reads them off the
                  depths of the tree, ``sum_z v(z) (1 + Delta (T - depth z)) - Delta T``; it is never larger.
``robust tree``   every factor loses ``delta_i`` times its largest value at every step ("Robust tree"). The paper's
                  plain ``- delta_i`` is the same only while no factor exceeds 1, which is checked as it is computed.

Agents couple with independent coins: ``Delta = 1 - prod (1 - delta_i)``. What must be an upper bound is rounded up.
Floating point may have added less than ``gamma(n) = n u / (1 - n u)`` of a nonnegative sum of products of n operations
(docs/theory/numerics.md), and that is taken off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...abstraction.models import AgentModel, JointModel, Policies
from ...certificates.value_functions import UNIT, Occupancy
from ...relations.kinds import joint_delta
from ..ascent import Sweep, TrainSweep

SPARE_MASS = 1e-8
"""Added to the undecided mass of every step, so that a second, coarser computation of it does not exceed it."""

CHARGE_INFLATION = 1.0 + 1e-9
"""Factor on what is subtracted, far above the rounding of what it is subtracted from."""

SECOND_EVALUATION = 0.1
"""Share of the tolerance of trains that is held back for a second evaluation, whose rounding may choose otherwise."""

AGENT_RESERVE, COMMON_RESERVE = 1e-11, 10
"""Relative reserve per agent, and for how many agents more, for a kernel built and summed in another way."""

LOSS_RESERVE = 1e-11
"""Added to delta times the largest value, so that the check's own robust tree, rounded otherwise, is not smaller."""


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
    """Return an upper bound on the relative error of the backward recursion, with a reserve for a second evaluation.

    A certificate is checked by a program that sums in another order and builds the kernel in another way; the reserve
    keeps a right certificate from being refused for that.
    """
    n_agents = len(joint.models)
    # Operations that a value passes through: sums over cells at every step, then the product over agents and terms.
    n = joint.horizon * sum(s + 1 for s in joint.n_cells) + n_agents + rank + 2
    gamma = n * UNIT / (1.0 - n * UNIT)
    return 2.0 * gamma + AGENT_RESERVE * (n_agents + COMMON_RESERVE)


def rounding_loss(problem: Problem, joint: JointModel) -> float:
    """Return an upper bound on what carrying out policies in floating point costs over the horizon, a probability."""
    agents = zip(problem.agents, joint.models, strict=True)
    per_step = sum(model.relation.rounding_loss(agent, model.grid.edges) for agent, model in agents)
    return joint.horizon * per_step * CHARGE_INFLATION


def nominal_bound(joint: JointModel, sweep: Sweep, lost: float, aligned: bool, deadlocked: float = 0.0) -> Bound:
    """Return the bound of a value with delta = 0, and its gap if nothing is lost at edges.

    Parameters
    ----------
    joint : JointModel
    sweep : Sweep
        With frozen policies.
    lost : float
        What carrying the policies out costs (see ``rounding_loss``).
    aligned : bool
        Whether no value is lost at region and workspace edges.
    stranded : float
        Upper bound on the probability of ever being, undecided, in a cell without an admissible choice. The value
        counts such runs as failed, but the controller goes on with them.
    """
    relative = relative_rounding(joint, sweep.rank)
    lower = min(1.0, max(0.0, sweep.value * (1.0 - relative) - lost))
    # Everything that the value may lack: rounding, what was pruned, what kernels miss, runs that are stranded.
    loss = joint.horizon * sum(model.kernel.loss for model in joint.models) + lost
    gap = (sweep.value - lower) + sweep.value * relative + sweep.dropped + loss + deadlocked
    return Bound("nominal", lower, min(gap * (1 + 1e-12), 1.0 - lower) if aligned else None)


def train_bound(joint: JointModel, sweep: TrainSweep, lost: float, above: float | None = None) -> Bound:
    """Return the bound of a value held as tensor trains: less its error and, where relations can be lost, ``Delta T``.

    ``lost`` is what carrying the policies out costs (see ``rounding_loss``); ``above``, an upper bound on what they
    attain (see ``evaluate_above``), gives the gap.
    """
    delta = joint_delta([model.delta for model in joint.models])
    rounding = SECOND_EVALUATION * sweep.rounding.tolerance
    reserve = sweep.terms.error + rounding + relative_rounding(joint, sweep.rank) + lost
    lower = min(1.0, max(0.0, sweep.value - reserve - delta * joint.horizon * CHARGE_INFLATION))
    if delta > 0 or above is None:
        return Bound("a-posteriori" if delta > 0 else "nominal", lower)
    loss = joint.horizon * sum(model.kernel.loss for model in joint.models)
    more = rounding + relative_rounding(joint, sweep.rank) + loss + lost
    return Bound("nominal", lower, float(min(max(0.0, above + more - lower) * (1 + 1e-12), 1.0 - lower)))


def a_posteriori_bound(joint: JointModel, sweep: Sweep, lost: float, undecided: float) -> Bound:
    """Return ``V - Delta * Theta``, less ``lost``; ``undecided`` is an upper bound on Theta."""
    delta = joint_delta([model.delta for model in joint.models])
    value = sweep.value * (1.0 - relative_rounding(joint, sweep.rank))
    return Bound("a-posteriori", min(1.0, max(0.0, value - lost - delta * undecided * CHARGE_INFLATION)))


def robust_bound(joint: JointModel, sweep: Sweep, lost: float) -> Bound:
    """Return the bound of a value grown with ``robust_loss``, less ``lost``."""
    return Bound("robust tree", min(1.0, max(0.0, sweep.value * (1.0 - relative_rounding(joint, sweep.rank)) - lost)))


def undecided_steps(joint: JointModel, occupancies: Sequence[Occupancy]) -> float:
    """Return an upper bound on Theta, the expected number of steps that find the task undecided.

    It is the alive mass summed over time, with what was dropped and what kernels miss added back.
    """
    missing = sum(model.kernel.loss for model in joint.models)
    total = 0.0
    for t, occupancy in enumerate(occupancies):
        mass = sum(float(occupancy.masses(q).sum()) for q in range(joint.n_states) if not joint.absorbing[q])
        total += min(1.0, mass * CHARGE_INFLATION + occupancy.leftover + t * missing + SPARE_MASS)
    return total * CHARGE_INFLATION


def deadlocked_mass(joint: JointModel, policies: Policies, occupancies: Sequence[Occupancy]) -> float:
    """Return an upper bound on the probability of ever being undecided in a cell whose policy has no choice."""
    missing = sum(model.kernel.loss for model in joint.models)
    total = 0.0
    for t, occupancy in enumerate(occupancies):
        total += occupancy.leftover + t * missing
        for q, rows in enumerate(occupancy.terms.index):
            if joint.absorbing[q] or not len(rows):
                continue
            # Per agent the mass in its idle cells, times the masses of the others: a union bound over agents.
            masses = np.array([factors.sum(axis=1)[rows[:, i]] for i, factors in enumerate(occupancy.terms.factors)])
            for i, factors in enumerate(occupancy.terms.factors):
                idle = factors[:, policies[i][t, q] < 0].sum(axis=1)[rows[:, i]]
                total += float((idle * np.prod(np.delete(masses, i, axis=0), axis=0)).sum())
    return total * CHARGE_INFLATION


def robust_loss(model: AgentModel, masked: NDArray, backed_up: NDArray) -> NDArray:
    """Return smoothed factors (n, Z) less ``delta`` times the largest value of the masked factors (n, S), at least 0.

    This is a lower bound on what a factor is worth to the continuous agent, whatever its scale (docs/theory/bounds.md,
    "Robust tree").
    """
    if model.delta == 0.0:
        return backed_up
    largest = masked.max(axis=1, initial=0.0)[:, None]
    return _less(backed_up, largest * (model.delta * CHARGE_INFLATION + LOSS_RESERVE))


def plain_loss(model: AgentModel, masked: NDArray, backed_up: NDArray) -> NDArray:
    """Return smoothed factors less ``delta``, at least 0: the paper's operator, sound while no factor exceeds 1.

    Raises
    ------
    ValueError
        If a factor exceeds 1.
    """
    if model.delta == 0.0:
        return backed_up
    if masked.max(initial=0.0) > 1.0:
        raise ValueError("`masked`: the plain robust operator is unsound for factors above 1; use the scale-free form")
    return _less(backed_up, model.delta * CHARGE_INFLATION + LOSS_RESERVE)


def _less(backed_up: NDArray, loss: NDArray | float) -> NDArray:
    """Return ``max(0, backed_up - loss)``, in place: the array is fresh from smoothing and large."""
    backed_up -= loss
    return np.maximum(backed_up, 0.0, out=backed_up)
