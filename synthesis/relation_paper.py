"""The paper's (epsilon, delta) relation for scalar agents, in closed form (THEORY section 1, row ``paper``).

Error ``e = x - xhat``, interface ``u = uhat + K e``, noise coupling ``what = w + F e``; with ``a_K = a + b K`` and
cells of width h the error moves as ``e' = (a_K - F) e + beta``, ``|beta| <= h/2``. The relation
``R = {|e| <= epsilon}`` is kept whenever the coupling succeeds, because

    F = sign(a_K) max(0, |a_K| - 1 + h / (2 epsilon))      gives      |a_K - F| epsilon + h/2 <= epsilon,

and the coupling fails with probability at most ``delta = 2 Phi(|F| epsilon / (2 sigma)) - 1`` (maximal coupling of two
normal distributions whose means differ by F e). The paper has K = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ..envs.agent import LinearAgent

FloatArray = NDArray[Any]


@dataclass(frozen=True, eq=False)
class PaperRelation:
    """Relation ``|x - xhat| <= epsilon`` of a scalar agent with its finite model.

    Parameters
    ----------
    a, b, drift : float
        Dynamics ``x' = a x + b u + drift + w``.
    deviation : float
        Standard deviation sigma of w, in state units.
    epsilon : float
        Half width of the relation, in state units.
    feedback, coupling : float
        K and F.
    delta : float
        Upper bound on the probability, per step, that the coupling fails.
    inputs : (A,) array
        Abstract inputs uhat, all in U - [-|K| epsilon, |K| epsilon].
    is_cell : bool
        Whether epsilon is half a cell: then F = a_K, and related means in the same cell.
    """

    a: float
    b: float
    drift: float
    deviation: float
    epsilon: float
    feedback: float
    coupling: float
    delta: float
    inputs: FloatArray
    is_cell: bool = False

    kind = "paper"
    is_box = False
    has_state_coordinates = True

    @property
    def coordinates(self) -> FloatArray:
        """Grid coordinates are the state."""
        return np.eye(1)

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All numbers, for comparing relations."""
        numbers = (self.a, self.b, self.drift, self.deviation, self.epsilon, self.feedback, self.coupling, self.delta)
        return (np.array(numbers), self.inputs)

    def to_grid(self, states: FloatArray) -> FloatArray:
        """Grid coordinates of states, a new array."""
        return np.array(states, dtype=float)

    def means(self, centres: FloatArray) -> FloatArray:
        """(S, A) mean of the abstract successor of each cell centre (S,) under each input."""
        return self.a * centres[:, None] + self.b * self.inputs + self.drift


def paper_relation(
    agent: LinearAgent,
    edges: FloatArray,
    epsilon: float,
    feedback: float = 0.0,
    inputs: int = 10,
    delta: float | None = None,
) -> PaperRelation:
    """Closed-form relation of a scalar agent with the cell ``edges``.

    Parameters
    ----------
    agent : LinearAgent
        Scalar state, input and output map ``y = x``.
    edges : (S + 1,) array
        Cell edges; h is the largest width.
    epsilon : float
        At least h / 2, in state units.
    feedback : float
        K of the interface ``u = uhat + K (x - xhat)``.
    inputs : int
        Number of abstract inputs, evenly spread over the reduced input interval, ends included.
    delta : float, optional
        A larger failure probability than the closed form, to be used instead of it.

    Raises
    ------
    ValueError
        If the agent is not scalar, epsilon is smaller than half a cell, the feedback uses up the inputs, or ``delta``
        is smaller than the closed form.
    """
    if (agent.n_states, agent.n_inputs, agent.n_outputs) != (1, 1, 1):
        raise ValueError(
            f"agent `{agent.name}`: the `paper` relation is for scalar agents, got {agent.n_states} states"
        )
    widths = np.diff(edges)
    width = float(widths.max()) * (1 + 1e-12)
    is_cell = bool(abs(epsilon - 0.5 * width) <= 1e-9 * width and widths.min() >= width * (1 - 1e-9))
    epsilon = 0.5 * width if is_cell else epsilon
    if not epsilon >= width / 2:
        raise ValueError(f"`epsilon`: expected at least half a cell width, {width / 2:g}, got {epsilon!r}")
    if isinstance(inputs, bool) or not isinstance(inputs, int) or inputs < 1:
        raise ValueError(f"`inputs`: expected a positive whole number, got {inputs!r}")
    a, b, deviation = float(agent.A[0, 0]), float(agent.B[0, 0]), float(np.sqrt(agent.noise_covariance[0, 0]))
    closed = a + b * feedback
    reserve = abs(feedback) * epsilon * (1 + 1e-12)
    low, high = float(agent.input_box.low[0]) + reserve, float(agent.input_box.high[0]) - reserve
    if low > high:
        raise ValueError(
            f"`feedback`: expected |K| epsilon within the inputs of agent `{agent.name}`, got K = {feedback!r}"
        )
    coupling = float(np.sign(closed)) * max(0.0, abs(closed) - 1.0 + width / (2 * epsilon) + 1e-15)
    least = coupling_failure(abs(coupling) * epsilon, deviation)
    if delta is not None and not least <= delta <= 1:
        raise ValueError(f"`delta`: expected a number from {least:.7g} (the closed form) to 1, got {delta!r}")
    grid = np.linspace(low, high, inputs) if inputs > 1 else np.array([0.5 * (low + high)])
    chosen = least if delta is None else float(delta)
    return PaperRelation(a, b, float(agent.offset[0]), deviation, epsilon, feedback, coupling, chosen, grid, is_cell)


def coupling_failure(distance: float, deviation: float) -> float:
    """Upper bound on the total variation distance of two normal distributions whose means are ``distance`` apart.

    ``2 Phi(distance / (2 deviation)) - 1``, rounded up; 1 for singular noise and different means.

    Examples
    --------
    >>> round(coupling_failure(0.0025, 0.5), 7)
    0.0019947
    """
    if distance == 0.0:
        return 0.0
    if deviation == 0.0:
        return 1.0
    half = distance / (2.0 * deviation)
    return min(1.0, (1.0 - 2.0 * float(ndtr(-half))) * (1 + 1e-12) + 1e-15)
