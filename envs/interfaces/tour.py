"""The letters to pursue, one in each automaton state: those of the shortest tour to acceptance.

A tour goes from the start of the problem through the regions of one letter after the other. Its length is the sum of
the ways of all agents, straight and in shares of the workspaces' widths; a way through a region that loses the task
counts `DETOUR` times. Noise, dynamics and pairs of agents are left out. No guarantee rests on it: it only says in which
order a learner is led through a task that may be done in several.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..simulation import Dynamics
from ..systems.backends import to_host

DETOUR, POINTS = 2.0, 32
"""What a way counts that goes through a region that loses, and how many points of a way are looked at."""

Letter = frozenset[int]
Place = dict[int, np.ndarray]
"""Outputs (p,) of the agents that the last letter asked for something; the others stand where the problem starts."""


@dataclass(frozen=True, eq=False)
class Tour:
    """Where agents begin, and where propositions want them.

    Attributes
    ----------
    start : tuple of np.ndarray, shape (p_i,)
        Outputs of every agent in the middle of the start.
    width : tuple of np.ndarray, shape (p_i,)
        Widths of the outputs of their workspaces.
    boxes : dict of int to (int, np.ndarray, np.ndarray)
        Of each proposition that is no pair: its agent, and the ends (p_i,) of its region at time 0.
    """

    start: tuple[np.ndarray, ...]
    width: tuple[np.ndarray, ...]
    boxes: dict[int, tuple[int, np.ndarray, np.ndarray]]

    @classmethod
    def of(cls, dynamics: Dynamics) -> Tour:
        """Return what a tour of a problem goes by; the dynamics must be those of numpy."""
        start: dict[int, np.ndarray] = {}
        width: dict[int, np.ndarray] = {}
        boxes: dict[int, tuple[int, np.ndarray, np.ndarray]] = {}
        for block in dynamics.blocks:
            middle = block.outputs(0.5 * (block.initial_low + block.initial_high))
            for k, agent in enumerate(to_host(block.agents).tolist()):
                start[agent], width[agent] = middle[:, k, 0], block.output_width[:, k, 0]
            low, high = block.regions(0)
            for j, (proposition, owner) in enumerate(zip(block.propositions.tolist(), block.owners.tolist())):
                boxes[proposition] = int(block.agents[owner]), low[:, j, 0], high[:, j, 0]
        agents = range(len(start))
        return cls(tuple(start[i] for i in agents), tuple(width[i] for i in agents), boxes)

    def letters(
        self,
        initial: int,
        steps: np.ndarray,
        forward: Sequence[Mapping[Letter, int]],
        avoided: Sequence[Letter],
    ) -> tuple[Letter, ...]:
        """Return the letter that each automaton state pursues; the empty one if it has none.

        Parameters
        ----------
        initial : int
        steps : np.ndarray of float, shape (Q,)
            Fewest automaton steps to acceptance.
        forward : sequence of mappings
            Of each automaton state: letters that lead to one of fewer steps, and where they lead.
        avoided : sequence of frozenset of int
            Of each automaton state: the propositions that lose the task.
        """
        entered: list[set[Letter]] = [set() for _ in forward]
        entered[initial].add(frozenset())
        for onward in forward:
            for letter, target in onward.items():
                entered[target].add(letter)
        # From the last steps to the first ones: the length of the rest of the tour, and its next letter.
        rest: dict[tuple[int, Letter], tuple[float, Letter]] = {}
        for q in np.argsort(steps, kind="stable").tolist():
            for last in entered[q] or {frozenset()}:
                place = self._place(last)
                ways = [
                    (self._way(place, letter, avoided[q]) + rest[target, letter][0], k, letter)
                    for k, (letter, target) in enumerate(forward[q].items())
                ]
                length, _, letter = min(ways, default=(0.0, 0, frozenset[int]()))
                rest[q, last] = length, letter
        # States of the tour pursue what it does there; the others what is shortest from any letter that leads there.
        result = [min(rest[q, last] for last in entered[q] or {frozenset()})[1] for q in range(len(forward))]
        q, last = initial, frozenset[int]()
        while forward[q]:
            last = result[q] = rest[q, last][1]
            q = forward[q][last]
        return tuple(result)

    def _place(self, letter: Letter) -> Place:
        """Return where a letter leads those that it asks for something: to the nearest points from their start."""
        place: Place = {}
        for proposition in sorted(letter & self.boxes.keys()):
            agent, low, high = self.boxes[proposition]
            place[agent] = np.clip(place.get(agent, self.start[agent]), low, high)
        return place

    def _way(self, place: Place, letter: Letter, avoided: Letter) -> float:
        """Return the sum of the ways of all agents to where a letter leads them, in mean shares of the widths."""
        total = 0.0
        regions = [self.boxes[p] for p in sorted(avoided & self.boxes.keys())]
        for agent, there in self._place(letter).items():
            at = place.get(agent, self.start[agent])
            points = at + np.linspace(0.0, 1.0, POINTS)[:, None] * (there - at)
            loses = any(((low < points) & (points < high)).all(axis=1).any() for i, low, high in regions if i == agent)
            total += (DETOUR if loses else 1.0) * float((np.abs(there - at) / self.width[agent]).mean())
        return total
