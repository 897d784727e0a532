"""Regions of one agent that have no point in common, so that no word asks for both at once.

Boxes of the same outputs exclude each other where they do on an axis. Of discs, and of others that are told by
different outputs, nothing is known from corners: the states that tell them are cut into boxes, and two regions exclude
each other if intervals say of each box that one of them is not there. This is for the search: what a certificate
claims of letters is checked without it.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent, AnyAgent
from ....envs.systems.expressions import names_in
from ....envs.tasks.problem import Problem
from ....envs.tasks.regions import Proposition
from ...relations.grids import FloatArray

CUTS = {1: 120, 2: 40, 3: 16}
"""Boxes per axis, by the number of states."""

MOST_REGIONS = 60
"""Regions of an agent beyond which pairs of them are not looked at one by one."""


def exclusions(problem: Problem) -> NDArray[np.bool_]:
    """Return which propositions never hold together, as far as is known: symmetric, bool (P, P)."""
    labeling = problem.labeling
    result = np.zeros((len(labeling.names),) * 2, dtype=bool)
    for agent, own in zip(problem.agents, labeling.agent_propositions, strict=True):
        still = [int(p) for p in own if not problem.propositions[labeling.names[p]].moves]
        if len(still) > MOST_REGIONS:
            continue
        regions = _Regions(agent, {p: problem.propositions[labeling.names[p]] for p in still})
        for p, q in combinations(still, 2):
            result[p, q] = result[q, p] = regions.exclude(p, q)
    return result


class _Regions:
    """Regions (low, high) of one agent, and where in its workspace each of them may be."""

    def __init__(self, agent: AnyAgent, regions: dict[int, object]) -> None:
        self.agent = agent
        self.corners = {p: (r.low, r.high) for p, r in regions.items() if isinstance(r, Proposition)}
        low, high = (end[0] for end in agent.output_range(agent.state_low[None], agent.state_high[None]))
        self.told = {p: np.flatnonzero((a > low) | (b <= high)) for p, (a, b) in self.corners.items()}
        self._known: dict[tuple[int, tuple[int, ...]], NDArray[np.bool_]] = {}

    def exclude(self, p: int, q: int) -> bool:
        """Return whether two regions surely have no point of the workspace in common."""
        (low, high), (other_low, other_high) = self.corners[p], self.corners[q]
        if np.any((high <= other_low) | (other_high <= low)):
            return True
        states = tuple(sorted(self._states(p) | self._states(q)))
        if not 0 < len(states) <= len(CUTS):
            return False
        return not bool(np.any(self._may_be(p, states) & self._may_be(q, states)))

    def _states(self, p: int) -> set[int]:
        """Return the states on which the outputs depend that a region limits."""
        agent = self.agent
        if not isinstance(agent, Agent):
            return set()  # all regions are told by rows, and corners said what they can
        return {agent.states.index(name) for k in self.told[p] for name in names_in(agent.output_trees[k])}

    def _may_be(self, p: int, states: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return in which boxes of some states a region may have a point."""
        if (p, states) not in self._known:
            bottom, top = self._ranges(states)
            low, high = self.corners[p]
            self._known[p, states] = np.all((bottom < high) & (top >= low), axis=1)
        return self._known[p, states]

    def _ranges(self, states: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Return bounds (G, p) on the outputs in the boxes of some states."""
        agent, count = self.agent, CUTS[len(states)]
        edges = [np.linspace(agent.state_low[s], agent.state_high[s], count + 1) for s in states]
        low, high = (
            np.stack([axis.ravel() for axis in np.meshgrid(*ends, indexing="ij")], axis=1)
            for ends in ([edge[:-1] for edge in edges], [edge[1:] for edge in edges])
        )
        first, last = (np.tile(end, (len(low), 1)) for end in (agent.state_low, agent.state_high))
        first[:, states], last[:, states] = low, high
        return agent.output_range(first, last)
