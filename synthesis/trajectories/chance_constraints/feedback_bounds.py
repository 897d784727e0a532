"""What feedbacks and strips along a nominal path are worth: the bound of the certificate, for many of them at once.

The mathematics is that of docs/theory/paths.md, "Agents of any dynamics", in plain floating point; a certificate says a
little less than what is found here, and the check decides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.distributions import Tail
from ...relations.grids import FloatArray
from .limit_rows import INWARD, OUTWARD, PAIR, Worth
from .nonlinear_model import Curved, NonlinearModel, Tube, remainders
from .path_limits import Limits

LEAST = 1e-6
"""Strips, as a share of the range of a state, of states without noise: the check knows variances up to rounding alone,
which leaves a deviation of some 1e-8 of the range where there is none."""

LOST = 1e6
"""Drift, in ranges of states, from which a candidate is given up."""


Both = tuple[FloatArray, FloatArray]
"""How far something reaches below and above."""


@dataclass(frozen=True, eq=False)
class Feedback:
    """Candidates: gains (N, S, m, d), and strips (N, S + 1, d + m) in deviations of states and inputs."""

    gains: FloatArray
    strips: FloatArray


@dataclass(frozen=True, eq=False)
class Spreads:
    """Deviations, linearization errors and shifts of candidates, by which a nominal path is planned anew.

    Arrays (S + 1, .., d), (S + 1, .., p) and (S, .., m) of states, outputs and inputs; ``strips`` (S + 1, .., d + m)
    are those of the certificate. Between times and numbers stand the candidates, if there are several. True values are
    within a linearization error of linear deviations around shifted nominal values.
    """

    states: tuple[FloatArray, FloatArray, FloatArray]
    outputs: tuple[FloatArray, FloatArray, FloatArray]
    inputs: tuple[FloatArray, FloatArray, FloatArray]
    strips: FloatArray
    pairs: Mapping[int, tuple[FloatArray, ...]] = field(default_factory=dict)
    """By times: linearization errors, variances and what one step adds to these (.., J), of what pairs ask of the
    agent; then what each number of noise that agents share adds to its rows (.., J, t K), which is not in these
    variances; and shifts (.., J)."""

    def of(self, candidate: int) -> Spreads:
        """Return those of one candidate."""

        def one(each: tuple[FloatArray, FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
            return each[0][:, candidate], each[1][:, candidate], each[2][:, candidate]

        pairs = {t: tuple(part[candidate] for part in parts) for t, parts in self.pairs.items()}
        return Spreads(one(self.states), one(self.outputs), one(self.inputs), self.strips[:, candidate], pairs)


@dataclass(frozen=True, eq=False)
class OtherSides:
    """What pairs ask of one agent at one time, as the other agents are now.

    Parameters
    ----------
    forms : (.., J, p) array
        Forms of the agent's outputs.
    low, high : (.., J) arrays
        Distances of the nominal differences from their limits, less the linearization errors of the others.
    variance, largest : (.., J) arrays
        Variances that the others add by what is theirs alone, and what one step adds to these at most.
    shared : (.., J, t K) array
        What they add by each number of noise that agents share.
    """

    forms: FloatArray
    low: FloatArray
    high: FloatArray
    variance: FloatArray
    largest: FloatArray
    shared: FloatArray


@dataclass(frozen=True, eq=False)
class NominalPath:
    """Nominal states (S + 1, d) and inputs (S, m) of an agent, with the limits along them; ``pairs`` by times."""

    model: NonlinearModel
    limits: Limits
    states: FloatArray
    inputs: FloatArray
    pairs: Mapping[int, OtherSides] = field(default_factory=dict)

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
        return self.slopes_by_unknowns(np.arange(len(self.inputs)))

    def slopes_by_unknowns(self, times: NDArray[np.int64]) -> FloatArray:
        """Return the sizes (S, d, k) of the derivatives by what is unknown, at times (S,)."""
        d, m = self.model.agent.n_states, self.model.agent.n_inputs
        variables = self.model.variables(self.states[:-1].T, self.inputs.T, times)
        _, slopes = self.model.motion.slopes(variables)
        both = np.broadcast_to(slopes, (*slopes.shape[:2], len(self.inputs)))
        return np.abs(np.moveaxis(both, 2, 0)[:, :, d + m :])

    @cached_property
    def scales(self) -> tuple[FloatArray, FloatArray]:
        """Nominal multipliers (S, d) of the noise, and their derivatives (S, d, v)."""
        return self.scales_at(np.arange(len(self.inputs)))

    def scales_at(self, times: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Return the multipliers (S, d) of the noise, and their derivatives (S, d, v), at times (S,)."""
        assert self.model.scale is not None
        variables = self.model.variables(self.states[:-1].T, self.inputs.T, times)
        values, slopes = self.model.scale.slopes(variables)
        both = np.broadcast_to(slopes, (*slopes.shape[:2], len(self.inputs)))
        return np.broadcast_to(values, (len(values), len(self.inputs))).T, np.moveaxis(both, 2, 0)

    @cached_property
    def noises(self) -> FloatArray:
        """Covariances (S, d, d) of the noise."""
        agent, steps = self.model.agent, len(self.inputs)
        if self.model.scale is None:
            return np.broadcast_to(self.model.covariance, (steps, agent.n_states, agent.n_states))
        squares = (self.scales[0] * self.model.deviations) ** 2
        return squares[:, :, None] * np.eye(agent.n_states)

    def many(self, states: FloatArray, inputs: FloatArray) -> list[NominalPath]:
        """Return paths along states (N, S + 1, d) and inputs (N, S, m) near this one, with its limits.

        Their derivatives are computed at once. Pairs are kept apart in the directions in which they are now.
        """
        n, steps, d = len(states), inputs.shape[1], states.shape[2]
        model, limits, cls = self.model, self.limits, type(self)
        values, matrices = model.outputs(states.reshape(n * (steps + 1), d))
        moved = values.reshape(n, steps + 1, -1) - self.outputs[0]
        pairs: list[dict[int, OtherSides]] = [{} for _ in range(n)]
        for t, asked in self.pairs.items():
            for beside, nearer in zip(pairs, moved[:, t] @ asked.forms.T, strict=True):
                beside[t] = replace(asked, low=asked.low + nearer, high=asked.high - nearer)
        paths = [cls(model, limits, *one) for one in zip(states, inputs, pairs, strict=True)]
        # All of them one after another are one long path, of steps that begin anew.
        x, u = states[:, :-1].reshape(n * steps, d), inputs.reshape(n * steps, -1)
        times = np.tile(np.arange(steps), n)
        together = cls(model, limits, np.concatenate([x, x[-1:]]), u)
        parts: dict[str, tuple[FloatArray, ...]] = {
            "linear": model.linear(x, u, times), "by_unknowns": (together.slopes_by_unknowns(times),),
        }  # fmt: skip
        if model.scale is not None:
            parts["scales"] = together.scales_at(times)
        each = {name: [np.split(part, n) for part in found] for name, found in parts.items()}
        each["outputs"] = [np.split(values, n), np.split(matrices, n)]
        for k, path in enumerate(paths):
            for name, found in each.items():
                own = tuple(part[k] for part in found)
                path.__dict__[name] = own if len(own) > 1 else own[0]
        return paths

    def worth(self, feedback: Feedback) -> tuple[Worth, Spreads]:
        """Return the rows of all candidates, and the spreads of the first one."""
        worth, spreads = worth_of([self], feedback, np.zeros(len(feedback.gains), dtype=np.int64))
        return worth, spreads.of(0)


def worth_of(paths: Sequence[NominalPath], feedback: Feedback, which: NDArray[np.int64]) -> tuple[Worth, Spreads]:
    """Return rows and spreads of N candidates at once, each along the path ``which`` (N,), of agents that are alike."""
    return _Walk(paths, feedback, which).walked()


class _Walk:
    """One walk with N candidates along the nominal paths of agents with one model and the same ranges."""

    def __init__(self, paths: Sequence[NominalPath], feedback: Feedback, which: NDArray[np.int64]) -> None:
        self.model, self.feedback, self.n = paths[0].model, feedback, len(which)
        agent = self.agent = self.model.agent
        self.d, self.m, self.steps = agent.n_states, agent.n_inputs, len(paths[0].inputs)

        # What belongs to the paths, candidate by candidate: times, candidates, and the rest.
        def each(read: Callable[[NominalPath], FloatArray]) -> FloatArray:
            return np.stack([read(path) for path in paths], axis=1)[:, which]

        self.x, self.u = each(lambda p: p.states), each(lambda p: p.inputs)
        self.A, self.B = each(lambda p: p.linear[0]), each(lambda p: p.linear[1])
        self.y, self.C = each(lambda p: p.outputs[0]), each(lambda p: p.outputs[1])
        self.unknowns, self.noises = each(lambda p: p.by_unknowns), each(lambda p: p.noises)
        self.limits_x = each(lambda p: p.limits.states[0]), each(lambda p: p.limits.states[1])
        self.limits_y = each(lambda p: p.limits.outputs[0]), each(lambda p: p.limits.outputs[1])
        self.jumps = each(lambda p: p.limits.jumps[0]), each(lambda p: p.limits.jumps[1])
        self.jumped: tuple[FloatArray, ...] | None = None
        if self.model.scale is not None:
            self.slope_forms = np.moveaxis(each(lambda p: p.scales[1]), 1, 3)
        self.asked = _padded(paths, which)
        self.needs_outputs = any(len(path.limits.limited) or path.pairs for path in paths)
        self.needs_outputs |= any(bool(np.any(np.isfinite(ends))) for ends in self.jumps)
        self.shared = self.model.shared
        steps, d = self.steps, self.d
        # Closed loops since each remainder stand side by side, (N, d, S + 1, d): a step multiplies them all at once.
        self.products = np.zeros((self.n, d, steps + 1, d))
        self.linearization_errors, self.shifts = np.zeros((2, self.n, steps + 1, d))
        # The set of starts stands before the first remainder. Steps that leave none, as those of linear agents do, have
        # no place here: what they round has a covariance.
        self.products[:, :, 0] = np.eye(d)
        self.keeps_all = self.model.tail == Tail.LONG or self.shared is not None
        self.faint = np.zeros((self.n, d, d))
        starts = [np.maximum(p.model.agent.initial.high - p.states[0], p.states[0] - p.model.agent.initial.low)
                  for p in paths]  # fmt: skip
        self.linearization_errors[:, 0] = np.array(starts)[which]
        self.count = int(self.keeps_all or bool(np.any(self.linearization_errors[:, 0])))
        self.covariance, self.each_noise = np.zeros((self.n, d, d)), np.zeros((self.n, steps, d, d))
        self.worth = Worth(tail=self.model.tail, lost=steps * self.model.lost)
        width = agent.state_high - agent.state_low
        self.least = LEAST * np.concatenate([width, np.maximum(agent.input_high - agent.input_low, 1e-9)])
        self.ends = self.model.ends
        self.lost, self.rounded = LOST * width, np.diag((1e-13 * width) ** 2)
        self.forms, self.centres = self._derivatives()
        self.rows, self.parts = self._rows()
        self.found: tuple[FloatArray, ...] = ()
        self.carried: FloatArray | None = None  # covariances (N, d, d) of deviations with those a step earlier

    def _derivatives(self) -> tuple[FloatArray, FloatArray]:
        """Return matrices (S, d, v, N) of the linear forms of steps, and what derivatives are off from them."""
        unknown = self.unknowns
        forms = np.concatenate([self.A, self.B, np.zeros_like(unknown)], axis=3)
        centres = np.concatenate([np.zeros((*unknown.shape[:3], self.d + self.m)), unknown], axis=3)
        return np.moveaxis(forms, 1, 3), np.moveaxis(centres, 1, 3)

    def _rows(self) -> tuple[list[FloatArray], dict[str, slice]]:
        """Return rows (N, J, d) of which something is asked at each time, and which of them are about what."""
        n, d, steps = self.n, self.d, self.steps
        gains = np.moveaxis(self.feedback.gains, 1, 0)
        eye = np.broadcast_to(np.eye(d), (steps + 1, n, d, d))
        blocks = {"states": eye, "outputs": self.C, "inputs": gains}
        ends = np.cumsum([0, *(block.shape[2] for block in blocks.values())])
        parts = {name: slice(a, b) for name, a, b in zip(blocks, ends[:-1], ends[1:], strict=True)}
        # the last states and outputs have no inputs beside them
        rows = np.concatenate([eye[:-1], self.C[:-1], gains], axis=2)
        return [*rows, np.concatenate([eye[-1], self.C[-1]], axis=1)], parts

    def known(self, part: str) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return shifts, linearization errors and variances (N, J) of some rows at the time where the walk is."""
        shift, linearization_error, variance = (each[:, self.parts[part]] for each in self.found)
        return shift, linearization_error, variance

    def of_rows(self, t: int, rows: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return shifts, linearization errors and variances (N, J) of rows (J, d) or (N, J, d) at time t."""
        rows = np.broadcast_to(rows, (self.n, *rows.shape[-2:]))
        moved = np.matmul(rows, self.products_to(self.count))
        shifts, linearization_errors = (
            each[:, : self.count].reshape(self.n, -1, 1) for each in (self.shifts, self.linearization_errors)
        )
        shift, linearization_error = (
            np.matmul(moved, shifts)[..., 0],
            np.matmul(np.abs(moved), linearization_errors)[..., 0],
        )
        # A sum of t d numbers is at most the root of t d times the sum of their squares.
        faint = np.maximum(np.sum(np.matmul(rows, self.faint) * rows, axis=2), 0.0)
        linearization_error = linearization_error + np.sqrt(t * self.d * faint)
        return shift, linearization_error * OUTWARD, np.sum(np.matmul(rows, self.covariance) * rows, axis=2)

    def _together(self, t: int, earlier: FloatArray | None) -> FloatArray:
        """Return the correlations (N, J) of rows at time t with themselves one step earlier, about."""
        rows, variance = self.rows[t], self.found[-1]
        if earlier is None or self.carried is None:
            return np.zeros(variance.shape)
        covariance = np.sum(np.matmul(rows, self.carried) * self.rows[t - 1][:, : rows.shape[1]], axis=2)
        size = np.sqrt(np.maximum(variance * earlier[:, : rows.shape[1]], 1e-300))
        return np.asarray(np.clip(covariance / size, -1.0, 1.0))

    def products_to(self, count: int, first: int = 0) -> FloatArray:
        """Return the closed loops since some remainders, side by side (N, d, .. d)."""
        return self.products[:, :, first:count].reshape(self.n, self.d, -1)

    def moved_by(self, t: int, rows: FloatArray) -> FloatArray:
        """Return rows (N, J, d) as rows (N, t, J, d) of the noise of each step before t."""
        moved = np.matmul(rows, self.products_to(t + 1, 1)).reshape(*rows.shape[:2], t, self.d)
        return np.asarray(moved.swapaxes(1, 2))

    def largest(self, t: int, rows: FloatArray) -> FloatArray | None:
        """Return what one step adds at most to these variances (N, J); None where no tail depends on it."""
        if self.model.tail != Tail.LONG or t == 0:
            return None
        rows = np.broadcast_to(rows, (self.n, *rows.shape[-2:]))
        moved = self.moved_by(t, rows)
        each = np.sum(np.matmul(moved, self.each_noise[:, :t]) * moved, axis=3)
        return np.asarray(each.max(axis=1)) * OUTWARD

    def by_sources(self, t: int, rows: FloatArray) -> FloatArray:
        """Return what each number of shared noise adds to rows (N, J, d) at time t, as (N, J, t K)."""
        if self.shared is None:
            return np.zeros((*rows.shape[:2], 0))
        each = np.matmul(self.moved_by(t, rows), self.shared)
        return np.asarray(each.swapaxes(1, 2).reshape(*rows.shape[:2], -1))

    def walked(self) -> tuple[Worth, Spreads]:
        d, m, n, steps, bent = self.d, self.m, self.n, self.steps, self.model.bent
        states, outputs = np.zeros((3, steps + 1, n, d)), np.zeros((3, steps + 1, n, self.agent.n_outputs))
        inputs, pairs = np.zeros((3, steps, n, m)), dict[int, tuple[FloatArray, ...]]()
        strips = np.full((steps + 1, n, d + m), np.inf)
        eye = np.eye(d)
        for t in range(steps + 1):
            x = self.x[t]
            earlier = self.found[-1] if t else None
            self.found = self.of_rows(t, self.rows[t])
            self.together = self._together(t, earlier)
            shift, linearization_error, variance = self.known("states")
            sd = np.sqrt(np.maximum(variance, 0.0)) * OUTWARD
            asked = bent[:d] if t < steps else self.model.bent_outputs
            if self.needs_outputs:
                asked = asked | self.model.bent_outputs
            asked = asked | self.model.tubed
            strip = np.where(asked, self.feedback.strips[:, t, :d] * sd + self.least[:d], np.inf)
            wide = strip + linearization_error if t else linearization_error
            # The tube lies around what the path is shifted to, within the workspace.
            rest = x - self.agent.state_low, self.agent.state_high - x
            reach = (
                np.maximum(np.minimum(wide - shift, rest[0]), 0.0),
                np.maximum(np.minimum(wide + shift, rest[1]), 0.0),
            )
            states[:, t], strips[t, :, :d] = (sd, linearization_error, shift), strip
            if t:
                low, high = (end[t] for end in self.limits_x)
                size = INWARD * np.abs(x)
                names = [f"{name} at step {t}" for name in self.model.names[:d]]
                below = x + shift - low - size - linearization_error
                above = high - x - shift - size - linearization_error
                correlation = self.together[:, self.parts["states"]]
                self.worth.add(below, above, strip, sd**2, names, self.largest(t, eye), correlation)
                outputs[:, t] = self._outputs(t, reach)
                self._land(t, reach)
                if t in self.asked:
                    pairs[t] = self._pairs(t, reach, self.asked[t])
            if t < steps:
                *inputs[:, t], strips[t, :, d:] = self._step(t, reach)
        spreads = [(each[0], each[1], each[2]) for each in (states, outputs, inputs)]
        return self.worth, Spreads(spreads[0], spreads[1], spreads[2], strips, pairs)

    def _off_outputs(self, t: int, reach: Both) -> tuple[FloatArray, FloatArray]:
        """Return what outputs (N, p) are off their linear forms: middles and half widths."""
        if not np.any(self.model.bent_outputs):
            return np.zeros(self.y[t].shape), np.zeros(self.y[t].shape)
        ends = self.ends[0][: self.d], self.ends[1][: self.d]
        matrix = np.moveaxis(self.C[t], 0, 2)
        tube = Tube.around(self.x[t].T, (reach[0].T, reach[1].T), ends)
        middle, off = remainders(tube.curved(self.model.output), tube, matrix, np.zeros_like(matrix))
        return middle.T, off.T * OUTWARD

    def _outputs(self, t: int, reach: Both) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Add the limits of outputs; return their deviations, linearization errors and shifts (N, p)."""
        low, high = (end[t] for end in self.limits_y)
        y = self.y[t]
        shift, linearization_error, variance = self.known("outputs")
        middle, off = self._off_outputs(t, reach)
        shift, linearization_error = shift + middle, linearization_error + off
        here = np.flatnonzero(np.any(np.isfinite(low) | np.isfinite(high), axis=0))
        sd = np.sqrt(np.maximum(variance, 0.0)) * OUTWARD
        if len(here):
            size = INWARD * (np.abs(y) + 1e-3)
            names = [f"output {k} at step {t}" for k in here]
            rows = (
                (y + shift - low - size - linearization_error)[:, here],
                (high - y - shift - size - linearization_error)[:, here],
            )
            nothing, largest = np.full((self.n, len(here)), np.inf), self.largest(t, self.C[t][:, here])
            correlation = self.together[:, self.parts["outputs"]][:, here]
            self.worth.add(*rows, nothing, sd[:, here] ** 2, names, largest, correlation)
        return sd, linearization_error, shift

    def _jump(
        self, t: int, reach: Both, closed: FloatArray, step: tuple[FloatArray, FloatArray, FloatArray]
    ) -> tuple[FloatArray, ...] | None:
        """Return shifts, linearization errors, variances and largest ones (N, p) of how outputs move from time t to the
        next.

        A step has a middle and a half width (N, d) of its remainder, and noise (N, d, d). None where nothing is asked.
        """
        if not any(np.any(np.isfinite(end[t + 1])) for end in self.jumps):
            return None
        middle, off, noise = step
        after, before = self.C[t + 1], self.C[t]
        form = np.matmul(after, closed) - before
        (shift, linearization_error, variance), largest = self.of_rows(t, form), self.largest(t, form)
        own = np.sum(np.matmul(after, noise) * after, axis=2)
        middle_y, off_y = self._off_outputs(t, reach)
        shift = shift + np.einsum("npd,nd->np", after, middle) - middle_y
        linearization_error = linearization_error + np.einsum("npd,nd->np", np.abs(after), off) * OUTWARD + off_y
        return shift, linearization_error, variance + own, np.maximum(variance if largest is None else largest, own)

    def _land(self, t: int, reach: Both) -> None:
        """Add the limits of how far outputs moved in the step before."""
        if self.jumped is None:
            return
        shift, linearization_error, variance, largest = self.jumped
        middle, off = self._off_outputs(t, reach)
        moved, size = self.y[t] - self.y[t - 1] + shift + middle, INWARD * (np.abs(self.y[t]) + 1e-3)
        low, high = (end[t] for end in self.jumps)
        here = np.flatnonzero(np.any(np.isfinite(low) | np.isfinite(high), axis=0))
        spare = size + linearization_error + off
        rows = (moved - low - spare)[:, here], (high - moved - spare)[:, here]
        names = [f"jump of output {k} to step {t}" for k in here]
        variance, largest = variance[:, here] * OUTWARD, largest[:, here] * OUTWARD
        self.worth.add(*rows, np.full((self.n, len(here)), np.inf), variance, names, largest)

    def _pairs(self, t: int, reach: Both, asked: OtherSides) -> tuple[FloatArray, ...]:
        """Add the limits of differences of this agent and others; return what it adds to them (N, J).

        That are linearization errors, variances by what it does not share, what one step adds to these, what sources
        add, and shifts.
        """
        rows = np.matmul(asked.forms, self.C[t])
        (shift, linearization_error, variance), largest = self.of_rows(t, rows), self.largest(t, rows)
        largest = variance if largest is None else largest
        if np.any(self.model.bent_outputs):
            middle, off = self._off_outputs(t, reach)
            shift = shift + np.einsum("njp,np->nj", asked.forms, middle)
            linearization_error = linearization_error + np.einsum("njp,np->nj", np.abs(asked.forms), off) * OUTWARD
        nothing = np.full(linearization_error.shape, np.inf)
        names = [f"{PAIR} at step {t}"] * linearization_error.shape[1]
        shared = self.by_sources(t, rows)
        variance = np.maximum(variance - np.sum(shared**2, axis=2), 0.0)
        together = np.sum(both_sources(shared, asked.shared) ** 2, axis=2)
        both = variance + asked.variance + together, largest + asked.largest
        self.worth.add(
            asked.low + shift - linearization_error,
            asked.high - shift - linearization_error,
            nothing,
            both[0],
            names,
            both[1],
        )
        return linearization_error, variance, largest, shared, shift

    def _tube(self, t: int, reach: Both, around: Both) -> Tube:
        """Return the tube of a step: how far states (N, d) and inputs (N, m) reach below and above."""
        at = np.concatenate([self.x[t].T, self.u[t].T, self.model.known(self.n, t)])
        least, most = self.model.unknown_at(t)
        half = np.repeat(0.5 * (most - least), self.n, axis=1)
        half = np.concatenate([half, np.zeros((self.agent.names_time * 1, self.n))])  # the time is known
        sides = [np.concatenate([states.T, inputs.T, half]) for states, inputs in zip(reach, around, strict=True)]
        return Tube.around(at, (sides[0], sides[1]), self.ends, self.feedback.gains[:, t])

    def _step(self, t: int, reach: Both) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Go on by a step; return deviations, errors, shifts and strips of inputs."""
        inputs, strip, around = self._inputs(t, reach)
        tube = self._tube(t, reach, around)
        curved = tube.curved(self.model.step_parts)
        middle, off = (part.T for part in remainders(curved[: self.d], tube, self.forms[t], self.centres[t]))
        noise = self._varied_noise(t, tube, curved[self.d :])
        # What is lost stays so; numbers remain finite, so that scores can be compared.
        is_known = np.isfinite(off) & np.isfinite(middle) & (np.abs(middle) < self.lost)
        middle = np.where(is_known, middle, 0.0)
        off = np.where(is_known, np.minimum(off, self.lost), self.lost)
        closed = self.A[t] + np.matmul(self.B[t], self.feedback.gains[:, t])
        self.jumped = self._jump(t, reach, closed, (middle, off, noise))
        self._advance(t, closed, (middle, off, noise))
        return *inputs, strip

    def _inputs(self, t: int, reach: Both) -> tuple[tuple[FloatArray, FloatArray, FloatArray], FloatArray, Both]:
        """Add the limits of inputs; return deviations, linearization errors, shifts, strips, and their reach."""
        d, gain, u, agent = self.d, self.feedback.gains[:, t], self.u[t], self.agent
        shift, linearization_error, variance = self.known("inputs")
        sd = np.sqrt(np.maximum(variance, 0.0)) * OUTWARD
        moved = np.any(gain != 0.0, axis=2)
        strips = self.feedback.strips[:, t, d : d + self.m]
        strip = np.where(moved & self.model.bent[d:], strips * sd + self.least[d:], np.inf)
        # No input is farther from its nominal value than the states that it follows.
        size = np.einsum("nmd,nd->nm", np.abs(gain), np.maximum(*reach))
        wide, rounded = strip + linearization_error, 1e-13 * np.abs(u)
        below = np.where(moved, np.minimum(np.maximum(wide - shift, 0.0), size) * OUTWARD + rounded, 0.0)
        above = np.where(moved, np.minimum(np.maximum(wide + shift, 0.0), size) * OUTWARD + rounded, 0.0)
        spare = linearization_error + INWARD * (np.abs(u) + 1e-3)
        low = np.where(moved, u + shift - agent.input_low - spare, np.inf)
        high = np.where(moved, agent.input_high - u - shift - spare, np.inf)
        names = [f"{name} at step {t}" for name in self.model.names[d : d + self.m]]
        self.worth.add(low, high, strip, sd**2, names, self.largest(t, gain), self.together[:, self.parts["inputs"]])
        return (sd, linearization_error, shift), strip, (below, above)

    def _varied_noise(self, t: int, tube: Tube, curved: Curved) -> FloatArray:
        """Return covariances (N, d, d) of the noise of a step: scales are anything up to the largest on the tube."""
        d, noise = self.d, self.noises[t]
        if self.model.scale is None:
            return noise
        slopes, deviations = self.slope_forms[t], self.model.deviations
        bent, more = remainders(curved, tube, np.zeros_like(slopes), np.abs(slopes), follows=False)
        varied = (np.abs(bent) + more).T * deviations
        is_varied = self.model.varied & (deviations > 0.0)
        own = np.where(is_varied, np.sqrt(np.einsum("nkk->nk", noise)) + varied * OUTWARD, 0.0)
        noise = np.where(is_varied[:, None] * np.eye(d, dtype=bool), own[:, :, None] ** 2, noise)
        self.worth.stop(np.full(self.n, bool(np.any(is_varied))))
        return noise

    def _advance(self, t: int, closed: FloatArray, step: tuple[FloatArray, FloatArray, FloatArray]) -> None:
        """Go on by a closed loop (N, d, d), to which a step adds a middle and a half width (N, d), and noise."""
        (middle, off, noise), k = step, self.count
        moved = np.clip(np.matmul(closed, self.products_to(k)), -1e30, 1e30)
        self.products[:, :, :k] = moved.reshape(self.n, self.d, k, self.d)
        if self.keeps_all or np.any(off) or np.any(middle):
            self.products[:, :, k] = np.eye(self.d)
            self.shifts[:, k], self.linearization_errors[:, k], self.each_noise[:, t] = middle, off, noise
            self.count += 1
        self.faint = _moved(self.faint, closed) + self.rounded
        self.carried = np.matmul(closed, self.covariance)
        self.covariance = _moved(self.covariance, closed) + noise


def _moved(covariance: FloatArray, closed: FloatArray) -> FloatArray:
    """Return covariances (N, d, d) after a step of closed loops (N, d, d), as far as numbers reach."""
    return np.clip(np.matmul(np.matmul(closed, covariance), closed.swapaxes(1, 2)), -1e60, 1e60)


def both_sources(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return sums of what sources add to rows (.., J, n); one of them may know no sources (n = 0)."""
    return first + second if first.shape[-1] == second.shape[-1] else max(first, second, key=lambda one: one.shape[-1])


def _padded(paths: Sequence[NominalPath], which: NDArray[np.int64]) -> dict[int, OtherSides]:
    """Return what pairs ask of N candidates at each time, with rows that ask for nothing where some have fewer."""
    result = {}
    for t in sorted({t for path in paths for t in path.pairs}):
        most = max(len(path.pairs[t].low) for path in paths if t in path.pairs)
        p = paths[0].model.agent.n_outputs
        forms = np.zeros((len(paths), most, p))
        variance, largest = np.zeros((2, len(paths), most))
        low, high = np.full((len(paths), most), np.inf), np.full((len(paths), most), np.inf)
        shared = np.zeros((len(paths), most, max(path.pairs[t].shared.shape[1] for path in paths if t in path.pairs)))
        for k, path in enumerate(paths):
            if t in path.pairs:
                one = path.pairs[t]
                count = len(one.low)
                forms[k, :count], variance[k, :count], largest[k, :count] = one.forms, one.variance, one.largest
                low[k, :count], high[k, :count] = one.low, one.high
                shared[k, :count, : one.shared.shape[1]] = one.shared
        result[t] = OtherSides(forms[which], low[which], high[which], variance[which], largest[which], shared[which])
    return result
