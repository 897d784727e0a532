"""Backups on grids of vertices that count their work as they do it, and are broken off where seconds are over."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...extended_check.vertex_grids import KEPT, Backups, Images, LatticeImages, corners_of
from ...relations.grids import FloatArray
from ...trajectories.planning import CountedWork

ONCE = 1e-3
"""Work of anything that is done once in an automaton state and a step, however few vertices there are."""

WEIGHT, PRODUCT = 7e-8, 6e-11
"""Work of a weight of a plane or an interval, and of a weight times a number of a table, in core seconds."""

ON_LATTICE, PAIRS = 1.0, 2.0
"""Powers of the number of vertices with which work grows: what is looked up at points of a lattice, that are as dense
whatever the cells are; and what cells have to do with all cells that are near."""


MORE_LAWS = 1.7
"""Times as many laws as there are on the grid before: where each of them leads has to be made."""


ADJUSTED, MOST_ADJUSTED = 0.5, (0.5, 2.0)
"""Power of what is charged along an axis, beside the others, by which its share of cells changes from one grid to the
next, and by how much at most: what is charged falls with the square of the number of cells."""


class BrokenOff(Exception):
    """Seconds are over in the middle of a grid."""


class Counted(Backups):
    """Backups that count their work, in core seconds."""

    work = CountedWork()

    def within(self, work: CountedWork) -> Self:
        """Count for a search."""
        self.work = work
        return self

    @property
    def spent(self) -> float:
        """The work so far."""
        return sum(self.parts.values())

    def grown(self, more: float, laws: NDArray[np.int64]) -> float:
        """Return about the work of the same with so many times as many vertices, for laws (T, Q) as here."""
        each = [len(set(now[here].tolist())) for now, here in zip(laws, self.reached, strict=False)]
        largest = max((own.size for own in self.images.values()), default=0) * more**self._power
        # where those of one time are too many to be kept they are made anew at every time
        is_kept = max(each) * largest <= KEPT
        if self.moves:  # images are made at every time as it is
            images = {self._power: 1.0}
        else:
            images = {self._power: MORE_LAWS if is_kept else sum(each) / (1.0 + laws.max())}
        return sum(work * images.get(power, 1.0) * more**power for power, work in self.parts.items())

    @property
    def _power(self) -> float:
        """The power with which work of images grows: each vertex and cell sees what is near along each axis."""
        return 1.0 + 1.0 / len(self.edges)

    @property
    def wanted(self) -> FloatArray:
        """How many times as many cells each axis (d,) should have: what is charged falls with the square of them."""
        share = (self.bent / np.exp(np.log(self.bent).mean())) ** ADJUSTED
        return np.clip(np.where(np.isfinite(share), share, 1.0), *MOST_ADJUSTED)

    def count(self, work: float, power: float = 1.0) -> None:
        """Count work, which grows with a power of the vertices; raise BrokenOff where what was found has to do."""
        self.parts[power] = self.parts.get(power, 0.0) + work
        self.work.count(work)
        if self.work.is_broken_off():
            raise BrokenOff

    def __post_init__(self) -> None:
        super().__post_init__()
        self.parts = dict[float, float]()  # work by the power with which it grows
        # which node of disturbances is worst at each vertex, at times and in automaton states that are looked at
        self.worst = dict[tuple[int, int], NDArray[np.int64]]()
        self.bent = np.full(len(self.edges), 1e-300)  # what is charged along each axis where values are high

    def image_of(self, inputs: FloatArray, t: int) -> Images | LatticeImages:
        """Return where inputs (V, m) lead at a time."""
        images = super().image_of(inputs, t)
        self.count(WEIGHT * images.size, self._power)
        return images

    def below(self, W: FloatArray, images: Images | LatticeImages) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return numbers at vertices of a function that is at most F, and the cells on which it is 0."""
        if not W.any():
            return np.zeros([n + 1 for n in self.shape]), np.ones(self.shape, dtype=bool)
        self._count_bounds(images)
        values, nothing = super().below(W, images)
        self._add_bends(np.where(nothing, 0.0, self._corner_means(values)))
        return values, nothing

    def measure(self, W: FloatArray, means: FloatArray, images: Images | LatticeImages) -> None:
        """Look at what would be charged if numbers of which nothing was charged were bounds, as means (V,) are."""
        self._count_bounds(images)
        self.charge(W, images)
        self._add_bends(self._corner_means(means))

    def _count_bounds(self, images: Images | LatticeImages) -> None:
        self.count(ONCE, 0.0)
        self.count(PRODUCT * images.work(), PAIRS if isinstance(images, Images) else ON_LATTICE)

    def _corner_means(self, values: FloatArray) -> FloatArray:
        return np.asarray(corners_of(values, len(self.shape)).reshape(*self.shape, -1).mean(axis=-1))

    def _add_bends(self, weights: FloatArray) -> None:
        self.bent = self.bent + self._bends @ weights.ravel()

    def charge(self, W: FloatArray, images: Images | LatticeImages) -> tuple[FloatArray, FloatArray]:
        """Return what is taken off all corners of each cell (S,), and what F may bend along each axis (d, S)."""
        always, self._bends = super().charge(W, images)
        return always, self._bends
