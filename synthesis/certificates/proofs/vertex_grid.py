"""Grids of one agent whose vertices have inputs: what proofs of one agent and of teams hold of each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.backends import is_whole
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from .archive import Pool, Stored


@dataclass(frozen=True, eq=False, repr=False)
class VertexGrid:
    """Cells of one agent, inputs at their vertices, and how values are bounded there (docs/theory/vertices.md).

    Parameters
    ----------
    edges : d arrays (n + 1,) or (T + 1, n + 1)
        Edges of cells along each axis, which tile the workspace of the agent; or those of each time, inside of it.
    inputs : (L, V, m) array
        Inputs at vertices, the last axis running fastest; between them they are interpolated.
    laws : (T, Q) int array
        Which of them acts at each time, in each automaton state.
    jumps : d bools
        Along which axes values may jump from cell to cell; along others they are made continuous.
    near : float
        Deviations of the noise that are looked at; what is further away costs its probability.
    window : (2, d) array, (T + 1, 2, d) array or None
        Ends of the lattice on which second derivatives are bounded, where all noise is normal and of one size; those
        of each time where edges are.
    matrix : (d, d) array or None
        The grid is one of ``matrix @ x``, where noise that moves several states is independent (None: of x itself).
    """

    edges: tuple[FloatArray, ...]
    inputs: FloatArray
    laws: NDArray[np.int64]
    jumps: tuple[bool, ...]
    near: float
    window: FloatArray | None
    matrix: FloatArray | None = None

    @property
    def moves(self) -> bool:
        """Whether the grid is another one at each time."""
        return any(axis.ndim > 1 for axis in self.edges)

    @property
    def size_text(self) -> str:
        """Numbers of cells along its axes, in words."""
        return " x ".join(str(axis.shape[-1] - 1) for axis in self.edges)

    def entries(self, pool: Pool) -> dict[str, Any]:
        """Return its entries in a file."""
        return {
            "edges": [pool.put(axis) for axis in self.edges],
            "inputs": pool.put(self.inputs),
            "laws": pool.put(self.laws),
            "jumps": list(self.jumps),
            "near": float(self.near),
            **({} if self.window is None else {"window": pool.put(self.window)}),
            **({} if self.matrix is None else {"matrix": pool.put(self.matrix)}),
        }

    @classmethod
    def of_entries(cls, problem: Problem, i: int, entry: dict[str, Any], stored: Stored) -> Self:
        """Return the grid of agent i in a file; raise ValueError if there is none."""
        agent = problem.agents[i]
        edges = tuple(stored.numbers(number) for number in entry["edges"])
        times = problem.horizon + 1
        fits = len(edges) == agent.n_states and all(
            axis.ndim > 0 and axis.shape[:-1] in ((), (times,)) and axis.shape[-1] > 1
            and np.all(np.isfinite(axis)) and np.all(np.diff(axis, axis=-1) > 0.0)
            for axis in edges
        )  # fmt: skip
        moves = fits and any(axis.ndim > 1 for axis in edges)
        inputs, laws = stored.numbers(entry["inputs"]), stored.array(entry["laws"])
        shape = (math.prod(axis.shape[-1] for axis in edges) if fits else 0, agent.n_inputs)
        if not fits or inputs.ndim != 3 or inputs.shape[1:] != shape or not np.all(np.isfinite(inputs)):
            raise ValueError("its inputs do not fit its grid")
        whole = is_whole(laws, signed=True) and laws.shape == (problem.horizon, problem.automaton.n_states)
        if not whole or laws.min() < 0 or laws.max() >= len(inputs):
            raise ValueError("its laws do not fit the horizon and the automaton")
        jumps = tuple(entry["jumps"])
        if len(jumps) != agent.n_states or not all(isinstance(own, bool) for own in jumps):
            raise ValueError("it does not say along which axes values may jump")
        near = entry["near"]
        if not isinstance(near, float):
            raise ValueError("it does not say how far it looks")
        window = stored.numbers(entry["window"]) if "window" in entry else None
        ends = (times, 2, agent.n_states) if moves else (2, agent.n_states)
        if window is not None and (window.shape != ends or not np.all(np.isfinite(window))):
            raise ValueError("its lattice has no ends along each axis")
        matrix = stored.numbers(entry["matrix"]) if "matrix" in entry else None
        if matrix is not None and (matrix.shape != (agent.n_states,) * 2 or not np.all(np.isfinite(matrix))):
            raise ValueError("its coordinates are not as many as states")
        return cls(edges, inputs, laws.astype(np.int64), jumps, near, window, matrix)
