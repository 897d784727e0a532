"""The least mean at a vertex over all that disturbances may do: their box is cut into pieces, which are like cells.

Let F(d) = E W(y(x, d) + sigma(x, d) w) at a vertex x, under its input, d in a piece of the box of disturbances.

**Theorem.** Let D_j be at least the positive part of the second derivative of F along axis j of the piece, times its
side squared. Let ``m(a, b, D) = min(a, b) - (max(0, D/2 - |a - b|))^2 / (2 D)``, and 0 taken off where D is 0. Then F
is at least what is left of its numbers at the corners of the piece if pairs (a, b) of them along one axis after the
other become m(a, b, D_j). *Proof.* At the share s of the way along axis j F is at least ``(1 - s) a + s b - D s (1 - s)
/ 2`` (``backups``, one cell), for the numbers a and b at both ends. That is least at an end if ``|a - b| >= D / 2``,
and else at a share where it is m. So m is the least of functions that grow with a and b, and lower bounds on a and b,
such as m along axes before, give one on F. QED

So nothing is charged where F rises or falls faster along a piece than it bends: at most D_j / 8 for each axis.

A piece is a cell whose sides are disturbances: its images, how they bend and what is off where they have kinks are
those of ``closed_loops``, derivatives those of ``images`` and ``lattices``, and so is the lemma of what is near. Inputs
that are rounded count in ``rho`` of pieces. The number at a vertex is then below F there for every disturbance and
every rounding, as ``backups`` asks of the corners of a cell, on which F is looked at for one disturbance at a time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...checker.intervals import down, interval, up
from ...checker.problem import Agent
from ...checker.rigorous import Array, U
from .closed_loops import INPUT_OFF, ClosedLoop, corners_of, enclosed, images_at, unknown_of, vertices_of
from .noise_bounds import Noise

if TYPE_CHECKING:
    from .images import Images
    from .lattices import LatticeImages

WIDE = 0.5  # deviations of the noise, or cells of an axis without any, that a piece moves the next state by at most
MOST_PIECES = 8  # of one disturbance, whatever it moves: each costs as much as all cells
ROUND = 0.01  # pieces: where about so few more would do they are not made, so that rounding does not decide


def nodes_of(agent: Agent, edges: tuple[Array, ...], noises: Sequence[Noise | None]) -> tuple[Array, ...]:
    """Return the ends of pieces of the interval of each disturbance, by how far it moves states from any vertex."""
    at, d, box = vertices_of(edges), len(edges), unknown_of(agent, 1)[:, :, 0]
    inputs = np.repeat(agent.input_box.mean(axis=0)[None], at.shape[1], axis=0)
    middle, result = 0.5 * box[0] + 0.5 * box[1], list[Array]()
    for j, (low, high) in enumerate(box.T):
        ends = np.repeat(middle[:, None], 2, axis=1)
        ends[j] = low, high
        first, last = (
            images_at(agent, at, inputs, 0, np.repeat(own[:, None], at.shape[1], axis=1))[0] for own in ends.T
        )
        moved, sizes = np.abs(last - first)[:d], np.fmin(np.abs(first), np.abs(last))[d:]
        beside = [sizes[k] if noise else np.diff(edges[k]).min() for k, noise in enumerate(noises)]
        with np.errstate(all="ignore"):
            share = np.stack([own / side for own, side in zip(moved, beside, strict=True)]) / WIDE
        count = math.ceil(np.clip(np.fmax.reduce(share, axis=None, initial=0.0) - ROUND, 1.0, MOST_PIECES))
        result.append(np.append(low + (high - low) * np.arange(count) / count, high))
    return tuple(result)


def pieces_of(agent: Agent, edges: tuple[Array, ...], inputs: Array, t: int, nodes: tuple[Array, ...]) -> ClosedLoop:
    """Return the closed loop at vertices: points are vertices beside every node, and cells pieces at every vertex."""
    return pieces_at(agent, vertices_of(edges), tuple(len(axis) for axis in edges), inputs, t, nodes)


def pieces_at(
    agent: Agent, at: Array, shape: tuple[int, ...], inputs: Array, t: int, nodes: tuple[Array, ...]
) -> ClosedLoop:
    """Return the same at any states (d, n), arranged as ``shape``, under inputs (n, m)."""
    off = INPUT_OFF * np.abs(agent.input_box).max(axis=0)
    (d, n), m = at.shape, len(off)
    every = np.repeat(vertices_of(nodes), n, axis=1)
    count = every.shape[1] // n
    images = images_at(agent, np.tile(at, count), np.tile(inputs, (count, 1)), t, every)
    ends = (vertices_of(tuple(own[side] for own in nodes)) for side in (slice(-1), slice(1, None)))
    low, high = (np.repeat(own, n, axis=1) for own in ends)
    count = low.shape[1] // n
    given = np.tile(np.stack([down(inputs - off), up(inputs + off)]).transpose(0, 2, 1), count)
    ranges = np.concatenate([interval(np.tile(at, count)), given, np.stack([low, high])], axis=1)
    ways = [np.zeros((2, ranges.shape[1], 1, ranges.shape[2])) for _ in nodes]
    for j, moves in enumerate(ways):
        moves[:, d + m + j, 0] = down(high[j] - low[j]), up(high[j] - low[j])
    return enclosed(agent, images, (*(len(own) for own in nodes), *shape), ranges, ways, t)


def still_at(agent: Agent, at: Array, inputs: Array, t: int) -> ClosedLoop:
    """Return the closed loop at states (d, n) under inputs (n, m) where there are no disturbances.

    Each point stands twice, at both ends of a cell along which nothing moves.
    """
    off, n = INPUT_OFF * np.abs(agent.input_box).max(axis=0), at.shape[1]
    centre, rho = (np.tile(own, 2) for own in images_at(agent, at, inputs, t))
    given = np.stack([down(inputs - off), up(inputs + off)]).transpose(0, 2, 1)
    ranges = np.concatenate([interval(at), given], axis=1)
    return enclosed(agent, (centre, rho), (2, n), ranges, [np.zeros((2, ranges.shape[1], 1, n))], t)


@dataclass(frozen=True, eq=False)
class AnyDisturbance:
    """Lower bounds on means at vertices, whatever disturbances do: from ``images`` of pieces between ``nodes``."""

    images: Images | LatticeImages
    nodes: tuple[Array, ...]

    @property
    def size(self) -> int:
        """How many numbers it holds."""
        return self.images.size

    @property
    def products(self) -> float:
        """How many products they take."""
        return self.images.work()

    def below(self, W: Array) -> Array:
        """Return lower bounds (V,) for numbers at both ends of intervals; what is not known is below 0."""
        (always, bends), n = self.images.cost(W), len(self.nodes)
        at = self.images.vertices.below(W).reshape(*(len(own) for own in self.nodes), -1)
        # no mean is negative
        least = np.maximum(corners_of(at, n).reshape(len(always), *(2,) * n), 0.0)
        for bend in bends[::-1]:
            least = between(least[..., 0], least[..., 1], bend.reshape(-1, *(1,) * (least.ndim - 2)))
        least = np.maximum(least - always - 8.0 * n * U * float(np.abs(W).max()), 0.0)
        pieces = math.prod(len(own) - 1 for own in self.nodes)
        return np.asarray(np.where(self.images.known, least, -1.0).reshape(pieces, -1).min(axis=0))


def between(a: Array, b: Array, bend: Array) -> Array:
    """Return m(a, b, D): lower bounds on a function between its ends, that bends at most so much."""
    lack = np.maximum(0.5 * bend - np.abs(b - a), 0.0)
    share = np.divide(lack, bend, out=np.zeros_like(lack), where=lack > 0.0)
    return np.asarray(np.minimum(a, b) - 0.5 * share * lack * (1.0 + 2.0**-40))
