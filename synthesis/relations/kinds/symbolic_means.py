"""Boxes around the means of agents whose dynamics are expressions (docs/theory/boxes.md, "Boxes of expressions").

From every state of a cell, under every disturbance, the mean lies in the box of ``expressions.enclosed``. Cells may be
cut into parts first, whose boxes are united: that is tighter where dynamics bend strongly inside a cell.

Choices that steer put the mean along commanded axes on a target (``commands``): that which the input of the menu has at
the centre of the cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent
from ....envs.systems.expressions import Affine, Interval, enclosed, roundings
from ..grids import FloatArray
from .commands import Command, commands_of, steered_inputs, steered_trees

INNER = 4.0
"""Factor on what inner terms of expressions lose, for products of such losses; the check allows for half of it."""

COMPUTED = 1e-12
"""Share of their size by which targets may be missed, and inputs be off, as they are computed; the check allows for
less."""


@dataclass(frozen=True, eq=False)
class SymbolicMeans:
    """Boxes around the means of an agent with expressions, over all its disturbances.

    Parameters
    ----------
    agent : Agent
    parts : int
        Parts into which cells are cut along each axis.
    steer : (A,) bool array, optional
        Which choices of the menu steer; none by default.
    """

    agent: Agent
    parts: int
    steer: NDArray[np.bool_] | None = None

    def around(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the corners (n, A, d) of boxes around the means from the closed cells ``[low, high]``, (n, d) each.

        They are not numbers where nothing is known of the mean, or an input that steers is not admissible.
        """
        if self.steer is None or not np.any(self.steer):
            return self.of_menu(low, high, input_set)
        shape = (len(low), len(input_set), self.agent.n_states)
        first, last = np.empty(shape), np.empty(shape)
        first[:, ~self.steer], last[:, ~self.steer] = self.of_menu(low, high, input_set[~self.steer])
        first[:, self.steer], last[:, self.steer] = self._steered(low, high, input_set[self.steer])
        return first, last

    def scales(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return ends (n, A, d) of what the noise is multiplied with in the closed cells, for every choice.

        They are not numbers where nothing is known; None where the noise is the same everywhere.
        """
        if self.agent.noise_scale is None:
            return None
        shape = (len(low), len(input_set), self.agent.n_states)
        first, last = np.full(shape, np.inf), np.full(shape, -np.inf)
        for box in self.cut(low, high):
            # Choices that steer apply other inputs than the menu's; there are none where the scale depends on inputs.
            ends = enclosed(self.agent.scale_trees, self._names(input_set), self.variables(box))
            for k, (below, above) in enumerate(ends):
                first[..., k] = np.minimum(first[..., k], below)
                last[..., k] = np.maximum(last[..., k], above)
        return first, last

    def of_menu(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the corners for choices that apply one input in the whole cell."""
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

    def _steered(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the corners for choices that steer."""
        agent, shape = self.agent, (len(low), len(input_set), self.agent.n_states)
        centre = 0.5 * (low + high)
        at = np.broadcast_to(centre.T[:, :, None], (shape[2], *shape[:2]))
        targets = agent.mean(at, np.broadcast_to(input_set.T[:, None], (input_set.shape[1], *shape[:2])))
        names = self._names(input_set) | {c.target: Affine(targets[c.axis]) for c in self.commands}
        first, last = np.full(shape, np.inf), np.full(shape, -np.inf)
        trees = steered_trees(agent, self.commands)
        wanted = [tree for c in self.commands for tree in (c.tree, c.rest)]
        for box in self.cut(low, high):
            variables = self.variables(box)
            for axis, (below, above) in enumerate(enclosed(trees, names, variables)):
                np.minimum(first[..., axis], below, out=first[..., axis])
                np.maximum(last[..., axis], above, out=last[..., axis])
            found = enclosed(wanted, names, variables)
            for c, asked, rest in zip(self.commands, found[::2], found[1::2], strict=True):
                least, most = agent.input_low[c.input], agent.input_high[c.input]
                # Inner terms may be larger than what they add up to, and lose more.
                lost, of_factor = roundings([c.rest, c.factor], names, variables)
                [factor] = enclosed([c.factor], names, variables)
                nearest = np.minimum(np.abs(factor[0]), np.abs(factor[1]))
                missed = INNER * (lost + of_factor * max(abs(least), abs(most)))
                with np.errstate(divide="ignore", invalid="ignore"):
                    spare = COMPUTED * (abs(least) + abs(most)) + missed / nearest
                inside = (asked[0] >= least + spare) & (asked[1] <= most - spare) & (of_factor <= 0.5 * nearest)
                # The target is missed by what computing the input rounds.
                off = COMPUTED * (np.abs(targets[c.axis]) + 2.0 * np.maximum(np.abs(rest[0]), np.abs(rest[1])))
                off = off + missed
                first[..., c.axis] = np.minimum(first[..., c.axis], targets[c.axis] - off)
                last[..., c.axis] = np.maximum(last[..., c.axis], targets[c.axis] + off)
                first[~inside] = np.nan
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

    def steered(
        self,
        choices: NDArray[np.intp],
        points: FloatArray,
        centres: FloatArray,
        u: FloatArray,
        beside: FloatArray | None = None,
    ) -> FloatArray:
        """Return the inputs (m, ...) of choices (...) at points (d, ...) of cells with centres (d, ...).

        ``u`` are the inputs of the menu, ``beside`` (l, ...) the states of others that the dynamics name, if any.
        """
        if self.steer is None or not np.any(self.steer):
            return u
        return np.where(self.steer[choices], steered_inputs(self.agent, self.commands, centres, points, u, beside), u)

    @cached_property
    def commands(self) -> tuple[Command, ...]:
        """Axes that have targets."""
        return commands_of(self.agent)

    @property
    def description(self) -> dict[str, Any]:
        """What files hold of it."""
        return {"parts": self.parts, "steer": [] if self.steer is None else self.steer.tolist()}

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that boxes depend on, for comparing relations."""
        texts = (np.frombuffer(text, dtype=np.uint8) for text in self.agent.motion_key)
        steer = np.zeros(0, dtype=bool) if self.steer is None else self.steer
        return (*texts, np.array([self.parts]), steer)
