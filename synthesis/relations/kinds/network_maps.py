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
from itertools import product

import numpy as np

from ....envs.systems.agents import AnyAgent
from ..grids import FloatArray, RelationRefused, linear_agent
from .affine_means import AffineBoxes, MapRelation
from .boxes import LinearMeans, linear_means
from .network_bounds import CELLS_AT_ONCE, OUTWARD, Form, mean_form, widening
from .networks import NetworkPolicy

OUTWARD_OF_PARTS = 1e-8
"""Widening where cells are cut, as a share of their width: whatever single precision is off by (about 1e-7) enters the
ends of every part, and the check, which rounds otherwise, must find its ends inside these."""


@dataclass(frozen=True, eq=False)
class NetworkMaps:
    """Affine maps of a linear agent that a network moves; choices are modes (``NetworkPolicy``).

    Parameters
    ----------
    linear : LinearMeans
    policy : NetworkPolicy
    cuts : int
        Parts into which cells are cut along each axis to enclose what the maps leave.
    idle : tuple of int
        Automaton states that networks are told of in which nothing is left to decide: their modes are not looked at.
    """

    linear: LinearMeans
    policy: NetworkPolicy
    cuts: int
    idle: tuple[int, ...] = ()

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
        whole = self._bounds(low, high, mode)
        first, last = -whole.radius, whole.radius
        if self.cuts > 1:
            # The slopes are those of the whole cell. On a part the network is closer to a line, though to another one.
            first, last = np.full(low.shape, np.inf), np.full(low.shape, -np.inf)
            middle = 0.5 * (low + high)
            ends = [low + (high - low) * (k / self.cuts) for k in range(self.cuts)] + [high]
            for part in product(range(self.cuts), repeat=low.shape[1]):
                left = np.stack([ends[k][:, axis] for axis, k in enumerate(part)], axis=1)
                right = np.stack([ends[k + 1][:, axis] for axis, k in enumerate(part)], axis=1)
                of_part = self._bounds(left, right, mode)
                away = np.einsum("nkj,nj->nk", whole.slopes, 0.5 * (left + right) - middle)
                offset = of_part.centre - whole.centre - away
                left_over = Form(of_part.slopes - whole.slopes, offset, of_part.radius).ends(_half(left, right))
                np.minimum(first, left_over[0], out=first)
                np.maximum(last, left_over[1], out=last)
            # Either enclosure holds.
            first, last = np.maximum(first, -whole.radius), np.minimum(last, whole.radius)
        moved = 0.5 * (first + last)
        rest = np.maximum(last - moved, moved - first) * (1.0 + OUTWARD) + widening(self.policy, self.linear.B)
        if self.cuts > 1:
            rest += OUTWARD_OF_PARTS * np.max(high - low, axis=1, keepdims=True)
        return Form(whole.slopes, whole.centre + moved, rest + self.linear.rounding)

    def _bounds(self, low: FloatArray, high: FloatArray, mode: int) -> Form:
        """Return affine forms of the means from boxes (n, d) around their middles."""
        moves = (self.linear.A, self.linear.B, self.linear.offset)
        return mean_form(self.policy, moves, (0.5 * (low + high), _half(low, high)), mode)

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that maps depend on, for comparing relations."""
        return (*self.linear.arrays, *self.policy.arrays, np.array([self.cuts]))


def _half(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return half widths (n, d) of boxes, rounded outward."""
    centre = 0.5 * (low + high)
    return np.maximum(high - centre, centre - low) * (1.0 + 1e-12)


def network_linear_relation(
    agent: AnyAgent,
    policy: NetworkPolicy,
    numbers: tuple[int, int, Sequence[int]],
    idle: Sequence[int] = (),
) -> MapRelation:
    """Return the relation ``linear`` of an agent that a network moves: affine maps in all modes.

    Parameters
    ----------
    agent : AnyAgent
    policy : NetworkPolicy
    numbers : parts, cuts and reach
        See ``MapRelation`` and ``NetworkMaps``.
    idle : sequence of int
        See ``NetworkMaps``.
    """
    parts, cuts, reach = numbers
    if not agent.is_affine:
        raise RelationRefused(
            f"agent `{agent.name}`: networks on cells move agents with linear dynamics, got expressions"
        )
    linear = linear_means(linear_agent(agent, "linear"))
    return MapRelation(
        NetworkMaps(linear, policy, cuts, tuple(idle)), policy.idle_menu, parts, tuple(int(n) for n in reach)
    )
