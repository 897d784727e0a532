"""The letters to pursue, one in each automaton state, those of the shortest tour; and ways around what is avoided.

A tour goes from the start of the problem through the regions of one letter after the other. Its length is the sum of
the ways of all agents, straight and in shares of the workspaces' widths; a way through a region that loses the task
counts `DETOUR` times. Noise, dynamics and pairs of agents are left out. No guarantee rests on it: it only says in which
order a learner is led through a task that may be done in several.

Where an agent in the plane has to avoid regions on its way to the next letter, the way is measured around them: by
steps from cell to cell of a grid of its outputs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..simulation import Dynamics
from ..systems.backends import is_host, namespace, to_host

DETOUR, POINTS = 2.0, 32
"""What a way counts that goes through a region that loses, and how many points of a way are looked at."""

CELLS = 64
"""Cells of the grid along each axis."""

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


def detours(dynamics: Dynamics, route: Sequence[np.ndarray], avoided: Sequence[Letter]) -> dict[int, np.ndarray]:
    """Return how far cells are from what the next letter asks of an agent, around what it avoids.

    Only for agents with linear outputs in the plane, and for regions that stand still.

    Parameters
    ----------
    dynamics : Dynamics
        Of numpy.
    route, avoided : sequences
        Of each automaton state: the propositions of the next letter, and those to avoid.

    Returns
    -------
    dict of int to np.ndarray
        By agent: ways in mean shares of the widths, float (Q, CELLS^2); 0 where nothing is avoided or asked.
    """
    found: dict[int, np.ndarray] = {}
    for block in dynamics.blocks:
        if not is_planar(block):
            continue
        for place, agent in enumerate(block.agents.tolist()):
            own = [j for j in range(len(block.owners)) if block.owners[j] == place]
            cells = _cells(block, place)

            tables = np.zeros((len(route), CELLS**2))
            for q, letter in enumerate(route):
                wanted = [j for j in own if block.propositions[j] in letter]
                bad = [j for j in own if int(block.propositions[j]) in avoided[q]]
                if wanted and bad:
                    blocked = np.any([_within(block, j, cells) for j in bad], axis=0)
                    goal = np.all([_within(block, j, cells) for j in wanted], axis=0) & ~blocked
                    if goal.any():
                        tables[q] = _steps_to(goal, blocked).ravel() / (2.0 * CELLS)
            if tables.any():
                found[agent] = tables
    return found


def is_planar(block: Any) -> bool:
    """Return whether the outputs of a block are linear and in the plane, and its regions stand still."""
    if block.region_low.ndim != 3 or len(block.region_low) != 2:
        return False
    return hasattr(block.motion, "C") or all(map(block.motion.agent.output_axis, range(2)))


def cells_of(block: Any, agents: list[int]) -> Callable[[np.ndarray], Any]:
    """Return what tells the cells (k, M) of agents of a block from its states (d, n, M); the nearest if outside."""
    places = slice(None) if agents == list(range(len(block.agents))) else agents  # a view, where that will do
    low, width = _corner(block, places), block.output_width[:, places]

    def cells(states: np.ndarray) -> Any:
        share = block.outputs(states)[:, places] - low
        # What is no number is not above 0 either.
        if is_host(share):
            share /= width
            share *= CELLS
            whole = np.fmin(np.fmax(share, 0.0, out=share), CELLS - 1.0, out=share).astype(np.int64)
        else:
            xp, share = namespace(share), share / width * CELLS
            whole = xp.astype(xp.where(share > 0.0, xp.where(share < CELLS - 1.0, share, CELLS - 1.0), 0.0), xp.int64)
        return whole[0] * CELLS + whole[1]

    return cells


def _corner(block: Any, places: Any) -> Any:
    """Return the lower corners (2, k, 1) of the outputs of the workspaces of agents, (2, 1) of one."""
    return block.outputs(0.5 * (block.state_low + block.state_high))[:, places] - 0.5 * block.output_width[:, places]


def _cells(block: Any, place: int) -> np.ndarray:
    """Return the middles of the cells of an agent, float (CELLS, CELLS, 2)."""
    low, width = _corner(block, place)[:, 0], block.output_width[:, place, 0]
    axes = low[:, None] + width[:, None] * (np.arange(CELLS) + 0.5) / CELLS
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def _within(block: Any, proposition: int, cells: np.ndarray) -> np.ndarray:
    """Return which cells have their middle in the region of a proposition of a block, bool (CELLS, CELLS)."""
    low, high = block.region_low[:, proposition, 0], block.region_high[:, proposition, 0]
    inside: np.ndarray = ((low <= cells) & (cells < high)).all(axis=-1)
    return inside


def _steps_to(goal: np.ndarray, blocked: np.ndarray) -> np.ndarray:
    """Return the steps from each cell to a goal, around blocked cells; the most there are where no way leads."""
    steps = np.where(goal, 0.0, np.inf)
    # Each round lets the front move on by a cell; ways are at most as long as there are cells.
    for _ in range(steps.size):
        padded = np.pad(steps, 1, constant_values=np.inf)
        around = np.minimum.reduce([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
        nearer = np.where(blocked, np.inf, np.minimum(steps, around + 1.0))
        if np.array_equal(nearer, steps):
            break
        steps = nearer
    return np.where(np.isfinite(steps), steps, steps[np.isfinite(steps)].max())
