"""What floating point takes from a relation that is carried out (docs/theory/numerics.md, "Controllers").

A controller computes its inputs from matrices of its own, in double precision, and a coupled one its abstract state
from the states that it sees. Relations leave room for the rounding of inputs and errors, and bounds take off a
probability for means and cells that are missed. All of it is a few units in the last place of the largest numbers on
the way, whatever the units of states and inputs are; it is noticed only where a small noise stands beside large
numbers.

The check measures the same with code of its own (``steps.execution``). It counts fewer operations, and so finds
less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from ....envs.systems.agents import AnyAgent, LinearAgent
from ..grids import FloatArray, GridDynamics, grid_covariance, in_grid_coordinates, sharpness

DENSITY = 0.4
"""Upper bound on the density of the standard normal law."""

COUPLING = 2e-12
"""Upper bound on what rounding changes in the law of noise that is drawn by a coupling, in total variation."""

COMPUTED_TWICE = 2.0
"""Factor on the rounding of a mean that is computed on either side."""

BEYOND = 5.0
"""Standard deviations beyond what inputs reach within which all lattice points lie."""


@dataclass(frozen=True, eq=False)
class Sizes:
    """Largest numbers on the way from a state of the workspace to an input, in grid coordinates, and their rounding.

    Parameters
    ----------
    moves : GridDynamics
    deviations : (d,) array
        What shifts are measured in: deviations of the noise along the grid axes (see ``sharpness``).
    spread : (d, d) array
        By what factors computing grid coordinates may enlarge errors; the identity in state coordinates.
    states, inputs, means : (d,), (m,), (d,) arrays
        Largest states, inputs and means.
    read : (d,) array
        What grid coordinates of a state are computed off by.
    unit : float
        Relative rounding of the sums of products on the way.
    """

    moves: GridDynamics
    deviations: FloatArray
    spread: FloatArray
    states: FloatArray
    inputs: FloatArray
    means: FloatArray
    read: FloatArray
    unit: float

    @property
    def covariance(self) -> FloatArray:
        """Covariance (d, d) of the noise."""
        return self.moves.covariance


@dataclass(frozen=True, eq=False)
class Reading:
    """How well a controller reads the grid coordinates of a state, of any agent; fields as in `Sizes`."""

    covariance: FloatArray
    deviations: FloatArray
    spread: FloatArray
    read: FloatArray
    unit: float


def reading_of(agent: AnyAgent, coordinates: FloatArray) -> Reading:
    """Return how well controllers of an agent read grid coordinates."""
    d, m = agent.n_states, agent.n_inputs
    unit = (4.0 * (d + m) + 40.0) * 2.0**-53
    inverse = np.linalg.inv(coordinates)
    plain = np.array_equal(coordinates, np.eye(d))
    spread = np.eye(d) if plain else np.abs(inverse) @ np.abs(coordinates)
    states = np.abs(inverse) @ np.maximum(np.abs(agent.workspace.low), np.abs(agent.workspace.high))
    read = np.zeros(d) if plain else 8.0 * unit * spread @ spread @ states
    return Reading(grid_covariance(agent, coordinates), sharpness(agent, coordinates), spread, read, unit)


def sizes_of(agent: LinearAgent, coordinates: FloatArray) -> Sizes:
    """Return the largest numbers that controllers of an agent meet."""
    d, m = agent.n_states, agent.n_inputs
    moves, unit = in_grid_coordinates(agent, coordinates), (4.0 * (d + m) + 40.0) * 2.0**-53
    plain = np.array_equal(coordinates, np.eye(d))
    spread = np.eye(d) if plain else np.abs(moves.inverse) @ np.abs(coordinates)
    states = np.abs(moves.inverse) @ np.maximum(np.abs(agent.workspace.low), np.abs(agent.workspace.high))
    inputs = np.maximum(np.abs(agent.input_box.low), np.abs(agent.input_box.high))
    means = np.abs(moves.A) @ states + np.abs(moves.B) @ inputs + np.abs(moves.offset)
    means += states + BEYOND * np.sqrt(np.diag(moves.covariance))
    read = np.zeros(d) if plain else 8.0 * unit * spread @ spread @ states
    return Sizes(moves, sharpness(agent, coordinates), spread, states, inputs, means, read, unit)


def target_rounding(sizes: Sizes, right_inverse: FloatArray, middle: FloatArray) -> FloatArray:
    """Return upper bounds (m,) on the rounding of inputs ``R (z - d - A x) + middle``."""
    asked = np.abs(right_inverse) @ (3.0 * sizes.means) + np.abs(middle)
    return np.asarray(sizes.unit * asked + np.abs(right_inverse) @ np.abs(sizes.moves.A) @ sizes.read)


def feedback_rounding(sizes: Sizes, feedback: FloatArray) -> FloatArray:
    """Return upper bounds (m,) on the rounding of inputs ``uhat + K e``; without feedback there is none."""
    error = sizes.read + sizes.unit * sizes.states
    return np.asarray(np.abs(feedback) @ error + sizes.unit * sizes.inputs * np.any(feedback, axis=1))


def error_rounding(sizes: Sizes, feedback: FloatArray, coupling: FloatArray) -> FloatArray:
    """Return upper bounds (d,) on what rounding adds per step to the error of a coupled relation."""
    error = sizes.read + sizes.unit * sizes.states
    landed = 4.0 * sizes.unit * sizes.spread @ sizes.spread @ (sizes.spread @ sizes.means + sizes.means)
    return np.asarray(landed + (np.abs(sizes.moves.B) @ np.abs(feedback) + np.abs(coupling)) @ error)


def target_loss(
    sizes: Sizes, edges: Sequence[FloatArray], right_inverse: FloatArray, drift: FloatArray, middle: FloatArray
) -> float:
    """Return an upper bound on what carrying out targets costs per step: the mean is off, or a cell is misread.

    The mean under ``u = R (z - d - A x) + middle`` is ``A x + B u + c``; it is to be z.
    """
    moves, z = sizes.moves, sizes.means
    moved = moves.B @ right_inverse
    asked = np.abs(right_inverse) @ (3.0 * z) + np.abs(middle)
    off = np.abs(moves.A - moved @ moves.A) @ sizes.states + np.abs(moved - np.eye(len(z))) @ z
    off += np.abs(moves.offset + moves.B @ middle - moved @ drift) + np.abs(moved) @ np.abs(moves.A) @ sizes.read
    rounded = sizes.spread @ z + np.abs(moves.B) @ asked
    off += 8.0 * sizes.unit * sizes.spread @ sizes.spread @ rounded
    distance = float(np.linalg.norm(off / sizes.deviations)) * (1 + 1e-9)
    # For small distances the difference of tails would lose its digits; laws that are not Gaussian have other tails.
    is_small = distance < 1e-3 or sizes.moves.is_non_gaussian
    mean = min(1.0, DENSITY * distance) if is_small else 1.0 - 2.0 * float(ndtr(-0.5 * distance))
    return mean + missed_cells(sizes, sizes.read, edges)


def mean_loss(agent: LinearAgent, coordinates: FloatArray, edges: Sequence[FloatArray]) -> float:
    """Return an upper bound on what a mean under a given input costs per step: it is computed here, and by the agent.

    Both are off by rounding, and a cell may be misread; the cost is a probability.
    """
    sizes, off = sizes_of(agent, coordinates), mean_off(agent, coordinates)
    moved = DENSITY * float(np.linalg.norm(off / sizes.deviations)) * (1 + 1e-9)
    return moved + missed_cells(sizes, sizes.read, edges)


def mean_off(agent: LinearAgent, coordinates: FloatArray) -> FloatArray:
    """Return upper bounds (d,) on what means under given inputs are off by, here and in the agent together."""
    sizes = sizes_of(agent, coordinates)
    return np.asarray(COMPUTED_TWICE * sizes.unit * (sizes.means + sizes.spread @ sizes.means))


def missed_cells(sizes: Sizes | Reading, off: FloatArray, edges: Sequence[FloatArray]) -> float:
    """Return an upper bound on what misreading states by ``off`` (d,) costs per step, and on what coordinates cost.

    It is the mass of the noise within ``off`` of cell edges, and what the noise lacks, in total variation, to be
    independent along the axes.
    """
    narrow = np.array([np.min(np.diff(axis)) for axis in edges])
    covariance, spread = sizes.covariance, sizes.spread
    size = np.outer(sizes.deviations, sizes.deviations)
    dependent = np.abs(covariance - np.diag(np.diag(covariance)))
    if not np.array_equal(spread, np.eye(len(spread))):
        dependent = dependent + 16.0 * sizes.unit * spread @ spread @ size @ spread.T @ spread.T
    # A state without noise has no density: it has to be read without an error, and to depend on no other.
    with np.errstate(divide="ignore", invalid="ignore"):
        missed = float(np.sum(np.where(off == 0.0, 0.0, 2.0 * off * (1.0 / narrow + DENSITY / sizes.deviations))))
        lacking = np.where(dependent == 0.0, 0.0, dependent / size)
    return (missed + float(np.linalg.norm(lacking))) * (1 + 1e-9)
