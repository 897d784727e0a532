"""Means under a network as an affine map of the state in each cell, and a small box around what is left.

In a mode the network lies around an affine function of the state on every cell: the linear bounds that are pulled back
from the mean (``network_bounds``) have slopes G, which are those of the closed loop, and a radius rho. So the mean from
x in a cell with centre c is

    z + G (x - c) + r,      |r_k| <= rho_k ,

which is all that linear cells of agents with expressions use (``affine_means``; docs/theory/networks.md, "Linear
cells"). rho is 0, up to rounding, where nothing bends, and of second order in the cell where the network is smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....envs.systems.agents import AnyAgent
from ..grids import FloatArray, RelationRefused, linear_agent
from .affine_means import AffineBoxes, MapRelation
from .linear_means import LinearMeans, linear_means
from .network_bounds import CELLS_AT_ONCE, OUTWARD, Form, mean_form, widening
from .networks import NetworkPolicy


@dataclass(frozen=True, eq=False)
class NetworkMaps:
    """Affine maps of a linear agent that a network moves; choices are modes (``NetworkPolicy``).

    Parameters
    ----------
    linear : LinearMeans
    policy : NetworkPolicy
    idle : tuple of int
        Automaton states that networks are told of in which nothing is left to decide: their modes are not looked at.
    """

    linear: LinearMeans
    policy: NetworkPolicy
    idle: tuple[int, ...] = ()
    cuts = 1

    @property
    def network(self) -> NetworkPolicy:
        """The network."""
        return self.policy

    def around(self, low: FloatArray, high: FloatArray, input_set: FloatArray) -> AffineBoxes:
        """Return the maps of the closed cells ``[low, high]``, (n, d) each, in all modes (outer bounds)."""
        n, d, modes = *low.shape, len(input_set)
        centre, gain = np.full((n, modes, d), np.nan), np.zeros((n, modes, d, d))
        rest = np.zeros((n, modes, d))
        for mode in range(modes):
            if mode % self.policy.view.states in self.idle:
                continue
            for start in range(0, n, CELLS_AT_ONCE):
                block = slice(start, start + CELLS_AT_ONCE)
                form = self._form(low[block], high[block], mode)
                centre[block, mode], gain[block, mode], rest[block, mode] = form.centre, form.slopes, form.radius
        return AffineBoxes(centre, gain, rest)

    def _form(self, low: FloatArray, high: FloatArray, mode: int) -> Form:
        """Return the maps of cells (n, d) in one mode as affine forms."""
        moves = (self.linear.A, self.linear.B, self.linear.offset)
        form = mean_form(self.policy, moves, (0.5 * (low + high), _half(low, high)), mode)
        rest = form.radius * (1.0 + OUTWARD) + widening(self.policy, self.linear.B)
        return Form(form.slopes, form.centre, rest + self.linear.rounding)

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that maps depend on, for comparing relations."""
        return (*self.linear.arrays, *self.policy.arrays)


def _half(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return half widths (n, d) of boxes, rounded outward."""
    centre = 0.5 * (low + high)
    return np.maximum(high - centre, centre - low) * (1.0 + 1e-12)


def network_linear_relation(
    agent: AnyAgent,
    policy: NetworkPolicy,
    parts: int,
    reach: Sequence[int],
    idle: Sequence[int] = (),
) -> MapRelation:
    """Return the relation ``linear`` of an agent that a network moves: affine maps in all modes.

    Parameters
    ----------
    agent : AnyAgent
    policy : NetworkPolicy
    parts, reach
        See ``MapRelation``.
    idle : sequence of int
        See ``NetworkMaps``.
    """
    if not agent.is_affine:
        raise RelationRefused(
            f"agent `{agent.name}`: networks on cells move agents with linear dynamics, got expressions"
        )
    linear = linear_means(linear_agent(agent, "linear"))
    return MapRelation(NetworkMaps(linear, policy, tuple(idle)), policy.idle_menu, parts, tuple(int(n) for n in reach))
