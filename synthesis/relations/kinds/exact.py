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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent, LinearAgent, with_expressions
from ....envs.systems.arguments import counted
from ..grids import FloatArray, Grid, RelationRefused, linear_agent
from .cell_relation import ReadsCells
from .inverse_means import SymbolicTargets, symbolic_targets
from .rounding import sizes_of, target_loss, target_rounding
from .rows import Row, product, rows_of, times

INPUT_MARGIN = 1e-12
"""Relative reserve on inputs that keeps a computed input inside its box in spite of rounding; always restrictive."""


@dataclass(frozen=True, eq=False, repr=False)
class ExactRelation(ReadsCells):
    """Target-mean interface of an agent with full-row-rank ``B`` (exact relation: delta = 0, epsilon = half a cell).

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
    rounding : (m,) array
        Upper bounds on the rounding of an input.
    """

    A: FloatArray
    B: FloatArray
    right_inverse: FloatArray
    drift: FloatArray
    input_centre: FloatArray
    input_half_width: FloatArray
    rounding: FloatArray

    kind = "exact"
    delta = 0.0

    def __repr__(self) -> str:
        d, m = self.B.shape
        return f"ExactRelation({counted(d, 'state')}, {counted(m, 'input')}, delta 0)"

    def means(self, cells: FloatArray) -> FloatArray:
        """Return the means (S, d) reached from the points (S, d) under the central input, up to rounding."""
        return cells @ self.A.T + self.drift

    def reserve(self, half_widths: FloatArray) -> FloatArray:
        """Return lower bounds (S, m) on the input half widths left for the target; negative if nothing is left.

        What is taken off lets the input cancel ``A x`` for every x of a cell with ``half_widths`` (S, d).
        """
        need = half_widths @ np.abs(self.right_inverse @ self.A).T
        scale = np.abs(self.input_centre) + self.input_half_width
        return self.input_half_width - need * (1 + INPUT_MARGIN) - INPUT_MARGIN * (scale + need) - self.rounding

    def on(self, grid: Grid) -> ExactOnCells:
        """Return which targets inputs reach from the cells of a grid."""
        return ExactOnCells(self, self.means(grid.centres), self.reserve(grid.half_widths))

    def describe(self) -> dict[str, Any]:
        """Return the description that files hold."""
        return {"kind": "exact"}

    def rounding_loss(self, agent: AnyAgent, edges: Sequence[FloatArray]) -> float:
        """Return an upper bound on what carrying the relation out in floating point costs per step, a probability."""
        sizes = sizes_of(linear_agent(agent, self.kind))
        return target_loss(sizes, self.right_inverse, self.drift, self.input_centre)

    @cached_property
    def is_box(self) -> bool:
        """Whether the admissible targets of a cell are a box (scaled permutation)."""
        used = self.right_inverse != 0
        return bool(np.all(used.sum(axis=1) <= 1) and np.all(used.sum(axis=0) == 1))

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
        )

    @property
    def matrices(self) -> tuple[Any, FloatArray]:
        """Itself, and no inputs."""
        return self, np.zeros((0, 0))

    def mean_targets(self, targets: FloatArray) -> FloatArray:
        """Return target means (d, ...) less the drift, as ``inputs`` takes them."""
        return np.asarray(targets - self.drift.reshape(-1, *[1] * (targets.ndim - 1)))

    def inputs(
        self, mean_targets: Sequence[FloatArray] | FloatArray, states: FloatArray, beside: FloatArray | None = None
    ) -> FloatArray:
        """Return the inputs (m, ...) that put the mean of the next state on targets, from ``states`` (d, ...).

        They are ``B^+ (mean_targets - A x) + u_mid``; linear agents name nobody who is ``beside``.
        """
        dynamics, inverse, centres = self._rows
        gaps = [mean_target - times(row, states) for mean_target, row in zip(mean_targets, dynamics, strict=True)]
        inputs = product(inverse, gaps)
        for component, centre in zip(inputs, centres, strict=True):
            component += centre
        return inputs

    @cached_property
    def _rows(self) -> tuple[tuple[Row, ...], tuple[Row, ...], list[float]]:
        """A, B^+ and u_mid as plain numbers: arrays are multiplied by these faster than by numbers of numpy."""
        return rows_of(self.A), rows_of(self.right_inverse), self.input_centre.tolist()


@dataclass(frozen=True, eq=False)
class ExactOnCells:
    """Targets that inputs reach from cells under the exact relation of matrices.

    Parameters
    ----------
    relation : ExactRelation
    means : (S, d) array
        Means from the centres of cells under the central input.
    reserve : (S, m) array
        Input half widths left for the target; negative if nothing is left.
    """

    relation: ExactRelation
    means: FloatArray
    reserve: FloatArray

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which cells (S,) leave something to targets."""
        return np.asarray(np.all(self.reserve > 0.0, axis=1))

    @property
    def reach(self) -> FloatArray:
        """How far (S, d) targets may be from these means."""
        return np.asarray(np.maximum(self.reserve, 0.0) @ np.abs(self.relation.B).T)

    @property
    def farthest(self) -> tuple[FloatArray, FloatArray]:
        """Means (n, d), and how far (d,) inputs move them at most."""
        return self.means, np.abs(self.relation.B) @ self.relation.input_half_width

    def fits(self, cells: NDArray[Any], targets: FloatArray) -> NDArray[np.bool_]:
        """Return whether targets (.., d) are reached from all of cells (..); the two broadcast."""
        wanted = np.abs((targets - self.means[cells]) @ self.relation.right_inverse.T)
        return np.asarray(np.all(wanted <= self.reserve[cells], axis=-1))

    def leaves(self, share: float) -> bool:
        """Return whether every cell leaves this share of all inputs for the target."""
        return bool(np.all(self.reserve >= share * self.relation.input_half_width))


def exact_relation(agent: LinearAgent) -> ExactRelation:
    """Return the exact relation of an agent.

    Raises
    ------
    ValueError
        If ``B`` does not have full row rank: no input then reaches an arbitrary mean.
    """
    sizes, box = sizes_of(agent), agent.input_box
    # Units do not matter: states are measured by the workspace, inputs by their box.
    state_unit, input_unit = sizes.states, np.maximum(box.half_width, np.finfo(float).tiny)
    scaled = agent.B * input_unit / state_unit[:, None]
    rank = np.linalg.matrix_rank(scaled)
    if rank < agent.n_states:
        raise RelationRefused(
            f"agent `{agent.name}`: the exact relation needs `B` with full row rank {agent.n_states}, "
            f"got a {agent.B.shape[0]} x {agent.B.shape[1]} matrix of rank {rank}; "
            "give the agent as many independent inputs as states"
        )
    # The smaller half of the box on either side of the rounded centre: never beyond the box.
    centre = 0.5 * (box.low + box.high)
    half = np.minimum(box.high - centre, centre - box.low)
    right_inverse = _right_inverse(scaled) * input_unit[:, None] / state_unit
    return ExactRelation(
        A=agent.A,
        B=agent.B,
        right_inverse=right_inverse,
        drift=agent.offset + agent.B @ centre,
        input_centre=centre,
        input_half_width=half,
        rounding=target_rounding(sizes, right_inverse, centre),
    )


def _right_inverse(matrix: FloatArray) -> FloatArray:
    """Return a right inverse; that of a scaled permutation has its zeros, by which it is recognised."""
    used = matrix != 0
    if np.all(used.sum(axis=1) == 1) and np.all(used.sum(axis=0) <= 1):
        return np.divide(1.0, matrix, out=np.zeros(matrix.shape), where=used).T
    return np.linalg.pinv(matrix)


def aimed_relation(agent: AnyAgent) -> ExactRelation | SymbolicTargets:
    """Return the exact relation of an agent, or refuse it in words."""
    if agent.is_affine:
        return exact_relation(linear_agent(agent, "exact"))
    return symbolic_targets(with_expressions(agent))
