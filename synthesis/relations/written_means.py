"""Boxes around the means of agents whose dynamics are expressions (docs/theory/boxes.md, "Boxes of expressions").

From every state of a cell, under every disturbance, the mean lies in the box of ``expressions.enclosed``. Cells may be
cut into parts first, whose boxes are united: that is tighter where dynamics bend strongly inside a cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from ...envs.agents import Agent
from ...envs.expressions import Affine, Interval, enclosed
from ..cells import FloatArray

ROTATED = 1e-12
"""Share of their size by which boxes are widened where grid coordinates are not the state: the inverse matrix is
rounded. The check widens by less."""


@dataclass(frozen=True, eq=False)
class WrittenMeans:
    """Boxes around the means of an agent with expressions, over all its disturbances.

    Parameters
    ----------
    agent : Agent
    coordinates : (d, d) array
        Grid coordinates to state.
    parts : int
        Parts into which cells are cut along each axis.
    """

    agent: Agent
    coordinates: FloatArray
    parts: int

    def around(
        self, low: FloatArray, high: FloatArray, menu: FloatArray, gains: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the corners (n, A, d) of boxes around the means from the closed cells ``[low, high]``, (n, d) each.

        They are not numbers where nothing is known of the mean. There are no gains.
        """
        shape = (len(low), len(menu), self.agent.n_states)
        first, last = np.full(shape, np.inf), np.full(shape, -np.inf)
        # Neighbouring parts share the numbers that are their ends, so that nothing is left out between them.
        cuts = [low + (high - low) * (k / self.parts) for k in range(self.parts)] + [high]
        for part in product(range(self.parts), repeat=shape[2]):
            box = [(cuts[k][:, axis, None], cuts[k + 1][:, axis, None]) for axis, k in enumerate(part)]
            for axis, (below, above) in enumerate(self._enclosed(box, menu)):
                # minimum and maximum keep what is not a number
                np.minimum(first[..., axis], below, out=first[..., axis])
                np.maximum(last[..., axis], above, out=last[..., axis])
        return self._widened(first, last)

    def _enclosed(self, box: list[Interval], menu: FloatArray) -> list[Interval]:
        """Return intervals (n, A) around the mean along each axis, from boxes of n cells."""
        one, names = np.ones((1, 1)), {}
        for state, row in zip(self.agent.states, self.coordinates, strict=True):
            slopes = {k: entry * one for k, entry in enumerate(row.tolist()) if entry != 0.0}
            names[state] = Affine(np.zeros((1, 1)), slopes)
        for name, column in zip(self.agent.inputs, menu.T, strict=True):
            names[name] = Affine(column[None])
        # Disturbances are variables like the axes of the cell: anything in their intervals.
        variables = list(box)
        for name, (least, most) in self.agent.disturbances.items():
            names[name] = Affine(np.zeros((1, 1)), {len(variables): one})
            variables.append((least * one, most * one))
        return enclosed(self.agent.trees, names, variables, None if self._is_plain else self._inverse)

    def _widened(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self._is_plain:
            return low, high
        size = np.maximum(np.abs(low), np.abs(high)) @ (np.abs(self._inverse) @ np.abs(self.coordinates)).T
        return low - ROTATED * size, high + ROTATED * size

    @cached_property
    def _is_plain(self) -> bool:
        return bool(np.array_equal(self.coordinates, np.eye(len(self.coordinates))))

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self.coordinates))

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that boxes depend on, for comparing relations."""
        texts = (np.frombuffer(text, dtype=np.uint8) for text in self.agent.motion_key)
        return (*texts, np.array([self.parts]))
