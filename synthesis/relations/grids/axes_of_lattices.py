"""What the axes of a lattice stand for, in the order in which lattices have them.

Along most states a lattice has points for the mean of the next state, and that is all. Two kinds of noise need more
(docs/theory/boxes.md, "Noise that is larger in some places" and "States without noise"):

- where noise has a scale that depends on the state, an axis of logarithms of the scale stands before that of the mean;
- where a state has no noise, the next one is the mean itself, and all that counts is the cell that holds it: the points
  are the numbers of the cells, and one more at either end for what leaves the workspace.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ....envs.systems.agents import AnyAgent
from ....envs.systems.expressions import Number
from .grid import FloatArray


@dataclass(frozen=True)
class LatticeAxis:
    """One axis of a lattice, and the number of the state that it belongs to.

    Values between its points are interpolated, unless it ``is_interpolated`` not: then each point is a cell. Where it
    ``is_logarithmic`` the points are logarithms of what they stand for.
    """

    state: int

    is_interpolated: ClassVar[bool] = True
    is_logarithmic: ClassVar[bool] = False


class MeanAxis(LatticeAxis):
    """Means of the next state."""


class CellAxis(LatticeAxis):
    """Numbers of cells, of a state without noise."""

    is_interpolated = False


class ScaleAxis(LatticeAxis):
    """Logarithms of what the noise is multiplied with."""

    is_logarithmic = True


def lattice_axes(agent: AnyAgent) -> tuple[LatticeAxis, ...]:
    """Return the axes of an agent's lattice under the relation ``boxes``."""
    axes = list[LatticeAxis]()
    for k, still in enumerate(agent.still_axes.tolist()):
        if still:
            axes.append(CellAxis(k))
            continue
        if agent.timed_scale_trees and agent.timed_scale_trees[k] != Number(1.0):
            axes.append(ScaleAxis(k))
        axes.append(MeanAxis(k))
    return tuple(axes)


def points_by_axis(agent: AnyAgent, lattice: Sequence[FloatArray]) -> dict[LatticeAxis, FloatArray]:
    """Return the points of a lattice by what they stand for."""
    return dict(zip(lattice_axes(agent), lattice, strict=True))


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
