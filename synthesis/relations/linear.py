"""The linear relation: means that are affine in each cell, values that are multilinear in it.

A choice in a cell with centre c is an affine map ``m(x) = z + G (x - c)`` for the mean of the next state. Values are
kept at the corners of cells, so that what is lost is of second order in the size of a cell (docs/theory/linear.md).

Agents whose inputs reach every mean (full-row-rank ``B``) choose a lattice point z and a gain, ``G = 0`` (relation
``exact``) or ``G = I``; the input ``u_mid + B^+ (z + G (x - c) - A x - c_0 - B u_mid)`` puts the mean there. All other
agents choose an input; its mean from x is ``A x + B u + c_0``, affine with ``G = A``, and nothing is kept in reserve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...envs.agents import AnyAgent, LinearAgent, counted
from ..cells import FloatArray, RelationRefused, in_grid_coordinates, linear_agent
from .coordinates import ReadsCoordinates
from .exact import ExactRelation, exact_relation
from .rounding import mean_loss

CARRIED_OUT_TWICE = 2.0
"""Factor on the rounding of a target: the centre of a cell and the gain enter it as well."""


@dataclass(frozen=True, eq=False, repr=False)
class LinearRelation(ReadsCoordinates):
    """Affine maps from the state to the mean of the next state, in grid coordinates (delta = 0, no memory).

    Parameters
    ----------
    A, B : (d, d), (d, m) arrays
        Dynamics.
    offset : (d,) array
        Mean from the origin under the input 0.
    coordinates : (d, d) array
        Grid coordinates to state.
    steers : tuple of ExactRelation
        Interfaces of the gains 0 and 1; empty for agents whose inputs do not reach every mean.
    menu : (A, m) array
        Inputs of such agents; empty for all others.
    parts : int
        Parts of each side of a cell at whose ends the value on its image is read, to see how it bends.
    """

    A: FloatArray
    B: FloatArray
    offset: FloatArray
    coordinates: FloatArray
    steers: tuple[ExactRelation, ...]
    menu: FloatArray
    parts: int = 2

    kind = "linear"
    delta = 0.0

    def __repr__(self) -> str:
        d, m = self.B.shape
        choices = "target means" if self.steers else counted(len(self.menu), "choice")
        return f"LinearRelation({counted(d, 'state')}, {counted(m, 'input')}, {choices}, delta 0)"

    def describe(self) -> dict[str, Any]:
        """Return the description that files hold."""
        return {"kind": "linear", "menu": self.menu.tolist(), "parts": self.parts}

    @property
    def gains(self) -> FloatArray:
        """Gain matrices (g, d, d) of the choices."""
        if not self.steers:
            return self.A[None]
        return np.stack([steer.gain * np.eye(len(self.A)) for steer in self.steers])

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All matrices, for comparing relations."""
        of_steers = [array for steer in self.steers for array in (*steer.arrays, np.array([steer.gain]))]
        return (self.A, self.B, self.offset, self.coordinates, self.menu, np.array([self.parts]), *of_steers)

    def execution_loss(self, agent: AnyAgent, edges: Sequence[FloatArray]) -> float:
        """Return an upper bound on what carrying the relation out in floating point costs per step, a probability."""
        if self.steers:
            return CARRIED_OUT_TWICE * self.steers[0].execution_loss(agent, edges)
        return mean_loss(linear_agent(agent, self.kind), self.coordinates, edges)


def linear_relation(
    agent: LinearAgent, coordinates: FloatArray, menu: FloatArray | None = None, parts: int = 2
) -> LinearRelation:
    """Return the linear relation of an agent in the given grid coordinates.

    Parameters
    ----------
    agent : LinearAgent
    coordinates : (d, d) array
    menu : (A, m) array, optional
        Inputs to choose from; by default targets are chosen, which needs ``B`` of full row rank.
    parts : int
        See ``LinearRelation``.

    Raises
    ------
    ValueError
        If targets are to be chosen and ``B`` does not have full row rank, or if an input is outside its box.
    """
    moves = in_grid_coordinates(agent, coordinates)
    steers: tuple[ExactRelation, ...] = ()
    if menu is None:
        exact = exact_relation(agent, coordinates)
        steers, menu = (exact, replace(exact, gain=1.0)), np.zeros((0, agent.n_inputs))
    else:
        box = agent.input_box
        if not len(menu) or not np.all((box.low <= menu) & (menu <= box.high)):
            raise RelationRefused(f"agent `{agent.name}`: the linear relation needs inputs inside their box")
    return LinearRelation(moves.A, moves.B, moves.offset, coordinates, steers, menu, parts)
