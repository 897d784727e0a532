"""Controllers on grids whose vertices have inputs: multilinear interpolation, by time and automaton state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import TURN
from ....envs.systems.arguments import tree_text
from ...relations.grids import FloatArray
from .communicated import told_of_all
from .path_controller import PathController


@dataclass(frozen=True, eq=False, repr=False)
class VertexController(PathController):
    """The controller of one agent on a grid of its workspace; it sees its state, the automaton state and the time.

    Parameters
    ----------
    problem : Problem
        Of one agent.
    paths : ()
    edges : d arrays (n + 1,) or (T + 1, n + 1)
        Edges of cells along each axis, increasing; or those of each time.
    vertex_inputs : (L, V, m) array
        Inputs at all vertices, the last axis running fastest.
    laws : (T, Q) int array
        Which of them acts at each time, in each automaton state.
    matrix : (d, d) array or None
        The grid is one of ``matrix @ x``; None: of the states x.
    """

    information = "own state, automaton state, time"

    edges: tuple[FloatArray, ...]
    vertex_inputs: FloatArray
    laws: NDArray[np.int64]
    matrix: FloatArray | None = None

    def __repr__(self) -> str:
        rows = [("cells", [axis.shape[-1] - 1 for axis in self.edges]), ("laws", len(self.vertex_inputs))]
        return tree_text(f"VertexController of {self.problem.name!r}", rows)

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, FloatArray]:
        """Return the action of the agent: name -> (m,) float64; see ``PathController.act``."""
        seen = told_of_all(self.problem, observations, infos, self.problem.automaton.n_states)
        return {
            name: self.inputs(0, np.asarray(state, dtype=float)[:, None], np.array([q]), time)[:, 0]
            for name, (state, q, time) in seen.items()
        }

    def inputs(self, agent: int, states: FloatArray, q: NDArray[Any], time: int) -> FloatArray:
        """Return inputs (m, M) at states (d, M), automaton states (M,) and a time, within the input box."""
        now = min(time, len(self.laws) - 1)
        which = self.laws[now][np.asarray(q)]
        places = states if self.matrix is None else self.matrix @ states
        edges, own = [axis if axis.ndim == 1 else axis[now] for axis in self.edges], self.problem.agents[0]
        if own.angles:  # the numbers in the window that stand for these points of a circle
            places = np.array(places, dtype=float)
            for k in np.flatnonzero(own.wrapped_axes):
                middle = 0.5 * (edges[k][0] + edges[k][-1])
                places[k] += TURN * np.round((middle - places[k]) / TURN)
        result = interpolated(edges, self.vertex_inputs, places, which)
        return np.clip(result, own.input_low[:, None], own.input_high[:, None])


def interpolated(
    edges: Sequence[FloatArray], tables: FloatArray, states: FloatArray, which: NDArray[Any]
) -> FloatArray:
    """Return multilinear interpolations (m, M) of tables (L, V, m) at states (d, M), of table ``which`` (M,) each."""
    result, shape = np.zeros((tables.shape[2], states.shape[1])), [len(axis) for axis in edges]
    below, shares = list[NDArray[Any]](), list[FloatArray]()
    for axis, x in zip(edges, states, strict=True):
        place = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2)
        below.append(place)
        shares.append(np.clip((x - axis[place]) / (axis[place + 1] - axis[place]), 0.0, 1.0))
    for corner in np.ndindex(*[2] * len(shape)):
        weight = np.prod([s if up else 1.0 - s for up, s in zip(corner, shares, strict=True)], axis=0)
        vertex = np.ravel_multi_index([place + up for up, place in zip(corner, below, strict=True)], shape)
        result += weight * tables[which, vertex].T
    return result
