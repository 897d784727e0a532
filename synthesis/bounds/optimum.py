"""How far from the best: an upper bound on what any policy attains on the same cells.

Where joint cells are few, dense joint programming says it exactly (``oracle``); elsewhere the product of the agents'
relaxations bounds it from above (``relaxation``). The policies it speaks of are all of them, centralised ones and those
with any memory included, on the same abstraction: ``abstract optimum``. It is no bound for the continuous system, whose
policies may do better than any on these cells.
"""

from __future__ import annotations

import math

import numpy as np

from ...envs.problem import Problem
from ..models import InputMenu, JointModel, TargetWindows
from ..search import Relaxation, upper_bound
from ..values import UNIT, Occupancy, to_host
from .dense import dense_optimum

WORK = 5e8
"""Multiplications that dense programming may take."""

CLOSE = 1e-6
"""Relative distance of a bound from above at which a tighter one is not worth its time."""


def abstract_bound(
    problem: Problem, joint: JointModel, start: Occupancy, relaxations: tuple[Relaxation, ...], value: float
) -> float:
    """Upper bound on the abstract optimum from the start (mean over a box), of which ``value`` is attained."""
    most = upper_bound(joint, start, relaxations)
    if most - value <= CLOSE * most or not _is_small(joint):
        return most
    dense = dense_optimum(problem, joint.models)
    total = 0.0
    for q, rows in enumerate(start.terms.index):
        for row in rows:
            rest = dense[q]
            for own, k in zip(start.terms.factors, row, strict=True):
                rest = np.tensordot(to_host(own)[k], rest, axes=1)
            total += float(rest)
    loss = joint.horizon * sum(model.kernel.loss for model in joint.models)
    operations = joint.horizon * sum(s + 1 for s in joint.n_cells) + sum(joint.n_cells) + len(joint.models)
    return min(most, total * (1.0 + 4.0 * operations * UNIT) + loss)


def _is_small(joint: JointModel) -> bool:
    """Whether dense programming applies, and is quick."""
    for model in joint.models:
        if isinstance(model.choices, TargetWindows) and not model.choices.relation.is_box:
            return False
    entries = joint.n_states * math.prod(float(n) for n in joint.n_cells)
    axes = sum(n + _choices(model.choices) for n, model in zip(joint.n_cells, joint.models, strict=True))
    return joint.horizon * entries * axes <= WORK


def _choices(choices: TargetWindows | InputMenu) -> int:
    """What a maximum over the choices costs per cell."""
    if isinstance(choices, InputMenu):
        return int(choices.leads_to.shape[1])
    return int(np.prod(np.maximum(choices.high - choices.low, 0), axis=1).max(initial=0))
