"""Value iteration on grids whose vertices have inputs: one agent, noise along each axis or none, of any law and size.

At time t and in automaton state q the value V_t(q, .) is multilinear on each cell, or 0 on all of it, and 0 outside the
grid, which may be another one at each time. Let W be V_(t+1) in the state that the letter leads to (the least one if it
is not known), made continuous from below along axes without noise and others that are named, and F(x) = E W(y(x) +
noise), y the image under interpolated inputs (``closed_loops``), sigma the sizes of the noise.

**Theorem.** If on every cell V_t(q, .) <= F or V_t(q, .) = 0, for all t and q, and V_T is 1 where the automaton accepts
and else 0, then V_0 at the start, after its letter, is at most the probability that the task is satisfied. *Proof.* So
is V_t(q, x), by induction over T - t: that probability is at least 0, and at least E W. QED

**Theorem** (one cell). Let D_k be at least the positive part of the second derivative of F along axis k of a cell,
times its side squared. Along that axis F is at least its chord less D_k s (1 - s) / 2, s the share of the way, and so
at least the chord of both ends less a and b, if ``sqrt a + sqrt b >= sqrt(D_k / 2)``: D_k / 8 at both, or more at one.
Taken one axis after the other, with a and b that may depend on the ends of axes before, this leaves a multilinear
function below F. *Proof.* D s (1 - s) / 2 <= a (1 - s) + b s is tangent to the parabola, or above it. QED

Along an axis W is a sum of jumps j_e at planes e, of kinks kappa_e (y - e)^+, and of nothing else. With f the density
of the noise, tau = (e - y) / sigma, and derivatives along the side of a cell, a kink bends by

    f(tau) (y' + tau sigma')^2 / sigma + R(tau) sigma'' + P(y + noise > e) y''

(R: ``noise_bounds``), so that only kinks upward count in its first term. A jump bends by at most

    (|f'(tau)| (y' + tau sigma')^2 + f(tau) (sigma |y'' + tau sigma''| + 2 |sigma' (y' + tau sigma')|)) / sigma^2.

A kink that y crosses leaves at most kappa (|y'| + |y''|) s (1 - s), since between two crossings y turns; also with
noise w, for y + sigma w in the place of y. Means along several axes multiply, and mixed derivatives are products of
first ones. All of these are sums over planes and cells of numbers of W, with weights that are bounded on the image of
the cell. *Proof* and more: docs/theory/vertices.md.

All of this is for any fixed disturbance: numbers at vertices are below F for all of them (``disturbances``).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ....envs.systems.distributions import Law
from ...checker import CheckedAgent, CheckedProblem, Refused
from ...checker.cells import start_weights
from ...checker.distributions import NORMAL
from ...checker.expressions import names_in
from ...checker.formula import wrong_automaton
from ...checker.intervals import up
from ...checker.motions import cell_boxes, cell_labels
from ...checker.rigorous import Array, Truth, U, Whole, wrong_arithmetic
from ...checker.tree import finished
from .any_disturbance import AnyDisturbance, nodes_of, pieces_at, pieces_of, still_at
from .closed_loops import ClosedLoop, closed_loop, corners_of, images_at, names_time, vertices_of
from .coordinates import Independent, independent, start_points
from .images import Images, Vertices
from .lattices import Lattice, LatticeImages, deviations_of
from .noise_bounds import Noise, noise_of
from .turns import check_windows, labels_of_copies

KEPT = 6e7  # numbers of images that are kept
NEAR = 6.8  # deviations of the noise that are looked at, unless a proof says otherwise
FARTHEST = 30.0  # the most of them
LETTERS = 4  # times whose letters are kept
FINEST = 1e6  # how many sides of a cell the ends of an axis may be away from 0


def failure_of(
    problem: CheckedProblem,
    edges: tuple[Array, ...],
    inputs: Array,
    laws: Whole,
    jumps: tuple[bool, ...],
    near: float,
    noise_laws: Sequence[Law] | None,
    window: Array | None = None,
    matrix: Array | None = None,
) -> float:
    """Return an upper bound on the probability that the task fails; ``Refused`` if none follows.

    The law of time t and automaton state q is ``inputs[laws[t, q]]``, inputs (V, m) at vertices of ``edges``. Values
    that are more than ``near`` deviations of the noise away are left out, which is charged. Second derivatives are
    bounded on a lattice around a ``window`` (2, d), or feature by feature (None). Noise has the laws ``noise_laws`` of
    its sources, or is normal (None). The grid is one of ``matrix @ x``, or of the states x (None): those coordinates
    in which the noise is independent, and no other ones (``coordinates``). Edges (T + 1, n + 1) of an axis are those
    of each time: they lie in the workspace; edges (n + 1,), of all times, tile it.
    """
    refuse_to_begin(problem)
    problem = independent(problem)
    own = problem.matrix if isinstance(problem, Independent) else None
    if (own is None) != (matrix is None) or (own is not None and not np.array_equal(own, np.asarray(matrix))):
        raise Refused("its grid is one of other coordinates")
    steps = Backups(problem, edges, jumps, near, noise_laws, window)
    every = problem.horizon, len(problem.automaton.accepting)
    if laws.shape != every or np.any((laws < 0) | (laws >= len(inputs))):
        raise Refused("it does not say which law acts at every time and in every automaton state")
    values, given_up = steps.at_end()
    for t in range(problem.horizon - 1, -1, -1):
        values, given_up = steps.backup(values, given_up, inputs[laws[t]], t)
    return steps.failure(values, given_up)


def refuse_to_begin(problem: CheckedProblem) -> None:
    """Raise where nothing is proved, as the small checker does: first of the machine, then of the automaton."""
    if wrong := wrong_arithmetic():
        raise ArithmeticError(f"nothing can be proved on this machine: {wrong}")
    if problem.formula is not None and (wrong := wrong_automaton(problem.automaton, problem.formula)):
        raise Refused(f"the automaton is not that of the formula: {wrong}")


def has_moving_regions(problem: CheckedProblem) -> bool:
    """Return whether a region is elsewhere at some time."""
    return any(np.any(own.low != own.low[0]) or np.any(own.high != own.high[0]) for own in problem.regions)


def at_time(problem: CheckedProblem, t: int) -> CheckedProblem:
    """Return a problem whose regions are, at all times, where they are at one."""
    regions = [replace(own, low=own.low[[t]], high=own.high[[t]]) for own in problem.regions]
    return replace(problem, regions=tuple(regions))


@dataclass(eq=False)
class Backups:
    """One Bellman backup after the other on a grid, from the end of the horizon; what laws lead to is kept."""

    problem: CheckedProblem
    edges: tuple[Array, ...]
    jumps: tuple[bool, ...]
    near: float = NEAR
    noise_laws: Sequence[Law] | None = None
    window: Array | None = None
    images: dict[tuple[int, bytes], Images | LatticeImages] = field(default_factory=dict)
    letters: dict[int, list[tuple[dict[int, bool], Truth]]] = field(default_factory=dict)
    lattices: dict[int, Lattice] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.problem.agents) != 1 or self.problem.pairs:
            raise Refused("the task is about several agents, and a grid of vertices is of one")
        agent = self.agent
        if agent.shared_noise.any():
            raise Refused(f"`{agent.name}` has noise that others share, which grids of vertices do not know")
        used = agent.noise != 0.0
        if np.any(used.sum(axis=1) > 1) or np.any(used.sum(axis=0) > 1):
            raise Refused(f"the noise of `{agent.name}` is not independent along each of its states")
        if not len(self.edges) == len(self.jumps) == len(agent.states):
            raise Refused(f"the grid has another number of axes than `{agent.name}` has states")
        if not 0.0 < self.near <= FARTHEST:
            raise Refused(f"it looks {self.near:g} deviations of the noise far, not up to {FARTHEST:g}")
        turning = np.array([state in agent.angles for state in agent.states])
        box = np.where(turning, np.array([[-np.inf], [np.inf]]), agent.state_box)
        for axis, low, high in zip(self.edges, *box, strict=True):
            # what is no number is smaller than nothing
            widths = np.diff(axis, axis=-1)
            if (
                not widths.size
                or not np.all(widths * FINEST >= np.abs(axis).max(axis=-1, keepdims=True))
                or np.any(widths <= 0.0)
            ):
                raise Refused("an axis has fewer than two numbers, does not increase, or is too fine")
            if axis.ndim == 1 and (axis[0] != low or axis[-1] != high):
                raise Refused(f"the cells of `{agent.name}` do not tile its workspace")
            if axis.ndim > 1 and (
                axis.shape[:-1] != (self.problem.horizon + 1,) or axis.min() < low or axis.max() > high
            ):
                raise Refused(f"the cells of `{agent.name}` do not lie in its workspace at each time")
        ends = (self.problem.horizon + 1,) if self.moves else ()
        if self.window is not None and self.window.shape != (*ends, 2, len(agent.states)):
            raise Refused("its lattice has no ends along each axis, at each time where its grid moves")
        if isinstance(self.problem, Independent):
            self.problem.refuse_fine(self.edges)
        if agent.angles:
            check_windows(self.problem, self.edges)

    @property
    def agent(self) -> CheckedAgent:
        """The agent."""
        return self.problem.agents[0]

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of cells along the axes."""
        return tuple(axis.shape[-1] - 1 for axis in self.edges)

    @property
    def moves(self) -> bool:
        """Whether the grid is another one at each time."""
        return any(axis.ndim > 1 for axis in self.edges)

    def edges_at(self, t: int) -> tuple[Array, ...]:
        """Return the edges (n + 1,) of each axis at a time."""
        return tuple(axis[t] if axis.ndim > 1 else axis for axis in self.edges)

    @property
    def noisy(self) -> list[bool]:
        """Which axes have noise."""
        return [noise is not None for noise in self.noises]

    @cached_property
    def noises(self) -> list[Noise | None]:
        """The noise of each axis, in units of the deviation of its source; None where there is none."""
        agent, result = self.agent, list[Noise | None]()
        # sources that are all normal may be those of other coordinates, of which no law is known by its place
        laws = None if all(own.tail == NORMAL for own in agent.envelopes) else self.noise_laws
        if laws is None and any(own.tail != NORMAL or own.mean or own.off or own.lost for own in agent.envelopes):
            raise Refused(f"the noise of `{agent.name}` is not normal, and nothing says which law it has")
        for row in agent.noise:
            source = int(np.argmax(np.abs(row))) if row.any() else -1
            deviation = agent.envelopes[source].deviation if row.any() else 0.0
            noise = noise_of(None if laws is None else laws[source], deviation) if deviation else None
            result.append(noise)
            if noise is not None and not noise.is_even and row[source] < 0.0:
                raise Refused(
                    f"`{agent.name}` has noise along an axis turned round, which is not the same to both sides"
                )
        return result

    @cached_property
    def reached(self) -> Truth:
        """Which automaton states (T + 1, Q) runs may be in at each time, those apart that have lost the task."""
        automaton = self.problem.automaton
        result = np.zeros((self.problem.horizon + 1, len(automaton.accepting)), dtype=bool)
        ways = [[*automaton.targets(q, {})] for q in range(result.shape[1])]
        result[0, ways[automaton.initial]] = True
        for now, later in itertools.pairwise(result):
            for q in np.flatnonzero(now):
                later[ways[q]] = True
        return result & ~np.array(automaton.dead())

    def inside(self, t: int) -> Truth:
        """Return which cells of a time, at both ends of every interval, lie in the workspace of the states."""
        if not isinstance(self.problem, Independent):
            return np.ones(tuple(2 * n for n in self.shape), dtype=bool)
        return np.asarray(doubled(self.problem.inside(*cell_boxes(self.edges_at(t))).reshape(self.shape)))

    def at_end(self) -> tuple[Array, Truth]:
        """Return numbers (Q, n_1 + 1, ..) at vertices at the end, and which cells (Q, n_1, ..) are 0: none."""
        accepting = np.array(self.problem.automaton.accepting)
        values = np.zeros((len(accepting), *(n + 1 for n in self.shape)))
        values[accepting] = 1.0
        return values, np.zeros((len(accepting), *self.shape), dtype=bool)

    def backup(self, values: Array, given_up: Truth, inputs: Array, t: int) -> tuple[Array, Truth]:
        """Return the same one step earlier, for inputs (Q, V, m) at the vertices."""
        below, nothing = np.zeros_like(values), np.ones_like(given_up)
        done = finished(self.problem.automaton)
        memory: dict[bytes, tuple[Array, Truth]] = {}
        # where no run is at that time V is 0, as good as any lower bound
        for q in np.flatnonzero(self.reached[t]).tolist():
            if done[q]:
                below[q], nothing[q] = 1.0, False
            else:
                W = self.after_letter(values, given_up, q, t + 1)
                key = W.tobytes() + inputs[q].tobytes()
                if key not in memory:
                    memory[key] = self.below(W, self.images_of(inputs[q], t))
                below[q], nothing[q] = memory[key]
        return below, nothing

    def images_of(self, inputs: Array, t: int) -> Images | LatticeImages:
        """Return where inputs (V, m) lead, made once where that does not depend on the time."""
        key = t if names_time(self.agent) or self.moves else 0, inputs.tobytes()
        found = self.images.pop(key, None)
        if found is None:
            low, high = self.agent.input_box
            if not np.all((low <= inputs) & (inputs <= high)):
                raise Refused("an input at a vertex is outside its box")
            found = self.image_of(inputs, t)
            # those that were used longest ago go first
            while self.images and found.size + sum(own.size for own in self.images.values()) > KEPT:
                del self.images[next(iter(self.images))]
        self.images[key] = found
        return found

    def image_of(self, inputs: Array, t: int) -> Images | LatticeImages:
        """Return where inputs (V, m) lead at a time."""
        loop = closed_loop(self.agent, self.edges_at(t), inputs, t)
        if not self.agent.disturbances:
            return self._seen(loop, t)
        pieces = self._seen(pieces_of(self.agent, self.edges_at(t), inputs, t, self.nodes), t)
        # What disturbances may do is in the numbers at vertices: cells do not pay for it once more.
        return self._seen(replace(loop, rho=0.0 * loop.rho), t, AnyDisturbance(pieces, self.nodes))

    def _seen(self, loop: ClosedLoop, t: int, vertices: Vertices | None = None) -> Images | LatticeImages:
        if self.window is None:
            return Images.of(loop, self.edges_at(t + 1), self.noises, self.near, vertices)
        return LatticeImages.of(loop, self.lattice(t + 1), self.noises, self.near, vertices)

    @cached_property
    def nodes(self) -> tuple[Array, ...]:
        """The ends of pieces of the interval of each disturbance."""
        return nodes_of(self.agent, self.edges_at(0), self.noises)

    @cached_property
    def deviations(self) -> Array:
        """Deviations (d,) of the noise along each axis; ``Refused`` where it is of another law, or its size varies."""
        if names_in(self.agent.scale) - {*self.agent.states}:
            raise Refused("a lattice is for noise of one size, whatever inputs are, and at all times")
        at, (low, high) = vertices_of(self.edges_at(0)), self.agent.input_box
        middle = np.repeat((0.5 * low + 0.5 * high)[None], at.shape[1], axis=0)
        return deviations_of(np.abs(images_at(self.agent, at, middle, 0)[0][len(at) :]), self.noises)

    def lattice(self, t: int) -> Lattice:
        """Return the lattice around the window of a time; the last one is kept."""
        assert self.window is not None
        key = t if self.moves else 0
        if key not in self.lattices:
            self.lattices.clear()
            window = self.window[t] if self.moves else self.window
            self.lattices[key] = Lattice.of(self.edges_at(t), self.deviations, window)
        return self.lattices[key]

    def after_letter(self, values: Array, given_up: Truth, q: int, t: int) -> Array:
        """Return V in the state that the letter of a time leads q to: numbers (2 n_1, ..) at both ends of intervals.

        Where the letter is not known it is the least of those of all states that it may lead to.
        """
        automaton = self.problem.automaton
        t = t if self.moves or has_moving_regions(self.problem) else 0
        if t not in self.letters:
            if len(self.letters) >= LETTERS:
                self.letters.clear()
            now, edges = at_time(self.problem, t), self.edges_at(t)
            labels = labels_of_copies(now, edges) if self.agent.angles else cell_labels(now, 0, edges)[1]
            mine = [p for p, region in enumerate(self.problem.regions) if region.agents == (0,)]
            kinds, which = np.unique(labels, axis=0, return_inverse=True)
            known = [{p: label > 0 for p, label in zip(mine, kind, strict=True) if label} for kind in kinds.tolist()]
            inside = self.inside(t)
            self.letters[t] = [(own, doubled(which.reshape(self.shape) == k) & inside) for k, own in enumerate(known)]
        result = np.zeros(tuple(2 * n for n in self.shape))
        for letter, where in self.letters[t]:
            each = [self.on_cells(values[target], given_up[target]) for target in automaton.targets(q, letter)]
            result = np.where(where, np.min(each, axis=0), result)
        return result

    def on_cells(self, values: Array, given_up: Truth) -> Array:
        """Return numbers at both ends of all intervals, from those at vertices and the cells that are 0."""
        for k in range(values.ndim):
            values = np.repeat(values, 2, axis=k)
            values = np.take(values, range(1, values.shape[k] - 1), axis=k)
        return np.where(doubled(given_up), 0.0, values)

    def below(self, W: Array, images: Images | LatticeImages) -> tuple[Array, Truth]:
        """Return numbers (n_1 + 1, ..) at vertices of a function that is at most F, and the cells on which it is 0."""
        for k, jumps in enumerate(self.jumps):
            if not (jumps and self.noisy[k]):
                W = _continuous(W, k)
        at, d = images.vertices.below(W), len(self.shape)
        always, bends = self.charge(W, images)
        low = corners_of(at.reshape(tuple(n + 1 for n in self.shape)), d).reshape(-1, *(2,) * d)
        low = low - always.reshape(-1, *(1,) * d)
        # Numbers stay above 0, of whichever order of the axes leaves more; where none does V is 0.
        orders = [_lessened(low, bends, order) for order in (range(d), range(d)[::-1])]
        table = np.where(_sums(orders[0]) >= _sums(orders[1]), *orders)
        nothing = ~images.known | ~np.all(table >= 0.0, axis=tuple(range(1, d + 1))) | ~(_sums(table).ravel() > 0.0)
        table = np.where(nothing.reshape(-1, *(1,) * d), np.inf, table).reshape(*self.shape, *(2,) * d)
        result = np.full(tuple(n + 1 for n in self.shape), np.inf)
        for corner in itertools.product((0, 1), repeat=d):
            here = tuple(slice(c, n + c) for c, n in zip(corner, self.shape, strict=True))
            np.minimum(result[here], table[(slice(None),) * d + corner], out=result[here])
        return np.where(np.isinf(result), 0.0, result), nothing.reshape(self.shape)

    def means_at(self, W: Array, states: Array, inputs: Array, t: int) -> Array:
        """Return lower bounds (n,) on F at any states (d, n) under inputs (n, m), at a time.

        They hold whatever disturbances do; what is not known is below 0.
        """
        for k, noisy in enumerate(self.noisy):
            W = W if noisy else _continuous(W, k)
        if self.agent.disturbances:
            nodes, loop = self.nodes, pieces_at(self.agent, states, (states.shape[1],), inputs, t, self.nodes)
        else:
            nodes, loop = (np.zeros(2),), still_at(self.agent, states, inputs, t)
        return AnyDisturbance(Images.of(loop, self.edges_at(t + 1), self.noises, self.near), nodes).below(W)

    def charge(self, W: Array, images: Images | LatticeImages) -> tuple[Array, Array]:
        """Return what is taken off all corners of each cell (S,), and what F may bend along each axis (d, S)."""
        return images.cost(W)

    def failure(self, values: Array, given_up: Truth) -> float:
        """Return an upper bound on the failure: 1 less the mean of V_0 over the start, after the letter of time 0."""
        automaton = self.problem.automaton
        W = self.after_letter(values, given_up, automaton.initial, 0)
        starts = [self.agent.start]
        if isinstance(self.problem, Independent):
            # a point that is known up to rounding: in a cell the least value is that at a corner
            places = [
                np.searchsorted(axis, own, side="right")
                for axis, own in zip(self.edges_at(0), starts[0].T, strict=True)
            ]
            if any(first != last for first, last in places):
                raise Refused("the start may lie on either side of an edge")
            starts = start_points(self.agent)
        # Weights are lower bounds, and no number is negative.
        each = [float(start_weights(own, self.edges_at(0), True) @ W.ravel()) for own in starts]
        value = max(0.0, min(each) * (1.0 - 4.0 * U * W.size))
        lost = self.problem.lost if isinstance(self.problem, Independent) else 0.0
        return float(np.clip(up(up(1.0 - value) + lost), 0.0, 1.0))


def _sums(table: Array) -> Array:
    return np.sum(table, axis=tuple(range(1, table.ndim)), keepdims=True)


def _lessened(corners: Array, bends: Array, order: Sequence[int]) -> Array:
    """Return corners (S, 2, .., 2) of a multilinear function below F, from those of F: one axis after the other.

    What F bends is taken off at both ends alike, unless one has less than that: then that one becomes 0.
    """
    d, before = corners.ndim - 1, list[int]()
    for k in order:
        rest = tuple(1 + j for j in range(d) if j != k and j not in before)
        least = np.moveaxis(np.min(corners, axis=rest, keepdims=True), 1 + k, 0)
        bend = bends[k].reshape(-1, *(1,) * (d - 1))
        both, low = bend / 8.0, np.maximum(least, 0.0)
        less = np.minimum(both, low)
        # the other end has the rest of the root, and what both are rounded by
        other = (np.sqrt(0.5 * bend) * (1.0 + 2.0**-40) - np.sqrt(less[::-1])) ** 2 * (1.0 + 2.0**-40)
        taken = np.where(less < both, less, np.maximum(both, other))
        short = np.all(low < both, axis=0)
        corners = np.where(short[None], -1.0, np.moveaxis(corners, 1 + k, 0) - taken)
        corners = np.moveaxis(corners, 0, 1 + k)
        before.append(k)
    return corners


def doubled(cells: Any) -> Any:
    """Return what is said of cells, at both ends of every interval."""
    for k in range(cells.ndim):
        cells = np.repeat(cells, 2, axis=k)
    return cells


def _continuous(W: Array, k: int) -> Array:
    """Return numbers at both ends of intervals that do not jump along axis k, not to 0 beyond it, and are no larger."""
    ends = np.moveaxis(W, k, 0)
    least, none = np.minimum(ends[1:-1:2], ends[2::2]), np.zeros_like(ends[:1])
    return np.moveaxis(np.concatenate([none, np.repeat(least, 2, axis=0), none]), 0, k)
