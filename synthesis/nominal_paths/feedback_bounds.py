"""What feedbacks and slabs along a nominal path are worth: the bound of the certificate, for many of them at once.

The mathematics is that of docs/theory/paths.md, "Agents of any dynamics", in plain floating point; a certificate says a
little less than what is found here, and the check decides.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc, log_ndtr

from ..cells import FloatArray
from .nonlinear_model import NonlinearModel, remainders
from .path_limits import Limits

OUTWARD = 1.0 + 1e-7
"""Factor on drifts and failures of what is claimed: the check rounds outward, and has enclosures of its own."""

INWARD = 1e-9
"""Share of the size of a number by which distances are shortened."""

LEAST = 1e-9
"""Slabs, as a share of the range of a state, of states without noise."""

SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)
"""Probabilities of all slabs for which rows are chosen to be slabs or tails."""

LOST = 1e6
"""Drift, in ranges of states, from which a candidate is given up."""


@dataclass(frozen=True, eq=False)
class Feedback:
    """Candidates: gains (N, S, m, d), and slabs (N, 2 d + m) in deviations of states, inputs and noises."""

    gains: FloatArray
    slabs: FloatArray


@dataclass(eq=False)
class Worth:
    """Rows of inequalities of N candidates: distances, slabs and variances, lists of arrays (N, J)."""

    low: list[FloatArray] = field(default_factory=list)
    high: list[FloatArray] = field(default_factory=list)
    slab: list[FloatArray] = field(default_factory=list)
    variance: list[FloatArray] = field(default_factory=list)
    names: list[str] = field(default_factory=list)

    def add(self, low: FloatArray, high: FloatArray, slab: FloatArray, variance: FloatArray, names: list[str]) -> None:
        """Add rows (N, J)."""
        shape = variance.shape
        for kept, new in zip((self.low, self.high, self.slab, self.variance), (low, high, slab, variance)):
            kept.append(np.broadcast_to(new, shape))
        self.names += names

    @cached_property
    def _all(self) -> tuple[FloatArray, ...]:
        return tuple(np.concatenate(part, axis=1) for part in (self.low, self.high, self.slab, self.variance))

    def scores(self) -> FloatArray:
        """Return numbers (N,) that grow with the failure, also where that is 1: logarithms of sums of soft tails."""
        return np.log(np.maximum(self.soft().sum(axis=1), 1e-300))

    def soft(self) -> FloatArray:
        """Return what each row (N, J) adds to the failure; where the limit is broken it goes on to grow."""
        low, high, slab, variance = self._all
        one, other, inner = (_soft(distance, variance) for distance in (low, high, slab))
        both = 2.0 * _soft(np.minimum(np.minimum(low, high), slab), variance)
        apart = 2.0 * inner + np.where(low < slab, one, 0.0) + np.where(high < slab, other, 0.0)
        return np.minimum(both, apart)

    def failures(self) -> FloatArray:
        """Return upper bounds (N,) on the probabilities that an inequality fails, up to rounding."""
        low, high, slab, variance = self._all
        both = np.minimum(2.0 * _tails(np.minimum(np.minimum(low, high), slab), variance), 1.0)
        inner = np.minimum(2.0 * _tails(slab, variance), 1.0)
        outer = np.where(low < slab, _tails(low, variance), 0.0) + np.where(high < slab, _tails(high, variance), 0.0)
        best = np.ones(len(low))
        for share in SHARES:
            as_slab = share * both <= share * inner + outer
            chosen = np.where(as_slab, both, inner)
            with np.errstate(divide="ignore"):
                kept = np.sum(np.log1p(-chosen), axis=1)
            best = np.minimum(best, -np.expm1(kept) + np.sum(np.where(as_slab, 0.0, outer), axis=1))
        return np.minimum(1.0, best * OUTWARD)


def _quotient(distance: FloatArray, variance: FloatArray) -> FloatArray:
    """Return distances in deviations, between -1000 and 1000."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        z = distance / np.sqrt(np.maximum(variance, 1e-300))
    return np.clip(np.where(distance == np.inf, np.inf, np.where(np.isnan(z), -1e3, z)), -1e3, 1e3)


def _soft(distance: FloatArray, variance: FloatArray) -> FloatArray:
    return np.where(distance == np.inf, 0.0, -log_ndtr(_quotient(distance, variance)))


def _tails(distance: FloatArray, variance: FloatArray) -> FloatArray:
    tail = 0.5 * erfc(_quotient(distance, variance) / np.sqrt(2.0)) + 2e-300
    return np.where(distance == np.inf, 0.0, np.where(variance > 0.0, tail, np.where(distance > 0.0, 0.0, 1.0)))


@dataclass(frozen=True, eq=False)
class Spreads:
    """Deviations and drifts of one candidate, by which a nominal path is planned anew.

    Arrays (S + 1, d), (S + 1, p) and (S, m) of states, outputs and inputs; ``slabs`` (S + 1, 2 d + m) are those of the
    certificate.
    """

    states: tuple[FloatArray, FloatArray]
    outputs: tuple[FloatArray, FloatArray]
    inputs: tuple[FloatArray, FloatArray]
    slabs: FloatArray


@dataclass(frozen=True, eq=False)
class NominalPath:
    """Nominal states (S + 1, d) and inputs (S, m) of an agent, with the limits along them."""

    model: NonlinearModel
    limits: Limits
    states: FloatArray
    inputs: FloatArray

    @cached_property
    def linear(self) -> tuple[FloatArray, FloatArray]:
        """Jacobians (S, d, d) and (S, d, m)."""
        return self.model.linear(self.states[:-1], self.inputs)

    @cached_property
    def outputs(self) -> tuple[FloatArray, FloatArray]:
        """Outputs (S + 1, p) and their Jacobians (S + 1, p, d)."""
        return self.model.outputs(self.states)

    @cached_property
    def by_unknowns(self) -> FloatArray:
        """Sizes (S, d, k) of the derivatives by what is unknown."""
        d, m = self.model.agent.n_states, self.model.agent.n_inputs
        variables = self.model.variables(self.states[:-1].T, self.inputs.T)
        _, slopes = self.model.motion.slopes(variables)
        both = np.broadcast_to(slopes, (*slopes.shape[:2], len(self.inputs)))
        return np.abs(np.moveaxis(both, 2, 0)[:, :, d + m :])

    @cached_property
    def scales(self) -> tuple[FloatArray, FloatArray]:
        """Nominal multipliers (S, d) of the noise, and sizes (S, d, v) of their derivatives."""
        assert self.model.scale is not None
        variables = self.model.variables(self.states[:-1].T, self.inputs.T)
        values, slopes = self.model.scale.slopes(variables)
        both = np.broadcast_to(slopes, (*slopes.shape[:2], len(self.inputs)))
        return values.T, np.abs(np.moveaxis(both, 2, 0))

    def noise(self, t: int) -> FloatArray:
        """Return the covariance (d, d) of the noise of step t."""
        if self.model.scale is None:
            return self.model.agent.noise_covariance
        return np.diag((self.scales[0][t] * self.model.deviations) ** 2)

    def worth(self, feedback: Feedback) -> tuple[Worth, Spreads]:
        """Return the rows of all candidates, and the spreads of the first one."""
        return _Walk(self, feedback).walked()


class _Walk:
    """One walk along a nominal path with N candidates."""

    def __init__(self, nominal: NominalPath, feedback: Feedback) -> None:
        agent = nominal.model.agent
        self.nominal, self.model, self.agent, self.feedback = nominal, nominal.model, agent, feedback
        self.d, self.m, self.n = agent.n_states, agent.n_inputs, len(feedback.gains)
        steps, d = len(nominal.inputs), self.d
        self.products = np.zeros((self.n, steps + 1, d, d))
        self.drifts = np.zeros((self.n, steps + 1, d))
        # The set of starts stands before the first remainder.
        self.products[:, 0] = np.eye(d)
        start = agent.initial
        self.drifts[:, 0] = np.maximum(start.high - nominal.states[0], nominal.states[0] - start.low)
        self.covariance = np.zeros((self.n, d, d))
        self.worth = Worth()
        width = agent.state_high - agent.state_low
        self.least = LEAST * np.concatenate([width, np.maximum(agent.input_high - agent.input_low, 1e-9)])
        low = np.concatenate([agent.state_low, agent.input_low, nominal.model.unknown[0]])
        self.ends = low, np.concatenate([agent.state_high, agent.input_high, nominal.model.unknown[1]])
        self.lost = LOST * width

    def of_rows(self, t: int, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return drifts and variances (N, J) of rows (J, d) or (N, J, d) at time t."""
        rows = np.broadcast_to(rows, (self.n, *rows.shape[-2:]))
        moved = np.abs(np.matmul(rows[:, None], self.products[:, : t + 1]))
        drift = np.einsum("nsjd,nsd->nj", moved, self.drifts[:, : t + 1])
        return drift * OUTWARD, np.einsum("njd,nde,nje->nj", rows, self.covariance, rows)

    def walked(self) -> tuple[Worth, Spreads]:
        nominal, d, m = self.nominal, self.d, self.m
        steps, bent = len(nominal.inputs), self.model.bent
        sd_x, sd_y, sd_u = np.zeros((steps + 1, d)), np.zeros((steps + 1, self.agent.n_outputs)), np.zeros((steps, m))
        dr_x, dr_y, dr_u = sd_x.copy(), sd_y.copy(), sd_u.copy()
        slabs = np.full((steps + 1, 2 * d + m), np.inf)
        eye = np.eye(d)
        for t in range(steps + 1):
            x = nominal.states[t]
            drift, variance = self.of_rows(t, eye)
            sd = np.sqrt(np.maximum(variance, 0.0)) * OUTWARD
            asked = bent[:d] if t < steps else self.model.bent_outputs
            if len(nominal.limits.limited):
                asked = asked | self.model.bent_outputs
            slab = np.where(asked, self.feedback.slabs[:, :d] * sd + self.least[:d], np.inf)
            reach = np.where(np.isinf(slab), np.inf, slab) + drift if t else drift
            reach = np.minimum(reach, np.maximum(self.agent.state_high - x, x - self.agent.state_low))
            sd_x[t], dr_x[t], slabs[t, :d] = sd[0], drift[0], slab[0]
            if t:
                low, high = nominal.limits.states[:, t]
                size = INWARD * np.abs(x)
                names = [f"{name} at step {t}" for name in self.model.names[:d]]
                self.worth.add(x - low - size - drift, high - x - size - drift, slab, sd**2, names)
                sd_y[t], dr_y[t] = self._outputs(t, reach)
            if t < steps:
                sd_u[t], dr_u[t], slabs[t, d:] = self._step(t, reach)
        return self.worth, Spreads((sd_x, dr_x), (sd_y, dr_y), (sd_u, dr_u), slabs)

    def _outputs(self, t: int, reach: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Add the limits of outputs; return deviations and drifts (p,) of the first candidate."""
        low, high = self.nominal.limits.outputs[:, t]
        y, matrix = self.nominal.outputs[0][t], self.nominal.outputs[1][t]
        drift, variance = self.of_rows(t, matrix)
        if np.any(self.model.bent_outputs):
            ends = self.ends[0][: self.d], self.ends[1][: self.d]
            at = self.nominal.states[t]
            drift = drift + remainders(self.model.output, at, matrix, np.zeros_like(matrix), reach.T, ends).T * OUTWARD
        here = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
        sd = np.sqrt(np.maximum(variance, 0.0)) * OUTWARD
        if len(here):
            size = INWARD * (np.abs(y) + 1e-3)
            names = [f"output {k} at step {t}" for k in here]
            rows = (y - low - size - drift)[:, here], (high - y - size - drift)[:, here]
            self.worth.add(*rows, np.full((self.n, len(here)), np.inf), sd[:, here] ** 2, names)
        return sd[0], drift[0]

    def _step(self, t: int, reach: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Go on by a step; return deviations and drifts of inputs and slabs of inputs and noises, of the first one."""
        nominal, d, m = self.nominal, self.d, self.m
        gain, u, agent = self.feedback.gains[:, t], nominal.inputs[t], self.agent
        drift, variance = self.of_rows(t, gain)
        sd = np.sqrt(np.maximum(variance, 0.0)) * OUTWARD
        moved = np.any(gain != 0.0, axis=2)
        asked = moved & self.model.bent[d:]
        slab = np.where(asked, self.feedback.slabs[:, d : d + m] * sd + self.least[d:], np.inf)
        size = np.einsum("nmd,nd->nm", np.abs(gain), reach)
        around = np.where(moved, np.minimum(slab + drift, size) * OUTWARD + 1e-13 * np.abs(u), 0.0)
        spare = INWARD * (np.abs(u) + 1e-3)
        low = np.where(moved, u - agent.input_low - drift - spare, np.inf)
        high = np.where(moved, agent.input_high - u - drift - spare, np.inf)
        names = [f"{name} at step {t}" for name in self.model.names[d : d + m]]
        self.worth.add(low, high, slab, sd**2, names)
        ends, at = self.ends, np.concatenate([nominal.states[t], u, self.model.calm])
        half = np.repeat((0.5 * (self.model.unknown[1] - self.model.unknown[0]))[:, None], self.n, axis=1)
        boxes = np.concatenate([reach.T, around.T, half])
        A, B = nominal.linear[0][t], nominal.linear[1][t]
        matrix = np.hstack([A, B, np.zeros((d, len(half)))])
        centre = np.hstack([np.zeros((d, d + m)), nominal.by_unknowns[t]])
        off = remainders(self.model.motion, at, matrix, centre, boxes, ends).T
        noise_slab = np.full((self.n, d), np.inf)
        if self.model.scale is not None:
            varied = remainders(self.model.scale, at, np.zeros_like(matrix), nominal.scales[1][t], boxes, ends).T
            is_varied = self.model.varied & (self.model.deviations > 0.0)
            noise_slab = np.where(is_varied, self.feedback.slabs[:, d + m :], np.inf)
            off = off + np.where(is_varied, varied * self.model.deviations * np.where(is_varied, noise_slab, 0.0), 0.0)
            nothing = np.full((self.n, d), np.inf)
            noises = [f"noise of {name} at step {t}" for name in self.model.names[:d]]
            self.worth.add(nothing, nothing, noise_slab, np.ones((self.n, d)), noises)
        width = agent.state_high - agent.state_low
        # What is lost stays so; numbers remain finite, so that scores can be compared.
        off = np.where(np.isfinite(off), np.minimum(off, self.lost), self.lost) + 1e-13 * width
        closed = A + np.matmul(B, gain)
        self.products[:, : t + 1] = np.clip(np.matmul(closed[:, None], self.products[:, : t + 1]), -1e30, 1e30)
        self.products[:, t + 1] = np.eye(d)
        self.drifts[:, t + 1] = off
        covariance = np.matmul(np.matmul(closed, self.covariance), closed.swapaxes(1, 2)) + nominal.noise(t)
        self.covariance = np.clip(covariance, -1e60, 1e60)
        return sd[0], drift[0], np.concatenate([slab[0], noise_slab[0]])


def regulators(nominal: NominalPath, weights: FloatArray, held: NDArray[np.bool_]) -> FloatArray:
    """Return the feedbacks (N, S, m, d) of linear-quadratic problems along a nominal path.

    Parameters
    ----------
    weights : (N, d + m + 1) array
        Costs of states and inputs, and the factor on those of the last states.
    held : (S, m) bool array
        Inputs that stay at their nominal values: those at a limit.
    """
    A, B = nominal.linear
    d, m, steps = A.shape[1], B.shape[2], len(A)
    n = len(weights)
    P = np.zeros((n, d, d))
    index = np.arange(d)
    P[:, index, index] = weights[:, :d] * weights[:, -1:]
    R = np.zeros((n, m, m))
    R[:, np.arange(m), np.arange(m)] = weights[:, d : d + m]
    gains = np.zeros((n, steps, m, d))
    for t in range(steps - 1, -1, -1):
        free = np.where(held[t], 0.0, B[t])
        PB = np.matmul(P, free)
        gain = -np.linalg.solve(R + np.matmul(free.T, PB), np.matmul(PB.swapaxes(1, 2), A[t]))
        gain = np.where(held[t][:, None], 0.0, gain)
        closed = A[t] + np.matmul(free, gain)
        P = np.matmul(A[t].T, np.matmul(P, closed))
        P = 0.5 * (P + P.swapaxes(1, 2))
        P[:, index, index] += weights[:, :d]
        gains[:, t] = gain
    return gains
