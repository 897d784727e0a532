"""The (epsilon, delta) simulation relation, in which the controller remembers the abstract state (``paper``).

Error ``e = x - xhat``, interface ``u = uhat + K e``, noise coupling ``what = w + F e``:

    e' = (A + B K - F) e + beta,      |beta| <= half a cell.

A set E with ``(A + B K - F) E + beta inside E`` gives the relation ``x - xhat in E`` (docs/theory/relations.md,
"Errors"). The file ``scalar`` says what bounds E, why it is invariant, and how likely the coupling fails.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ....envs.systems.agents import AnyAgent
from ....envs.systems.arguments import box_text, counted, tree_text
from ..grids import FloatArray, linear_agent
from .cell_relation import ReadsCells
from .rounding import COUPLING, error_rounding, missed_cells, sizes_of

FORGIVEN = 1e-12
"""Share of the set of errors by which a computed error may lie outside: rounding.

Labels and inputs allow for a set larger by ``1e-9``.
"""


COUPLED_NUMBERS = ("epsilon", "feedback", "inputs", "delta")
"""Entries of its description: numbers."""


@dataclass(frozen=True, eq=False, repr=False)
class CoupledRelation(ReadsCells):
    """Interface and coupling between an agent and its finite model.

    Parameters
    ----------
    A, B : (d, d), (d, m) arrays
    drift : (d,) array
        Affine term.
    covariance : (d,) array
        Variances of the noise along the grid axes.
    feedback, coupling : (m, d), (d, d) arrays
        K and F.
    reach : (d,) array
        Half widths of the box around E.
    state_reach : (d,) array
        Half widths of the box around E, for labels.
    delta : float
        Upper bound on the probability, per step, that the coupling fails.
    inputs : (A, m) array
        Abstract inputs uhat, all in U less K E.
    input_low, input_high : (m,) arrays
        Input box.
    is_cell : bool
        Whether related states lie in the same cell.
    """

    A: FloatArray
    B: FloatArray
    drift: FloatArray
    covariance: FloatArray
    feedback: FloatArray
    coupling: FloatArray
    reach: FloatArray
    state_reach: FloatArray
    delta: float
    inputs: FloatArray
    input_low: FloatArray
    input_high: FloatArray
    is_cell: bool = False

    def __repr__(self) -> str:
        d, m = self.B.shape
        rows = [
            ("errors", f"within {box_text(-self.state_reach, self.state_reach)} of a cell's centre"),
            ("inputs", f"{len(self.inputs)} of {box_text(self.inputs.min(axis=0), self.inputs.max(axis=0))}"),
            ("delta", f"at most {self.delta:.3g} per step"),
        ]
        return tree_text(f"CoupledRelation: {counted(d, 'state')}, {counted(m, 'input')}", rows)

    kind = "paper"
    has_memory = True

    def describe(self) -> dict[str, Any]:
        """Return the description that files hold."""
        return {
            "kind": "paper",
            "epsilon": float(self.reach[0]),
            "feedback": float(self.feedback[0, 0]),
            "inputs": len(self.inputs),
            "delta": self.delta,
        }

    def nearest_choices(self, other: CoupledRelation) -> NDArray[np.intp]:
        """Return the abstract input that is nearest to each one (A',) of another relation of the agent."""
        apart = other.inputs[:, None] - self.inputs[None]
        return np.argmin(np.sum(apart**2, axis=2), axis=1)

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All numbers, for comparing relations."""
        return (
            self.A,
            self.B,
            self.drift,
            self.covariance,
            self.feedback,
            self.coupling,
            self.reach,
            self.inputs,
            self.input_low,
            self.input_high,
            np.array([self.delta]),
        )

    def rounding_loss(self, agent: AnyAgent, edges: Sequence[FloatArray]) -> float:
        """Return an upper bound on what carrying the relation out in floating point costs per step, a probability."""
        sizes = sizes_of(linear_agent(agent, self.kind))
        off = error_rounding(sizes, self.feedback, self.coupling)
        if self.is_cell:  # what is left of the error where both land in one cell
            off = off + np.abs(self.A + self.B @ self.feedback - self.coupling) @ self.reach
        return missed_cells(sizes.deviations, off, edges) + (COUPLING if np.any(self.coupling) else 0.0)

    def means(self, centres: FloatArray) -> FloatArray:
        """Return the means (S, A, d) of the abstract successors of each cell centre (S, d) under each input."""
        return (centres @ self.A.T + self.drift)[:, None, :] + (self.inputs @ self.B.T)[None]

    def related(self, error: FloatArray) -> NDArray[np.bool_]:
        """Return whether errors (d, ...) lie in the box around E, which is E for scalar agents.

        The last digits are forgiven (``FORGIVEN``).
        """
        result = np.ones(error.shape[1:], dtype=bool)
        for component, reach in zip(error, (self.reach * (1 + FORGIVEN)).tolist(), strict=True):
            result &= np.abs(component) <= reach
        return result


def coupling_failure(distance: float) -> float:
    """Return an upper bound on the total variation distance of two standard normals with means ``distance`` apart.

    It is ``2 Phi(distance / 2) - 1``, rounded up.

    Examples
    --------
    >>> round(coupling_failure(0.005), 7)
    0.0019947
    """
    if distance == 0.0:
        return 0.0
    return min(1.0, (1.0 - 2.0 * float(ndtr(-0.5 * distance))) * (1 + 1e-12) + 1e-15)


def couple(whitened: FloatArray, move: FloatArray, uniform: FloatArray) -> FloatArray:
    """Return standard normal noise (d, ...) of the abstract system, equal to ``whitened + move`` as often as possible.

    Maximal coupling by reflection: ``whitened + move`` is accepted with probability ``min(1, phi(whitened + move) /
    phi(whitened))``, otherwise the noise is mirrored at 0 along ``move`` (docs/theory/relations.md, "Maximal
    coupling").
    """
    # log(phi(w + v) / phi(w)) = -(w'v + v'v / 2), summed component by component.
    along, length = whitened[0] * move[0], move[0] * move[0]
    for noise_component, move_component in zip(whitened[1:], move[1:], strict=True):
        along += noise_component * move_component
        length += move_component * move_component
    length *= 0.5
    result, rejected = whitened + move, np.flatnonzero(~(uniform <= np.exp(-(along + length))))
    # Reflect the rejected ones, few as a rule: w - 2 v (v'w) / (v'v).
    if len(rejected):
        noise, by = (array.reshape(len(array), -1).take(rejected, axis=1) for array in (whitened, move))
        squared = 2.0 * length.take(rejected)
        share = along.take(rejected) / np.where(squared > 0, squared, 1.0)
        result.reshape(len(result), -1)[:, rejected] = noise - 2.0 * by * share
    return result


def joint_delta(deltas: Sequence[float]) -> float:
    """Return an upper bound on the probability, per step, that any agent's relation is lost.

    It is ``1 - prod(1 - delta_i)``, computed without cancellation and rounded up (docs/theory/relations.md, "Many
    agents").

    Examples
    --------
    >>> round(joint_delta([0.002, 0.002]), 6)
    0.003996
    """
    if max(deltas) >= 1.0:
        return 1.0
    total = -math.expm1(sum(math.log1p(-delta) for delta in deltas))
    return min(1.0, total * (1 + 1e-14 * (len(deltas) + 4)))
