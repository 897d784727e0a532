"""The paper's (epsilon, delta) relation for scalar agents, in closed form.

Error ``e = x - xhat``, interface ``u = uhat + K e``, noise coupling ``what = w + F e``. With ``a_K = a + b K`` and
cells of width h the error moves as ``e' = (a_K - F) e + beta``, ``|beta| <= h/2``. The relation
``R = {|e| <= epsilon}`` is kept whenever the coupling succeeds, because

    F = sign(a_K) max(0, |a_K| - 1 + h / (2 epsilon))      gives      |a_K - F| epsilon + h/2 <= epsilon.

The coupling fails with probability at most ``delta = 2 Phi(|F| epsilon / (2 sigma)) - 1``, the maximal coupling of two
normal distributions whose means differ by F e (docs/theory/relations.md, "Scalar agents in closed form"). The paper has
K = 0.
"""

from __future__ import annotations

import numpy as np

from ....envs.systems.agents import LinearAgent
from ....envs.systems.arguments import checked_count
from ..grids import FloatArray, RelationRefused
from .coupled import CoupledRelation, coupling_failure
from .rounding import error_rounding, feedback_rounding, sizes_of

OUTWARDS = 1.0 + 1e-12
"""Factor on the width of cells, far above its rounding."""

WIDENED = 1.0 + 2e-9
"""Factor on epsilon in labels, inputs and delta: room for the rounding of controllers; restrictive everywhere."""


ENLARGED = 1e-9
"""Share by which labels and inputs allow for a wider interval of errors."""

MOST_INPUTS = 100_000
"""Most abstract inputs."""


def paper_relation(
    agent: LinearAgent,
    edges: FloatArray,
    epsilon: float,
    feedback: float = 0.0,
    inputs: int = 10,
    delta: float | None = None,
) -> CoupledRelation:
    """Return the closed-form relation of a scalar agent with the cell ``edges``; its delta is an upper bound.

    Parameters
    ----------
    agent : LinearAgent
        Scalar state, input and output.
    edges : (S + 1,) array
        Cell edges; h is the largest width.
    epsilon : float
        At least h / 2, in state units. If it is h / 2, related states lie in the same cell.
    feedback : float
        K of the interface ``u = uhat + K (x - xhat)``.
    inputs : int
        Number of abstract inputs, evenly spread over the reduced input interval, ends included.
    delta : float, optional
        A failure probability above the closed form, to be used in its place.

    Raises
    ------
    ValueError
        If the agent is not scalar, epsilon is smaller than half a cell, the feedback uses up the inputs, or ``delta``
        is smaller than the closed form.
    """
    if (agent.n_states, agent.n_inputs, agent.n_outputs) != (1, 1, 1):
        raise RelationRefused(
            f"agent `{agent.name}`: the `paper` relation is for scalar agents, got {agent.n_states} states; "
            "take `exact` or `linear`"
        )
    # With epsilon at half a cell of equal ones, related states share their cell: labels need no margin then.
    widths = np.diff(edges)
    width = float(widths.max()) * OUTWARDS
    is_cell = bool(abs(epsilon - 0.5 * width) <= 1e-9 * width and widths.min() >= width * (1 - 1e-9))
    epsilon = 0.5 * width if is_cell else float(epsilon)
    if not epsilon >= width / 2:
        raise RelationRefused(
            f"`epsilon`: expected at least half a cell width, {width / 2:g}, got {epsilon!r}; give a larger one, or "
            "more `cells`"
        )
    inputs = checked_count(inputs, "inputs", most=MOST_INPUTS)
    # The feedback takes |K| epsilon of the inputs on both sides.
    a, b, variance = float(agent.A[0, 0]), float(agent.B[0, 0]), float(agent.noise_covariance[0, 0])
    closed = a + b * feedback
    sizes = sizes_of(agent)
    reserve = abs(feedback) * epsilon * WIDENED + float(feedback_rounding(sizes, np.array([[feedback]]))[0])
    low, high = float(agent.input_box.low[0]) + reserve, float(agent.input_box.high[0]) - reserve
    if low > high:
        raise RelationRefused(
            f"`feedback`: expected |K| epsilon within the inputs of agent `{agent.name}`, got K = {feedback!r}"
        )
    if not is_cell:
        rounding = error_rounding(sizes, np.array([[feedback]]), np.array([[closed]]))
        if np.any(rounding > 0.5 * ENLARGED * width):
            raise RelationRefused(
                f"agent `{agent.name}`: its states, inputs or offset are so large next to its cells that rounding "
                "would count; measure states from a point nearby, or ask for fewer `cells`"
            )
    # The smallest |F| that keeps the interval invariant, rounded up; without noise no shift can be hidden.
    coupling = float(np.sign(closed)) * max(0.0, abs(closed) - 1.0 + width / (2 * epsilon) + 1e-15)
    least = (
        coupling_failure(abs(coupling) * epsilon * WIDENED / float(np.sqrt(variance)))
        if variance > 0
        else float(coupling != 0)
    )
    if delta is not None and not least <= delta <= 1:
        raise RelationRefused(f"`delta`: expected a number from {least:.7g} (the closed form) to 1, got {delta!r}")
    grid = np.linspace(low, high, inputs) if inputs > 1 else np.array([0.5 * (low + high)])
    return CoupledRelation(
        A=agent.A,
        B=agent.B,
        drift=agent.offset,
        covariance=np.array([variance]),
        feedback=np.array([[feedback]], dtype=float),
        coupling=np.array([[coupling]]),
        reach=np.array([epsilon]),
        state_reach=np.array([epsilon * WIDENED]),
        delta=least if delta is None else float(delta),
        inputs=grid[:, None],
        input_low=agent.input_box.low,
        input_high=agent.input_box.high,
        is_cell=is_cell,
    )
