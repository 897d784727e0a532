"""What the axes of a lattice stand for, in the order in which lattices have them.

Along most states a lattice has points for the mean of the next state, and that is all. Two kinds of noise need more
(docs/theory/boxes.md, "Noise that is larger in some places" and "States without noise"):

- where noise has a scale that depends on the state, an axis of logarithms of the scale stands before that of the mean;
- where a state has no noise, the next one is the mean itself, and all that counts is the cell that holds it: the points
  are the numbers of the cells, and one more at either end for what leaves the workspace.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...envs.agents import AnyAgent
from ...envs.expressions import Number
from .grid import FloatArray


@dataclass(frozen=True)
class LatticeAxis:
    """One axis of a lattice, and the number of the state that it belongs to."""

    kind: Literal["scale", "mean", "cell"]
    state: int


def lattice_axes(agent: AnyAgent) -> tuple[LatticeAxis, ...]:
    """Return the axes of an agent's lattice under the relation ``boxes``."""
    axes = []
    for k, still in enumerate(agent.still_axes.tolist()):
        if still:
            axes.append(LatticeAxis("cell", k))
            continue
        if agent.timed_scale_trees and agent.timed_scale_trees[k] != Number(1.0):
            axes.append(LatticeAxis("scale", k))
        axes.append(LatticeAxis("mean", k))
    return tuple(axes)


def cell_points(n_cells: int) -> FloatArray:
    """Return the points of the axis of a state without noise: -1, the cells, and their number."""
    return np.arange(-1.0, n_cells + 1.0)


STILL_SHARE = 0.05
"""Share of the workspace that counts as the deviation of a state without noise where cells are chosen."""


def deviations_of(agent: AnyAgent) -> FloatArray:
    """Return standard deviations (d,) of the noise along the states, by which cells are chosen.

    States without noise have a share of their workspace instead.
    """
    span = agent.state_high - agent.state_low
    return np.where(agent.still_axes, STILL_SHARE * span, np.sqrt(np.maximum(np.diag(agent.noise_covariance), 0.0)))
