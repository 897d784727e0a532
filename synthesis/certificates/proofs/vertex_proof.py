"""Proofs on grids whose vertices have inputs: few states, noise of any size; of one agent, or of a team."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from ....envs.systems.backends import is_whole
from ....envs.tasks.problem import Problem
from ..controllers import VertexController
from .archive import Pool, Stored
from .path_proof import ONE_RUN, OTHER_STARTS, probability
from .proof import Capability, FailureProof
from .vertex_grid import VertexGrid

OF_TEAM = MappingProxyType({
    Capability.VALUES: ONE_RUN.replace("along a path", "on grids of vertices"),
    Capability.OTHER_STARTS: OTHER_STARTS.replace("along a path", "on grids of vertices"),
})  # fmt: skip
OF_ONE = MappingProxyType({
    **{asked: text.replace("grids of vertices", "a grid of vertices") for asked, text in OF_TEAM.items()},
    Capability.VALUES: "one on a grid of vertices, whose values only `value_in_time` and `shield` know; "
    '`relation="linear"` or "boxes" may give one on cells',
})  # fmt: skip
"""What whoever asks for values, or for other starts, is told."""


@dataclass(frozen=True, eq=False, repr=False)
class VertexProof(FailureProof):
    """A bound by value iteration on the grid of one agent (docs/theory/vertices.md).

    Parameters
    ----------
    grid : VertexGrid
    failure : float
        Upper bound on the probability that the task is not satisfied.
    """

    grid: VertexGrid
    failure: float

    kind = "vertex-grid"
    unsupported = OF_ONE
    bound = "vertex grid"

    @property
    def method(self) -> str:
        """How the bound was found, in words."""
        moving = " that move with runs" if self.grid.moves else ""
        return f"value iteration on {self.grid.size_text} cells{moving}, inputs interpolated between vertices"

    def controller(self, problem: Problem) -> VertexController:
        """Return the controller the bound belongs to."""
        return _controller(problem, (self.grid,))

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        return {"failure": float(self.failure), **self.grid.entries(pool)}

    @classmethod
    def read(cls, problem: Problem, stored: Stored) -> Self:
        """Return the proof in a file; raise ValueError if there is none."""
        if problem.n_agents != 1:
            raise ValueError("its problem has several agents, and a grid of vertices is of one")
        grid = VertexGrid.of_entries(problem, 0, stored.entry, stored)
        return cls(grid, probability(stored.entry["failure"]))


@dataclass(frozen=True, eq=False, repr=False)
class VertexTeamProof(FailureProof):
    """A bound by value iteration on a tree of products, one factor for the grid of each agent.

    Parameters
    ----------
    grids : tuple of VertexGrid
        One for each agent.
    sets, start_sets : tuples of (K, n) bool arrays
        Sets of kinds of cells of each agent that guards name, and those of the letter of time 0; a kind is a row of
        labels that cells have at any time.
    guards : tuple of (G,), (G,) and (G, I) int arrays
        From which state to which one under which set of each agent.
    start : tuple of (G_0,) and (G_0, I) int arrays
        The same of the letter of time 0, out of the initial state.
    tree : tuple of (n, 4), (m, 6) and (k, 3) int arrays
        Vertices, unions, and what is kept, by time and automaton state (``checker.tree``).
    failure : float
        Upper bound on the probability that the task is not satisfied.
    """

    grids: tuple[VertexGrid, ...]
    sets: tuple[np.ndarray, ...]
    start_sets: tuple[np.ndarray, ...]
    guards: tuple[np.ndarray, np.ndarray, np.ndarray]
    start: tuple[np.ndarray, np.ndarray]
    tree: tuple[np.ndarray, np.ndarray, np.ndarray]
    failure: float

    kind = "vertex-grids"
    unsupported = OF_TEAM
    bound = "vertex grid"

    @property
    def rank(self) -> int:  # type: ignore[override]
        """Largest number of terms of one automaton state."""
        each = np.unique(self.tree[2][:, :2], axis=0, return_counts=True)[1]
        return int(each.max(initial=1))

    @property
    def method(self) -> str:
        """How the bound was found, in words."""
        sizes = " and ".join(dict.fromkeys(grid.size_text for grid in self.grids))
        moving = " that move with runs" if any(grid.moves for grid in self.grids) else ""
        return f"value iteration on {sizes} cells of each agent{moving}, inputs interpolated between vertices"

    def controller(self, problem: Problem) -> VertexController:
        """Return the controllers the bound belongs to."""
        return _controller(problem, self.grids)

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        return {
            "failure": float(self.failure),
            "agents": [
                grid.entries(pool) | {"sets": pool.put(sets), "start_sets": pool.put(first)}
                for grid, sets, first in zip(self.grids, self.sets, self.start_sets, strict=True)
            ],
            **{name: [pool.put(own) for own in getattr(self, name)] for name in ("guards", "start", "tree")},
        }

    @classmethod
    def read(cls, problem: Problem, stored: Stored) -> Self:
        """Return the proof in a file; raise ValueError if there is none."""
        entry, n, Q = stored.entry, problem.n_agents, problem.automaton.n_states
        if len(entry["agents"]) != n:
            raise ValueError("it has another number of grids than there are agents")
        grids = tuple(VertexGrid.of_entries(problem, i, own, stored) for i, own in enumerate(entry["agents"]))
        tables = list[list[np.ndarray]]()
        for name in ("sets", "start_sets"):
            tables.append([stored.array(own[name]) for own in entry["agents"]])
            if any(sets.dtype != np.bool_ or sets.ndim != 2 for sets in tables[-1]):
                raise ValueError("its sets are none of kinds of cells")
        counts = [[len(own) for own in table] for table in tables]
        source, target, sets = (stored.array(number) for number in entry["guards"])
        guards = _whole(source, [Q])[:, 0], _whole(target, [Q])[:, 0], _whole(sets, counts[0])
        target, sets = (stored.array(number) for number in entry["start"])
        start = _whole(target, [Q])[:, 0], _whole(sets, counts[1])
        if any(len({*map(len, own)}) > 1 for own in (guards, start)):
            raise ValueError("its guards are inconsistent")
        T, most, G = problem.horizon, 2**31, len(guards[0])
        vertices, unions, kept = (stored.array(number) for number in entry["tree"])
        tree = (
            _whole(vertices, [T, Q, G, most]),
            _whole(unions, [T, Q, most, most, n, n + 1], least=[0, 0, 0, 0, 0, -n]),
            _whole(kept, [T, Q, most]),
        )
        failure = probability(entry["failure"])
        return cls(grids, tuple(tables[0]), tuple(tables[1]), guards, start, tree, failure)


def _whole(table: np.ndarray, below: list[int], least: list[int] | None = None) -> np.ndarray:
    """Return a table (n, k) of whole numbers, each below that of its column; raise ValueError if it is none."""
    table = table[:, None] if table.ndim == 1 else table
    if not is_whole(table, signed=True) or table.ndim != 2 or table.shape[1] != len(below):
        raise ValueError("a table of its tree has other columns, or numbers that are not whole")
    if np.any(table < np.array(least or [0])) or np.any(table >= np.array(below)):
        raise ValueError("a table of its tree holds a number that is out of range")
    return table.astype(np.int64)


def _controller(problem: Problem, grids: tuple[VertexGrid, ...]) -> VertexController:
    columns = zip(*((own.edges, own.inputs, own.laws, own.matrix) for own in grids), strict=True)
    return VertexController(problem, (), *columns)
