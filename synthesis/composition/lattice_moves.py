"""How agents move between cells as far as pairs ask: from cells to lattice points, give or take a reach, and to cells.

Under the relation ``exact`` means are lattice points. Where a mean lies in a box, as under networks, the lattice point
nearest to its middle stands for it, and the *reach* is how far the box goes beyond that point along each axis. Cells
and nearness then have the largest probability that any mean within reach gives them, so that masses bound what they
stand for from above, and may sum to more than 1 (docs/theory/pairs.md, "Under networks").
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ...envs.systems.agents import AnyAgent
from ..abstraction.models import AgentModel, StepPolicy
from ..relations.grids import FloatArray, RelationRefused

LARGER, ADDED = 1.0 + 1e-12, 1e-14
"""What masses are rounded up by: far more than special functions are off by."""

FARTHER = 1.0 + 1e-9
"""Factor on a reach, so that a second enclosure, which rounds otherwise, reaches no farther."""

MOST_POINTS = 5_000_000
"""Most lattice points of an agent whose masses are followed."""


@dataclass(frozen=True, eq=False)
class OnPoints:
    """Moves of an agent whose means are lattice points.

    Parameters
    ----------
    model : AgentModel
    """

    model: AgentModel

    @property
    def lattice(self) -> tuple[FloatArray, ...]:
        """Lattice axes."""
        return self.model.lattice

    @property
    def loss(self) -> float:
        """What masses lack, per step."""
        return self.model.kernel.loss

    def share(self, agent: AnyAgent) -> FloatArray:
        """Return the mass (S,) of the start in cells."""
        return self.model.share(agent.initial.low, agent.initial.high)

    def cells(self, places: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which cells (S,) hold a place at which factors have values."""
        return places

    def step(self, policy: StepPolicy) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the lattice point (S,) that each cell moves to, -1 for none, and the reach (d,) around it."""
        return np.asarray(self.model.choices.points(policy)), np.zeros(len(self.lattice))

    def propagated(self, masses: FloatArray, points: NDArray[np.int64], reach: FloatArray) -> FloatArray:
        """Return masses (S,) after a step."""
        return np.asarray(self.model.kernel.propagate(masses[None], points)[0])


@dataclass(frozen=True, eq=False)
class NearPoints:
    """Moves of an agent whose means lie in boxes: all masses are upper bounds.

    Parameters
    ----------
    agent : AnyAgent
    model : AgentModel
    """

    agent: AnyAgent
    model: AgentModel
    loss = 0.0
    known: dict[bytes, list[FloatArray]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.agent.angles:
            raise RelationRefused(
                f"agent `{self.agent.name}`: what pairs may spoil is bounded for states that are numbers, got the "
                f"angle {self.agent.angles[0]!r}, which wraps; ask for the relation `path`"
            )
        if np.prod([len(axis) for axis in self.lattice]) > MOST_POINTS:
            raise RelationRefused(
                f"agent `{self.agent.name}`: masses have at most {MOST_POINTS} lattice points, got more; ask for fewer "
                "`cells`"
            )

    @property
    def lattice(self) -> tuple[FloatArray, ...]:
        """Lattice axes."""
        return self.model.lattice

    def share(self, agent: AnyAgent) -> FloatArray:
        """Return the mass (S,) of the start in cells."""
        return self.model.grid.overlap(agent.initial.low, agent.initial.high)

    def cells(self, places: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which cells (S,) hold a place at which factors have values: one of their corners, or themselves."""
        if not self.model.is_linear:
            return places
        shape = self.model.grid.shape
        corners = places.reshape([n for k in shape for n in (k, 2)])
        return np.asarray(corners.any(axis=tuple(range(1, 2 * len(shape), 2)))).ravel()

    def step(self, policy: StepPolicy) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the lattice point (S,) that each cell moves to, -1 for none, and the reach (d,) around it."""
        cells, chosen = np.arange(len(policy)), np.maximum(policy, 0)
        low, high = self._boxes[0][cells, chosen], self._boxes[1][cells, chosen]
        if not np.all(np.isfinite(low[policy >= 0]) & np.isfinite(high[policy >= 0])):
            raise RelationRefused(f"agent `{self.agent.name}`: nothing is known of its means from some of its cells")
        index, reach = [], np.zeros(low.shape[1])
        for k, axis in enumerate(self.lattice):
            lattice_spacing = (axis[-1] - axis[0]) / (len(axis) - 1)
            place = np.rint(np.where(policy >= 0, (0.5 * (low[:, k] + high[:, k]) - axis[0]) / lattice_spacing, 0.0))
            index.append(np.clip(place, 0, len(axis) - 1).astype(np.int64))
            beyond = np.maximum(high[:, k] - axis[index[-1]], axis[index[-1]] - low[:, k])
            reach[k] = np.max(beyond, where=policy >= 0, initial=0.0) * FARTHER
        points = np.ravel_multi_index(tuple(index), tuple(len(axis) for axis in self.lattice))
        return np.where(policy >= 0, points, -1), reach

    def propagated(self, masses: FloatArray, points: NDArray[np.int64], reach: FloatArray) -> FloatArray:
        """Return masses (S,) after a step."""
        key = reach.tobytes()
        if key not in self.known:
            self.known[key] = self._tables(reach)
        shape = tuple(len(axis) for axis in self.lattice)
        moving = points >= 0
        spread = np.bincount(points[moving], weights=masses[moving], minlength=int(np.prod(shape))).reshape(shape)
        for axis, table in enumerate(self.known[key]):
            spread = np.moveaxis(np.tensordot(spread, table, axes=(axis, 0)), -1, axis)
        return np.asarray(spread).ravel()

    def _tables(self, reach: FloatArray) -> list[FloatArray]:
        """Return, per axis, the largest mass (Z, S) of each cell that a mean within reach of a point gives it."""
        deviations = np.sqrt(np.diag(self.agent.noise_covariance))
        tables = []
        for edges, axis, std, most in zip(self.model.grid.edges, self.lattice, deviations, reach, strict=True):
            low, high = edges[:-1], edges[1:]
            mean = axis[:, None] + np.clip(0.5 * (low + high) - axis[:, None], -most, most)
            mass = _between((low - mean) / std, (high - mean) / std)
            tables.append(np.minimum(1.0, np.maximum(mass, 0.0) * LARGER + ADDED))
        return tables

    @cached_property
    def _boxes(self) -> tuple[FloatArray, FloatArray]:
        """Corners (S, A, d) of boxes around the means of every cell under every choice."""
        boxes = self.model.relation.mean_boxes(self.model.grid.low, self.model.grid.high)  # type: ignore[union-attr]
        return boxes.low, boxes.high


Moves = OnPoints | NearPoints
"""How one agent moves."""


def moves_of(agent: AnyAgent, model: AgentModel) -> Moves:
    """Return how an agent moves: on lattice points, or near them where its relation encloses means in boxes."""
    return NearPoints(agent, model) if hasattr(model.relation, "mean_boxes") else OnPoints(model)


def _between(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the mass between two points of the normal law, by the tails that are small."""
    return np.asarray(np.where(low > 0.0, ndtr(-low) - ndtr(-high), ndtr(high) - ndtr(low)))
