"""Feedbacks of linear-quadratic problems along nominal paths, for many weights at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...relations.grids import FloatArray


def feedback_gains(A: FloatArray, B: FloatArray, weights: FloatArray, held: NDArray[np.bool_]) -> FloatArray:
    """Return the feedbacks (N, S, m, d) of linear-quadratic problems along nominal paths.

    Parameters
    ----------
    A, B : (S, N, d, d) and (S, N, d, m) arrays
        Jacobians.
    weights : (N, d + m + 1) array
        Costs of states and inputs, and the factor on those of the last states.
    held : (S, N, m) bool array
        Inputs that stay at their nominal values: those at a limit.
    """
    d, m, steps = A.shape[2], B.shape[3], len(A)
    n = len(weights)
    P = np.zeros((n, d, d))
    index = np.arange(d)
    P[:, index, index] = weights[:, :d] * weights[:, -1:]
    R = np.zeros((n, m, m))
    R[:, np.arange(m), np.arange(m)] = weights[:, d : d + m]
    gains = np.zeros((n, steps, m, d))
    for t in range(steps - 1, -1, -1):
        free = np.where(held[t][:, None], 0.0, B[t])
        PB = np.matmul(P, free)
        push = R + np.matmul(free.swapaxes(1, 2), PB)
        gain = -np.linalg.solve(push, np.matmul(PB.swapaxes(1, 2), A[t]))
        gain = np.where(held[t][:, :, None], 0.0, gain)
        closed = A[t] + np.matmul(free, gain)
        P = np.matmul(A[t].swapaxes(1, 2), np.matmul(P, closed))
        P = 0.5 * (P + P.swapaxes(1, 2))
        P[:, index, index] += weights[:, :d]
        gains[:, t] = gain
    return gains
