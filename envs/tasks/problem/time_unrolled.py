"""Problems that name the time, written out as problems that do not: what certificates on grids are about.

Regions that move become one region for each place that they are in, and the automaton counts steps: at each time it
reads the propositions of that time. An agent whose dynamics name the time gets a *clock*, a last input with the name
`t`, from 0 to T - 1. Whoever sets the clock of each agent to the time, at every step, has the same runs with the same
verdicts in both problems (docs/theory/time.md, "Written out").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...systems.agents import AnyAgent
from ..automata import Automaton, DecisionDiagrams, automaton_from_diagrams
from ..regions import Proposition
from .families import AnyProposition
from .joint_noise import refuse_joint_noise
from .record import Problem
from .specification import Specification

MOST_TABLES = 250_000
"""Most automaton states of a problem that is written out, times its steps: policies have a table for each of them."""

MOST_REGIONS = 2_000
"""Most places of regions: labels are compared place by place."""


def unrolled_in_time(problem: Problem) -> Problem:
    """Return the problem without the time; itself if nothing names it.

    Raises
    ------
    ValueError
        If it has propositions about pairs, or needs more automaton states or regions than are reasonable.
    """
    if not problem.names_time:
        return problem
    if problem.labeling.pairs:
        raise ValueError(
            "`problem`: expected propositions of single agents beside the time `t`, got some about pairs; ask for the "
            "relation `path`"
        )
    refuse_joint_noise(problem)
    agents = [clocked(agent, problem.horizon) for agent in problem.agents]
    if not problem.labeling.moves:
        return Problem(
            name=problem.name, horizon=problem.horizon, agents=agents, propositions=problem.propositions,
            specification=Specification(automaton=problem.automaton),
        )  # fmt: skip
    places = Places(problem)
    if len(places.regions) > MOST_REGIONS:
        raise ValueError(
            f"`propositions`: expected regions in at most {MOST_REGIONS} places in all, got {len(places.regions)}; ask "
            "for the relation `path`, or a shorter horizon"
        )
    return Problem(
        name=problem.name, horizon=problem.horizon, agents=agents, propositions=places.regions,
        specification=Specification(automaton=_counting(problem, places)),
    )  # fmt: skip


def clocked(agent: AnyAgent, horizon: int) -> AnyAgent:
    """Return an agent whose dynamics name the time with a clock in its place; others stay as they are."""
    return agent.with_clock(horizon) if agent.names_time else agent


class Places:
    """Where the regions of a problem are at each time: places, by names of propositions that stand still.

    Parameters
    ----------
    problem : Problem

    Attributes
    ----------
    regions : dict from str to Proposition
        The propositions of the problem that is written out, in the order of those that they come from.
    """

    def __init__(self, problem: Problem) -> None:
        self.regions: dict[str, AnyProposition] = {}
        self._names: dict[str, list[str | None]] = {}
        agents, times = {agent.name: agent for agent in problem.agents}, np.arange(problem.horizon + 1, dtype=float)
        for name, proposition in problem.propositions.items():
            if not proposition.moves:
                self.regions[name] = proposition
                continue
            assert isinstance(proposition, Proposition)
            agent, (low, high) = agents[proposition.agent], proposition.over(times)
            known: dict[bytes, str | None] = {}
            own = self._names.setdefault(name, [])
            for time in range(problem.horizon + 1):
                key = (low[:, time] + 0.0).tobytes() + (high[:, time] + 0.0).tobytes()
                if key not in known:
                    known[key] = None
                    if not _is_nowhere(agent, low[:, time], high[:, time]):
                        known[key] = self._fresh(f"{name}_t{time}", problem)
                        self.regions[known[key] or ""] = Proposition(agent.name, low[:, time], high[:, time])
                own.append(known[key])

    def name_of(self, name: str, time: int) -> str | None:
        """Return the proposition that stands for one at a time; None where its region holds nowhere."""
        return self._names[name][time] if name in self._names else name

    def _fresh(self, name: str, problem: Problem) -> str:
        while name in problem.propositions or name in self.regions:
            name += "_"
        return name


def _is_nowhere(agent: AnyAgent, low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
    """Return whether a region is empty, or surely has no point of the workspace, as labels see it."""
    if np.any(low >= high):
        return True
    bottom, top = (end[0] for end in agent.output_range(agent.state_low[None], agent.state_high[None]))
    states = agent.state_outputs
    bottom[:states], top[:states] = agent.state_low[:states], agent.state_high[:states]
    return bool(np.any((low > top) | (high <= bottom)) or np.any(low[:states] >= top[:states]))


def _counting(problem: Problem, places: Places) -> Automaton:
    """Return the automaton that counts steps, and reads at each time the propositions of that time."""
    automaton, names = problem.automaton, list(places.regions)
    variable = {name: k for k, name in enumerate(names)}
    manager = DecisionDiagrams()
    # States: (letters read, state of the automaton), and behind them two in which everything is decided.
    order = [(0, automaton.initial)]
    number, accepted, lost = {order[0]: 0}, -1, -2

    def code(read: int, q: int) -> int:
        at_end = read == problem.horizon + 1
        if automaton.accepting[q] and (automaton.is_co_safe or at_end):
            return accepted
        if automaton.dead[q] or at_end:
            return lost
        if (read, q) not in number:
            number[read, q] = len(order)
            order.append((read, q))
            if len(order) * problem.horizon > MOST_TABLES:
                raise ValueError(
                    f"`horizon`: expected at most {MOST_TABLES} pairs of a step and an automaton state that counts "
                    "steps, got more; ask for the relation `path`, or a shorter horizon"
                )
        return number[read, q]

    # The list grows as it is gone through: every state is looked at once.
    below = {q: _below(automaton, int(automaton.root[q])) for q in range(automaton.n_states)}
    targets = [{entry: code(read + 1, -1 - entry) for entry in below[q] if entry < 0} for read, q in order]
    final = {accepted: len(order), lost: len(order) + 1}
    roots = []
    for (time, q), leaves in zip(order, targets, strict=True):
        made = {entry: manager.terminal(final.get(target, target)) for entry, target in leaves.items()}
        # Children test later propositions than their parents, so they are made first.
        for entry in sorted((e for e in below[q] if e >= 0), key=lambda e: -int(automaton.variable[e])):
            name = places.name_of(automaton.propositions[int(automaton.variable[entry])], time)
            low, high = made[int(automaton.low[entry])], made[int(automaton.high[entry])]
            made[entry] = low if name is None else manager.node(variable[name], low, high)
        roots.append(made[int(automaton.root[q])])
    roots += [manager.terminal(len(order)), manager.terminal(len(order) + 1)]
    titles = [f"{automaton.state_names[q]} after {read}" for read, q in order]
    titles += [_unused("satisfied", titles), _unused("lost", titles)]
    accepting = [False] * len(order) + [True, False]
    return automaton_from_diagrams(tuple(names), automaton.semantics, titles, 0, accepting, manager, roots)


def _unused(title: str, taken: list[str]) -> str:
    while title in taken:
        title += "_"
    return title


def _below(automaton: Automaton, root: int) -> list[int]:
    """Return all entries of the diagrams from one on, itself and states (coded as ``-1 - q``) among them."""
    seen, stack = {root}, [root]
    while stack:
        entry = stack.pop()
        for child in (int(automaton.low[entry]), int(automaton.high[entry])) if entry >= 0 else ():
            if child not in seen:
                seen.add(child)
                stack.append(child)
    return sorted(seen)


def states_in_time(problem: Problem, base: Problem) -> NDArray[np.int64]:
    """Return the automaton states (T + 1, Q) of `base` that go with those of a problem at times 0 to T; -1 for none.

    `base` is to be the problem written out. This follows both automata at once, through all letters that both can read
    at each time, and trusts nothing of how `base` was made but the names of its propositions.

    Raises
    ------
    ValueError
        If they part: a state of the problem goes with two of `base`, or one is accepted and the other is not.
    """
    places, horizon = Places(problem), problem.horizon
    first, second = problem.automaton, base.automaton
    if first.semantics != second.semantics or base.horizon != horizon:
        raise ValueError("its automata are judged at different times")
    for name, region in places.regions.items():
        other = base.propositions.get(name)
        if not isinstance(other, Proposition) or other.moves or other.to_dict() != region.to_dict():
            raise ValueError(f"`{name}` is not the region that the problem has at its time")
    table = np.full((horizon + 1, first.n_states), -1, dtype=np.int64)
    reached = {(first.initial, second.initial)}
    for time in range(horizon + 1):
        reached = {pair for q, b in reached for pair in _read_both(first, second, q, b, places, time)}
        for q, b in reached:
            if table[time, q] not in (-1, b):
                raise ValueError("a state of the task goes with two states of what is written out")
            table[time, q] = b
            if (first.is_co_safe or time == horizon) and first.accepting[q] != second.accepting[b]:
                raise ValueError("what is written out is satisfied where the task is not, or the other way round")
    return table


def _read_both(first: Automaton, second: Automaton, q: int, b: int, places: Places, time: int) -> set[tuple[int, int]]:
    """Return the pairs of states to which a letter of a time may lead both automata (a superset)."""
    names = [places.name_of(name, time) for name in first.propositions]
    place = {name: p for p, name in enumerate(names) if name is not None}
    found, seen = set[tuple[int, int]](), set[tuple[int, int]]()
    stack = [(int(first.root[q]), int(second.root[b]))]
    while stack:
        pair = stack.pop()
        if pair in seen:
            continue
        seen.add(pair)
        e, f = pair
        if e < 0 and f < 0:
            found.add((-1 - e, -1 - f))
            continue
        p = int(first.variable[e]) if e >= 0 else len(names)
        own = second.propositions[int(second.variable[f])] if f >= 0 else ""
        # Propositions of other times may hold or not.
        of_second = place.get(own, -1) if f >= 0 else len(names)
        if of_second < 0:
            stack += [(e, int(second.low[f])), (e, int(second.high[f]))]
        elif p < of_second:
            stack.append((int(first.low[e]), f))
            if names[p] is not None:  # a region that is nowhere does not hold
                stack.append((int(first.high[e]), f))
        elif of_second < p:
            stack += [(e, int(second.low[f])), (e, int(second.high[f]))]
        else:
            stack += [(int(first.low[e]), int(second.low[f])), (int(first.high[e]), int(second.high[f]))]
    return found
