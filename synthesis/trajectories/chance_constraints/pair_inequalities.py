"""Pairs of agents along nominal paths: in which direction each is kept apart, and what that asks of either agent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...relations.grids import FloatArray
from .feedback_bounds import OtherSides, both_sources
from .limit_rows import INWARD, Worth
from .pair_costs import PairLimits

Contributions = Mapping[int, tuple[FloatArray, ...]]
"""By times: what an agent adds to linearization errors, variances and what one step adds to these (J,) of its rows; and
by sources (J, t K) of noise that agents share; and how far its nominal values are shifted (J,)."""


@dataclass(frozen=True, eq=False)
class Side:
    """Rows (J,) in which an agent takes part at one time, and the forms (J, p) of its outputs."""

    rows: NDArray[np.int64]
    forms: FloatArray


@dataclass(frozen=True, eq=False)
class PairRows:
    """Limits of differences along nominal paths.

    Parameters
    ----------
    low, high : mapping from time to (R,) arrays
        Distances of nominal differences from their limits.
    sides : sequence of mappings from time to Side
        One for each agent.
    normals : (S + 1, sum of p) array
        Directions as the certificate holds them.
    """

    low: Mapping[int, FloatArray]
    high: Mapping[int, FloatArray]
    sides: Sequence[Mapping[int, Side]]
    normals: FloatArray

    def asked(self, contributions: Sequence[Contributions]) -> list[dict[int, OtherSides]]:
        """Return what rows ask of each agent, if the others add what they add now."""
        totals, result = self._totals(contributions), list[dict[int, OtherSides]]()
        for own, sides in zip(contributions, self.sides, strict=True):
            asked = {}
            for t, side in sides.items():
                rows = side.rows
                linearization_error, variance, largest, shared, shift = (total[rows] for total in totals[t])
                if t in own:
                    parts = zip((linearization_error, variance, largest), own[t], strict=False)
                    linearization_error, variance, largest = (max_0(a - b[: len(rows)]) for a, b in parts)
                    shared, shift = both_sources(shared, -own[t][3][: len(rows)]), shift - own[t][4][: len(rows)]
                low, high = (
                    self.low[t][rows] + shift - linearization_error,
                    self.high[t][rows] - shift - linearization_error,
                )
                asked[t] = OtherSides(side.forms, low, high, variance, largest, shared)
            result.append(asked)
        return result

    def add_to(self, worth: Worth, contributions: Sequence[Contributions]) -> None:
        """Add all rows once, with what both agents add, to the rows (1, J) of a team."""
        for t, (linearization_error, variance, largest, shared, shift) in self._totals(contributions).items():
            variance = variance + np.sum(shared**2, axis=1)
            low, high = self.low[t] + shift - linearization_error, self.high[t] - shift - linearization_error
            names = [f"a pair at step {t}"] * len(low)
            worth.add(low[None], high[None], np.full((1, len(low)), np.inf), variance[None], names, largest[None])

    def _totals(self, contributions: Sequence[Contributions]) -> dict[int, tuple[FloatArray, ...]]:
        totals = {}
        for t, low in self.low.items():
            sources = max((own[t][3].shape[1] for own in contributions if t in own), default=0)
            totals[t] = (*np.zeros((3, len(low))), np.zeros((len(low), sources)), np.zeros(len(low)))
        for own, sides in zip(contributions, self.sides, strict=True):
            # Agents of the same batch may be in pairs of which this one is no part.
            for t in own.keys() & sides.keys():
                rows = sides[t].rows
                for total, part in zip(totals[t], own[t], strict=True):
                    if part.ndim == 1 or part.shape[1]:
                        total[rows] += part[: len(rows)]  # others of the same batch may have had more
        return totals


def pair_rows(
    limits: Sequence[PairLimits], outputs: Sequence[FloatArray], spreads: Sequence[FloatArray], columns: int
) -> PairRows:
    """Return the rows for nominal outputs (S + 1, p) of all agents, with deviations (S + 1, p) of outputs.

    A pair is kept apart in the direction in which it is the most deviations away from its region.
    """
    times, sizes = len(outputs[0]), [own.shape[1] for own in outputs]
    y, sd = np.concatenate(outputs, axis=1), np.concatenate(spreads, axis=1)
    normals = np.zeros((times, columns))
    low: dict[int, list[float]] = {}
    high: dict[int, list[float]] = {}
    sides: list[dict[int, tuple[list[int], list[FloatArray]]]] = [{} for _ in outputs]
    for group in limits:
        z, scale = group.differences(y), deviations_of(group, sd)
        _, direction = group.ways_out(z[..., None], scale)
        direction = direction[..., 0] / scale
        direction = direction / np.linalg.norm(direction, axis=2, keepdims=True)
        size = np.abs(y[:, group.places[0]]) + np.abs(y[:, group.places[1]])
        for t, k in zip(*np.nonzero(group.asked), strict=True):
            box, value, spare = (group.low[t, k], group.high[t, k]), z[t, k], INWARD * (size[t, k] + 1e-3)
            if group.asked[t, k] < 0:
                normal = direction[t, k]
                normals[t, group.columns[k]] = normal
                corner = np.maximum(normal * box[0], normal * box[1]).sum()
                corner += INWARD * np.abs(normal) @ np.maximum(np.abs(box[0]), np.abs(box[1]))
                corner = min(corner, (1.0 + INWARD) * group.radius[t, k] * float(np.linalg.norm(normal)))
                asked = [(normal, float(normal @ value - np.abs(normal) @ spare - corner), np.inf)]
            else:
                at, off = group.faces @ value, np.abs(group.faces) @ spare
                ends = at - group.face_low[t, k] - off, group.face_high[t, k] - at - off
                asked = [(face, float(a), float(b)) for face, a, b in zip(group.faces, *ends, strict=True)]
            for form, below, above in asked:
                row = len(low.setdefault(t, []))
                low[t].append(below)
                high.setdefault(t, []).append(above)
                for side, sign in ((0, 1.0), (1, -1.0)):
                    i = int(group.agents[side, k])
                    full = np.zeros(sizes[i])
                    full[group.outputs[side, k]] = sign * form
                    rows, forms = sides[i].setdefault(t, ([], []))
                    rows.append(row)
                    forms.append(full)
    done = [{int(t): Side(np.array(rows), np.array(forms)) for t, (rows, forms) in own.items()} for own in sides]
    least, most = ({int(t): np.array(values) for t, values in part.items()} for part in (low, high))
    return PairRows(least, most, done, normals)


def max_0(values: FloatArray) -> FloatArray:
    """Return values, or 0 where rounding made them negative."""
    return np.maximum(values, 0.0)


def deviations_of(group: PairLimits, sd: FloatArray) -> FloatArray:
    """Return deviations (S + 1, K, p) of differences for those (S + 1, P) of all outputs."""
    return np.maximum(np.hypot(sd[:, group.places[0]], sd[:, group.places[1]]), 1e-4 * group.widths)
