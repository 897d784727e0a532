"""From a computed value to a certified number.

``nominal``: all relations have delta = 0, so the satisfaction probability of the continuous closed loop is at least the
value of the abstraction, ``P >= V`` (THEORY section 4), and equal to it where nothing was lost at edges, to pruning or
to rounding (section 1). What floating point may have added to a nonnegative sum of products of n operations is below
``gamma(n) = n u / (1 - n u)`` of the value (section 9), and is taken off.
"""

from __future__ import annotations

from dataclasses import dataclass

from .ascent import Sweep
from .joint import JointModel
from .kernel import UNIT


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
    rounding : float
        What was taken off ``value`` for floating point.
    """

    name: str
    lower: float
    gap: float | None
    rounding: float


def relative_rounding(joint: JointModel, rank: int) -> float:
    """Upper bound on the relative error of the backward recursion, with a reserve for a second evaluation of it.

    A certificate is checked by a program that sums in another order and builds the kernel in another way; the reserve,
    ``1e-11`` per agent and ten more, keeps a right certificate from being refused for that.
    """
    n_agents = len(joint.models)
    n = joint.horizon * sum(s + 1 for s in joint.n_cells) + n_agents + rank + 2
    gamma = n * UNIT / (1.0 - n * UNIT)
    return 2.0 * gamma + 1e-11 * (n_agents + 10)


def nominal_bound(joint: JointModel, sweep: Sweep, aligned: bool) -> Bound:
    """Bound of a value with delta = 0; ``aligned`` says that no value is lost at region and workspace edges."""
    relative = relative_rounding(joint, sweep.rank)
    lower = min(1.0, max(0.0, sweep.value * (1.0 - relative)))
    loss = joint.horizon * sum(model.kernel.loss for model in joint.models)
    gap = (sweep.value - lower) + sweep.value * relative + sweep.dropped + loss if aligned else None
    return Bound("nominal", lower, None if gap is None else min(gap * (1 + 1e-12), 1.0 - lower), sweep.value - lower)
