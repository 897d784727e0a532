"""Boxes around means, read off expressions (docs/theory/boxes.md, "Boxes of expressions").

From every state of a cell, under every disturbance, the mean lies in the box of ``expressions.enclosed``. Cells may be
cut into parts first, whose boxes are united: that is tighter where dynamics bend strongly inside a cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from ....envs.systems.agents import AnyAgent
from ....envs.systems.expressions import Affine, Interval, enclosed
from ..grids import FloatArray


@dataclass(frozen=True, eq=False)
class SymbolicMeans:
    """Boxes around the means of an agent, over all its disturbances.

    Parameters
    ----------
    agent : AnyAgent
    parts : int
        Parts into which cells are cut along each axis.
    """

    agent: AnyAgent
    parts: int

    def scales(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return ends (n, A, d) of what the noise is multiplied with in the closed cells, for every choice.

        They are not numbers where nothing is known; None where the noise is the same everywhere.
        """
        if self.agent.noise_scale is None:
            return None
        shape = (len(low), len(input_set), self.agent.n_states)
        first, last = np.full(shape, np.inf), np.full(shape, -np.inf)
        for box in self.cut(low, high):
            ends = enclosed(self.agent.scale_trees, self._names(input_set), self.variables(box))
            for k, (below, above) in enumerate(ends):
                first[..., k] = np.minimum(first[..., k], below)
                last[..., k] = np.maximum(last[..., k], above)
        return first, last

    def around(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the corners (n, A, d) of boxes around the means from the closed cells ``[low, high]``, (n, d) each.

        They are not numbers where nothing is known of the mean.
        """
        shape = (len(low), len(input_set), self.agent.n_states)
        first, last = np.full(shape, np.inf), np.full(shape, -np.inf)
        for box in self.cut(low, high):
            for axis, (below, above) in enumerate(
                enclosed(self.agent.trees, self._names(input_set), self.variables(box))
            ):
                # minimum and maximum keep what is not a number
                np.minimum(first[..., axis], below, out=first[..., axis])
                np.maximum(last[..., axis], above, out=last[..., axis])
        return first, last

    def cut(self, low: FloatArray, high: FloatArray) -> Iterator[list[Interval]]:
        """Yield the parts of cells as boxes of (n, 1) intervals."""
        # Neighbouring parts share the numbers that are their ends, so that nothing is left out between them.
        cuts = [low + (high - low) * (k / self.parts) for k in range(self.parts)] + [high]
        for part in product(range(self.parts), repeat=low.shape[1]):
            yield [(cuts[k][:, axis, None], cuts[k + 1][:, axis, None]) for axis, k in enumerate(part)]

    def variables(self, box: list[Interval]) -> list[Interval]:
        """Return all variables: the axes of the cell, and disturbances and neighbours, anything in their intervals."""
        one = np.ones((1, 1))
        return [*box, *((low * one, high * one) for low, high in self.agent.unknowns.values())]

    def _names(self, input_set: FloatArray) -> dict[str, Affine]:
        """Return what states, inputs and disturbances are in the variables."""
        one, names = np.ones((1, 1)), {}
        for k, state in enumerate(self.agent.states):
            names[state] = Affine(np.zeros((1, 1)), {k: one})
        for name, column in zip(self.agent.inputs, input_set.T, strict=True):
            names[name] = Affine(column[None])
        for k, name in enumerate(self.agent.unknowns, start=self.agent.n_states):
            names[name] = Affine(np.zeros((1, 1)), {k: one})
        return names

    @property
    def description(self) -> dict[str, Any]:
        """What files hold of it."""
        return {} if self.agent.is_affine else {"parts": self.parts}

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that boxes depend on, for comparing relations."""
        texts = (np.frombuffer(text, dtype=np.uint8) for text in self.agent.motion_key)
        return (*texts, np.array([self.parts]))
