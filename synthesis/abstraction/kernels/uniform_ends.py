"""What uniform noise leaves unknown between lattice points: variation of a factor at the two ends of the noise.

With noise uniform on [a, b) along one axis, ``g(m) = (H(m + b) - H(m + a)) / (b - a)`` with H' = h, the factor smoothed
along all other axes. So ``g'' = (h'(m + b) - h'(m + a)) / (b - a)``, jumps of h included, and between two lattice
points eta apart the interpolant of g is above g by at most

    eta / (4 (b - a)) * (what h rises in the interval moved by b  +  what it falls in the interval moved by a) .

h is linear in every cell, and an interval shorter than any cell meets one edge at most (docs/theory/linear.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ....envs.systems.distributions import Uniform
from ...certificates.value_functions import UNIT
from ...relations.grids import FloatArray
from .kernel import AxisTable
from .linear_kernel import HAT_SLACK

WIDER = 1.0 + 1e-9
"""Share by which charges are raised for rounding."""


@dataclass(frozen=True, eq=False)
class UniformEnds:
    """The axis of an agent's grid along which the noise is uniform.

    Parameters
    ----------
    axis : int
    lattice, edges : arrays
        Points of the lattice, and edges of the cells, along it.
    law : Uniform
    """

    axis: int
    lattice: FloatArray
    edges: FloatArray
    law: Uniform

    def charges(self, tables: Sequence[AxisTable], factors: NDArray) -> list[FloatArray]:
        """Return for each factor (n, 2^d S) what interpolation adds above every lattice point (Z_1, ..), at most.

        The charge of an interval stands at its lower point; those of intervals at the ends of the lattice are 0.
        """
        shape, result = [table.shape[1] for table in tables], []
        width, lattice_spacing = self.law.high - self.law.low, float(np.max(np.diff(self.lattice)))
        for factor in factors:
            tensor = factor.reshape(shape)
            for k, table in enumerate(tables):
                if k != self.axis:
                    tensor = np.moveaxis(table.backup(np.moveaxis(tensor, k, -1)), -1, k)
            along = np.moveaxis(tensor, self.axis, 0)
            columns = along.reshape(len(along), -1)
            up, down = (_variation(operators, columns) for operators in self._operators)
            interpolation_error = np.zeros((len(self.lattice), columns.shape[1]))
            interpolation_error[:-1] = (np.maximum(up, 0.0).sum(axis=0) + np.maximum(-down, 0.0).sum(axis=0)) * (
                lattice_spacing / (4 * width)
            )
            interpolation_error = interpolation_error.reshape(len(self.lattice), *along.shape[1:])
            result.append(np.moveaxis(interpolation_error, 0, self.axis) * WIDER)
        return result

    @cached_property
    def _operators(self) -> tuple[tuple[csr_array, csr_array, csr_array, csr_array], ...]:
        """For both ends of the noise, what gives h at the ends of intervals and on both sides of an edge inside."""
        return tuple(readings(self.lattice + shift, self.edges) for shift in (self.law.high, self.law.low))


def _variation(operators: tuple[csr_array, csr_array, csr_array, csr_array], columns: FloatArray) -> FloatArray:
    """Return the three moves (3, Z - 1, N) of h in every interval: to the edge, at the edge, and from there on."""
    begin, before, after, end = (operator @ columns for operator in operators)
    return np.stack([before - begin, after - before, end - after])


def readings(points: FloatArray, edges: FloatArray) -> tuple[csr_array, csr_array, csr_array, csr_array]:
    """Return matrices (Z - 1, 2 S) that read a function, linear in every cell and 0 outside, on intervals of points.

    They give its values at the lower end, just before and just after the edge inside, and at the upper end; without an
    edge inside the middle two are those at the lower end.
    """
    cells, left, right = len(edges) - 1, points[:-1], points[1:]
    first = np.searchsorted(edges, left, side="right") - 1  # cell of the lower end, -1 or S outside
    last = np.searchsorted(edges, right, side="left") - 1
    crosses = last > first

    def reading(cell: NDArray[np.intp], at: FloatArray) -> csr_array:
        inside = np.flatnonzero((cell >= 0) & (cell < cells))
        own = cell[inside]
        share = np.clip((at[inside] - edges[own]) / (edges[own + 1] - edges[own]), 0.0, 1.0)
        rows = np.concatenate([inside, inside])
        entries = np.concatenate([1.0 - share, share])
        return csr_array((entries, (rows, np.concatenate([2 * own, 2 * own + 1]))), shape=(len(left), 2 * cells))

    edge = edges[np.clip(first + 1, 0, cells)]
    return (
        reading(first, left),
        reading(first, np.where(crosses, edge, left)),
        reading(np.where(crosses, last, first), np.where(crosses, edge, left)),
        reading(last, right),
    )


def uniform_hats(lattice: FloatArray, edges: FloatArray, law: Uniform) -> tuple[AxisTable, float]:
    """Return a table of hat masses under uniform noise, from below, and what a row misses at most."""
    low, high = edges[:-1], edges[1:]
    width = law.high - law.low
    first = np.maximum(low, lattice[:, None] + law.low)
    last = np.maximum(np.minimum(high, lattice[:, None] + law.high), first)
    mass = (last - first) / width
    upper = mass * (0.5 * (first + last) - low) / (high - low)
    # Ends are rounded in the last place of the largest numbers; a mass is off by that over the width of the noise. The
    # sum of the three is more than any of them, as the check counts them: no less may be taken off here than there.
    size = float(np.max(np.abs(edges)) + np.max(np.abs(lattice)) + max(abs(law.low), abs(law.high)))
    slack = HAT_SLACK * UNIT * (size * (1.0 / width + 1.0 / float(np.min(high - low))) + 1.0)
    masses = np.stack([np.maximum(mass - upper - slack, 0.0), np.maximum(upper - slack, 0.0)], axis=-1)
    masses = np.where((mass > 0.0)[..., None], masses, 0.0).reshape(len(lattice), -1)
    # A cell that the noise just touches may be missed as a whole.
    lost = 4.0 * slack * (2.0 + float(np.max(np.sum(mass > 0.0, axis=1))))
    return AxisTable((len(lattice), 2 * len(low)), ((0, len(lattice), 0, 2 * len(low), masses),)), lost
