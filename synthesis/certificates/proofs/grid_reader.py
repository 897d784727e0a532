"""From the header and the arrays of a file to a proof on grids; nothing in them is trusted.

Shapes, ranges of all indices and numbers are checked before they are used. Only ``check`` says whether the
certificate is true.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...relations.grids import Grid, lattice_axes
from ...relations.kinds import check_description
from ..cell_probabilities import AgentRecord
from ..value_functions import MergeLog, Merges, Rounding, Terms
from .archive import Stored

CLAIM_FIELDS = ("method", "bound", "bounds", "lower_bound", "gap", "relative_rounding", "rank")
"""Fields of a proof about its claim, which files hold under the same names."""

LARGEST_ROUNDING = 1e-3
"""Largest relative reserve for floating point that makes sense: more of it would hide a wrong value."""


class GridReader:
    """Rebuilds what a proof on grids holds, checking every shape and index on the way.

    Parameters
    ----------
    problem : Problem
    stored : Stored
    """

    def __init__(self, problem: Problem, stored: Stored) -> None:
        self.problem, self.header, self.arrays = problem, stored.entry, stored.arrays
        self.n_agents, self.n_states = problem.n_agents, problem.automaton.n_states

    def fields(self) -> dict[str, Any]:
        """Return the fields of the proof but for the opposite task's; raise ValueError (KeyError, ..) otherwise."""
        header = self.header
        agents = self._each(header["agents"], self.n_agents, self._agent)
        # Guards point at automaton states and at the masks of the agents.
        source, target = (self._integers(header["guards"][k], (None,), self.n_states) for k in (0, 1))
        mask = self._integers(header["guards"][2], (len(source), self.n_agents), None)
        if len(target) != len(source) or any(mask[:, i].max(initial=-1) >= len(a.masks) for i, a in enumerate(agents)):
            raise ValueError("its guards are inconsistent")
        start_target = self._integers(header["start_guards"][0], (None,), self.n_states)
        start_mask = self._integers(header["start_guards"][1], (len(start_target), self.n_agents), None)
        if any(start_mask[:, i].max(initial=-1) >= len(a.start_masks) for i, a in enumerate(agents)):
            raise ValueError("its start guards are inconsistent")
        claim = {name: header[name] for name in CLAIM_FIELDS}
        _check_claim(claim)
        # The value function is either a tree with its skeleton, or trains with their rounding.
        trains = header.get("rounding") is not None
        if trains and (header["terms"] is not None or header["skeleton"]):
            raise ValueError("it holds a value tree beside its tensor trains")
        return dict(
            agents=tuple(agents),
            guard_source=source,
            guard_target=target,
            guard_mask=mask,
            start_target=start_target,
            start_mask=start_mask,
            merge_log=() if trains else tuple(self._each(header["skeleton"], self.problem.horizon, self._step)),
            terms=None if trains else self._terms(agents),
            rounding=self._rounding(agents) if trains else None,
            **claim,
        )

    def _each(self, items: Any, count: int, read: Any) -> list[Any]:
        """Return what ``read`` makes of each of ``count`` items, their number kept in ``_position``."""
        if not isinstance(items, list) or len(items) != count:
            raise ValueError(f"a list of {count} entries is missing")
        self._position = 0
        result = []
        for self._position, item in enumerate(items):
            result.append(read(item))
        return result

    def _array(self, number: Any, kinds: str, shape: tuple[int | None, ...]) -> NDArray:
        """Return the array with a number, read-only, of given kinds of dtype and shape (None: any length)."""
        array = self.arrays[str(int(number))]
        fits = array.ndim == len(shape) and all(b is None or a == b for a, b in zip(array.shape, shape, strict=True))
        plain = array.dtype == np.float64 if kinds == "f" else array.dtype.isnative and array.dtype != np.uint64
        if array.dtype.kind not in kinds or not plain or not fits:
            raise ValueError(f"array {number} has type {array.dtype} and shape {array.shape}, expected {shape}")
        if kinds == "f" and not np.all(np.isfinite(array)):
            raise ValueError(f"array {number} holds numbers that are not finite")
        array.setflags(write=False)
        return array

    def _integers(self, number: Any, shape: tuple[int | None, ...], below: int | None, least: int = 0) -> NDArray:
        """Return the array of whole numbers with a number, all in ``least .. below - 1`` (None: without an end)."""
        array = self._array(number, "iu", shape)
        if array.size and (array.min() < least or (below is not None and array.max() >= below)):
            raise ValueError(f"array {number} holds indices out of range")
        return array

    def _agent(self, entry: dict[str, Any]) -> AgentRecord:
        """Return what is stored of one agent."""
        agent = self.problem.agents[self._position]
        d = agent.n_states
        n_axes = len(lattice_axes(agent)) if entry["relation"]["kind"] == "boxes" else d
        if len(entry["edges"]) != d or len(entry["lattice"]) != n_axes:
            raise ValueError("an agent has the wrong number of axes")
        # Files of 0.3 have a matrix from grid axes to states.
        if "coordinates" in entry and not np.array_equal(self._array(entry["coordinates"], "f", (d, d)), np.eye(d)):
            raise ValueError(
                "cells lie along other axes than states, which 0.4 does not read; make it anew along a path"
            )
        grid = Grid(tuple(self._array(k, "f", (None,)) for k in entry["edges"]))
        lattice = tuple(self._array(k, "f", (None,)) for k in entry["lattice"])
        points = math.prod(len(axis) for axis in lattice)
        # A stationary policy is stored once, for all times; "law" is the name of the policy in files.
        times = 1 if self.arrays[str(int(entry["law"]))].shape[:1] == (1,) else self.problem.horizon
        shape = (times, self.n_states, grid.n_cells)
        # Choices are lattice points, or inputs of a menu whose entries are lattice points.
        input_set = None if entry["menu"] is None else self._integers(entry["menu"], (grid.n_cells, None), points)
        check_description(entry["relation"], self.problem.agents[self._position])
        kind = entry["relation"]["kind"]
        if (kind not in ("boxes", "exact", "linear")) != (input_set is not None):
            raise ValueError("a relation and its choices do not belong together")
        choices = points if input_set is None else input_set.shape[1]
        if kind == "linear":
            choices = len(entry["relation"]["menu"]) + (points if "aims" in entry["relation"] else 0)
        elif kind == "boxes":
            choices = len(entry["relation"]["menu"])
        if kind in ("boxes", "linear") and any(len(axis) < 2 for axis in lattice):
            raise ValueError(f"the lattice of an agent under the relation {kind} has axes of a single point")
        return AgentRecord(
            grid=grid,
            lattice=lattice,
            relation=entry["relation"],
            masks=self._array(entry["masks"], "b", (None, grid.n_cells)),
            start_masks=self._array(entry["start_masks"], "b", (None, grid.n_cells)),
            policy=self._integers(entry["law"], shape, choices, least=-1),
            input_set=input_set,
        )

    def _step(self, entry: Any) -> MergeLog:
        """Return one time of the tree."""
        if len(entry) != self.n_states:
            raise ValueError("the tree has the wrong number of states")
        origins, merges, kept = [], [], []
        # Per automaton state: vertices (guard, child), merges (into, absorbed, agent), and the vertices kept.
        for numbers in entry:
            origin = self._integers(numbers[0], (None, 2), None).astype(np.int64)
            n = len(origin)
            into = self._integers(numbers[1], (None,), n).astype(np.int64)
            absorbed = self._integers(numbers[2], (len(into),), n).astype(np.int64)
            agent = self._integers(numbers[3], (len(into),), self.n_agents).astype(np.int64)
            origins.append(origin)
            rest = None
            if len(numbers) > 5:
                rest = self._integers(numbers[5], (len(into),), self.n_agents + 1, -self.n_agents).astype(np.int64)
                if np.any(np.abs(rest) - 1 == agent):
                    raise ValueError("a remainder differs in the agent whose factors were added")
            merges.append(Merges(into, absorbed, agent, rest))
            kept.append(self._integers(numbers[4], (None,), n).astype(np.int64))
        return MergeLog(tuple(origins), tuple(merges), tuple(kept))

    def _rounding(self, agents: list[AgentRecord]) -> Rounding:
        """Return how trains were rounded; that the cells increase is left to whoever grows them again."""
        entry = self.header["rounding"]
        tolerance = entry["tolerance"]
        if not isinstance(tolerance, float) or not 0 < tolerance < 1:
            raise ValueError("its rounding has no tolerance between 0 and 1")
        visited: list[tuple[NDArray, ...] | None] = []
        for cells in self._each(entry["visited"], self.problem.horizon + 1, lambda item: item):
            if cells is not None and len(cells) != self.n_agents:
                raise ValueError("its rounding does not name the cells of every agent")
            if cells is None:  # all cells
                visited.append(None)
                continue
            pairs = zip(cells, agents, strict=True)
            visited.append(tuple(self._integers(k, (None,), a.grid.n_cells).astype(np.int64) for k, a in pairs))
        return Rounding(tolerance, tuple(visited))

    def _terms(self, agents: list[AgentRecord]) -> Terms:
        """Return the value function at time 0."""
        entry = self.header["terms"]
        if len(entry["factors"]) != self.n_agents or len(entry["index"]) != self.n_states:
            raise ValueError("the value function has the wrong size")
        factors = tuple(self._array(k, "f", (None, a.n_places)) for k, a in zip(entry["factors"], agents, strict=True))
        index = tuple(self._integers(k, (None, self.n_agents), None) for k in entry["index"])
        for rows in index:
            if len(rows) and any(rows[:, i].max() >= len(distinct) for i, distinct in enumerate(factors)):
                raise ValueError("the value function points at factors that are not there")
        return Terms(factors, index)


def _check_claim(claim: dict[str, Any]) -> None:
    """Raise ValueError unless the fields of a claim have the right types and ranges."""
    lower, gap, relative = claim["lower_bound"], claim["gap"], claim["relative_rounding"]
    texts = all(isinstance(claim[k], str) for k in ("method", "bound"))
    bounds = claim["bounds"]
    if any(isinstance(value, bool) for value in (lower, gap)):
        raise ValueError("its bound is not a number")
    if not isinstance(bounds, dict) or not all(isinstance(v, float | int) and abs(v) <= 1e9 for v in bounds.values()):
        raise ValueError("its bounds are not numbers")
    is_rank = isinstance(claim["rank"], int) and not isinstance(claim["rank"], bool) and 0 <= claim["rank"] < 2**53
    if not texts or not is_rank:
        raise ValueError("its header holds values of the wrong type")
    is_probability = isinstance(lower, float | int) and 0 <= lower <= 1
    if not is_probability or not (isinstance(relative, float) and 0 <= relative <= LARGEST_ROUNDING):
        raise ValueError("its bound is not a probability")
    if gap is not None and not (isinstance(gap, float | int) and 0 <= gap <= 1):
        raise ValueError("its gap is not a probability")
