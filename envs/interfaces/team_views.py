"""What the agents of a batch of teams see and do: one array per agent, of numpy or on a device."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ..simulation import Dynamics, Worlds
from ..systems.backends import Array, concatenated, is_host, namespace, single
from .nearest import checked_neighbours, common_sizes, nearest_bounds, nearest_seen
from .observation import (
    ACTIONS,
    AUTOMATON,
    SCALES,
    all_finite,
    checked_option,
    clip_in_place,
    shared_rows,
    tail_size,
    write_shared,
)

OBSERVATIONS = ("own", "joint", "neighbours")


class TeamViews:
    """Observations and actions of a team, agent by agent; the options are those of `TeamEnv`."""

    def __init__(
        self, dynamics: Dynamics, observation: str, neighbours: int | None, scale: str, automaton: str, actions: str
    ) -> None:
        problem = dynamics.problem
        self.dynamics, self.problem, self.names = dynamics, problem, tuple(problem.agent_names)
        self.observation = checked_option(observation, "observation", OBSERVATIONS)
        self.scale = checked_option(scale, "scale", SCALES)
        self.automaton = checked_option(automaton, "automaton", AUTOMATON)
        self.is_unit = checked_option(actions, "actions", ACTIONS) == "unit"
        self.neighbours = checked_neighbours(problem, self.observation, neighbours)
        bounds = [nearest_bounds(problem, agent, self.neighbours) for agent in problem.agents]
        self.bounds = [(dynamics.put(low[:, None]), dynamics.put(high[:, None])) for low, high in bounds]
        members = sorted((block, place, i) for i, (block, place) in enumerate(dynamics.position))
        self.members = [[i for b, _, i in members if b == block] for block in range(len(dynamics.blocks))]

    def inputs(self, actions: Mapping[str, Any], n_worlds: int) -> tuple[Array, ...]:
        """Return the inputs (m, n, M) per block, clipped to the input boxes.

        Raises
        ------
        ValueError
            If actions are missing or have the wrong shape; of numpy arrays also if they are not finite.
        """
        result = []
        for box, members in zip(self.dynamics.blocks, self.members, strict=True):
            shape = (n_worlds, box.input_low.shape[0])
            rows = [self._action(actions, self.names[i], shape) for i in members]
            xp = namespace(box.input_low)
            if self.dynamics.is_host:
                # Worlds last in memory, too, as all that follows runs along them.
                u = np.empty((shape[1], len(rows), n_worlds))
                for place, row in enumerate(rows):
                    u[:, place] = row.T
                if not all_finite(u):
                    raise ValueError("`actions`: expected finite numbers")
                clip_in_place(u, box, self.is_unit)
            else:
                middle = box.input_middle
                u = xp.stack([row.T for row in rows], axis=1)
                u = middle[0] + middle[1] * xp.clip(u, -1.0, 1.0) if self.is_unit else u
                u = xp.minimum(xp.maximum(u, box.input_low), box.input_high)
            result.append(u)
        return tuple(result)

    def _action(self, actions: Mapping[str, Any], name: str, shape: tuple[int, int]) -> Array:
        """Return the actions (M, m) of one agent in double precision."""
        given = actions.get(name, ())
        if self.dynamics.is_host:
            given = np.asarray(given, dtype=np.float64)
        if tuple(getattr(given, "shape", ())) != shape:
            got = getattr(given, "shape", type(given).__name__)
            raise ValueError(f"`actions`: expected numbers of shape {shape} for {name!r}, got {got}")
        return given if self.dynamics.is_host else namespace(given).astype(given, namespace(given).float64)

    def observations(self, worlds: Worlds, read: Sequence[Array]) -> dict[str, Array]:
        """Return the observations: states, automaton state, share of time left; `read` is what sensors see."""
        if self.dynamics.is_host and self.observation == "own":
            return self._own(worlds, read)
        tail = single(shared_rows(self.problem, worlds, self.automaton))
        states = [single(self._scaled(block, x)) for block, x in zip(self.dynamics.blocks, read, strict=True)]
        own = [states[block][:, place] for block, place in self.dynamics.position]
        if self.observation == "joint":
            common = concatenated([*own, tail]).T
            return dict.fromkeys(self.names, common)
        parts = zip(own, self._nearest(read)) if self.observation == "neighbours" else ((x,) for x in own)
        # Worlds are the last axis in memory: each array is a transposed view of one that is written row by row.
        return {name: concatenated([*part, tail]).T for name, part in zip(self.names, parts, strict=True)}

    def _own(self, worlds: Worlds, read: Sequence[Array]) -> dict[str, Array]:
        """Return the observations of agents that see themselves: each array is written once."""
        size, tail, parts = tail_size(self.problem, self.automaton), None, []
        for block, x in zip(self.dynamics.blocks, read, strict=True):
            d, n, n_worlds = x.shape
            # Agents first, so that the array of each is in one piece, with the worlds last in memory.
            rows = np.empty((n, d + size, n_worlds), dtype=np.float32)
            for k, seen in enumerate(self._rows(block, x)):
                rows[:, k] = seen
            if tail is None:
                tail = rows[0, d:]
                write_shared(self.problem, worlds, self.automaton, tail)
                rows[1:, d:] = tail
            else:
                rows[:, d:] = tail
            parts.append(rows)
        return {name: parts[block][place].T for name, (block, place) in zip(self.names, self.dynamics.position)}

    def _rows(self, block: Any, x: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the rows (n, M) of states (d, n, M) of a block as observations show them, still in double precision."""
        if self.scale == "raw":
            yield from x
            return
        for row, (low, scale) in zip(x, block.unit_rows, strict=True):
            # In place: new arrays are a good part of a step. NaN counts as the lower corner, as in all observations.
            seen = row - low
            seen *= scale
            seen -= 1.0
            yield np.fmin(np.fmax(seen, -1.0, out=seen), 1.0, out=seen)

    def _nearest(self, read: Sequence[Array]) -> Iterator[Array]:
        """Yield where the nearest others are from the place of every agent, (k, M) float32."""
        d, p = common_sizes(self.problem)
        blocks = self.dynamics.blocks
        outputs = [block.outputs(x) for block, x in zip(blocks, read, strict=True)]
        xp, position = namespace(read[0]), self.dynamics.position
        states = xp.stack([read[block][:d, place] for block, place in position])
        places = xp.stack([outputs[block][:p, place] for block, place in position])
        for i, (low, high) in enumerate(self.bounds):
            seen = nearest_seen(states, places, i, self.neighbours)
            if self.scale == "unit":
                seen = xp.clip((seen - low) * (2.0 / (high - low)) - 1.0, -1.0, 1.0)
            yield single(seen)

    def _scaled(self, block: Any, x: Array) -> Array:
        """Return the states (d, n, M) of a block as observations show them, still in double precision."""
        if self.scale == "raw":
            return x
        if is_host(x):
            return np.stack(list(self._rows(block, x)))
        low, high = block.state_low, block.state_high
        seen = (x - low) * (2.0 / (high - low)) - 1.0
        xp = namespace(seen)
        return xp.clip(xp.where(seen == seen, seen, -1.0), -1.0, 1.0)
