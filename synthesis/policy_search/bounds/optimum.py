"""How far from the best: an upper bound on what any policy attains on the same cells.

Where joint cells are few, dense joint programming gives the optimum itself (``dense``); elsewhere the product of the
agents' relaxations bounds it from above (``relaxation``). It speaks of all policies on the same abstraction,
centralised ones and those with any memory included: ``abstract optimum``. It is no bound for the continuous system,
whose policies may do better than any on these cells (docs/theory/bounds.md, "Upper bounds, and of what").
"""

from __future__ import annotations

import math

import numpy as np

from ....envs.tasks.problem import Problem
from ...abstraction.models import JointModel
from ...certificates.value_functions import UNIT, Occupancy
from ..ascent import Relaxation, upper_bound
from .dense import dense_optimum

MOST_MULTIPLICATIONS = 5e8
"""Multiplications that dense programming may take."""

MOST_NUMBERS = 2e7
"""Most numbers of an array of dense programming, 160 MB: joint lattice points count as well as joint cells."""

CLOSE_ENOUGH = 1e-6
"""Relative distance of a bound from above at which a tighter one is not worth its time."""


def abstract_bound(
    problem: Problem, joint: JointModel, start: Occupancy, relaxations: tuple[Relaxation, ...], value: float
) -> float:
    """Return an upper bound on the abstract optimum from the start (mean over a box); ``value`` is attained."""
    most = upper_bound(joint, start, relaxations)
    if most - value <= CLOSE_ENOUGH * most or not _is_small(joint):
        return most
    # Sum the dense optimum over the mass at the start, one agent's cells after the other.
    dense = dense_optimum(problem, joint.models)
    total = 0.0
    for q, rows in enumerate(start.terms.index):
        for row in rows:
            contracted = dense[q]
            for factors, k in zip(start.terms.factors, row, strict=True):
                contracted = np.tensordot(factors[k], contracted, axes=1)
            total += float(contracted)
    loss = joint.horizon * sum(model.kernel.loss for model in joint.models)
    operations = joint.horizon * sum(s + 1 for s in joint.n_cells) + sum(joint.n_cells) + len(joint.models)
    return min(most, total * (1.0 + 4.0 * operations * UNIT) + loss)


def _is_small(joint: JointModel) -> bool:
    """Return whether dense programming applies, and is quick."""
    costs = [model.choices.dense_cost for model in joint.models]
    if None in costs:
        return False
    points = [math.prod(model.kernel.lattice_shape) for model in joint.models]
    # Expectations are held at all joint lattice points, and turned into maxima over cells one agent after the other.
    numbers = math.prod(float(max(n, z)) for n, z in zip(joint.n_cells, points, strict=True))
    tables = sum(n * z for n, z in zip(joint.n_cells, points, strict=True))
    entries = joint.n_states * max(math.prod(float(n) for n in joint.n_cells), numbers)
    axes = sum(joint.n_cells) + sum(cost or 0 for cost in costs)
    fits = max(numbers, entries / joint.n_states, float(tables)) <= MOST_NUMBERS
    return fits and joint.horizon * entries * axes <= MOST_MULTIPLICATIONS
