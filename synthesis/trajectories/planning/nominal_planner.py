"""Nominal states and inputs that keep away from limits: sequential linear-quadratic problems with exact dynamics.

Limits are soft: a distance of z deviations from one costs ``-log Phi(z)``, which is the tail where that is small, and
grows like a square beyond the limit. What deviations there are, and what linearization error, is given. Dynamics are
hard, since every step of the iteration is a simulation under feedback. (Programs such as IPOPT find the same nonlinear
paths; the certificate needs none of them, and the package no dependence on a solver.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...relations.grids import FloatArray
from ..chance_constraints import Limits, NonlinearModel, PairAim, soft_costs
from .counted_work import CountedWork

STEPS = 0.5 ** np.arange(8)
"""Shares of a step that are tried at once."""

STILL = 1e-3
"""Improvement, as a share of the cost, from which the iteration ends."""

CALM = 1e-3
"""Cost of an input at half its range, so that inputs that nothing feels stay in the middle."""

REGULAR = 1e-6
"""First damping of the linear-quadratic problems."""


@dataclass(frozen=True, eq=False)
class Aim:
    """What a plan keeps away from, and what it follows.

    Parameters
    ----------
    limits : Limits
    states, outputs, inputs : pair of arrays
        Deviations (positive) and linearization errors, (S + 1, d), (S + 1, p) and (S, m).
    guess : (S + 1, p) array
        Outputs to follow, with a weight (p,) for each.
    weight : (p,) array
    pairs : sequence of PairAim
        Of a team, planned together as if it were one agent.
    """

    limits: Limits
    states: tuple[FloatArray, FloatArray]
    outputs: tuple[FloatArray, FloatArray]
    inputs: tuple[FloatArray, FloatArray]
    guess: FloatArray
    weight: FloatArray
    pairs: Sequence[PairAim] = ()

    @property
    def asks_of_outputs(self) -> bool:
        """Whether outputs cost anything."""
        return bool(np.any(self.weight)) or bool(len(self.limits.limited)) or bool(self.pairs)


def rolled(model: NonlinearModel, start: FloatArray, inputs: FloatArray) -> FloatArray:
    """Return the states (S + 1, d) that inputs (S, m) lead to from a start (d,)."""
    states = [start]
    for t, u in enumerate(inputs):
        states.append(model.step(states[-1][:, None], u[:, None], t)[:, 0])
    return np.array(states)


class Planner:
    """Plans for one agent and one aim; what they take is counted."""

    def __init__(self, model: NonlinearModel, aim: Aim, work: CountedWork) -> None:
        self.model, self.aim, self.work, agent = model, aim, work, model.agent
        self.middle, half = 0.5 * (agent.input_low + agent.input_high), 0.5 * (agent.input_high - agent.input_low)
        self.half = np.maximum(half, 1e-9)
        self.start = 0.5 * (agent.initial.low + agent.initial.high)

    def rolled(self, inputs: FloatArray) -> FloatArray:
        """Return the states (S + 1, d) that inputs (S, m) lead to."""
        return rolled(self.model, self.start, inputs)

    def cost(self, states: FloatArray, inputs: FloatArray) -> FloatArray:
        """Return the costs (n,) of states (S + 1, d, n) and inputs (S, m, n); infinite where agents ran away."""
        with np.errstate(all="ignore"):
            return self._cost(states, inputs)

    def _cost(self, states: FloatArray, inputs: FloatArray) -> FloatArray:
        aim = self.aim
        total = CALM * np.sum(((inputs - self.middle[:, None]) / self.half[:, None]) ** 2, axis=(0, 1))
        agent = self.model.agent
        ends = (agent.input_low, agent.input_high)
        total = total + soft_costs(inputs, ends, *aim.inputs)[0].sum(axis=(0, 1))
        total = total + soft_costs(states, aim.limits.states, *aim.states)[0].sum(axis=(0, 1))
        if aim.asks_of_outputs:
            s, d, n = states.shape
            flat = np.ascontiguousarray(np.moveaxis(states, 1, 0).reshape(d, -1))
            outputs = np.moveaxis(self.model.output.values(flat).reshape(-1, s, n), 0, 1)
            total = total + soft_costs(outputs, aim.limits.outputs, *aim.outputs)[0].sum(axis=(0, 1))
            total = total + np.sum(aim.weight[:, None] * (outputs - aim.guess[:, :, None]) ** 2, axis=(0, 1))
            for pairs in aim.pairs:
                total = total + pairs.cost(outputs)
        return np.where(np.isfinite(total), total, np.inf)

    def improved(self, inputs: FloatArray, rounds: int) -> tuple[FloatArray, FloatArray, float]:
        """Return states, inputs and cost after up to some rounds from given inputs."""
        with np.errstate(all="ignore"):  # agents that are unstable may run away from first inputs
            states = self.rolled(inputs)
        cost, damping = float(self.cost(states[:, :, None], inputs[:, :, None])[0]), REGULAR
        if not np.isfinite(cost):
            return states, inputs, np.inf
        for _ in range(rounds):
            self.work.planned(len(inputs), len(self.start), 1)
            push, gain = self._feedback(states, inputs, damping)
            tried_x, tried_u = self._simulated(states, inputs, push, gain)
            costs = self.cost(tried_x, tried_u)
            best = int(np.argmin(costs))
            if not costs[best] < cost:
                damping = max(damping, 1e-6) * 30.0
                if damping > 1e6:
                    break
                continue
            gained = cost - float(costs[best])
            states, inputs, cost = tried_x[:, :, best], tried_u[:, :, best], float(costs[best])
            damping = max(1e-9, damping / 5.0)
            if gained < STILL * (1e-3 + cost):
                break
        return states, inputs, cost

    def _feedback(self, states: FloatArray, inputs: FloatArray, damping: float) -> tuple[FloatArray, FloatArray]:
        """Return steps (S, m) and gains (S, m, d) of the linear-quadratic problem around a nonlinear path."""
        aim, agent = self.aim, self.model.agent
        A, B = self.model.linear(states[:-1], inputs)
        steps, d, m = A.shape[0], A.shape[1], B.shape[2]
        _, slope, bend = soft_costs(states[:, :, None], aim.limits.states, *aim.states)
        gx, hx = slope[:, :, 0], np.zeros((steps + 1, d, d))
        hx[:, np.arange(d), np.arange(d)] = bend[:, :, 0]
        if aim.asks_of_outputs:
            y, C = self.model.outputs(states)
            _, slope, bend = soft_costs(y[:, :, None], aim.limits.outputs, *aim.outputs)
            first = slope[:, :, 0] + 2.0 * aim.weight * (y - aim.guess)
            second = bend[:, :, 0] + 2.0 * aim.weight
            full = np.zeros((steps + 1, y.shape[1], y.shape[1]))
            full[:, np.arange(y.shape[1]), np.arange(y.shape[1])] = second
            for pairs in aim.pairs:
                slopes, second_derivatives = pairs.derivatives(y)
                first, full = first + slopes, full + second_derivatives
            gx = gx + np.einsum("tp,tpd->td", first, C)
            hx = hx + np.matmul(C.swapaxes(1, 2), np.matmul(full, C))
        _, slope, bend = soft_costs(inputs[:, :, None], (agent.input_low, agent.input_high), *aim.inputs)
        gu = slope[:, :, 0] + 2.0 * CALM * (inputs - self.middle) / self.half**2
        hu = bend[:, :, 0] + 2.0 * CALM / self.half**2
        push, gain = np.zeros((steps, m)), np.zeros((steps, m, d))
        v, V = gx[-1], hx[-1]
        width = agent.state_high - agent.state_low
        damped = damping * np.diag(1.0 / width**2)
        for t in range(steps - 1, -1, -1):
            BV = B[t].T @ (V + damped)
            Q = np.diag(hu[t] + damping / self.half**2) + BV @ B[t]
            # Inputs that stand at a limit and are pushed beyond stay there.
            q = gu[t] + B[t].T @ v
            stuck = ((inputs[t] <= agent.input_low) & (q > 0.0)) | ((inputs[t] >= agent.input_high) & (q < 0.0))
            free = np.flatnonzero(~stuck)
            both = np.column_stack([q, BV @ A[t]])
            solved = np.zeros((m, d + 1))
            if len(free):
                solved[free] = -np.linalg.solve(Q[np.ix_(free, free)], both[free])
            push[t], gain[t] = solved[:, 0], solved[:, 1:]
            closed = A[t] + B[t] @ gain[t]
            v = gx[t] + gain[t].T @ (gu[t] + hu[t] * push[t]) + closed.T @ (v + V @ (B[t] @ push[t]))
            V = hx[t] + gain[t].T @ (hu[t][:, None] * gain[t]) + closed.T @ V @ closed
            V = 0.5 * (V + V.T)
        return push, gain

    def _simulated(
        self, states: FloatArray, inputs: FloatArray, push: FloatArray, gain: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return states (S + 1, d, n) and inputs (S, m, n) after shares of a step, under feedback, within the box."""
        agent = self.model.agent
        x = np.repeat(self.start[:, None], len(STEPS), axis=1)
        all_x, all_u = [x], []
        with np.errstate(all="ignore"):
            for t in range(len(inputs)):
                u = inputs[t][:, None] + push[t][:, None] * STEPS + gain[t] @ (x - states[t][:, None])
                u = np.clip(u, agent.input_low[:, None], agent.input_high[:, None])
                x = self.model.step(x, u, t)
                all_x.append(x)
                all_u.append(u)
        return np.array(all_x), np.array(all_u)
