"""Nominal inputs of one agent: by least squares to the middle of everything, a linear program, and descent.

With the impulse response ``H_s = A^s B`` the nominal path is ``xbar_t = A^t x_0 + ... + sum_s H_{t-1-s} ubar_s``: every
inequality is linear in the inputs. Least squares are quick and often enough. Else a linear program maximises the
least distance to a limit, in deviations, and descent on the sum of the tails goes on from there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog, minimize
from scipy.sparse import csr_matrix, hstack
from scipy.special import ndtr

from ....envs.systems.agents import LinearAgent
from ...relations.grids import FloatArray
from ..chance_constraints import StripConstraints

ENOUGH = 1e-12
"""Probability of failing from which a nominal path is not improved."""

FARTHEST = 40.0
"""Distance in deviations that is as good as any."""

LEAST_DEVIATION = 1e-4
"""Deviation, as a share of the distance of the limits or of the size of a limit, that stands for none."""

MOST_VARIABLES = 4000
"""Most inputs of a path that are optimised."""


@dataclass(frozen=True, eq=False)
class Response:
    """How the states of an agent respond to its inputs.

    Parameters
    ----------
    free : (S + 1, d) array
        States without inputs.
    impulse : (S, d, m) array
        States that an input leads to, by the steps since then, less one.
    """

    free: FloatArray
    impulse: FloatArray

    @classmethod
    def of(cls, agent: LinearAgent, steps: int) -> Response:
        """Return the response of an agent over some steps."""
        free, impulse = np.empty((steps + 1, agent.n_states)), np.empty((steps, agent.n_states, agent.n_inputs))
        free[0], now = agent.initial.low, agent.B
        for t in range(steps):
            free[t + 1] = agent.A @ free[t] + agent.offset
            impulse[t] = now
            now = agent.A @ now
        return cls(free, impulse)

    def of_strips(self, strips: StripConstraints) -> tuple[FloatArray, FloatArray]:
        """Return ``(a, M)`` so that the nominal values (J,) of inequalities on states are ``a + M u`` for u (S m,)."""
        steps, _, m = self.impulse.shape
        constant = np.einsum("jd,jd->j", strips.rows, self.free[strips.times])
        matrix = np.zeros((len(strips.times), steps, m))
        for t in np.unique(strips.times):
            here = np.flatnonzero(strips.times == t)
            # inputs 0 .. t - 1 were t - 1 .. 0 steps ago
            matrix[here, :t] = np.tensordot(strips.rows[here], self.impulse[:t][::-1], axes=(1, 1))
        return constant, matrix.reshape(len(strips.times), -1)


def nominal_inputs(
    agent: LinearAgent, states: StripConstraints, inputs: StripConstraints, response: Response
) -> FloatArray:
    """Return nominal inputs (S, m) that keep inequalities on states and inputs with a small probability of failing."""
    constant, matrix = response.of_strips(states)
    width = _scale(states)
    low, high = np.tile(agent.input_low, len(response.impulse)), np.tile(agent.input_high, len(response.impulse))
    sharp = np.maximum(states.deviations, LEAST_DEVIATION * width)
    spare = np.maximum(inputs.deviations, 0.0)
    margin = np.minimum(FARTHEST * spare, 0.45 * (high - low))
    # Inputs that no inequality feels stay in the middle of their box, where feedback has the most room.
    felt = np.any(matrix != 0.0, axis=0)
    u = np.clip(_least_squares(constant, matrix, states, low, high), low + 0.2 * margin, high - 0.2 * margin)

    def failing(u: FloatArray) -> float:
        at = constant + matrix @ u
        tails = ndtr((states.low - at) / sharp) + ndtr((at - states.high) / sharp)
        return float(np.sum(tails) + np.sum(_input_tails(u, low, high, spare)[0]))

    if failing(u) > ENOUGH and len(low) <= MOST_VARIABLES:
        better = _farthest(constant, matrix, states, sharp, (low, high, spare))
        u = better if better is not None and failing(better) < failing(u) else u
        if failing(u) > ENOUGH:
            u = _descended(u, constant, matrix, states, sharp, (low, high, spare))
    return np.where(felt, u, 0.5 * (low + high)).reshape(len(response.impulse), -1)


def _scale(strips: StripConstraints) -> FloatArray:
    """Return widths (J,) of inequalities; the size of the limit where there is one only."""
    width = strips.high - strips.low
    sizes = np.where(np.isfinite(strips.low), np.abs(strips.low), np.abs(strips.high))
    # Where there is no limit at all, as on the far side of a region that was added, any size will do.
    return np.where(np.isfinite(width), width, np.where(np.isfinite(sizes), np.maximum(sizes, 1.0), 1.0))


def _least_squares(
    constant: FloatArray, matrix: FloatArray, strips: StripConstraints, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return inputs that come near to the middle of all inequalities, each measured by its width."""
    two_sided = np.isfinite(strips.low) & np.isfinite(strips.high)
    lower, upper = strips.low[two_sided], strips.high[two_sided]
    weight = 1.0 / np.maximum(upper - lower, 1e-12)
    aim = 0.5 * (lower + upper) - constant[two_sided]
    centre, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-12)
    # In units of half the input range, with a weak pull to its middle.
    scaled = matrix[two_sided] * weight[:, None] * half
    target = aim * weight - scaled @ (centre / half)
    normal = scaled.T @ scaled + 1e-3 * np.eye(len(low))
    return np.asarray(centre + half * np.linalg.solve(normal, scaled.T @ target))


def _farthest(
    constant: FloatArray,
    matrix: FloatArray,
    strips: StripConstraints,
    sharp: FloatArray,
    box: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray | None:
    """Return inputs whose least distance to a limit, in deviations, is the largest; None if the program fails."""
    low, high, spare = box
    up, down = np.isfinite(strips.high), np.isfinite(strips.low)
    eye = np.eye(len(low))[spare > 0.0]
    rows = np.concatenate([matrix[up], -matrix[down], eye, -eye])
    costs = np.concatenate([sharp[up], sharp[down], spare[spare > 0.0], spare[spare > 0.0]])
    limits = np.concatenate(
        [strips.high[up] - constant[up], constant[down] - strips.low[down], high[spare > 0.0], -low[spare > 0.0]]
    )
    scale = 1.0 / np.maximum(np.abs(rows).max(axis=1, initial=0.0), 1e-12)
    constraint = hstack([csr_matrix(rows * scale[:, None]), csr_matrix((costs * scale)[:, None])])
    objective = np.append(np.zeros(len(low)), -1.0)
    bounds = [*zip(low, high, strict=True), (None, FARTHEST)]
    solved = linprog(objective, A_ub=constraint, b_ub=limits * scale, bounds=bounds, method="highs")
    return np.asarray(solved.x[:-1]) if solved.status == 0 else None


def _descended(
    start: FloatArray,
    constant: FloatArray,
    matrix: FloatArray,
    strips: StripConstraints,
    sharp: FloatArray,
    box: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    """Return inputs with a smaller sum of tails, by descent from given ones."""
    low, high, spare = box

    def objective(u: FloatArray) -> tuple[float, FloatArray]:
        at = constant + matrix @ u
        below, above = (strips.low - at) / sharp, (at - strips.high) / sharp
        value, slope = _input_tails(u, low, high, spare)
        total = float(np.sum(ndtr(below) + ndtr(above)) + np.sum(value))
        with np.errstate(over="ignore", under="ignore"):
            density = (np.exp(-0.5 * above**2) - np.exp(-0.5 * below**2)) / np.sqrt(2.0 * np.pi) / sharp
        return total, matrix.T @ density + slope

    bounds = list(zip(low, high, strict=True))
    solved = minimize(objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 200})
    return np.asarray(solved.x) if solved.fun < objective(start)[0] else start


def _input_tails(u: FloatArray, low: FloatArray, high: FloatArray, spare: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the tails (S m,) of the limits of inputs that feedback moves, and their slopes."""
    moved = spare > 0.0
    safe = np.where(moved, spare, 1.0)
    below, above = (low - u) / safe, (u - high) / safe
    value = np.where(moved, ndtr(below) + ndtr(above), 0.0)
    slope = np.where(moved, (np.exp(-0.5 * above**2) - np.exp(-0.5 * below**2)) / np.sqrt(2.0 * np.pi) / safe, 0.0)
    return value, slope
