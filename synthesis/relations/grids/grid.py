"""Rectangular grids whose edges lie on the region boundaries.

An agent's workspace is cut into boxes ("cells"), the product of one partition per axis. Cells are half-open,
``[edge_k, edge_k+1)``, but for the last one of an axis, which is closed, exactly as regions and workspace are. A region
whose boundary lies on edges therefore holds in a cell either everywhere or nowhere (docs/theory/relations.md, "The
exact relation").
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.arguments import box_text, counted
from .refusal import RelationRefused
from .sizes import shape_text

FloatArray = NDArray[Any]
"""Floating-point numbers (rationals in exact tests)."""


@dataclass(frozen=True, eq=False, repr=False)
class Grid:
    """Partition of a box into ``S = prod(shape)`` cells, numbered in C order.

    Parameters
    ----------
    edges : tuple of (S_k + 1,) arrays
        Strictly increasing cell edges of each of the d axes, in state units.
    """

    edges: tuple[FloatArray, ...]

    def __post_init__(self) -> None:
        for k, axis in enumerate(self.edges):
            if axis.ndim != 1 or len(axis) < 2 or not np.all(np.diff(axis) > 0):
                raise ValueError(f"`edges[{k}]`: expected at least two strictly increasing numbers, got {axis!r}")
            axis.setflags(write=False)

    def __repr__(self) -> str:
        box = box_text(np.array([axis[0] for axis in self.edges]), np.array([axis[-1] for axis in self.edges]))
        number = counted(self.n_cells, "cell")
        return f"Grid({number if len(self.shape) == 1 else f'{shape_text(self.shape)} = {number}'} on {box})"

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells per axis."""
        return tuple(len(axis) - 1 for axis in self.edges)

    @property
    def n_cells(self) -> int:
        """Number of cells S."""
        return math.prod(self.shape)

    @property
    def low(self) -> FloatArray:
        """(S, d) lower corners."""
        return _product([axis[:-1] for axis in self.edges])

    @property
    def high(self) -> FloatArray:
        """(S, d) upper corners."""
        return _product([axis[1:] for axis in self.edges])

    @property
    def centres(self) -> FloatArray:
        """(S, d) cell centres."""
        return _product([0.5 * (axis[:-1] + axis[1:]) for axis in self.edges])

    @property
    def half_widths(self) -> FloatArray:
        """(S, d) half cell widths, rounded up so that centre plus half width covers the cell."""
        return np.maximum(self.high - self.centres, self.centres - self.low) * (1 + 4e-16)

    def cell_of(self, points: FloatArray) -> NDArray[np.int64]:
        """Return the cell that holds each point (exact); points outside are projected onto the grid first.

        Parameters
        ----------
        points : (d, ...) array
            Component first, as in the batched dynamics.

        Returns
        -------
        (...) array of int64 in ``0 .. S - 1``.
        """
        cells = np.zeros(points.shape[1:], dtype=np.int64)
        for axis, coordinate in zip(self.edges, points, strict=True):
            cells *= len(axis) - 1
            cells += np.searchsorted(axis[1:-1], coordinate, side="right")
        return cells

    def overlap(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Return the share (S,) of the box ``[low, high]`` (d,) that lies in each cell; a flat axis is a point."""
        share = np.ones(1)
        for edges, a, b in zip(self.edges, low, high, strict=True):
            if a == b:
                axis = np.zeros(len(edges) - 1)
                axis[np.searchsorted(edges[1:-1], a, side="right")] = float(edges[0] <= a <= edges[-1])
            else:
                axis = np.clip(np.minimum(edges[1:], b) - np.maximum(edges[:-1], a), 0.0, None) / (b - a)
            share = np.multiply.outer(share, axis).ravel()
        return share


def aligned_edges(low: float, high: float, cells: int, boundaries: Iterable[float] = ()) -> FloatArray:
    """Return the edges of about ``cells`` intervals of ``[low, high]``; every boundary inside is one of them.

    Segments between neighbouring boundaries are cut uniformly, in numbers proportional to their lengths (largest
    remainders, at least one cell each), so that a grid which is aligned already stays uniform.

    Raises
    ------
    ValueError
        If ``cells`` is smaller than the number of segments.
    """
    inside = sorted({float(b) for b in boundaries if low < b < high})
    points = np.array([low, *inside, high])
    lengths = np.diff(points)
    if cells < len(lengths):
        raise RelationRefused(
            f"`cells`: expected at least {len(lengths)} on [{low:g}, {high:g}], whose region boundaries cut it into "
            f"that many parts, got {cells}; ask for more cells"
        )
    # Every segment gets its share of the cells, rounded down; the cells that are left go to the largest remainders.
    share = lengths / lengths.sum() * cells
    counts = np.maximum(1, np.floor(share + 1e-9).astype(int))
    while counts.sum() < cells:
        counts[np.argmax(share - counts)] += 1
    while counts.sum() > cells:
        counts[np.argmin(np.where(counts > 1, share - counts, np.inf))] -= 1
    segments = [np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(points[:-1], points[1:], counts, strict=True)]
    edges = np.concatenate([*segments, points[-1:]])
    # Round all other edges, so that grids which differ in their boundaries alone share edges, and with them a kernel.
    decimals = 12 - max(0, math.ceil(math.log10(max(abs(low), abs(high), 1e-12))))
    rounded = np.round(edges, decimals)
    return np.where(np.isin(edges, points) | (np.abs(rounded - edges) > 1e-6 * lengths.min() / cells), edges, rounded)


def _product(axes: Sequence[FloatArray]) -> FloatArray:
    """Return the Cartesian product (prod n_k, d) in C order."""
    return np.stack([m.ravel() for m in np.meshgrid(*axes, indexing="ij")], axis=-1)
