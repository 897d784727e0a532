"""Inputs at the vertices of a grid: good ones that are much like their neighbours', few tables of them for all times.

Inputs are chosen for values that nothing is taken off from. Bounds themselves are no guide: where they are low for what
is charged, inputs would lead away on either side, and between both sides more is charged.

What is charged grows with the square of how far inputs of neighbours move the next state, in deviations of the noise.
So inputs maximise mean values less such squares. A table that is known acts again where that loses little: what inputs
lead to is computed once.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...extended_check.vertex_grids import Bands, Noise, Normal, hats_at, images_at, names_time, vertices_of
from ...relations.grids import FloatArray
from .counted_backups import ONCE, Counted
from .sampled_runs import RUNS, Runs, nearest_vertices

INPUTS = {1: 9, 2: 5, 3: 3}
"""Values of each input that are tried, by the number of inputs; between them means are interpolated."""

APART = 0.1
"""What inputs of neighbours cost that lead one deviation of the noise apart: the square of it, in probability."""

SIZED = 2.0
"""How much more it costs if sizes of the noise differ, in deviations: they move what is some deviations away."""

SWEEPS, COARSEST, LEVELLED = 20, 6, 0.01
"""How often inputs are adjusted to those of their neighbours, on the coarsest level (of every eighth vertex, say), the
next one, and so on; the fewest vertices of the longest axis on a level; and how much squares cost on all levels but the
finest, as a share: enough where values say nothing."""

FINE_SIZES = 0.25
"""Logarithm of the ratio of sizes of the noise for which there are tables, at most; the nearest one counts."""

AS_NONE = 0.2
"""Share of the narrowest cell below which noise counts as so small, where inputs are looked for."""

FINE_CELLS = 0.7
"""Deviations that cells are wide at least where means are interpolated between the middle of a cell and its ends."""

READ, SUMMED, SMOOTHED = 1.2e-7, 1e-10, (3e-3, 2e-6)
"""Work of a mean that is read, of a product in sums around points of a lattice, and of inputs that are adjusted to
those of their neighbours: once, and at each vertex, in core seconds."""

SAME = 5e-3
"""A law that is known acts where new inputs take off at most this share of the failure at any vertex."""

SAME_PASSING, SAME_DISTURBED = 0.2, 0.02
"""The same where runs that pass there lose at most this share of the failure hoped for, or aimed at, in all steps; and
where there are disturbances, which are as bad as can be at every step, so that failures are large."""

MOST_TRIED = 40
"""Known laws that are tried, the newest ones."""

LEAST_FAILURE = 1e-7
"""Failure below which none is aimed at."""

MOST_TABLES, BLOCK = 8, 8
"""Tables of axes that are kept, where images move in time; and of how many points ranges of them are multiples."""

IMAGES_AT_ONCE = 20_000
"""Images that are computed at once, about."""

FAINT = 1e-14
"""Weights of noise that count as none."""

NO_DIFFERENCE = 1e-11
"""Differences of means that count as none."""

CROSSED, CROSSED_SURE, SURE = 0.3, 2.0, 1e-3
"""Square of the deviation of further noise that inputs are chosen for, in squares of what means move by across a cell;
the same where less failure than the third number is hoped for. What is charged on a cell acts as such noise does, and
the wider a cell the more; values that are nearly 1 say little of inputs, and leave no room for what is charged."""


class Choice:
    """Inputs at all vertices of a grid, in shares of their ranges, and values under them: good guesses, no bounds.

    Means around points of a lattice are sums along one axis after the other, for some sizes of the noise, the nearest
    of which counts; between points they are interpolated. The noise is taken to be larger where cells are wide, but on
    coarse grids, on which nothing is charged.
    """

    def __init__(self, steps: Counted, runs: Runs | None, aim: float = 0.0, is_coarse: bool = False) -> None:
        self.steps, self.runs, self.aim, agent = steps, runs, aim, steps.agent
        sure = runs is not None and runs.failure < SURE
        self.crossed = 0.0 if is_coarse else CROSSED_SURE if sure else CROSSED
        self.m, self.now = len(agent.inputs), -1
        self.enter(steps.problem.horizon)
        self.acting = vertices_of(steps.nodes).T if agent.disturbances else None
        self.low, high = agent.input_box
        self.range, self.count = np.maximum(high - self.low, 1e-300), INPUTS[self.m]
        self.axis = np.linspace(0.0, 1.0, self.count)
        tried = np.stack(np.meshgrid(*[self.axis] * self.m, indexing="ij"), axis=-1).reshape(-1, self.m)
        self.tried = self.low + tried * (high - self.low)
        # laws (V, m) so far, the first one in the middle, and of which inputs that are tried they are means
        self.laws, self.between = list[FloatArray](), list[tuple[NDArray[np.int64], FloatArray]]()
        self._add(np.full((self.at.shape[1], self.m), 0.5))
        self.known: tuple[int, tuple[Reading, FloatArray]] | None = None
        self.tables: Tables = {}
        self.levels = _levels([n + 1 for n in steps.shape])

    def enter(self, t: int) -> None:
        """Look at the vertices (d, V) of a time, and at widths of the cells beside them."""
        if self.now >= 0 and not self.steps.moves:
            return
        self.now, edges = t, self.steps.edges_at(t)
        self.at = vertices_of(edges)
        widths = [np.diff(axis) for axis in edges]
        beside = [np.concatenate([own[:1], np.maximum(own[1:], own[:-1]), own[-1:]]) for own in widths]
        self.widths = np.stack(np.meshgrid(*beside, indexing="ij")).reshape(len(beside), -1)

    def of(self, values: FloatArray, t: int, later: NDArray[np.int64]) -> tuple[NDArray[np.int64], FloatArray]:
        """Return which law acts in each automaton state (Q,), from those a step later, and values (Q, n_1 + 1, ..)."""
        self.enter(t)
        automaton = self.steps.problem.automaton
        which, result = later.copy(), np.zeros_like(values)
        alike, nothing = dict[bytes, list[int]](), np.zeros((len(values), *self.steps.shape), bool)
        for q in np.flatnonzero(self.steps.reached[t]).tolist():
            if automaton.is_co_safe and automaton.accepting[q]:
                result[q] = 1.0
            else:
                W = self.steps.after_letter(values, nothing, q, t + 1)
                alike.setdefault(W.tobytes(), []).append(q)
        shape = tuple(2 * n for n in self.steps.shape)
        for numbers, states in alike.items():
            W = np.frombuffer(numbers).reshape(shape)
            law, means = self.adjusted(W, t, later[states], self.passing(t, states))
            if self.acting is not None:
                self.steps.worst |= dict.fromkeys(((t, q) for q in states), self._worst(law))
            which[states], result[states] = law, means.reshape(values.shape[1:])
        return which, result

    def passing(self, t: int, states: Sequence[int]) -> FloatArray:
        """Return the share of runs that pass by each vertex (V,) at a time, in some automaton states."""
        result = np.zeros(self.at.shape[1])
        if self.runs is not None:
            here = self.runs.states[t][:, np.isin(self.runs.q[t], states)]
            np.add.at(result, nearest_vertices(self.steps.edges_at(t), here), 1.0 / RUNS)
        return result

    def adjusted(self, W: FloatArray, t: int, later: NDArray[np.int64], passing: FloatArray) -> tuple[int, FloatArray]:
        """Return a law for values one step later, and means under it: a known one where that loses little."""
        reading, apart = self._images(t)
        every = reading.means(W).reshape(-1, *[self.count] * self.m, self.at.shape[1])
        self.steps.count(READ * every.size + SUMMED * reading.products)
        # of all disturbances the worst
        table, self.every = every.min(axis=0) if len(every) > 1 else every[0], every
        self.steps.count(ONCE, 0.0)
        known = list(dict.fromkeys([*later.tolist(), *range(len(self.laws))[:-MOST_TRIED:-1]]))
        means = self._under(table, known)
        # The best inputs of all vertices without regard to neighbours are no worse than those that are looked for.
        law = self._alike(table.reshape(-1, table.shape[-1]).max(axis=0), means, passing)
        if law is None:
            self.steps.count(SMOOTHED[0], 0.0)
            self.steps.count(SMOOTHED[1] * self.m * table.shape[-1])
            shares = self._smooth(table, apart)
            worth = self._read(table, shares)
            law = self._alike(worth, means, passing)
        if law is None:
            self._add(shares)
            return len(self.laws) - 1, worth
        return known[law], means[law]

    def _alike(self, worth: FloatArray, means: FloatArray, passing: FloatArray) -> int | None:
        """Return which of some means (K, V) loses least, if that is little."""
        loss = worth - means
        # what is lost everywhere, and what runs lose that pass there, with those that none of them has seen
        little = np.all(loss <= SAME * (1.0 - worth) + NO_DIFFERENCE, axis=1)
        lost = loss @ passing + loss.max(axis=1) / RUNS
        if self.runs is not None:
            failure = max(self.runs.failure, self.aim, LEAST_FAILURE)
            share = SAME_PASSING if self.acting is None else SAME_DISTURBED
            little |= lost <= share * failure / self.steps.problem.horizon
        return int(np.where(little, lost, np.inf).argmin()) if little.any() else None

    def _add(self, shares: FloatArray) -> None:
        """Add a law, and where it is between inputs that are tried."""
        self.laws.append(np.clip(self.low + shares * self.range, *self.steps.agent.input_box))
        place = np.minimum((shares * (self.count - 1)).astype(int), self.count - 2)
        part, index, weight = shares * (self.count - 1) - place, [], []
        for corner in itertools.product((0, 1), repeat=self.m):
            index.append(np.ravel_multi_index((place + corner).T, (self.count,) * self.m))
            weight.append(np.prod(np.where(corner, part, 1.0 - part), axis=1))
        self.between.append((np.stack(index), np.stack(weight)))

    def _under(self, table: FloatArray, laws: Sequence[int]) -> FloatArray:
        """Return means (K, V) under some of the laws."""
        flat, at = table.reshape(-1, table.shape[-1]), np.arange(table.shape[-1])
        each = [np.sum(weight * flat[index, at], axis=0) for index, weight in (self.between[k] for k in laws)]
        return np.stack(each)

    def _worst(self, law: int) -> NDArray[np.int64]:
        """Return under which disturbances means that were read last are least at each vertex (V,), under a law."""
        return np.concatenate([self._under(table, [law]) for table in self.every]).argmin(axis=0)

    def _best(self, table: FloatArray) -> FloatArray:
        places = np.unravel_index(table.reshape(-1, table.shape[-1]).argmax(axis=0), table.shape[:-1])
        return np.stack([self.axis[own] for own in places], axis=1)

    def _read(self, table: FloatArray, shares: FloatArray, but: int = -1) -> FloatArray:
        """Return means (V,), or (count, V) for all values of one input, interpolated at the others' shares (V, m)."""
        table = table if but < 0 else np.moveaxis(table, but, -2)
        for j in range(self.m):
            if j != but:
                place = np.minimum((shares[:, j] * (self.count - 1)).astype(int), self.count - 2)
                part, at = shares[:, j] * (self.count - 1) - place, np.arange(len(place))
                # the axis of this input is the first that is left
                table = (1.0 - part) * table[place, ..., at].T + part * table[place + 1, ..., at].T
        return table

    def _smooth(self, table: FloatArray, apart: FloatArray) -> FloatArray:
        """Return the best shares (V, m) beside those of neighbours, found on finer and finer levels.

        Sweeps carry what neighbours have a few vertices far: on the finest level alone they would leave jumps of
        inputs wherever values say little, and the more of them the finer a grid is.
        """
        shares, above = np.empty(0), None
        for level in self.levels:
            here = table[..., level.places]
            shares = self._best(here) if above is None else level.between(shares, above)
            cost = level.cost * APART * apart[level.places]
            for _ in range(SWEEPS):
                shares = 0.5 * shares + 0.5 * self._swept(here, shares, cost, level)
            above = level
        return shares

    def _swept(self, table: FloatArray, shares: FloatArray, cost: FloatArray, level: Level) -> FloatArray:
        """Return the best shares (V, m) beside those of neighbours, each input on its own; squares cost (V, m)."""
        result, step = np.empty_like(shares), self.axis[1]
        for j in range(self.m):
            means, own = self._read(table, shares, j), shares[:, j].reshape(level.shape)
            total = np.zeros(level.shape)
            for there, here in level.beside:
                total[here] += own[there]
            total, count = total.ravel(), level.neighbours
            # Means are linear between inputs that are tried: on each piece a parabola, whose top is known.
            slopes = np.diff(means, axis=0) / step
            with np.errstate(all="ignore"):
                top = (total + 0.5 * slopes / cost[:, j]) / count
            top = np.where(np.isfinite(top), top, shares[:, j])
            best = np.clip(top, self.axis[:-1, None], self.axis[1:, None])
            worth = means[:-1] + slopes * (best - self.axis[:-1, None])
            worth = worth - cost[:, j] * (count * best**2 - 2.0 * total * best)
            result[:, j] = np.take_along_axis(best, worth.argmax(axis=0)[None], axis=0)[0]
        return result

    def _images(self, t: int) -> tuple[Reading, FloatArray]:
        """Return readings at images of all inputs that are tried, and squares (V, m) of how far inputs lead apart.

        Where there are disturbances images are those under each of some of them, one after the other.
        """
        steps, agent, n = self.steps, self.steps.agent, self.at.shape[1]
        if self.known is None or ((names_time(agent) or steps.moves) and self.known[0] != t):
            images = list[FloatArray]()
            # as many inputs at once as make long arrays
            parts = np.array_split(self.tried, min(len(self.tried), -(-len(self.tried) * n // IMAGES_AT_ONCE)))
            for acting, some in itertools.product([None] if self.acting is None else self.acting, parts):
                at, inputs = np.tile(self.at, len(some)), np.repeat(some, n, axis=0)
                unknown = None if acting is None else np.repeat(acting[:, None], at.shape[1], axis=1)
                images += np.split(images_at(agent, at, inputs, t, unknown)[0], len(some), axis=1)
            d, apart = len(self.at), np.zeros((n, self.m))
            sizes = np.maximum(np.abs(np.nan_to_num(images[len(images) // 2][d:])), self.widths)
            # under the first disturbances, if there are any
            means = np.stack(images[: len(self.tried)]).reshape(*[self.count] * self.m, 2 * d, n)
            for j in range(self.m):
                # over all of an input, whatever the others are
                way = np.ptp(means, axis=j) / np.tile(sizes, (2, 1))
                way[d:] *= SIZED
                apart[:, j] = np.nan_to_num(way).reshape(-1, n).max(axis=0) ** 2
            where, noises = np.concatenate(images, axis=1), steps.noises
            if self.crossed:
                across = np.concatenate([_across(own[:d], steps.shape) for own in images], axis=1)
                where[d:] = np.sqrt(where[d:] ** 2 + self.crossed * across)
                # what is charged at kinks along axes without noise is smeared, too
                noises = [Normal() if own is None else own for own in noises]
            if steps.moves:  # tables are of these edges
                self.tables.clear()
            self.known = t, (Reading(where, steps.edges_at(t + 1), noises, self.tables), apart)
        return self.known[1]


class Level:
    """Every vertex of a grid, every second, every fourth ..: places (d axes), neighbours, and what squares cost."""

    def __init__(self, lengths: Sequence[int], stride: int) -> None:
        self.axes = [np.unique(np.append(np.arange(0, n, stride), n - 1)) for n in lengths]
        self.shape = tuple(len(own) for own in self.axes)
        # a step of inputs over so many vertices is one of many small ones, at as many vertices along each axis
        self.cost = 1.0 if stride == 1 else LEVELLED / stride**2
        self.places = np.ravel_multi_index(np.meshgrid(*self.axes, indexing="ij"), tuple(lengths)).ravel()
        # Every vertex and the next one along each axis, both ways, and how many neighbours it has.
        axes, every = range(len(lengths)), slice(None)
        ways = [tuple(side if j == k else every for j in axes) for k in axes for side in (slice(1, None), slice(-1))]
        self.beside = [(ways[i], ways[i ^ 1]) for i in range(len(ways))]
        count = np.zeros(self.shape)
        for _, here in self.beside:
            count[here] += 1.0
        self.neighbours = count.ravel()

    def between(self, shares: FloatArray, above: Level) -> FloatArray:
        """Return shares (V, m) on this level, interpolated from those on a coarser one."""
        table = shares.reshape(*above.shape, -1)
        for k, (own, wide) in enumerate(zip(self.axes, above.axes, strict=True)):
            at = np.interp(own, wide, np.arange(len(wide)))
            low = np.minimum(at.astype(int), max(len(wide) - 2, 0))
            part = (at - low).reshape(-1, *(1,) * (table.ndim - k - 1))
            table = (1.0 - part) * table.take(low, axis=k) + part * table.take(low + 1, axis=k)
        return table.reshape(len(self.places), -1)


def _levels(lengths: Sequence[int]) -> list[Level]:
    """Return levels from the coarsest, with COARSEST vertices along the longest axis at least, to the finest."""
    count = max(0, math.floor(math.log2(max(lengths) / COARSEST)))
    return [Level(lengths, 2**power) for power in range(count, -1, -1)]


def _across(means: FloatArray, cells: tuple[int, ...]) -> FloatArray:
    """Return sums of squares (d, V) of what means (d, V) move by across the cells beside a vertex, along all axes."""
    d, table = len(means), np.nan_to_num(means).reshape(len(means), *(n + 1 for n in cells))
    result = np.zeros_like(table)
    for k in range(1, d + 1):
        moved = np.abs(np.diff(table, axis=k))
        first, last = np.take(moved, [0], axis=k), np.take(moved, [-1], axis=k)
        either = np.maximum(np.concatenate([first, moved], axis=k), np.concatenate([moved, last], axis=k))
        result += either**2
    return result.reshape(d, -1)


Part = tuple[float, int, int]
"""A size of the noise along an axis, and the first point that is read under it and the one after the last."""

Tables = dict[tuple[int, float, float, tuple[Part, ...]], Bands]
"""By axis, the least and the most size, which say where points are, and parts: weights of what is around their points.
Images that move in time often have the same."""


class Reading:
    """Means of values around images (2 d, N), means first and sizes after: no bounds. New ``tables`` are kept."""

    def __init__(
        self, images: FloatArray, edges: tuple[FloatArray, ...], noises: Sequence[Noise | None], tables: Tables
    ) -> None:
        d, noisy = len(edges), [noise is not None for noise in noises]
        y, sizes = np.nan_to_num(images[:d]), np.nan_to_num(np.abs(images[d:]))
        self.smoothing, places, parts = list[Bands](), list[NDArray[np.int64]](), list[FloatArray]()
        shape = list[int]()
        for k, axis in enumerate(edges):
            # Noise that is small beside the narrowest cell is as good as none.
            least = max(sizes[k].min(), AS_NONE * np.diff(axis).min())
            least, most = (float(f"{own:.2e}") for own in (least, max(sizes[k].max(), least)))
            levels = np.geomspace(least, most, 1 + math.ceil(math.log(most / least) / FINE_SIZES))
            lattice = _points(axis, least, most, noisy[k])
            nearest = np.abs(np.log(np.maximum(sizes[k], levels[0]))[:, None] - np.log(levels)).argmin(axis=1)
            below = np.clip(np.searchsorted(lattice, y[k], side="right") - 1, 0, len(lattice) - 2)
            # Under a size those points that images of that size are between.
            used, nearest = np.unique(nearest, return_inverse=True)
            ways = [(own, below[nearest == place]) for place, own in enumerate(levels[used].tolist())]
            each = tuple((own, *_rounded(some, len(lattice))) for own, some in ways)
            starts, lengths = (np.array(own) for own in zip(*[(i, j - i) for _, i, j in each], strict=True))
            offsets = np.cumsum(lengths) - lengths
            key = k, least, most, each
            if key not in tables:
                if len(tables) >= MOST_TABLES:
                    tables.clear()
                rows = np.concatenate([_hats(lattice[i:j], axis, own, noises[k]) for own, i, j in each])
                tables[key] = Bands.of(np.where(rows > FAINT, rows, 0.0))
            self.smoothing.append(tables[key])
            shape.append(int(lengths.sum()))
            share = np.clip((y[k] - lattice[below]) / (lattice[below + 1] - lattice[below]), 0.0, 1.0)
            first = offsets[nearest] + below - starts[nearest]
            places.append(np.stack([first, first + 1]))
            parts.append(np.stack([1.0 - share, share]))
            # without noise what is beyond the edges is lost
            parts[-1] *= noisy[k] | ((axis[0] <= y[k]) & (y[k] <= axis[-1]))
        # from (2 n_1, ..) to (sizes times points, ..), one axis after the other
        ends = [2 * len(axis) - 2 for axis in edges]
        self.products = sum(
            own.size * math.prod(shape[:k]) * math.prod(ends[k + 1 :]) for k, own in enumerate(self.smoothing)
        )
        # Of all corners those that any image has a share of.
        self.corners = []
        for corner in itertools.product((0, 1), repeat=d):
            weight = math.prod(part[c] for part, c in zip(parts, corner, strict=True))
            if np.any(weight):
                place = np.ravel_multi_index([own[c] for own, c in zip(places, corner, strict=True)], tuple(shape))
                self.corners.append((place, weight))

    def means(self, W: FloatArray) -> FloatArray:
        """Return means (N,) of numbers (2 n_1, ..) at both ends of all intervals."""
        # one axis after the other, to (sizes times points, ..)
        for k, own in enumerate(self.smoothing):
            W = own.along(W, k)
        flat = W.ravel()
        return np.sum([weight * flat[place] for place, weight in self.corners], axis=0)


def _points(axis: FloatArray, least: float, most: float, is_noisy: bool) -> FloatArray:
    """Return the points of an axis that means are read at: edges, what is beyond, and where cells are wide middles."""
    away = np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0]) * most * is_noisy
    middles = (0.5 * axis[1:] + 0.5 * axis[:-1])[np.diff(axis) > FINE_CELLS * least]
    return np.unique(np.concatenate([axis[0] - away, axis, middles, axis[-1] + away]))


def _rounded(below: NDArray[np.int64], count: int) -> tuple[int, int]:
    """Return the first of some points, and the one after the next one of the last, or a few more to both sides."""
    return int(below.min()) // BLOCK * BLOCK, min(count, -(-(int(below.max()) + 2) // BLOCK) * BLOCK)


def _hats(points: FloatArray, axis: FloatArray, size: float, noise: Noise | None) -> FloatArray:
    """Return weights (N, 2 n) of both ends of all intervals: those of noise, or of the cell a point is in."""
    if noise is not None:
        return hats_at(points, np.full(len(points), size), axis, noise)[0]
    # at an edge both cells count
    either = [hats_at(own, own, axis, None)[0] for own in (points, np.nextafter(points, -np.inf))]
    return 0.5 * either[0] + 0.5 * either[1]
