"""What letters ask of pairs of agents, as soft costs of their outputs for plans: to keep apart, or to be near.

A pair that is to keep apart is ``z`` deviations from its box, along the shortest way out of it, and costs
``-log Phi(z)``. So every pair that letters speak of pushes as soon as it comes near, and costs nothing elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ....envs.tasks.regions import PairRegion
from ...relations.grids import FloatArray
from .soft_limits import soft_costs

EMPTY = 1e-9
"""By how much a box that moves is empty where its check sees that it is, far beyond the rounding of its corners."""

LEAST_WIDTH = 1e-12
"""Least width of the box of a pair: one that moves may be empty at all times that a plan has."""


@dataclass(frozen=True, eq=False)
class PairLimits:
    """K pairs that compare p outputs each, and what letters ask of them.

    Parameters
    ----------
    numbers : (K,) int array
        Among all pairs of the problem.
    agents : (2, K) int array
    outputs, places : (2, K, p) int arrays
        Outputs that are compared, of the agents, and among the outputs of all agents together.
    low, high : (S + 1, K, p) arrays
        At each time: pairs may move.
    radius : (S + 1, K) array
        Infinite for boxes.
    faces : (k, p) array
        Forms whose limits say that a pair holds.
    face_low, face_high : (S + 1, K, k) arrays
    asked : (S + 1, K) int array
        1 where a pair is to hold, -1 where it is not; 0 at time 0.
    columns : (K, p) int array
        Where the certificate holds the directions of a pair.
    """

    numbers: NDArray[np.int64]
    agents: NDArray[np.int64]
    outputs: NDArray[np.int64]
    places: NDArray[np.int64]
    low: FloatArray
    high: FloatArray
    radius: FloatArray
    faces: FloatArray
    face_low: FloatArray
    face_high: FloatArray
    asked: NDArray[np.int8]
    columns: NDArray[np.int64]

    @property
    def widths(self) -> FloatArray:
        """Largest widths (K, p) of the boxes at any time, above 0: a pair that moves may be empty at times."""
        return np.maximum(np.max(self.high - self.low, axis=0), LEAST_WIDTH)

    def differences(self, outputs: FloatArray) -> FloatArray:
        """Return differences (S + 1, K, p, ..) of outputs (S + 1, P, ..) of all agents together."""
        return outputs[:, self.places[0]] - outputs[:, self.places[1]]

    def ways_out(self, differences: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances (S + 1, K, n) from the regions, negative inside, and unit directions (S + 1, K, p, n).

        Both are in units of ``scale`` (S + 1, K, p), with differences (S + 1, K, p, n) as they are.
        """
        if np.all(self.radius < np.inf):
            return self._out_of_balls(differences, scale)
        unit = scale[..., None]
        low, high, z = self.low[..., None] / unit, self.high[..., None] / unit, differences / unit
        away = z - np.clip(z, low, high)
        distance = np.sqrt((away**2).sum(axis=2))
        # Inside, the way to the nearest face.
        depth = np.concatenate([z - low, high - z], axis=2)
        face, p = np.argmin(depth, axis=2), z.shape[2]
        least = np.take_along_axis(depth, face[:, :, None], axis=2)[:, :, 0]
        axes = np.arange(p)[None, None, :, None]
        inner = np.where(face[:, :, None] % p == axes, np.where(face[:, :, None] < p, -1.0, 1.0), 0.0)
        outside = distance > 0.0
        direction = np.where(outside[:, :, None], away / np.where(outside, distance, 1.0)[:, :, None], inner)
        return np.where(outside, distance, -least), direction

    def _out_of_balls(self, differences: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the same for balls, along the way from their centres."""
        length = np.sqrt((differences**2).sum(axis=2, keepdims=True))
        first = np.eye(differences.shape[2])[0][:, None]
        normal = np.where(length > 0.0, differences / np.where(length > 0.0, length, 1.0), first)
        direction = normal * scale[..., None]
        size = np.sqrt((direction**2).sum(axis=2, keepdims=True))
        distance = (length[:, :, 0] - self.radius[..., None]) / size[:, :, 0]
        return distance, direction / size


def pair_limits(problem: Problem, letters: NDArray[np.int8]) -> list[PairLimits]:
    """Return what letters (S + 1, P) ask of pairs after time 0, by the number of outputs that are compared."""
    labeling = problem.labeling
    first_output = np.concatenate([[0], np.cumsum([agent.n_outputs for agent in problem.agents])])
    columns = np.concatenate([[0], np.cumsum([pair.size for pair in labeling.pairs])]).astype(int)
    asked = letters[:, labeling.first_pair :].copy()
    asked[0] = 0
    here = [k for k in range(len(labeling.pairs)) if asked[:, k].any()]
    result = []
    kinds = [(pair.size, pair.is_round) for pair in labeling.pairs]
    for p, is_round in sorted({kinds[k] for k in here}):
        numbers = np.array([k for k in here if kinds[k] == (p, is_round)])
        pairs = [labeling.pairs[k] for k in numbers]
        agents = np.array([[pair.first for pair in pairs], [pair.second for pair in pairs]])
        outputs = np.array([[pair.outputs[side] for pair in pairs] for side in (0, 1)])
        places = outputs + first_output[agents][:, :, None]
        ends = [_at_times(pair, len(letters)) for pair in pairs]
        low, high, radius, least, most = (np.stack([own[k] for own in ends], axis=1) for k in range(5))
        # What is surely empty at a time asks for nothing then.
        is_empty = np.any(low >= high + EMPTY, axis=2)
        here_asked = np.where((asked[:, numbers] < 0) & is_empty, 0, asked[:, numbers])
        result.append(
            PairLimits(numbers, agents, outputs, places, low, high, radius, pairs[0].at(0).inner_faces[0], least, most,
                       here_asked, columns[numbers][:, None] + np.arange(p))
        )  # fmt: skip
    return result


def _at_times(pair: PairRegion, times: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return corners (S + 1, p), radii (S + 1,), and limits of inner faces (S + 1, k), of a pair at all times."""
    if not pair.moves:
        ends = (pair.low, pair.high, np.float64(pair.radius), *pair.inner_faces[1:])
        low, high, radius, least, most = (np.broadcast_to(end, (times, *np.shape(end))) for end in ends)
        return low, high, radius, least, most
    here = [pair.at(t) for t in range(times)]
    faces = [own.inner_faces for own in here]
    low, high, radius = (np.array([getattr(own, name) for own in here]) for name in ("low", "high", "radius"))
    return low, high, radius, np.array([own[1] for own in faces]), np.array([own[2] for own in faces])


@dataclass(frozen=True, eq=False)
class PairAim:
    """What a plan keeps of pairs, with deviations and linearization errors (S + 1, K, p) of the differences."""

    limits: PairLimits
    sharp: FloatArray
    linearization_error: FloatArray

    def cost(self, outputs: FloatArray) -> FloatArray:
        """Return the costs (n,) of outputs (S + 1, P, n) of all agents together."""
        z = self.limits.differences(outputs)
        return sum((cost.sum(axis=(0, 1)) for cost, _, _, _ in self._parts(z)), np.zeros(outputs.shape[2]))

    def derivatives(self, outputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return slopes (S + 1, P) and second derivatives (S + 1, P, P), without bends of the way out."""
        s, size = outputs.shape
        slopes, second_derivatives = np.zeros((s, size)), np.zeros((s, size, size))
        z = self.limits.differences(outputs[:, :, None])
        first, second = self.limits.places
        for _, slope, bend, direction in self._parts(z):
            t, k = np.nonzero((np.abs(slope[:, :, 0]) > 1e-12) | (bend[:, :, 0] > 1e-12))
            form = direction[t, k, :, 0]
            both = np.concatenate([form, -form], axis=1)
            at = np.concatenate([first[k], second[k]], axis=1)
            np.add.at(slopes, (t[:, None], at), slope[t, k] * both)
            np.add.at(second_derivatives, (t[:, None, None], at[:, :, None], at[:, None, :]),
                      bend[t, k][:, :, None] * both[:, :, None] * both[:, None, :])  # fmt: skip
        return slopes, second_derivatives

    def _parts(self, z: FloatArray) -> Iterator[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
        """Yield costs, slopes, second derivatives (S + 1, K, n) along directions (S + 1, K, p, n)."""
        limits = self.limits
        if np.any(limits.asked < 0):
            distance, direction = limits.ways_out(z, self.sharp)
            linearization_error = np.sum(np.abs(direction) * (self.linearization_error / self.sharp)[..., None], axis=2)
            low = np.where(limits.asked < 0, 0.0, -np.inf)
            one, none = np.ones(low.shape), np.zeros(low.shape)
            cost, slope, bend = soft_costs(distance - linearization_error, (low, np.full(low.shape, np.inf)), one, none)
            yield cost, slope, bend, direction / self.sharp[..., None]
        if np.any(limits.asked > 0):
            for k, face in enumerate(limits.faces):
                low = np.where(limits.asked > 0, limits.face_low[..., k], -np.inf)
                high = np.where(limits.asked > 0, limits.face_high[..., k], np.inf)
                sharp, linearization_error = (
                    np.sqrt((self.sharp * face) ** 2 @ np.ones(len(face))),
                    self.linearization_error @ np.abs(face),
                )
                direction = np.broadcast_to(face[:, None], z.shape)
                yield *soft_costs(np.einsum("stpn,p->stn", z, face), (low, high), sharp, linearization_error), direction
