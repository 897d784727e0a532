"""Controllers on grids whose vertices have inputs: multilinear interpolation, by time and automaton state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import TURN
from ....envs.systems.arguments import tree_text
from ...relations.grids import FloatArray, alike_text
from .communicated import told_of_all
from .path_controller import PathController


@dataclass(frozen=True, eq=False, repr=False)
class VertexController(PathController):
    """Controllers on grids of the agents' workspaces; each sees its own state, the automaton state and the time.

    Parameters
    ----------
    problem : Problem
    paths : ()
    edges : tuple of d arrays (n + 1,) or (T + 1, n + 1)
        For each agent the edges of cells along each axis, increasing; or those of each time.
    vertex_inputs : tuple of (L, V, m) arrays
        Inputs at all vertices, the last axis running fastest.
    laws : tuple of (T, Q) int arrays
        Which of them acts at each time, in each automaton state.
    matrices : tuple of (d, d) arrays or None
        A grid is one of ``matrix @ x``; None: of the states x.
    """

    information = "own state, automaton state, time"

    edges: tuple[tuple[FloatArray, ...], ...]
    vertex_inputs: tuple[FloatArray, ...]
    laws: tuple[NDArray[np.int64], ...]
    matrices: tuple[FloatArray | None, ...]

    def __repr__(self) -> str:
        cells = [[axis.shape[-1] - 1 for axis in edges] for edges in self.edges]
        rows = [
            ("cells", alike_text(map(str, cells))),
            ("laws", alike_text(str(len(own)) for own in self.vertex_inputs)),
        ]
        return tree_text(f"VertexController of {self.problem.name!r}", rows)

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, FloatArray]:
        """Return the action of every agent observed: name -> (m,) float64; see ``PathController.act``."""
        seen = told_of_all(self.problem, observations, infos, self.problem.automaton.n_states)
        numbers = {name: i for i, name in enumerate(self.problem.agent_names)}
        return {
            name: self.inputs(numbers[name], np.asarray(state, dtype=float)[:, None], np.array([q]), time)[:, 0]
            for name, (state, q, time) in seen.items()
        }

    def inputs(self, agent: int, states: FloatArray, q: NDArray[Any], time: int) -> FloatArray:
        """Return inputs (m, M) at states (d, M), automaton states (M,) and a time, within the input box."""
        laws, own, matrix = self.laws[agent], self.problem.agents[agent], self.matrices[agent]
        now = min(time, len(laws) - 1)
        which = laws[now][np.asarray(q)]
        places = states if matrix is None else matrix @ states
        edges = [axis if axis.ndim == 1 else axis[now] for axis in self.edges[agent]]
        if own.angles:  # the numbers in the window that stand for these points of a circle
            places = np.array(places, dtype=float)
            for k in np.flatnonzero(own.wrapped_axes):
                middle = 0.5 * (edges[k][0] + edges[k][-1])
                places[k] += TURN * np.round((middle - places[k]) / TURN)
        result = interpolated(edges, self.vertex_inputs[agent], places, which)
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
