"""Boxes around the means of agents with expressions that a network moves.

What the network answers on a part of a cell is enclosed first (``network_bounds``): an interval for each input. The
expressions are then enclosed with inputs as disturbances in these intervals, on the same part (docs/theory/networks.md,
"Expressions").
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ....envs.systems.expressions import Interval
from ..grids import FloatArray
from .coordinates import Unsteered
from .network_bounds import mean_bounds
from .networks import NetworkPolicy
from .symbolic_means import SymbolicMeans


@dataclass(frozen=True, eq=False)
class DrivenMeans(Unsteered):
    """Boxes around the means of an agent with expressions under the modes of a network, and under inputs of a menu.

    The first choices are the modes (``NetworkPolicy``), and their inputs in the menu stand for nothing.

    Parameters
    ----------
    written : WrittenMeans
        Boxes under the inputs of the menu; nothing steers.
    policy : NetworkPolicy
    """

    written: SymbolicMeans
    policy: NetworkPolicy

    @property
    def network(self) -> NetworkPolicy:
        """The network."""
        return self.policy

    @cached_property
    def driven(self) -> SymbolicMeans:
        """Boxes around the means with every input anywhere in its box, but for a clock."""
        agent = self.written.agent.driven
        return SymbolicMeans(agent, self.written.coordinates, self.written.parts)

    def around(
        self, low: FloatArray, high: FloatArray, input_set: FloatArray, gains: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the corners (n, A, d) of boxes around the means from the closed cells ``[low, high]``, (n, d) each."""
        modes = self.policy.n_modes
        first, last = self._of_modes(low, high)
        if len(input_set) == modes:
            return first, last
        ends = self.written.of_menu(low, high, input_set[modes:])
        return np.concatenate([first, ends[0]], axis=1), np.concatenate([last, ends[1]], axis=1)

    def _of_modes(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the corners (n, modes, d) under the network."""
        shape = (len(low), self.policy.n_modes, self.written.agent.n_states)
        first, last = np.full(shape, np.inf), np.full(shape, -np.inf)
        clock = self._clock(self.policy.idle_menu)
        for part in self.driven.cut(low, high):
            variables = self._variables(part)
            for axis, (below, above) in enumerate(self.driven.enclosing(variables, clock)):
                # minimum and maximum keep what is not a number
                np.minimum(first[..., axis], below, out=first[..., axis])
                np.maximum(last[..., axis], above, out=last[..., axis])
        return self.written.widened(first, last)

    def _clock(self, input_set: FloatArray) -> FloatArray:
        """Return what is an input of an agent that is driven, under a menu (A, m): its clock, or one that is idle."""
        return input_set[:, -1:] if self.policy.has_clock else np.zeros((1, 1))

    def _variables(self, part: list[Interval]) -> list[Interval]:
        """Return all variables on parts of cells: axes, and what is unknown, the inputs (n, modes) among it."""
        agent, m = self.written.agent, self.policy.input_box.dimension
        corners = tuple(np.concatenate([ends[side] for ends in part], axis=1) for side in (0, 1))
        moves = np.zeros((m, agent.n_states)), np.eye(m), np.zeros(m)
        least, most = mean_bounds(self.policy, moves, self.written.coordinates, (corners[0], corners[1]), 1)
        variables = self.driven.variables(part)
        places = {name: k for k, name in enumerate(self.driven.agent.unknowns, start=agent.n_states)}
        for j, name in enumerate(agent.inputs[:m]):
            # What is deployed is cut to the box.
            box = float(agent.input_low[j]), float(agent.input_high[j])
            variables[places[name]] = np.clip(least[..., j], *box), np.clip(most[..., j], *box)
        return variables

    def scales(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return ends (n, A, d) of what the noise is multiplied with, whatever the inputs are."""
        found = self.driven.scales(low, high, self._clock(input_set))
        if found is None:
            return None
        shape = (len(low), len(input_set), self.written.agent.n_states)
        return np.broadcast_to(found[0], shape), np.broadcast_to(found[1], shape)

    @property
    def description(self) -> dict[str, Any]:
        """What files hold of it."""
        return {**self.written.description, "network": self.policy.description}

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that boxes depend on, for comparing relations."""
        return (*self.written.arrays, *self.policy.arrays)
