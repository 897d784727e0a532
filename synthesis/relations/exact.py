"""The exact relation: every mean can be commanded, and the cell process is a Markov chain.

When ``B`` has full row rank, the abstract input is the *target mean* z. From any x of a cell the controller applies

    u = u_mid + B^+ (z - A x - c - B u_mid),        so that        x' = z + w,

whatever x was: the cell process is a Markov chain and delta = 0 (docs/theory/relations.md, "The exact relation"). The
price is the input reserve. The input must be admissible for every x of the cell, which leaves to a cell with centre m
and half widths h the targets with

    | B^+ (z - A m - c - B u_mid) |_j  <=  (half-width of U)_j - (|B^+ A| h)_j .
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...envs.agents import LinearAgent, counted
from ..cells import FloatArray, RelationRefused, in_grid_coordinates
from .rows import Row, product, rows_of, times

INPUT_MARGIN = 1e-12
"""Relative reserve on inputs that keeps a computed input inside its box in spite of rounding; always restrictive."""


@dataclass(frozen=True, eq=False, repr=False)
class ExactRelation:
    """Target-mean interface of an agent with full-row-rank ``B`` (exact relation: delta = 0, epsilon = half a cell).

    All matrices are in grid coordinates ``x_grid`` with ``x = coordinates @ x_grid``.

    Parameters
    ----------
    A, B : (d, d), (d, m) arrays
        Dynamics.
    right_inverse : (m, d) array
        ``B^+`` with ``B B^+ = I``.
    drift : (d,) array
        ``c + B u_mid``, the mean from the origin under the central input.
    input_centre, input_half_width : (m,) arrays
        Input box.
    coordinates : (d, d) array
        Grid coordinates to state.
    """

    A: FloatArray
    B: FloatArray
    right_inverse: FloatArray
    drift: FloatArray
    input_centre: FloatArray
    input_half_width: FloatArray
    coordinates: FloatArray

    kind = "exact"
    delta = 0.0

    def __repr__(self) -> str:
        d, m = self.B.shape
        rotated = "" if self.has_state_coordinates else ", coordinates of its noise"
        return f"ExactRelation({counted(d, 'state')}, {counted(m, 'input')}, delta 0{rotated})"

    def means(self, cells: FloatArray) -> FloatArray:
        """Return the means (S, d) reached from the points (S, d) under the central input, up to rounding."""
        return cells @ self.A.T + self.drift

    def reserve(self, half_widths: FloatArray) -> FloatArray:
        """Return lower bounds (S, m) on the input half widths left for the target; negative if nothing is left.

        What is taken off lets the input cancel ``A x`` for every x of a cell with ``half_widths`` (S, d).
        """
        need = half_widths @ np.abs(self.right_inverse @ self.A).T
        scale = np.abs(self.input_centre) + self.input_half_width
        return self.input_half_width - need * (1 + INPUT_MARGIN) - INPUT_MARGIN * (scale + need)

    @cached_property
    def is_box(self) -> bool:
        """Whether the admissible targets of a cell are a box in grid coordinates (scaled permutation)."""
        used = self.right_inverse != 0
        return bool(np.all(used.sum(axis=1) <= 1) and np.all(used.sum(axis=0) == 1))

    def to_grid(self, states: FloatArray) -> FloatArray:
        """Return the grid coordinates (d, ...) of states (d, ...) as a new array."""
        if self.has_state_coordinates:
            return np.array(states, dtype=float)
        return product(rows_of(np.linalg.inv(self.coordinates)), states)

    @property
    def has_state_coordinates(self) -> bool:
        """Whether grid coordinates are the state itself."""
        return bool(np.array_equal(self.coordinates, np.eye(len(self.coordinates))))

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All matrices, for comparing relations."""
        return (
            self.A,
            self.B,
            self.right_inverse,
            self.drift,
            self.input_centre,
            self.input_half_width,
            self.coordinates,
        )

    def aims(self, targets: FloatArray) -> FloatArray:
        """Return target means (d, ...) less the drift, as ``inputs`` takes them."""
        return np.asarray(targets - self.drift.reshape(-1, *[1] * (targets.ndim - 1)))

    def inputs(self, aims: Sequence[FloatArray] | FloatArray, states: FloatArray) -> FloatArray:
        """Return the inputs (m, ...) that put the mean of the next grid state on targets, from ``states`` (d, ...).

        They are ``B^+ (aims - A x) + u_mid``.
        """
        dynamics, inverse, centres = self._rows
        gaps = [aim - times(row, states) for aim, row in zip(aims, dynamics, strict=True)]
        inputs = product(inverse, gaps)
        for component, centre in zip(inputs, centres, strict=True):
            component += centre
        return inputs

    @cached_property
    def _rows(self) -> tuple[tuple[Row, ...], tuple[Row, ...], list[float]]:
        """A, B^+ and u_mid as plain numbers: arrays are multiplied by these faster than by numbers of numpy."""
        return rows_of(self.A), rows_of(self.right_inverse), self.input_centre.tolist()


def exact_relation(agent: LinearAgent, coordinates: FloatArray) -> ExactRelation:
    """Return the exact relation of an agent in the given grid coordinates.

    Raises
    ------
    ValueError
        If ``B`` does not have full row rank: no input then reaches an arbitrary mean.
    """
    if np.linalg.matrix_rank(agent.B) < agent.n_states:
        raise RelationRefused(
            f"agent `{agent.name}`: the exact relation needs `B` with full row rank {agent.n_states}, "
            f"got a {agent.B.shape[0]} x {agent.B.shape[1]} matrix of rank {np.linalg.matrix_rank(agent.B)}; "
            "give the agent as many independent inputs as states"
        )
    moves = in_grid_coordinates(agent, coordinates)
    A, B = moves.A, moves.B
    box = agent.input_box
    # The smaller half of the box on either side of the rounded centre: never beyond the box.
    centre = 0.5 * (box.low + box.high)
    half = np.minimum(box.high - centre, centre - box.low)
    return ExactRelation(
        A=_clean(A),
        B=_clean(B),
        right_inverse=_clean(np.linalg.pinv(B)),
        drift=moves.offset + B @ centre,
        input_centre=centre,
        input_half_width=half,
        coordinates=coordinates,
    )


def _clean(matrix: FloatArray) -> FloatArray:
    """Return the matrix with 0 for entries that are rounding noise next to its largest; they would blur its structure.

    A scaled permutation is recognised by its zeros.
    """
    scale = np.max(np.abs(matrix), initial=0.0)
    return np.where(np.abs(matrix) <= 1e-15 * scale, 0.0, matrix)
