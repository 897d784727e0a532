"""The relation of mean boxes: from all points of a cell the mean of the next state lies in a known box.

The controller reads the cell of the true state, the automaton state and the time, and has no memory. From state x of
cell s choice a applies the input ``u_a``. All that the finite model knows of the mean is that it lies in the box
``M(s, a)``; the kernel takes the least value over it (docs/theory/boxes.md). So nothing depends on how the boxes were
made, and an agent needs no more than boxes for all points of a cell, and inputs. They are made in ``symbolic_means``,
whether dynamics are expressions or matrices, which are sums of products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ....envs.systems.arguments import counted
from ..grids import FloatArray, RelationRefused, sharpness
from .cell_relation import ReadsCells
from .rounding import missed_cells
from .symbolic_means import SymbolicMeans

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


@dataclass(frozen=True, eq=False, repr=False)
class BoxRelation(ReadsCells):
    """Mean boxes of an agent (delta = 0, no memory).

    Parameters
    ----------
    means : SymbolicMeans
        What makes the boxes.
    menu : (A, m) array
        Inputs u_a.
    input_low, input_high : (m,) arrays
        Input box.
    """

    means: SymbolicMeans
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
        Of ``SymbolicMeans``.

    Raises
    ------
    ValueError
        If an input is outside its box.
    """
    box = agent.input_box
    if not len(input_set) or not np.all((box.low <= input_set) & (input_set <= box.high)):
        raise RelationRefused(f"agent `{agent.name}`: mean boxes need inputs inside their box")
    return BoxRelation(SymbolicMeans(agent, parts), input_set, box.low, box.high)
