"""Shaped rewards: a potential read off the task automaton; every step pays the difference of the potential.

**"shaped"** pays what no policy can influence in the end. With the potential Phi of a state, a step from s to s' pays
`r + discount Phi(s') - Phi(s)`, and Phi is 0 once the episode has ended. The discounted sum over an episode of T steps
is then

    sum_t discount^t r_t  -  Phi(s_0).

This is the sparse return less a number that no policy influences, so the same policies are optimal (Ng, Harada and
Russell 1999). Termination and truncation both count as an end: the observation holds the time left, so the decision
problem ends at the horizon as well.

Phi lies in [0, 1]. It is 1 in accepting states, and 0 where acceptance is out of reach or an agent has left its
workspace. Elsewhere it counts the automaton steps that are still needed; between two of them it rises as agents come
closer to the regions of a letter that takes the next step. It estimates progress; no guarantee rests on it.

A consequence of the zero at the end: **all failing episodes have the same return**, -Phi(s_0). A learner that has never
succeeded learns nothing from it.

**"progress"** tells a good failure from a bad one. It pays the differences of a level that is kept to the end: when a
task is lost, the level stays what it was. The undiscounted return is satisfaction plus the progress made, so the
optimal policies may differ from those of the task; learn with it first and with "sparse" afterwards.

- Co-safe tasks: the level counts automaton steps as Phi does, but between two of them it rises along *one* letter, the
  one nearest to the start of the problem. Where two letters are equally good (two rooms to meet in), agents that see
  only themselves would else be drawn to both.
- Tasks judged at the horizon: half of the level is the share of time survived, a quarter is Phi, and a quarter says how
  *easily* the automaton state is carried to acceptance by letters at random. That rewards what keeps options open, such
  as a battery that was just charged.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import islice
from typing import Any

import numpy as np

from ..arrays import concatenated, double, is_host, namespace
from ..dynamics import Dynamics, Worlds
from ..dynamics import worlds as core
from ..logic import Automaton

REWARDS = ("sparse", "shaped", "progress")
# Limits that keep the potential cheap to evaluate; a shorter list makes the guess coarser, and nothing else.
_STATE_PATHS = 2000  # paths of a state's diagram that are read
_STATE_LETTERS = 32  # letters of a state that are used: those that ask for the fewest propositions


@dataclass(frozen=True, eq=False)
class Potential:
    """The potential of a problem.

    Attributes
    ----------
    dynamics : Dynamics
    steps : np.ndarray of float, shape (Q,)
        Fewest automaton steps to acceptance; infinite if there is no way.
    wanted : tuple of tuple of np.ndarray of int
        Per automaton state: the propositions of the letters that take a step forward, one array per letter.
    """

    dynamics: Dynamics
    steps: np.ndarray
    wanted: tuple[tuple[np.ndarray, ...], ...]

    @classmethod
    def of(cls, dynamics: Dynamics) -> Potential:
        """Return the potential of a problem, read off its automaton."""
        automaton = dynamics.problem.automaton
        manager, roots = automaton.diagrams()
        # Letters that no state of the agents has would be short cuts: the regions of one agent may lie apart.
        listed = [list(_letters(manager, root)) for root in roots]
        moves = [[move for move in following if _possible(dynamics, move[0])] for following in listed]
        targets = [{target for _, target in following} for following in moves]
        for q, following in enumerate(listed):
            if len(following) == _STATE_PATHS:  # there may be more letters than were read
                targets[q].update(manager.leaves(roots[q]))
        steps = _steps(automaton.accepting, targets)
        wanted = []
        for q, following in enumerate(moves):
            forward = {letter for letter, target in following if steps[target] < steps[q]}
            simplest = sorted(forward, key=lambda letter: (len(letter), sorted(letter)))[:_STATE_LETTERS]
            wanted.append(tuple(np.array(sorted(letter), dtype=int) for letter in simplest))
        return cls(dynamics, steps, tuple(wanted))

    def at(self, worlds: Worlds) -> np.ndarray:
        """Return the potential of each world, float (M,), between 0 and 1."""
        finite = self.steps[np.isfinite(self.steps)]
        most = finite.max() if finite.size else 0.0
        levels = self._by_state(
            worlds, self._gaps(worlds), lambda q, gaps: (most - self.steps[q] + self._closeness(q, gaps)) / (most + 1.0)
        )
        result: np.ndarray = namespace(levels).where(worlds.failed, 0.0, levels)
        return result

    def _by_state(self, worlds: Worlds, gaps: np.ndarray, level: Callable[[int, np.ndarray], np.ndarray]) -> np.ndarray:
        """Return the levels (M,) that `level` gives worlds of a state from gaps (P, M); 0 in hopeless states."""
        if is_host(worlds.q):
            result = np.zeros(worlds.n_worlds)
            for q in np.unique(worlds.q):
                here = np.flatnonzero(worlds.q == q)
                if np.isfinite(self.steps[q]):
                    result[here] = level(int(q), gaps[:, here])
            return result
        # On a device nobody asks which states there are: that would fetch numbers.
        xp = namespace(worlds.q)
        result = xp.zeros_like(worlds.states[0][0, 0])
        for q in np.flatnonzero(np.isfinite(self.steps)).tolist():
            result = xp.where(worlds.q == q, level(q, gaps), result)
        return result

    def kept(self, worlds: Worlds, before: np.ndarray) -> np.ndarray:
        """Return the level of the reward "progress", float (M,) in [0, 1]; lost tasks keep the level `before`."""
        problem = self.dynamics.problem
        if problem.automaton.is_co_safe:
            levels = self._along(worlds)
        else:
            ease, time = self._placed("ease"), worlds.time
            levels = 0.25 * self.at(worlds) + 0.25 * ease[time, worlds.q] + 0.5 * double(time) / problem.horizon
        result: np.ndarray = namespace(levels).where(worlds.failed | self._placed("dead")[worlds.q], before, levels)
        return result

    @cached_property
    def dead(self) -> np.ndarray:
        """Automaton states from which the task is lost, bool (Q,)."""
        return self.dynamics.problem.automaton.dead

    def _placed(self, name: str) -> Any:
        """Return a table of this record where the worlds live; it is copied once."""
        if name not in self._copies:
            self._copies[name] = self.dynamics.put(getattr(self, name))
        return self._copies[name]

    @cached_property
    def _copies(self) -> dict[str, Any]:
        return {}

    @cached_property
    def ease(self) -> np.ndarray:
        """How easily each automaton state is carried to acceptance, float (T + 1, Q), from 0 to 1 at every time."""
        return _ease(self.dynamics.problem.automaton, self.dynamics.problem.horizon)

    @cached_property
    def route(self) -> tuple[np.ndarray, ...]:
        """Per automaton state: the one letter to pursue, as its propositions; empty if there is none."""
        if not self.dynamics.is_host:
            return Potential(Dynamics.of(self.dynamics.problem), self.steps, self.wanted).route
        start = core.begin(self.dynamics, tuple(0.5 * (b.initial_low + b.initial_high) for b in self.dynamics.blocks))
        gaps = self._offsets(start)[:, 0]
        empty = np.zeros(0, dtype=int)
        return tuple(
            min(letters, key=lambda p: gaps[p].mean() if p.size else 0.0, default=empty) for letters in self.wanted
        )

    def _along(self, worlds: Worlds) -> np.ndarray:
        """Return how far the worlds have come along the route, float (M,), between 0 and 1."""
        most = self.steps[np.isfinite(self.steps)].max(initial=0.0)
        return self._by_state(
            worlds,
            self._offsets(worlds),
            lambda q, offsets: (most - self.steps[q] + _near(self.route[q], offsets)) / (most + 1.0),
        )

    def _offsets(self, worlds: Worlds) -> np.ndarray:
        """Return the mean gap of all axes to the region of each proposition, in workspace widths: (P, M) in [0, 1]."""
        return self._gaps(worlds, "mean")

    def _closeness(self, q: int, gaps: np.ndarray) -> Any:
        """Return how close the agents are to a letter that takes a step forward: float (M,), or one number for all."""
        if self.steps[q] == 0 or not self.wanted[q]:
            return 1.0 if self.steps[q] == 0 else 0.0
        return reduce(namespace(gaps).maximum, (_near(letter, gaps) for letter in self.wanted[q]))

    def _gaps(self, worlds: Worlds, joined: str = "max") -> np.ndarray:
        """Return how far the owners of each proposition are from its region, in workspace widths: (P, M) in [0, 1].

        `joined` says what of all axes counts: their "max" or their "mean".
        """
        rows = []
        for block, x in zip(self.dynamics.blocks, worlds.states):
            if len(block.propositions):
                with np.errstate(over="ignore", invalid="ignore"):
                    y = block.outputs(x)[:, block.owners]
                    # The width is that of the outputs of the workspace.
                    width = block.output_width[:, block.owners]
                    rows.append(_joined(y, *block.regions(worlds.time), width, joined))
        rows += self._gaps_of_pairs(worlds, joined)
        if not rows:
            return self.dynamics.put(np.zeros((0, worlds.n_worlds)))
        return concatenated(rows)[self.dynamics.proposition_rows]

    def _gaps_of_pairs(self, worlds: Worlds, joined: str) -> list[np.ndarray]:
        """Return the same of pairs of agents: how far their difference is from its box, in widths of both."""
        blocks, rows = self.dynamics.blocks, []
        if not self.dynamics.pairs:
            return []
        with np.errstate(over="ignore", invalid="ignore"):
            outputs = {b: block.outputs(x) for b, (block, x) in enumerate(zip(blocks, worlds.states))}
            widths = {b: block.output_width for b, block in enumerate(blocks)}
            for pairs in self.dynamics.pairs:
                first, second = (
                    widths[b][axes[:, None], places[None]]
                    for b, axes, places in zip(pairs.blocks, pairs.outputs, pairs.places)
                )
                width = first + second  # how far a difference can be from another
                d = core.difference(pairs, outputs)
                low, high, radius = pairs.regions(worlds.time)
                rows.append(_joined(d, low, high, width, joined, radius))
        return rows


def _joined(
    y: np.ndarray, low: np.ndarray, high: np.ndarray, width: np.ndarray, joined: str, radius: Any = None
) -> np.ndarray:
    """Return how far points (p, k, M) are from boxes, in widths, joined over the axes: (k, M) in [0, 1].

    Balls of a radius (k, 1) have one gap, along the way to their centre, whose parts are its shares.
    """
    xp = namespace(y)
    gap = xp.maximum(low - y, y - high) / width
    if radius is not None:
        length = xp.sqrt((y * y).sum(axis=0))
        outside = xp.abs(y) * xp.where(length > radius, 1.0 - radius / xp.where(length > 0.0, length, 1.0), 0.0)
        gap = xp.where(radius < np.inf, outside / width, gap)
    # What is no number is as far away as can be, and so is what is beyond a width.
    gap = xp.where(gap < 1.0, xp.where(gap > 0.0, gap, 0.0), 1.0)
    result: np.ndarray = getattr(xp, joined)(gap, axis=0)
    return result


def _near(letter: np.ndarray, gaps: np.ndarray) -> Any:
    """Return how near worlds are to a letter, from gaps (P, M): (M,), or 1 if it asks for nothing."""
    if not letter.size:
        return 1.0
    # Row by row, in the order in which numpy adds rows: no positions have to be sent to a device.
    return 1.0 - sum(gaps[p] for p in letter.tolist()) / float(letter.size)


def _letters(manager: Any, root: int) -> Iterator[tuple[frozenset[int], int]]:
    """Yield the letters of a state, each with the state it leads to.

    A letter is named by the propositions that have to hold; those that must not hold are ignored.
    """
    for assignment, target in islice(manager.paths(root), _STATE_PATHS):
        yield frozenset(p for p, holds in assignment.items() if holds), target


def _possible(dynamics: Dynamics, letter: frozenset[int]) -> bool:
    """Return whether the regions of every agent in a letter have a point in common, at some time if they move."""
    for block in dynamics.blocks:
        for agent in np.unique(block.owners):
            held = [k for k, p in enumerate(block.propositions) if block.owners[k] == agent and int(p) in letter]
            if held:
                low, high = block.region_low[..., held, :].max(axis=-2), block.region_high[..., held, :].min(axis=-2)
                if (low >= high).any(axis=(-2, -1)).all():
                    return False
    return True


def _steps(accepting: np.ndarray, following: Sequence[Collection[int]]) -> np.ndarray:
    """Return the fewest transitions from each automaton state to an accepting one, infinite if there is no way."""
    steps = np.where(accepting, 0.0, np.inf)
    # Bellman-Ford: shortest ways are at most as long as there are states.
    for _ in range(len(following)):
        shorter = np.array([min((steps[t] + 1.0 for t in targets), default=np.inf) for targets in following])
        if (shorter >= steps).all():
            break
        steps = np.minimum(steps, shorter)
    return steps


def _ease(automaton: Automaton, horizon: int) -> np.ndarray:
    """Return how easily letters at random lead each state to acceptance: float (T + 1, Q), from 0 to 1 at every time.

    The chance that T - t letters, in which every proposition holds or not by the toss of a coin, are accepted from a
    state; on a logarithmic scale, from the least chance of a state that is not dead to the largest.
    """
    result = np.zeros((horizon + 1, automaton.n_states))
    chance = automaton.accepting.astype(float)
    levels = [np.flatnonzero(automaton.variable == p) for p in np.unique(automaton.variable)[::-1]]
    for time in range(horizon, -1, -1):
        with np.errstate(divide="ignore"):
            logs = np.log(chance)
        alive = np.isfinite(logs)
        if alive.any():
            least, most = logs[alive].min(), logs[alive].max()
            result[time, alive] = (logs[alive] - least) / (most - least) if most > least else 1.0
        # One letter more: half of the chance behind either child, from the last proposition to the first.
        nodes = np.zeros(len(automaton.variable))
        for here in levels:
            low, high = (_behind(entries[here], chance, nodes) for entries in (automaton.low, automaton.high))
            nodes[here] = 0.5 * low + 0.5 * high
        chance = _behind(automaton.root, chance, nodes)
        chance = chance / max(chance.max(), 1e-300)  # only ratios count; products of many halves would vanish
    return result


def _behind(entries: np.ndarray, chance: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return the numbers behind entries of a diagram: of a node, or of state -1 - e for an entry e below 0."""
    of_states = chance[-1 - np.minimum(entries, -1)]
    return np.where(entries < 0, of_states, nodes[np.maximum(entries, 0)] if nodes.size else 0.0)
