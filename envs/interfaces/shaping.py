"""Shaped rewards: levels of the agents, read off the task automaton; every step pays their differences.

The **level** of an agent lies in [0, 1]. It is 1 in accepting states of the automaton and 0 where acceptance is out of
reach or an agent has left its workspace. Elsewhere it counts the automaton steps that are still needed; between two of
them it rises as the agent comes closer to what *one* letter asks of it, the next one of the shortest tour, in the
plane around regions that lose the task or set it back (`tour`).
Where two letters are equally good (two rooms to meet in), agents that see only themselves would else be drawn to both.
A letter is a conjunction over agents, so each of them has a level of its own; one of which a letter asks nothing has
done its part. The level of a team is the mean of those of its agents. No guarantee rests on levels.

**"shaped"** pays what no policy can influence in the end. With the level Phi of a state, a step from s to s' pays
`r + discount Phi(s') - Phi(s)`, and Phi is 0 once the episode has ended, at the horizon as well. The discounted sum
over an episode is the sparse one less Phi(s_0), so the same policies are optimal (Ng, Harada and Russell 1999). All
failing episodes have the same return: a learner that has never succeeded learns nothing from it.

**"progress"** tells a good failure from a bad one. An automaton step is worth 1, half of it for the way from the start.
In tasks that only have to be kept alive, time survived is worth something, too; and a task that is lost keeps what it
was worth, less its `loss`. What is gained stays, so optimal policies may differ from those of the task; by how much is
proved in docs/how-to/learned_policies.md, "What the rewards keep".
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add
from typing import Any

import numpy as np

from ..simulation import Dynamics, Worlds
from ..simulation import batch_simulator as core
from ..systems.backends import is_host, namespace, to_host
from ..tasks.automata import Automaton
from .tour import CELLS, Tour, cells_of, detours

Weights = list[tuple[list[int], Any]]
"""Places of gaps, and what these take off a level in each automaton state, floats (Q,)."""

REWARDS = ("sparse", "shaped", "progress")

LOSS, DEATH = 0.4, 1.0
"""What "progress" takes for a lost task, and where the task is to survive. Much more, and agents that have not found a
way learn to stay where they are (so learners begin with a share of it); much less, and they run into one another."""

SURVIVAL = 0.5
"""What "progress" pays for surviving to the horizon, in tasks that are lost or satisfied and nothing else."""

EASE = 0.25
"""What it pays there for the automaton state that is most easily carried to acceptance."""

# Limits that keep the potential cheap to evaluate; a shorter list makes the guess coarser, and nothing else.
_STATE_PATHS = 2000  # paths of a state's diagram that are used: those that do not lose the task
_READ_PATHS = 10_000  # paths that are read
_STATE_LETTERS = 32  # letters of a state that are used: those that ask for the fewest propositions


@dataclass(frozen=True, eq=False)
class Potential:
    """The levels of a problem.

    Attributes
    ----------
    dynamics : Dynamics
    steps : np.ndarray of float, shape (Q,)
        Fewest automaton steps to acceptance; infinite if there is no way.
    route : tuple of np.ndarray of int
        Per automaton state: the propositions of the letter to pursue; empty if it asks for nothing.
    avoided : tuple of frozenset of int
        Per automaton state: the propositions that lose the task or set it back, whatever else holds.
    """

    dynamics: Dynamics
    steps: np.ndarray
    route: tuple[np.ndarray, ...]
    avoided: tuple[frozenset[int], ...]

    @classmethod
    def of(cls, dynamics: Dynamics) -> Potential:
        """Return the levels of a problem, read off its automaton."""
        if not dynamics.is_host:  # what is read off the automaton is read with numpy
            return replace(cls.of(Dynamics.of(dynamics.problem)), dynamics=dynamics)
        automaton = dynamics.problem.automaton
        manager, roots = automaton.diagrams()
        lost = automaton.dead
        listed = [_letters(manager, root, lost) for root in roots]
        # Letters that no state of the agents has would be short cuts: the regions of one agent may lie apart.
        moves = [[move for move in following if _possible(dynamics, move[0])] for following, _ in listed]
        targets = [{target for _, target in following} for following in moves]
        for q, (_, is_all) in enumerate(listed):
            if not is_all:
                targets[q].update(manager.leaves(roots[q]))
        steps = _steps(automaton.accepting, targets)
        joint = _overlaps(dynamics)
        avoided = tuple(_avoided(manager, root, steps <= steps[q], joint) for q, root in enumerate(roots))
        # What no state can do without holds wherever the task is not lost: it is nothing to come near to.
        needs = [letter for q in np.flatnonzero(~automaton.absorbing) for letter, _ in listed[q][0]]
        always = frozenset.intersection(*needs) if needs else frozenset()
        forward: list[dict[frozenset[int], int]] = []
        for q, following in enumerate(moves):
            onward = {letter - always: target for letter, target in following if steps[target] < steps[q]}
            simplest = sorted(onward, key=lambda letter: (len(letter), sorted(letter)))[:_STATE_LETTERS]
            forward.append({letter: onward[letter] for letter in simplest})
        chosen = Tour.of(dynamics).letters(automaton.initial, steps, forward, avoided)
        route = [np.array(sorted(letter), dtype=int) for letter in chosen]
        return cls(dynamics, steps, tuple(route), avoided)

    def __getstate__(self) -> dict[str, Any]:
        return {
            name: getattr(self, name) for name in ("dynamics", "steps", "route", "avoided")
        }  # functions are made again

    def at(self, worlds: Worlds, own: bool = False) -> np.ndarray:
        """Return the level of every team, float (M,) in [0, 1]; with `own` those of its agents, (n, M)."""
        levels, failed = self._undecided(worlds, own), worlds.failed
        result: np.ndarray = namespace(levels).where(failed, 0.0, levels)
        return result

    def _undecided(self, worlds: Worlds, own: bool) -> np.ndarray:
        """Return the levels that worlds have if no agent has left its workspace, (M,) or (n, M)."""
        gaps, q, rows = self._gaps(worlds), worlds.q, []
        for weights in self._weights[own]:
            row = _entries(self._placed("counted"), q)
            for places, weight in weights:
                row = row - _entries(weight, q) * reduce(add, (gaps[k] for k in places))
            rows.append(row)
        for agents, detours_now in self._detours[own]:
            for agent, detour in zip(agents, detours_now(worlds)):
                row = agent if own else 0
                rows[row] = rows[row] - detour
        result: np.ndarray = namespace(q).stack(rows) if own else rows[0]
        return result

    def progress(self, worlds: Worlds, before: Any = 0.0, own: bool = False, care: float = 1.0) -> np.ndarray:
        """Return what the reward "progress" has paid for worlds, float (M,); with `own` for their agents, (n, M).

        Tasks that are lost keep what they had `before`, less the `loss`; of `LOSS` a share `care` is taken.
        """
        worth = self.parts * self._undecided(worlds, own)
        if self.is_survival:
            worth = worth + self._placed("clock")[worlds.time, worlds.q]
        result: np.ndarray = namespace(worth).where(
            worlds.failed | _entries(self._placed("dead"), worlds.q), before - self.loss(care), worth
        )
        return result

    @cached_property
    def parts(self) -> float:
        """Into how many parts levels are divided: the most automaton steps that are needed, and acceptance."""
        return float(self.steps[np.isfinite(self.steps)].max(initial=0.0)) + 1.0

    @cached_property
    def counted(self) -> np.ndarray:
        """Level of each automaton state where no gap is left, float (Q,)."""
        return np.where(np.isfinite(self.steps), 1.0 - np.minimum(self.steps, self.parts) / self.parts, 0.0)

    @cached_property
    def dead(self) -> np.ndarray:
        """Automaton states from which the task is lost, bool (Q,)."""
        return self.dynamics.problem.automaton.dead

    @cached_property
    def _asked(self) -> tuple[np.ndarray, np.ndarray]:
        """Propositions whose gaps count, int (K,), and of which agent each automaton state asks which, (n, Q, K)."""
        pursued = np.unique(np.concatenate([np.zeros(0, dtype=int), *self.route]))
        asks = np.array([np.isin(pursued, letter) for letter in self.route])
        asked: np.ndarray = _owned(self.dynamics)[:, None, pursued] & asks
        for agent, table in self._tables.items():
            asked[agent, table.any(axis=1)] = False  # the way is measured around what is avoided
        counts = asked.any(axis=(0, 1))
        return pursued[counts], asked[..., counts]

    @cached_property
    def _tables(self) -> dict[int, np.ndarray]:
        """Ways around what is avoided, by agent: float (Q, CELLS^2), 0 in automaton states without any."""
        host = self.dynamics if self.dynamics.is_host else Dynamics.of(self.dynamics.problem)
        return detours(host, self.route, self.avoided)

    @cached_property
    def _detours(self) -> list[list[tuple[list[int], Callable[[Worlds], np.ndarray]]]]:
        """What takes the ways around what is avoided off the level of the team, and of agents: (k, M) for k of them."""
        first = core.begin(self.dynamics, tuple(0.5 * (b.initial_low + b.initial_high) for b in self.dynamics.blocks))
        found: list[list[tuple[list[int], Callable[[Worlds], np.ndarray]]]] = [[], []]
        for number, block in enumerate(self.dynamics.blocks):
            agents = [agent for agent in self._tables if self.dynamics.position[agent][0] == number]
            if not agents:
                continue
            cells, shares = cells_of(block, [self.dynamics.position[agent][1] for agent in agents]), []
            for agent, cell in zip(agents, to_host(cells(first.states[number]))[:, 0]):
                table, start = self._tables[agent], self._tables[agent][:, cell].max()
                shares.append(np.minimum(table / (2.0 * start if start > 0.0 else 1.0), 1.0) / self.parts)
            for own, weight in enumerate((1.0 / self.dynamics.problem.n_agents, 1.0)):
                flat = self.dynamics.put((np.stack(shares) * weight).ravel())
                found[own].append((agents, _lookup(flat, number, self.dynamics.put(np.arange(len(agents))), cells)))
        return found

    @cached_property
    def _weights(self) -> tuple[list[Weights], list[Weights]]:
        """What gaps take off the level of the team, and of each agent."""
        _, asked = self._asked
        each = asked / (self.parts * np.maximum(asked.sum(axis=2, keepdims=True), 1))

        def entries(table: np.ndarray) -> Weights:
            # Gaps of equal weights are added before they are weighed.
            columns: dict[bytes, list[int]] = {}
            for k in np.flatnonzero(table.any(axis=0)).tolist():
                columns.setdefault(table[:, k].tobytes(), []).append(k)
            return [(places, self.dynamics.put(table[:, places[0]].copy())) for places in columns.values()]

        return [entries(each.mean(axis=0))], [entries(table) for table in each]

    @cached_property
    def _gaps(self) -> Callable[[Worlds], list[Any]]:
        # Gaps are measured by twice the way that their owners have to go from the start of the problem.
        pursued, asked = self._asked
        ways = np.where(asked.any(axis=1), _at_start(self.dynamics)[pursued], 0.0).max(axis=1, initial=0.0)
        longest = np.where(asked.any(axis=1), ways[:, None], 0.0).max(axis=0, initial=0.0)
        units = np.where(longest > 0.0, 2.0 * longest, 1.0)
        return _gaps_of(self.dynamics, pursued, units)

    @cached_property
    def is_survival(self) -> bool:
        """Whether the task asks for nothing but to survive: all automaton states that are not lost accept."""
        return not self.dynamics.problem.automaton.is_co_safe and self.parts == 1.0

    def loss(self, care: float = 1.0) -> float:
        """Return what a lost task costs."""
        return DEATH if self.is_survival else care * LOSS

    @cached_property
    def clock(self) -> np.ndarray:
        """What "progress" pays in tasks of survival, float (T + 1, Q)."""
        horizon = self.dynamics.problem.horizon
        return np.asarray(SURVIVAL * np.arange(horizon + 1.0)[:, None] / horizon + EASE * self.ease)

    @cached_property
    def ease(self) -> np.ndarray:
        """How easily each automaton state is carried to acceptance, float (T + 1, Q), from 0 to 1 at every time."""
        return _ease(self.dynamics.problem.automaton, self.dynamics.problem.horizon)

    def _placed(self, name: str) -> Any:
        """Return a table of this record where the worlds live; it is copied once."""
        if name not in self._copies:
            self._copies[name] = self.dynamics.put(getattr(self, name))
        return self._copies[name]

    @cached_property
    def _copies(self) -> dict[str, Any]:
        return {}


def _entries(table: Any, places: Any) -> Any:
    """Return the entries of a flat table at places of any shape; numpy is faster where it need not ask for the axis."""
    return table.take(places) if is_host(table) else table[places]


def _lookup(table: Any, number: int, agents: Any, cells: Callable[[np.ndarray], Any]) -> Callable[[Worlds], np.ndarray]:
    """Return what reads a table (k * Q * CELLS^2,) at automaton state and cells of k agents of a block: (k, M)."""
    first = agents[:, None] * (len(table) // len(agents))

    def read(worlds: Worlds) -> np.ndarray:
        result: np.ndarray = _entries(table, cells(worlds.states[number]) + first + worlds.q * CELLS**2)
        return result

    return read


def _owned(dynamics: Dynamics) -> np.ndarray:
    """Return which agent owns which proposition, bool (n, P); pairs have two owners."""
    automaton = dynamics.problem.automaton
    owns = np.zeros((dynamics.problem.n_agents, len(automaton.propositions)), dtype=bool)
    for block in dynamics.blocks:
        owns[to_host(block.agents)[to_host(block.owners)], to_host(block.propositions)] = True
    for pairs in dynamics.pairs:
        for b, places in zip(pairs.blocks, pairs.places):
            owns[to_host(dynamics.blocks[b].agents)[to_host(places)], to_host(pairs.propositions)] = True
    return owns


def _at_start(dynamics: Dynamics) -> np.ndarray:
    """Return the gaps (P,) of all propositions in the middle of the start, in widths."""
    if not dynamics.is_host:
        return _at_start(Dynamics.of(dynamics.problem))
    start = core.begin(dynamics, tuple(0.5 * (b.initial_low + b.initial_high) for b in dynamics.blocks))
    count = len(dynamics.problem.automaton.propositions)
    return np.array([row[0] for row in _gaps_of(dynamics, np.arange(count), np.ones(count))(start)])


def _gaps_of(dynamics: Dynamics, wanted: np.ndarray, units: np.ndarray) -> Callable[[Worlds], list[Any]]:
    """Return what tells how far the owners of propositions (K,) are from their regions: K rows (M,) in [0, 1].

    The mean gap of all axes, in workspace widths (of pairs: in widths of both), divided by units (K,).
    """
    makers: list[tuple[Any, Any]] = [(_block_gaps, dynamics.blocks), (_pair_gaps, dynamics.pairs)]
    parts, found = [], []
    for make, number, stack in ((make, k, stack) for make, stacks in makers for k, stack in enumerate(stacks)):
        propositions = to_host(stack.propositions)
        held = np.flatnonzero(np.isin(propositions, wanted))
        if held.size:
            places = np.searchsorted(wanted, propositions[held])
            parts.append(make(dynamics, number, held, dynamics.put(1.0 / units[places][:, None])))
            found.append(places)
    order = np.argsort(np.concatenate(found)).tolist() if found else []

    def gaps(worlds: Worlds) -> list[Any]:
        with np.errstate(over="ignore", invalid="ignore"):
            rows = [row for part in parts for row in part(worlds)]
        return [rows[k] for k in order]

    return gaps


def _block_gaps(dynamics: Dynamics, number: int, held: np.ndarray, rates: Any) -> Callable[[Worlds], np.ndarray]:
    """Return what tells the gaps (k, M) of some propositions of a block, times rates (k, 1)."""
    block = dynamics.blocks[number]
    owners = to_host(block.owners)[held]
    agents, places = dynamics.put(owners), dynamics.put(held)
    # The width is that of the outputs of the workspace.
    scales = rates / (block.output_width[:, agents] * len(block.output_width))
    is_each_once = owners.tolist() == list(range(len(block.agents)))

    def gaps(worlds: Worlds) -> np.ndarray:
        y = block.outputs(worlds.states[number])
        low, high = block.regions(worlds.time)
        return _joined(y if is_each_once else y[:, agents], low[:, places], high[:, places], scales)

    return gaps


def _pair_gaps(dynamics: Dynamics, number: int, held: np.ndarray, rates: Any) -> Callable[[Worlds], np.ndarray]:
    """Return what tells the gaps (k, M) of some pairs, times rates (k, 1)."""
    pairs, places = dynamics.pairs[number], dynamics.put(held)
    first, second = (
        dynamics.blocks[b].output_width[axes[:, None], agents[None]]
        for b, axes, agents in zip(pairs.blocks, pairs.outputs, pairs.places)
    )
    width = (first + second)[:, places]  # how far a difference can be from another
    scales = rates / (width * len(width))

    def gaps(worlds: Worlds) -> np.ndarray:
        outputs = {b: dynamics.blocks[b].outputs(worlds.states[b]) for b in pairs.blocks}
        low, high, radius = pairs.regions(worlds.time)
        d = pairs.difference(outputs)[:, places]
        return _joined(d, low[:, places], high[:, places], scales, radius[places])

    return gaps


def _joined(y: np.ndarray, low: np.ndarray, high: np.ndarray, scales: np.ndarray, radius: Any = None) -> np.ndarray:
    """Return how far points (p, k, M) are from boxes, the sum of all axes times scales (p, k, 1): (k, M) in [0, 1].

    Balls of a radius (k, 1) have one gap, along the way to their centre, whose parts are its shares.
    """
    xp = namespace(y)
    gap = xp.maximum(low - y, y - high)
    if radius is not None:
        length = xp.sqrt((y * y).sum(axis=0))
        outside = xp.abs(y) * xp.where(length > radius, 1.0 - radius / xp.where(length > 0.0, length, 1.0), 0.0)
        gap = xp.where(radius < np.inf, outside, gap)
    parts = (np.maximum(gap, 0.0) if is_host(gap) else xp.where(gap <= 0.0, 0.0, gap)) * scales
    total = parts[0] if len(parts) == 1 else parts.sum(axis=0)
    # What is no number is as far away as can be.
    result: np.ndarray = np.fmin(total, 1.0) if is_host(total) else xp.where(total < 1.0, total, 1.0)
    return result


def _letters(manager: Any, root: int, lost: np.ndarray) -> tuple[list[tuple[frozenset[int], int]], bool]:
    """Return the letters of a state that do not lose the task, each with where it leads, and whether these are all.

    A letter is named by the propositions that have to hold; those that must not hold are ignored.
    """
    found: list[tuple[frozenset[int], int]] = []
    for number, (assignment, target) in enumerate(manager.paths(root)):
        if len(found) == _STATE_PATHS or number == _READ_PATHS:
            return found, False
        if not lost[target]:
            found.append((frozenset(p for p, holds in assignment.items() if holds), target))
    return found, True


def _avoided(manager: Any, root: int, goes_on: np.ndarray, joint: np.ndarray) -> frozenset[int]:
    """Return the propositions that lose the task or set it back in a state; none if there are too many paths.

    `goes_on`, bool (Q,), says which states are as near to acceptance; `joint`, bool (P, P), what can hold together.
    """
    may = np.zeros(len(joint), dtype=bool)
    for number, (assignment, target) in enumerate(manager.paths(root)):
        if number == _READ_PATHS:
            return frozenset()
        held = [p for p, holds in assignment.items() if holds]
        if goes_on[target] and joint[np.ix_(held, held)].all():
            free: np.ndarray = np.all(joint[:, held], axis=1)
            free[[p for p, holds in assignment.items() if not holds]] = False
            may |= free
    return frozenset(np.flatnonzero(~may).tolist())


def _overlaps(dynamics: Dynamics) -> np.ndarray:
    """Return which two propositions can hold together, bool (P, P), as far as regions of one agent lie apart."""
    joint = np.ones((len(dynamics.problem.automaton.propositions),) * 2, dtype=bool)
    for block in (block for block in dynamics.blocks if len(block.propositions)):
        low, high = (corners.reshape(-1, *corners.shape[-3:]) for corners in (block.region_low, block.region_high))
        meet = (np.maximum(low, np.moveaxis(low, -1, -2)) < np.minimum(high, np.moveaxis(high, -1, -2))).all(axis=1)
        same = block.owners[:, None] == block.owners[None]
        joint[np.ix_(block.propositions, block.propositions)] &= ~same | meet.any(axis=0)
    return joint


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
