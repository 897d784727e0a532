"""The published computation of Fig. 3, step by step: **a reproduction, not a certificate**.

The paper's reach-avoid figures come out to six digits if, and only if, the kernel is built with the *variance* .25 in
the place of the standard deviation .5 while delta belongs to the standard deviation .5: two different systems in one
computation (THEORY section 11). Nothing here is a claim about any system unless ``kernel_deviation`` is the standard
deviation of the noise; ``certigym.synthesize`` makes certificates.

Conventions of the published computation, each needed for the digits: cells of equal width and inputs
``linspace(-5, 5, 10)``; delta = .002; guards as products of literals, each literal shrunk by epsilon at region
boundaries but not at the edge of the workspace; the plain operator ``max(0, P[mask v] - delta)``; one policy per agent,
chosen anew at every step for both agents at once by the 1-norm weights of the other agent's factors under the policies
of the step before, where only terms count that are alive under those policies; ties to the first input; the reported
mean reads the start through the shrunk guards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ...synthesis.cells import FloatArray, Grid

LOW, HIGH, CELLS, EPSILON, A, B = -20.0, 5.0, 1000, 0.1, 0.9, 0.5
INPUTS = np.linspace(-5.0, 5.0, 10)
DELTA = 0.002
"""Published failure probability per agent; the closed form is .0019947."""
VARIANCE = 0.25
"""Noise variance of the paper, used as a standard deviation in its kernel."""
REGION = (slice(0, 800), slice(600, 700))
"""Cells over which the figure averages: x1 in [-20, 0], x2 in [-5, -2.5]."""


@dataclass(frozen=True, eq=False)
class PublishedStep:
    """Outcome at one horizon.

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
    """The published computation for horizons 1 .. ``horizon`` (a reproduction, see the module).

    Parameters
    ----------
    horizon : int
    kernel_deviation : float
        Standard deviation the kernel is built with; published: the variance .25. The stated noise has .5.
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
        grown = [(reach[0] * 1.0, reach[1] * 1.0, 1)]
        grown += [(m1 * v1, m2 * v2, depth + 1) for m1, m2 in stay for v1, v2, depth in terms]
        depths = np.array([depth for _, _, depth in grown])
        shape = (len(grown), CELLS, len(INPUTS))
        factors = [np.array([g[i] for g in grown]) for i in (0, 1)]
        smoothed = [np.maximum(0.0, (own @ kernel).reshape(shape) - loss) for own in factors]
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
    """Masses (S, S * inputs) of every cell around the mean of each cell and input, as plain differences of a CDF."""
    edges = np.linspace(LOW, HIGH, CELLS + 1)
    centres = 0.5 * (edges[:-1] + edges[1:])
    means = (A * centres[:, None] + B * INPUTS).ravel()
    return np.asarray(np.diff(ndtr((edges[:, None] - means) / deviation), axis=0))


def _guards() -> tuple[tuple[FloatArray, FloatArray], list[tuple[FloatArray, FloatArray]]]:
    """Shrunk masks of ``p1`` and of the two products ``!p1 & !p3``, ``!p1 & !p2 & p3`` that stay undecided."""
    edges = np.linspace(LOW, HIGH, CELLS + 1)
    centres, slack = 0.5 * (edges[:-1] + edges[1:]), 1e-9
    low, high = centres - EPSILON, centres + EPSILON
    p1, not_p1 = low >= -slack, high <= slack
    not_p2 = (high <= -5.0 + slack) | p1
    p3, not_p3 = high <= -15.0 + slack, low >= -15.0 - slack
    return (p1, np.ones(CELLS)), [(not_p1, not_p3), (not_p1 & not_p2, p3)]


def _chosen(smoothed: FloatArray, policy: NDArray[Any]) -> FloatArray:
    """Values (n, S) of smoothed factors (n, S, inputs) at the chosen inputs."""
    return smoothed[:, np.arange(CELLS), policy]


def _field(
    stay: list[tuple[FloatArray, FloatArray]], terms: list[tuple[FloatArray, FloatArray, int]], loss: float, t: int
) -> FloatArray:
    """Value (800, 100) on the region, the start read through the shrunk guards; corrected a posteriori if asked for."""
    rows, columns = REGION
    first = np.array([m1 * v1 * (1.0 + loss * (t - depth)) for m1, _ in stay for v1, _, depth in terms])
    second = np.array([m2 * v2 for _, m2 in stay for _, v2, _ in terms])
    values = first[:, rows].T @ second[:, columns] if len(first) else np.zeros((800, 100))
    return np.asarray(np.maximum(0.0, values - loss * t))


def published_grid() -> Grid:
    """The grid of both agents."""
    return Grid((np.linspace(LOW, HIGH, CELLS + 1),))
