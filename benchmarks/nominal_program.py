"""Are nominal inputs of paths the best ones? A convex program by cvxpy and Clarabel (extra ``lmi``) beside our search.

``python benchmarks/nominal_program.py`` prints the certified probability of failing of some rows for both.

For one feedback and given letters both bounds of a path are concave in its nominal inputs: with the distances d_j to
the nearer limits, the logarithm of the product of ``2 Phi(d_j / sigma_j) - 1``, and less the sum of the tails of both
limits where these are kept. So risk is allocated among the inequalities at the same time as inputs are found. Each
bound is replaced by the least of its tangents, which makes a linear program; its answer is judged by what it certifies.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr

import certigym as cg
from certigym.synthesis.controllers import covariances_of
from certigym.synthesis.nominal_paths import path_search
from certigym.synthesis.nominal_paths.nominal import Response, nominal_inputs
from certigym.synthesis.path_bounds.slabs import Slabs, input_slabs, limits_of, state_slabs
from measuring import Rows, once, options, save, show

FloatArray = NDArray[np.float64]

ROWS = ("bas_4_deviation", "bas_4_variance", "ba_4d", "almost_identity_5", "rooms_5_two_heaters")
"""Rows of ``benchmarks/arch`` whose failure is no rounding error."""

PLACES = np.concatenate([np.geomspace(0.01, 0.4, 10)[:-1], np.linspace(0.4, 4.0, 28), np.linspace(4.4, 8.0, 10)])
"""Distances in deviations where tangents touch: close by where the bounds bend most, and up to tails of 1e-15."""

SHARPEST = 1e-7
"""Least deviation, as a share of the distance of the limits or of a limit's size: smaller ones count as none."""


def allocated_inputs(
    constant: FloatArray, matrix: FloatArray, states: Slabs, inputs: Slabs, correlated: bool
) -> FloatArray | None:
    """Return nominal inputs (S m,) that nearly maximise one of the two bounds; None if there are none.

    Parameters
    ----------
    constant, matrix : (J,), (J, S m) arrays
        Nominal values of the inequalities on states are ``constant + matrix @ u``.
    states, inputs : Slabs
    correlated : bool
        The bound by the correlation inequality, else Boole's.
    """
    import cvxpy as cp

    u, moved = cp.Variable(len(inputs.times)), inputs.deviations > 0.0
    fixed = ~moved
    limits = [u[fixed] >= inputs.low[fixed], u[fixed] <= inputs.high[fixed]] if fixed.any() else []
    sharp = states.deviations > SHARPEST * np.maximum(np.abs(_finite(states.low)), np.abs(_finite(states.high)))
    at = constant + matrix @ u
    # Without noise in a row its nominal value has to keep the limits, with a little to spare for rounding.
    limits += _strict(at, states, ~sharp)
    gains: list[Any] = []
    for value, slabs, which in ((at, states, sharp), (u, inputs, moved)):
        if which.any():
            more, worth = _worth(cp, value, slabs, which, correlated)
            limits += more
            gains.append(cp.sum(worth))
    if not gains:
        return None
    program = cp.Problem(cp.Maximize(sum(gains)), limits)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an inaccurate answer is judged by what it certifies
            program.solve(solver=cp.CLARABEL)
    except cp.SolverError:
        return None
    return None if u.value is None else np.clip(u.value, inputs.low, inputs.high)


def _finite(limits: FloatArray) -> FloatArray:
    return np.where(np.isfinite(limits), limits, 0.0)


def _strict(at: Any, slabs: Slabs, which: NDArray[np.bool_]) -> list[Any]:
    """Return constraints that nominal values keep limits, less a share of their size that rounding does not reach."""
    limits = []
    for side, limit in ((1.0, slabs.low), (-1.0, -slabs.high)):
        here = which & np.isfinite(limit)
        if here.any():
            limits.append(side * at[here] >= limit[here] + SHARPEST * (1.0 + np.abs(limit[here])))
    return limits


def _worth(cp: Any, at: Any, slabs: Slabs, which: NDArray[np.bool_], correlated: bool) -> tuple[list[Any], Any]:
    """Return constraints and the worth (n,) of inequalities with noise, by the tangents of a bound."""
    deviations = slabs.deviations[which]
    worth, limits = cp.Variable(int(which.sum())), []
    slope, offset = _tangents(correlated)
    sides = []
    for side, limit in ((1.0, slabs.low[which]), (-1.0, -slabs.high[which])):
        here = np.flatnonzero(np.isfinite(limit))
        if len(here):
            sides.append((here, (side * at[which][here] - limit[here]) / deviations[here]))
    if correlated:
        # The nearer limit counts, for both sides.
        for here, z in sides:
            limits += [worth[here] <= a * z + b for a, b in zip(slope, offset, strict=True)]
        limits += [worth <= 0.0]
        return limits, worth
    total: Any = 0.0
    for here, z in sides:
        tail = cp.Variable(len(here))
        limits += [tail <= a * z + b for a, b in zip(slope, offset, strict=True)] + [tail <= 0.0]
        total = total + cp.sum(tail)
    return [*limits, worth == 0.0], worth + total / max(1, int(which.sum()))


def _tangents(correlated: bool) -> tuple[FloatArray, FloatArray]:
    """Return slopes and offsets of tangents of ``log(2 Phi(z) - 1)``, or of ``-Phi(-z)``, both concave for z > 0."""
    density = np.exp(-0.5 * PLACES**2) / np.sqrt(2.0 * np.pi)
    if correlated:
        value, slope = np.log1p(-2.0 * np.exp(log_ndtr(-PLACES))), 2.0 * density / (2.0 * ndtr(PLACES) - 1.0)
    else:
        value, slope = -ndtr(-PLACES), density
    return slope, value - slope * PLACES


def failures(row: str, number: int = 0) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return failure and seconds of our nominal inputs, and of those of the program, for one of the feedbacks."""
    found: Any = cg.synthesize(Path(__file__).parent / "arch" / f"{row}.toml", relation="path").certificate
    agent: Any = found.problem.agents[0]
    gain, steps = path_search.feedback(agent, number), found.proof.n_steps
    assert gain is not None
    covariances = covariances_of(agent, gain, steps)
    states = state_slabs(limits_of(found.problem, 0, found.proof.letters, found.proof.faces), covariances)
    inputs, response = input_slabs(agent, gain, covariances, steps), Response.of(agent, steps)
    seconds, ours = once(lambda: nominal_inputs(agent, states, inputs, response))
    constant, matrix = response.of_slabs(states)
    longer, answers = once(lambda: [allocated_inputs(constant, matrix, states, inputs, c) for c in (True, False)])
    theirs = [path_search.failure_along(agent, u.reshape(steps, -1), states, inputs) for u in answers if u is not None]
    return (path_search.failure_along(agent, ours, states, inputs), seconds), (min(theirs, default=1.0), longer)


if __name__ == "__main__":
    arguments = options(__doc__)
    results: Rows = []
    for row in ROWS:
        for number in range(len(path_search.GAIN_COSTS) + 1):
            (ours, seconds), (theirs, longer) = failures(row, number)
            results.append({"row": row, "feedback": number, "ours": ours, "seconds": seconds,
                            "program": theirs, "its seconds": longer})  # fmt: skip
    show("nominal inputs", results)
    save({"nominal inputs": results}, arguments.json)
