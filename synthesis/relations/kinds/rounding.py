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

from ....envs.systems.agents import LinearAgent
from ..grids import FloatArray, sharpness

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
    """Largest numbers on the way from a state of the workspace to an input, and their rounding.

    Parameters
    ----------
    agent : LinearAgent
    deviations : (d,) array
        What shifts are measured in: deviations of the noise (see ``sharpness``).
    states, inputs, means : (d,), (m,), (d,) arrays
        Largest states, inputs and means.
    unit : float
        Relative rounding of the sums of products on the way.
    """

    agent: LinearAgent
    deviations: FloatArray
    states: FloatArray
    inputs: FloatArray
    means: FloatArray
    unit: float


def sizes_of(agent: LinearAgent) -> Sizes:
    """Return the largest numbers that controllers of an agent meet."""
    unit = (4.0 * (agent.n_states + agent.n_inputs) + 40.0) * 2.0**-53
    states = np.maximum(np.abs(agent.workspace.low), np.abs(agent.workspace.high))
    inputs = np.maximum(np.abs(agent.input_box.low), np.abs(agent.input_box.high))
    means = np.abs(agent.A) @ states + np.abs(agent.B) @ inputs + np.abs(agent.offset)
    means += states + BEYOND * np.sqrt(np.diag(agent.noise_covariance))
    return Sizes(agent, sharpness(agent), states, inputs, means, unit)


def target_rounding(sizes: Sizes, right_inverse: FloatArray, middle: FloatArray) -> FloatArray:
    """Return upper bounds (m,) on the rounding of inputs ``R (z - d - A x) + middle``."""
    return np.asarray(sizes.unit * (np.abs(right_inverse) @ (3.0 * sizes.means) + np.abs(middle)))


def feedback_rounding(sizes: Sizes, feedback: FloatArray) -> FloatArray:
    """Return upper bounds (m,) on the rounding of inputs ``uhat + K e``; without feedback there is none."""
    error = sizes.unit * sizes.states
    return np.asarray(np.abs(feedback) @ error + sizes.unit * sizes.inputs * np.any(feedback, axis=1))


def error_rounding(sizes: Sizes, feedback: FloatArray, coupling: FloatArray) -> FloatArray:
    """Return upper bounds (d,) on what rounding adds per step to the error of a coupled relation."""
    error = sizes.unit * sizes.states
    landed = 8.0 * sizes.unit * sizes.means
    return np.asarray(landed + (np.abs(sizes.agent.B) @ np.abs(feedback) + np.abs(coupling)) @ error)


def target_loss(sizes: Sizes, right_inverse: FloatArray, drift: FloatArray, middle: FloatArray) -> float:
    """Return an upper bound on what carrying out targets costs per step, as the mean is off.

    The mean under ``u = R (z - d - A x) + middle`` is ``A x + B u + c``; it is to be z.
    """
    agent, z = sizes.agent, sizes.means
    moved = agent.B @ right_inverse
    asked = np.abs(right_inverse) @ (3.0 * z) + np.abs(middle)
    off = np.abs(agent.A - moved @ agent.A) @ sizes.states + np.abs(moved - np.eye(len(z))) @ z
    off += np.abs(agent.offset + agent.B @ middle - moved @ drift)
    off += 8.0 * sizes.unit * (z + np.abs(agent.B) @ asked)
    distance = float(np.linalg.norm(off / sizes.deviations)) * (1 + 1e-9)
    # For small distances the difference of tails would lose its digits; laws that are not Gaussian have other tails.
    is_small = distance < 1e-3 or agent.laws is not None
    return min(1.0, DENSITY * distance) if is_small else 1.0 - 2.0 * float(ndtr(-0.5 * distance))


def mean_loss(agent: LinearAgent) -> float:
    """Return an upper bound on what a mean under a given input costs per step: it is computed here, and by the agent.

    Both are off by rounding; the cost is a probability.
    """
    return DENSITY * float(np.linalg.norm(mean_off(agent) / sharpness(agent))) * (1 + 1e-9)


def mean_off(agent: LinearAgent) -> FloatArray:
    """Return upper bounds (d,) on what means under given inputs are off by, here and in the agent together."""
    sizes = sizes_of(agent)
    return np.asarray(COMPUTED_TWICE * sizes.unit * 2.0 * sizes.means)


def missed_cells(deviations: FloatArray, off: FloatArray, edges: Sequence[FloatArray]) -> float:
    """Return an upper bound on what misreading states by ``off`` (d,) costs per step.

    It is the mass of the noise, with ``deviations`` (d,) as `sharpness` has them, within ``off`` of cell edges.
    """
    narrow = np.array([np.min(np.diff(axis)) for axis in edges])
    # A state without noise has no density: it has to be read without an error.
    with np.errstate(divide="ignore", invalid="ignore"):
        missed = np.where(off == 0.0, 0.0, 2.0 * off * (1.0 / narrow + DENSITY / deviations))
    return float(np.sum(missed)) * (1 + 1e-9)
