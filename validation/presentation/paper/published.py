"""The published computation of Fig. 3, step by step: **a reproduction, not a certificate**.

The paper's reach-avoid figures come out to six digits if, and only if, the kernel is built with the *variance* .25 in
the place of the standard deviation .5, while delta belongs to the standard deviation .5: two different systems in one
computation (docs/published_results.md, "Fig. 3: reach-avoid, two agents"). Nothing here is a claim about any system
unless ``kernel_deviation`` is the standard deviation of the noise; ``certigym.synthesize`` makes certificates.

The published computation has the following conventions, each of which the digits need: cells of equal width and inputs
``linspace(-5, 5, 10)``; delta = .002; guards are products of literals, and each literal is shrunk by epsilon at region
boundaries but not at the edge of the workspace; the plain operator ``max(0, P[mask v] - delta)``; one policy per agent,
chosen anew at every step for both agents at once, with the 1-norms of the other agent's factors as weights, under the
policies of the step before; only terms count that are alive under those policies; ties go to the first input; the
reported mean reads the start through the shrunk guards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ....synthesis.relations.grids import FloatArray, Grid

LOW, HIGH, CELLS, EPSILON, A, B = -20.0, 5.0, 1000, 0.1, 0.9, 0.5
"""Workspace, cells, epsilon and dynamics ``x' = A x + B u`` of both agents, as published."""
INPUTS = np.linspace(-5.0, 5.0, 10)
DELTA = 0.002
"""Published failure probability per agent; the closed form is .0019947."""
VARIANCE = 0.25
"""Noise variance of the paper, used as a standard deviation in its kernel."""
REGION = (slice(0, 800), slice(600, 700))
"""Cells over which the figure averages: x1 in [-20, 0], x2 in [-5, -2.5]."""

SLACK_OF_EDGES = 1e-9
"""Tolerance with which a cell touches a boundary: far above rounding, far below the cell width .025."""


@dataclass(frozen=True, eq=False)
class PublishedStep:
    """The published computation at one horizon.

    Parameters
    ----------
    horizon : int
    mean : float
        Value averaged over the region, as printed in the paper.
    field : (800, 100) array
        Value at each cell of the region.
    policies : (T, 2, S) int array
        Input of each agent and cell by time, while the task is undecided.
    """

    horizon: int
    mean: float
    field: FloatArray
    policies: NDArray[Any]


def published_curve(
    horizon: int, kernel_deviation: float = VARIANCE, delta: float = DELTA, correction: str = "robust tree"
) -> list[PublishedStep]:
    """Return the published computation for horizons 1 .. ``horizon``: a reproduction, in general no bound.

    Parameters
    ----------
    horizon : int
    kernel_deviation : float
        Standard deviation with which the kernel is built; the paper used the variance .25, the stated noise has .5.
    delta : float
        Failure probability per agent.
    correction : str
        ``"robust tree"`` or ``"a-posteriori"`` (Thm 2 or Thm 1 of the paper, with the policy heuristic of each).
    """
    robust = correction == "robust tree"
    loss = delta if robust else 0.0
    joint_loss = 0.0 if robust else 1.0 - (1.0 - delta) ** 2
    kernel = _kernel(kernel_deviation)
    reach, stay = _guards()
    policies = np.zeros((2, CELLS), dtype=np.int64)
    terms: list[tuple[FloatArray, FloatArray, int]] = []
    history: list[NDArray[Any]] = []
    steps = []
    for t in range(1, horizon + 1):
        # Apply the guards to the terms of the step before, and smooth the factors by the kernel.
        grown = [(reach[0] * 1.0, reach[1] * 1.0, 1)]
        grown += [(m1 * v1, m2 * v2, depth + 1) for m1, m2 in stay for v1, v2, depth in terms]
        depths = np.array([depth for _, _, depth in grown])
        shape = (len(grown), CELLS, len(INPUTS))
        factors = [np.array([g[i] for g in grown]) for i in (0, 1)]
        smoothed = [np.maximum(0.0, (masked @ kernel).reshape(shape) - loss) for masked in factors]
        # Choose new policies with weights from the old ones, and keep the terms that are alive under the new ones.
        old = [_chosen(smoothed[i], policies[i]) for i in (0, 1)]
        alive = (old[0].max(axis=1) * old[1].max(axis=1) > 1e-15) * (1.0 + joint_loss * (t - depths))
        weights = [old[1].sum(axis=1) * alive, old[0].sum(axis=1) * alive]
        policies = np.stack([np.tensordot(w, s, axes=1).argmax(axis=1) for w, s in zip(weights, smoothed, strict=True)])
        history.insert(0, policies)
        new = [_chosen(smoothed[i], policies[i]) for i in (0, 1)]
        pairs = zip(new[0], new[1], depths.tolist(), strict=True)
        terms = [(v1, v2, depth) for v1, v2, depth in pairs if v1.max() * v2.max() > 1e-15]
        field = _field(stay, terms, joint_loss, t)
        steps.append(PublishedStep(t, float(field.mean()), field, np.array(history)))
    return steps


def _kernel(deviation: float) -> FloatArray:
    """Return the masses (S, S * inputs) of every cell for each cell and input, as plain differences of a CDF."""
    edges = np.linspace(LOW, HIGH, CELLS + 1)
    centres = 0.5 * (edges[:-1] + edges[1:])
    means = (A * centres[:, None] + B * INPUTS).ravel()
    return np.asarray(np.diff(ndtr((edges[:, None] - means) / deviation), axis=0))


def _guards() -> tuple[tuple[FloatArray, FloatArray], list[tuple[FloatArray, FloatArray]]]:
    """Return the shrunk masks of ``p1`` and of the two undecided products ``!p1 & !p3`` and ``!p1 & !p2 & p3``."""
    edges = np.linspace(LOW, HIGH, CELLS + 1)
    centres, slack = 0.5 * (edges[:-1] + edges[1:]), SLACK_OF_EDGES
    low, high = centres - EPSILON, centres + EPSILON
    # A literal holds in a cell if it holds everywhere within epsilon of the centre.
    p1, not_p1 = low >= -slack, high <= slack
    not_p2 = (high <= -5.0 + slack) | p1
    p3, not_p3 = high <= -15.0 + slack, low >= -15.0 - slack
    return (p1, np.ones(CELLS)), [(not_p1, not_p3), (not_p1 & not_p2, p3)]


def _chosen(smoothed: FloatArray, policy: NDArray[Any]) -> FloatArray:
    """Return the values (n, S) of smoothed factors (n, S, inputs) at the chosen inputs."""
    return smoothed[:, np.arange(CELLS), policy]


def _field(
    stay: list[tuple[FloatArray, FloatArray]], terms: list[tuple[FloatArray, FloatArray, int]], loss: float, t: int
) -> FloatArray:
    """Return the value (800, 100) on the region, the start read through the shrunk guards.

    With a joint ``loss`` per step above 0 it is corrected a posteriori.
    """
    # Values are products of one factor per agent, so the field is a product of two matrices.
    rows, columns = REGION
    first = np.array([m1 * v1 * (1.0 + loss * (t - depth)) for m1, _ in stay for v1, _, depth in terms])
    second = np.array([m2 * v2 for _, m2 in stay for _, v2, _ in terms])
    values = first[:, rows].T @ second[:, columns] if len(first) else np.zeros((800, 100))
    return np.asarray(np.maximum(0.0, values - loss * t))


def published_grid() -> Grid:
    """Return the grid of both agents."""
    return Grid((np.linspace(LOW, HIGH, CELLS + 1),))
