"""The relation of mean boxes: from all points of a cell the mean of the next state lies in a known box.

The controller reads the cell of the true state, the automaton state and the time, and has no memory. From state x of
cell s choice a applies the input ``u_a``. All that the finite model knows of the mean is that it lies in the box
``M(s, a)``; the kernel takes the least value over it (docs/theory/boxes.md). So nothing depends on how the boxes were
made, and an agent needs no more than boxes for all points of a cell, and inputs. Here they are made for
linear agents, in ``symbolic_means`` for those whose dynamics are expressions, in ``network_bounds`` for linear agents
that a network moves; kernel, search and tree are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent, AnyAgent, LinearAgent
from ....envs.systems.arguments import counted
from ..grids import FloatArray, RelationRefused, linear_agent, sharpness
from .cell_relation import ReadsCells
from .exact import INPUT_MARGIN
from .rounding import missed_cells, sizes_of
from .symbolic_means import SymbolicMeans

ROUNDED_TWICE = 2.0
"""Factor on the rounding of a mean: it is computed here, and by the agent itself."""

WRAPPED_OFF = 2e-13
"""What an angle that wraps is off by in floating point, at most."""


@dataclass(frozen=True, eq=False)
class MeanBoxes:
    """Boxes around the means of the next state, for n cells and A choices (outer bounds).

    Parameters
    ----------
    low, high : (n, A, d) arrays
        Corners: the mean from every point of the closed cell lies between them.
    admissible : (n, A) bool array
        Whether the input of the choice is admissible at every point of the closed cell.
    scales : pair of (n, A, d) arrays, or None
        Ends of what the noise of each state is multiplied with, positive where a choice is admissible; None where the
        noise is the same everywhere.
    """

    low: FloatArray
    high: FloatArray
    admissible: NDArray[np.bool_]
    scales: tuple[FloatArray, FloatArray] | None = None


@dataclass(frozen=True, eq=False)
class LinearMeans:
    """Boxes around the means of a linear agent.

    Parameters
    ----------
    A, B : (d, d), (d, m) arrays
        Dynamics.
    offset : (d,) array
        Mean from the origin under the input 0.
    rounding : (d,) array
        Upper bounds on what means are off by in floating point.
    """

    A: FloatArray
    B: FloatArray
    offset: FloatArray
    rounding: FloatArray

    def around(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the corners (n, A, d) of boxes around the means from the closed cells ``[low, high]``, (n, d) each.

        With ``x = c + e``, ``|e| <= h``, the mean is ``A c + B u_a + offset + A e``: it is off its centre by ``|A| h``
        at most, and by what is rounded.
        """
        centre = 0.5 * (low + high)
        half = np.maximum(high - centre, centre - low) * (1.0 + INPUT_MARGIN)
        middle = (centre @ self.A.T + self.offset)[:, None] + (input_set @ self.B.T)[None]
        extent = (half @ np.abs(self.A).T + self.rounding)[:, None]
        return middle - extent, middle + extent

    def scales(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return None: the noise is the same everywhere."""
        return None

    @property
    def description(self) -> dict[str, Any]:
        """What files hold of it."""
        return {}

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that boxes depend on, for comparing relations."""
        return (self.A, self.B, self.offset)


@dataclass(frozen=True, eq=False, repr=False)
class BoxRelation(ReadsCells):
    """Mean boxes of an agent (delta = 0, no memory).

    Parameters
    ----------
    means : LinearMeans or SymbolicMeans
        What makes the boxes.
    menu : (A, m) array
        Inputs u_a.
    input_low, input_high : (m,) arrays
        Input box.
    """

    means: LinearMeans | SymbolicMeans
    input_set: FloatArray
    input_low: FloatArray
    input_high: FloatArray

    kind = "boxes"
    delta = 0.0

    def __repr__(self) -> str:
        m = len(self.input_low)
        choices = counted(len(self.input_set), "choice")
        return f"BoxRelation({counted(m, 'input')}, {choices}, delta 0)"

    def describe(self) -> dict[str, Any]:
        """Return the description that files hold."""
        return {
            "kind": "boxes",
            "menu": self.input_set.tolist(),
            **self.means.description,
        }

    @property
    def n_choices(self) -> int:
        """Number of choices A."""
        return len(self.input_set)

    def mean_boxes(self, low: FloatArray, high: FloatArray) -> MeanBoxes:
        """Return boxes around the means from the closed cells ``[low, high]``, (n, d) each (outer bounds).

        A choice is not admissible, either, where nothing is known of its mean.
        """
        first, last = self.means.around(low, high, self.input_set)
        inside = np.all((self.input_low <= self.input_set) & (self.input_set <= self.input_high), axis=1)
        known = np.all(np.isfinite(first) & np.isfinite(last), axis=2)
        scales = self.scales(low, high)
        if scales is not None:
            known &= np.all((scales[0] > 0.0) & np.isfinite(scales[1]), axis=2)
        return MeanBoxes(first, last, inside & known, scales)

    def scales(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return ends (n, A, d) of what noise is multiplied with in the closed cells ``[low, high]``, (n, d) each.

        They are not numbers where nothing is known; None where the noise is the same everywhere.
        """
        return self.means.scales(low, high, self.input_set)

    def inputs(self, choices: NDArray[np.intp]) -> FloatArray:
        """Return the inputs ``u_a`` (m, ...) of choices (...)."""
        return np.stack([column.take(choices, mode="clip") for column in self._columns])

    def nearest_choices(self, other: BoxRelation) -> NDArray[np.intp]:
        """Return the choice of this relation that does most nearly what each choice (A',) of another one does."""
        if np.array_equal(self.input_set, other.input_set):
            return np.arange(len(other.input_set))
        width = np.where(self.input_high > self.input_low, self.input_high - self.input_low, 1.0)
        return np.argmin(np.sum(((other.input_set[:, None] - self.input_set) / width) ** 2, axis=2), axis=1)

    @cached_property
    def _columns(self) -> FloatArray:
        """Inputs (m, A) of the choices, each component on its own."""
        return np.ascontiguousarray(self.input_set.T)

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All matrices, for comparing relations."""
        return (
            *self.means.arrays,
            self.input_set,
            self.input_low,
            self.input_high,
        )

    def rounding_loss(self, agent: AnyAgent, edges: Sequence[FloatArray]) -> float:
        """Return an upper bound on what carrying the relation out in floating point costs per step, a probability.

        What means are off by is in the boxes; angles are rounded once more where they wrap.
        """
        return missed_cells(sharpness(agent), np.where(agent.wrapped_axes, WRAPPED_OFF, 0.0), edges)


def box_relation(agent: AnyAgent, input_set: FloatArray, parts: int = 1) -> BoxRelation:
    """Return the relation of mean boxes of an agent.

    Parameters
    ----------
    agent : AnyAgent
    menu : (A, m) array
        Inputs to choose from.
    parts : int
        Of ``SymbolicMeans``, where dynamics are expressions.

    Raises
    ------
    ValueError
        If an input is outside its box.
    """
    box = agent.input_box
    if not len(input_set) or not np.all((box.low <= input_set) & (input_set <= box.high)):
        raise RelationRefused(f"agent `{agent.name}`: mean boxes need inputs inside their box")
    means: LinearMeans | SymbolicMeans
    if isinstance(agent, Agent):
        means = SymbolicMeans(agent, parts)
    else:
        means = linear_means(linear_agent(agent, "boxes"))
    return BoxRelation(means, input_set, box.low, box.high)


def linear_means(agent: LinearAgent) -> LinearMeans:
    """Return what boxes of a linear agent are made of; means are computed here and by the agent."""
    sizes = sizes_of(agent)
    return LinearMeans(agent.A, agent.B, agent.offset, 2.0 * ROUNDED_TWICE * sizes.unit * sizes.means)
