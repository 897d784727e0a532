"""An agent as a search along nonlinear paths reads it: steps, derivatives and remainders, for many candidates at once.

Where dynamics name the time it is the last variable: one that is known at each step, and has no reach.

What is found here is only as good as it has to be to find something: the check computes everything again.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ....envs.systems.agents import TIME, AnyAgent, with_matrices
from ....envs.systems.distributions import Envelope, Tail
from ....envs.systems.expressions import Number, Operation, Program, Tree
from ...relations.grids import FloatArray
from .affine_forms import AffineForms

LATEST = 1e6
"""No step is later than that."""


@dataclass(frozen=True, eq=False)
class NonlinearModel:
    """The dynamics of an agent as programs of states, inputs and unknowns."""

    agent: AnyAgent
    shared: FloatArray | None = None
    """Factors (d, K) of sources of noise that other agents share; they are part of the agent's covariance."""
    beside: FloatArray | None = None
    """Ranges (2, S + 1, k) of what is unknown at each step, where others have paths; None: the same at all steps."""
    watched: tuple[int, ...] = ()
    """States that others name: they are kept in a tube, so that these know where they are."""
    width: float = 5.5
    """Half the width of that tube, in deviations: an agent itself would have it as wide as it may be."""

    def changed(self, **values: Any) -> NonlinearModel:
        """Return the model with other ranges of what is unknown, or another tube; programs are the same."""
        model, own = replace(self, **values), {field.name for field in fields(self)}
        model.__dict__.update({key: value for key, value in self.__dict__.items() if key not in (*own, "tubed")})
        return model

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of states, inputs and what is unknown; the time last, if dynamics name it."""
        timed = (TIME,) if self.agent.names_time else ()
        return (*self.agent.states, *self.agent.inputs, *self.agent.unknowns, *timed)

    @cached_property
    def tubed(self) -> NDArray[np.bool_]:
        """Which states (d,) have a tube in any case: unrolled angles, within half a turn, and what others name."""
        names = getattr(self.agent, "unrolled", ())
        own = self.names[: self.agent.n_states]
        return np.array([name in names or k in self.watched for k, name in enumerate(own)])

    @cached_property
    def motion(self) -> Program | AffineForms:
        """The mean of the next state."""
        if self.agent.is_affine:
            return AffineForms.of_motion(with_matrices(self.agent), self._mean_of_noise)
        return Program.of(self._means, self.names)

    @cached_property
    def step_parts(self) -> Program | AffineForms:
        """The mean of the next state, and what the noise is multiplied with: most share what they are made of."""
        if not self.agent.timed_scale_trees:
            return self.motion
        return Program.of([*self._means, *self.agent.timed_scale_trees], self.names)

    @property
    def _mean_of_noise(self) -> FloatArray:
        return np.asarray(self.agent.noise_axes @ self.laws[0])

    @cached_property
    def _means(self) -> list[Tree]:
        means = self._mean_of_noise.tolist()
        trees: list[Tree] = list(self.agent.timed_trees)
        scales = self.agent.timed_scale_trees or [Number(1.0)] * len(trees)
        for k, mean in enumerate(means):
            if mean:
                trees[k] = Operation("+", (trees[k], Operation("*", (Number(mean), scales[k]))))
        return trees

    @cached_property
    def output(self) -> Program | AffineForms:
        """Outputs, of states alone."""
        if self.agent.is_affine:
            return AffineForms.of_outputs(with_matrices(self.agent))
        states = self.names[: self.agent.n_states]
        return Program.of(self.agent.output_trees, states)

    @cached_property
    def scale(self) -> Program | None:
        """What the noise is multiplied with; None for nothing."""
        trees = self.agent.timed_scale_trees
        return Program.of(trees, self.names) if trees else None

    @cached_property
    def laws(self) -> tuple[FloatArray, FloatArray]:
        """Means (d,) and deviations (d,) of laws that are above the components of the noise."""
        known = np.array([(law.mean, law.deviation) for law in self.envelopes]).reshape(-1, 2)
        return (known[:, 0], known[:, 1]) if self.agent.laws else (np.zeros(self.agent.n_states), np.zeros(0))

    @property
    def deviations(self) -> FloatArray:
        """Deviations (d,) of the noise before it is multiplied."""
        return self.laws[1]

    @cached_property
    def envelopes(self) -> list[Envelope]:
        """Laws above those of the components of the noise; none where it has a covariance."""
        found = [law.envelope for law in self.agent.laws or ()]
        return [law for law in found if law is not None]

    @property
    def tail(self) -> Tail:
        """What is known of the tails of the noise."""
        return max((law.tail for law in self.envelopes), default=Tail.NORMAL)

    @property
    def lost(self) -> float:
        """Probability of the noise of a step that is given up."""
        return sum(law.lost for law in self.envelopes)

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance (d, d) of normal noise above that of the agent, where it is the same everywhere."""
        if self.agent.laws is None:
            return self.agent.noise_covariance
        axes = self.agent.noise_axes
        return np.asarray((axes * self.deviations**2) @ axes.T)

    @cached_property
    def unknown(self) -> FloatArray:
        """Ranges (2, k) of what is unknown."""
        return np.array(list(self.agent.unknowns.values()), dtype=float).reshape(-1, 2).T

    def unknown_at(self, time: ArrayLike) -> FloatArray:
        """Return ranges (2, k, n) of what is unknown at a step (n = 1), or at steps (n,)."""
        if self.beside is None:
            return self.unknown[:, :, None]
        times = np.minimum(np.atleast_1d(np.asarray(time, dtype=np.int64)), self.beside.shape[1] - 1)
        return self.beside[:, times].swapaxes(1, 2)

    def variables(self, x: FloatArray, u: FloatArray, time: ArrayLike) -> FloatArray:
        """Return all variables (v, n) for states (d, n) and inputs (m, n) at a step, or at steps (n,)."""
        return np.concatenate([x, u, self.known(x.shape[1], time)])

    def known(self, n: int, time: ArrayLike) -> FloatArray:
        """Return the variables (.., n) that are neither states nor inputs: middles of what is unknown, and the time."""
        low, high = self.unknown_at(time)
        calm = np.broadcast_to(0.5 * low + 0.5 * high, (len(low), n))
        if not self.agent.names_time:
            return calm
        return np.concatenate([calm, np.broadcast_to(np.asarray(time, dtype=float), (1, n))])

    def step(self, x: FloatArray, u: FloatArray, time: ArrayLike) -> FloatArray:
        """Return the means (d, n) of the next states, from a step, or from steps (n,)."""
        return self.motion.values(self.variables(x, u, time))

    def linear(
        self, states: FloatArray, inputs: FloatArray, times: ArrayLike | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return Jacobians (S, d, d) and (S, d, m) along states (S, d) and inputs (S, m) of steps 0 to S - 1.

        `times` (S,) are other steps.
        """
        d, m = self.agent.n_states, self.agent.n_inputs
        times = np.arange(len(inputs)) if times is None else times
        _, slopes = self.motion.slopes(self.variables(states.T, inputs.T, times))
        both = np.moveaxis(np.broadcast_to(slopes, (*slopes.shape[:2], len(states))), 2, 0)
        return np.array(both[:, :, :d]), np.array(both[:, :, d : d + m])

    def outputs(self, states: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return outputs (S, p) and their Jacobians (S, p, d) along states (S, d)."""
        values, slopes = self.output.slopes(np.ascontiguousarray(states.T))
        return values.T, np.moveaxis(np.broadcast_to(slopes, (*slopes.shape[:2], len(states))), 2, 0)

    @cached_property
    def bent(self) -> NDArray[np.bool_]:
        """Which states and inputs (d + m,) a tube has to bound: those that anything is not linear in."""
        d, m = self.agent.n_states, self.agent.n_inputs
        bent = np.zeros(len(self.names), dtype=bool)
        wide = np.stack(self.ends)[..., None]
        for program in (self.motion, self.scale):
            for slopes, second_derivatives in [] if program is None else program.curved(wide):
                for (j, k), (low, high) in second_derivatives.items():
                    # What is linear at each time needs no tube, whatever its slope is at others.
                    if not (low == 0.0 and high == 0.0) and k < self.n_varying:
                        bent[[j, k]] = True
                if program is self.scale:
                    bent[list(slopes)] = True
        return bent[: d + m]

    @cached_property
    def varied(self) -> NDArray[np.bool_]:
        """Which states (d,) have noise that is multiplied with what varies."""
        assert self.scale is not None
        wide = np.stack(self.ends)[..., None]
        return np.array([any(j < self.n_varying for j in slopes) for slopes, _ in self.scale.curved(wide)])

    @property
    def n_varying(self) -> int:
        """Number of variables but the time."""
        return len(self.names) - self.agent.names_time

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Closed limits (v,) within which variables stay."""
        agent, timed = self.agent, [0.0] * self.agent.names_time
        low = np.concatenate([agent.state_low, agent.input_low, self.unknown[0], timed])
        timed = [LATEST] * agent.names_time
        return low, np.concatenate([agent.state_high, agent.input_high, self.unknown[1], timed])

    @cached_property
    def bent_outputs(self) -> NDArray[np.bool_]:
        """Which states (d,) outputs are not linear in."""
        bent = np.zeros(self.agent.n_states, dtype=bool)
        wide = np.stack(self.ends)[:, : self.agent.n_states, None]
        for _, second_derivatives in self.output.curved(wide):
            for (j, k), (low, high) in second_derivatives.items():
                if not (low == 0.0 and high == 0.0):
                    bent[[j, k]] = True
        return bent


@dataclass(frozen=True, eq=False)
class Tube:
    """Boxes (v, n) of variables around points: how far they reach below and above, within closed limits.

    Parameters
    ----------
    at : (v, n) array
    low, high : (v, n) arrays
        Ends of the boxes.
    gains : (n, m, d) array, optional
        Feedback: the m variables after the first d ones move by it. None if there are only states.
    """

    at: FloatArray
    low: FloatArray
    high: FloatArray
    gains: FloatArray | None = None

    @classmethod
    def around(
        cls,
        at: FloatArray,
        reach: tuple[FloatArray, FloatArray],
        ends: tuple[FloatArray, FloatArray],
        gains: FloatArray | None = None,
    ) -> Tube:
        """Return boxes that reach so far (v, n) below and above points, within limits (v,)."""
        low = np.maximum(at - reach[0], np.minimum(ends[0][:, None], at))
        return cls(at, low, np.minimum(at + reach[1], np.maximum(ends[1][:, None], at)), gains)

    @cached_property
    def sides(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """How far the boxes reach below and above, and the larger of both."""
        below, above = self.at - self.low, self.high - self.at
        return below, above, np.maximum(below, above)

    @cached_property
    def moves(self) -> NDArray[np.bool_]:
        """Which variables (v,) have a reach: what has none, such as the time, adds nothing."""
        return np.any(self.sides[2] != 0.0, axis=1)

    def curved(self, program: Program | AffineForms) -> Curved:
        """Return first and second derivatives of expressions in these boxes."""
        return program.curved(np.array([self.low, self.high]))

    def products(self, p: int, q: int) -> tuple[FloatArray, FloatArray]:
        """Return the largest products (n,) of what two different variables are off: of one sign, and of two."""
        below, above, _ = self.sides
        same = np.maximum(below[p] * below[q], above[p] * above[q])
        return same, np.maximum(below[p] * above[q], above[p] * below[q])


Curved = list[tuple[dict[int, FloatArray], dict[tuple[int, int], FloatArray]]]
"""First and second derivatives of each of some expressions, as intervals (2, n)."""


def remainders(
    curved: Curved, tube: Tube, slopes: FloatArray, centre: FloatArray, follows: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Return what expressions are off their linear forms within a tube: middles and half widths.

    Where bends have a sign, so has what they add: a square is not below 0. With feedback the square of an input is one
    of states, too, and so is its product with a state.

    Parameters
    ----------
    curved : list
        Derivatives of p expressions in the tube.
    tube : Tube
    slopes : (p, v, n) array
        The matrix of the linear forms.
    centre : (p, v, n) array
        What derivatives at the point are off from it, at most.
    follows : bool
        Whether the feedback of the tube, if it has one, is used.

    Returns
    -------
    two (p, n) arrays
        Not numbers where nothing is known.
    """
    far, moves, gains = tube.sides[2], tube.moves, tube.gains if follows else None
    v, n = far.shape
    d = v if gains is None else gains.shape[2]
    moved = v if gains is None else d + gains.shape[1]
    middle, half = np.empty((2, len(curved), n))
    first_order = np.einsum("pvn,vn->pn", centre[:, moves], far[moves])
    for i, (first, second_derivatives) in enumerate(curved):
        total, closed = first_order[i], dict[tuple[int, int], FloatArray]()
        for (j, k), (a, b) in second_derivatives.items():
            if not (moves[j] and moves[k]):
                continue
            share = 0.5 if j == k else 1.0
            if max(j, k) >= moved:
                total = total + share * np.maximum(np.abs(a), np.abs(b)) * far[j] * far[k]
                continue
            total = total + share * 0.5 * (b - a) * far[j] * far[k]
            # A bend in the middle of what is known, as one of states alone.
            for p, one in _followed(j, d, gains):
                for q, other in _followed(k, d, gains):
                    key = (min(p, q), max(p, q))
                    closed[key] = closed.get(key, 0.0) + share * 0.5 * (a + b) * one * other
        least = most = np.zeros(n)
        for (p, q), factor in closed.items():
            if p == q:
                square = factor * far[p] ** 2
                least, most = least + np.minimum(square, 0.0), most + np.maximum(square, 0.0)
                continue
            same, opposite = tube.products(p, q)
            is_positive = factor > 0.0
            least = least - np.where(is_positive, factor * opposite, -factor * same)
            most = most + np.where(is_positive, factor * same, -factor * opposite)
        width = total + 0.5 * (most - least)
        if second_derivatives:
            mean = np.zeros(n)
            for j, ends in first.items():
                if not moves[j]:
                    continue
                a, b = ends - slopes[i, j]
                mean = mean + np.maximum(np.abs(a), np.abs(b)) * far[j]
            by_slopes = ~(width <= mean)
            middle[i], half[i] = np.where(by_slopes, 0.0, 0.5 * (least + most)), np.fmin(width, mean)
        else:
            middle[i], half[i] = 0.0, width
    return middle, half


def _followed(j: int, d: int, gains: FloatArray | None) -> list[tuple[int, FloatArray | float]]:
    """Return the states that variable j moves with, each with its factors (n,)."""
    if j < d or gains is None:
        return [(j, 1.0)]
    return [(k, gains[:, j - d, k]) for k in range(d)]
