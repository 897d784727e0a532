"""Tasks of mixed teams: who is on a grid, and what is left to those agents while the others keep their letters.

The task on grids reads at each time the propositions of its own agents. What the letters of agents along paths leave
open is read both ways: a state of its automaton is a set of states of the whole one, from all of which acceptance is
asked for. It counts steps, as letters differ from one time to another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import AnyAgent, Gaussian
from ...envs.logic import Automaton, DecisionDiagrams, automaton_from_diagrams
from ...envs.problem import Problem, Specification
from ..cells import RelationRefused, refuse_shared_noise
from ..models import reaches_every_mean

MOST_GRID_STATES = 3
"""States of an agent up to which it has a grid."""

MOST_STATES = 4_000
"""Most states of the automaton of agents on grids."""


def agents_on_grids(problem: Problem) -> tuple[int, ...]:
    """Return the agents of a mixed team that are on grids: those whose inputs reach every mean; the others have paths.

    Raises
    ------
    RelationRefused
        If these are none or all, an agent has an angle, or agents share noise or name each other across both kinds.
    """
    refuse_shared_noise(problem)
    for agent in problem.agents:
        if agent.angles:
            raise RelationRefused(f"agent `{agent.name}`: agents with angles are not for mixed teams")
    on_grids = tuple(i for i, agent in enumerate(problem.agents) if _may_be_on_a_grid(agent))
    if not 0 < len(on_grids) < problem.n_agents:
        kind = "all are" if on_grids else "none is"
        raise RelationRefused(f"a mixed team has agents for grids and agents that are not for grids, but {kind}")
    grids = {problem.agent_names[i] for i in on_grids}
    for agent in problem.agents:
        others = {name.split(".")[0] for name in agent.others}
        if others & ({*problem.agent_names} - grids if agent.name in grids else grids):
            raise RelationRefused(f"agent `{agent.name}`: its dynamics name agents of the other kind of a mixed team")
    return on_grids


def _may_be_on_a_grid(agent: AnyAgent) -> bool:
    """Return whether an agent has few states, plain normal noise along them, and the relation ``exact``."""
    if agent.n_states > MOST_GRID_STATES or not agent.has_plain_noise or agent.names_time:
        return False
    gaussian = agent.laws is None or all(isinstance(law, Gaussian) for law in agent.laws)
    covariance = agent.noise_covariance
    plain = gaussian and not np.any(covariance - np.diag(np.diag(covariance))) and not np.any(agent.still_axes)
    return plain and reaches_every_mean(agent)


def part_of(problem: Problem, agents: Sequence[int], horizon: int, automaton: Automaton | None) -> Problem:
    """Return the problem of some agents, with the propositions about nobody else; without an automaton: stay inside."""
    labeling, chosen = problem.labeling, [problem.agents[i] for i in agents]
    names = {agent.name for agent in chosen}
    owners = [{problem.propositions[name].agent} for name in labeling.names[: labeling.first_pair]]
    owners += [{problem.agent_names[pair.first], problem.agent_names[pair.second]} for pair in labeling.pairs]
    kept = [name for name, own in zip(labeling.names, owners, strict=True) if own <= names]
    inside = Specification(formula="true", semantics="finite-trace")
    return Problem(
        name=f"{problem.name[:150]}, {'those on grids' if automaton is not None else 'those along paths'}",
        horizon=horizon, agents=chosen, propositions={name: problem.propositions[name] for name in kept},
        specification=inside if automaton is None else Specification(automaton=automaton),
    )  # fmt: skip


def names_within(problem: Problem, agents: Sequence[int]) -> list[str]:
    """Return the propositions about some agents and nobody else, in the order of the automaton."""
    return list(part_of(problem, agents, problem.horizon, None).propositions)


Tree = tuple["int | frozenset[int]", "Tree | None", "Tree | None"]
"""A diagram on its way: a proposition and two branches, or a set of states."""


@dataclass(eq=False)
class _Level:
    """Diagrams of sets of states that read a letter of which some propositions are known, and some are not read."""

    automaton: Automaton
    read: set[int]
    known: dict[int, bool]
    made: dict[frozenset[int], Tree] = field(default_factory=dict)

    def tree(self, entries: frozenset[int]) -> Tree:
        entries = self._resolved(entries)
        if entries in self.made:
            return self.made[entries]
        if all(e < 0 for e in entries):
            result: Tree = (frozenset(-1 - e for e in entries), None, None)
        else:
            tested = min(int(self.automaton.variable[e]) for e in entries if e >= 0)
            sides = []
            for branch in (self.automaton.low, self.automaton.high):
                here = {int(branch[e]) if e >= 0 and self.automaton.variable[e] == tested else e for e in entries}
                sides.append(self.tree(frozenset(here)))
            result = sides[0] if sides[0] is sides[1] else (tested, sides[0], sides[1])
        self.made[entries] = result
        return result

    def _resolved(self, entries: frozenset[int]) -> frozenset[int]:
        """Return entries without those that test what the agents on grids do not read."""
        done, stack = set[int](), list(entries)
        while stack:
            e = stack.pop()
            p = int(self.automaton.variable[e]) if e >= 0 else -1
            if e < 0 or p in self.read:
                done.add(e)
                continue
            stack += [int(self.automaton.low[e])] if not self.known.get(p, False) else []
            stack += [int(self.automaton.high[e])] if self.known.get(p, True) else []
        return frozenset(done)


def task_on_grids(problem: Problem, on_grids: Sequence[int], known: Sequence[dict[int, bool]]) -> Problem:
    """Return the task of agents on grids while it is ``known``, for each time 0 to S, what others keep.

    Raises
    ------
    RelationRefused
        If its automaton has too many states, or the start leaves the first letter open.
    """
    automaton, names, steps = problem.automaton, names_within(problem, on_grids), len(known) - 1
    if problem.initial_q is None:
        raise RelationRefused("mixed teams are for starts that have one first letter")
    place = {name: p for p, name in enumerate(automaton.propositions)}
    read = {place[name] for name in names}
    columns = {place[name]: k for k, name in enumerate(names)}
    levels: list[dict[frozenset[int], Tree]] = []
    here = [frozenset([problem.initial_q])]
    merged: list[dict[frozenset[int], frozenset[int] | bool]] = []
    for t in range(1, steps + 1):
        level = _Level(automaton, read, known[t])
        trees = {states: level.tree(frozenset(int(automaton.root[q]) for q in states)) for states in here}
        final = {leaf: _verdict(automaton, leaf, t == steps) for tree in trees.values() for leaf in _leaves(tree)}
        united = _united([left for left in final.values() if not isinstance(left, bool)])
        merged.append({leaf: left if isinstance(left, bool) else united[left] for leaf, left in final.items()})
        levels.append(trees)
        here = sorted({*united.values()}, key=sorted)
        if sum(map(len, levels)) > MOST_STATES:
            raise RelationRefused(f"the automaton of a mixed team's agents on grids has more than {MOST_STATES} states")
    return part_of(problem, on_grids, steps, _counted(automaton, names, columns, levels, merged))


def _verdict(automaton: Automaton, states: frozenset[int], is_last: bool) -> frozenset[int] | bool:
    """Return the states from which acceptance is still asked for, or whether all is accepted, or something lost."""
    if any(automaton.dead[q] for q in states):
        return False
    left = frozenset(q for q in states if not automaton.finished[q])
    if is_last:
        return not left if automaton.is_co_safe else all(bool(automaton.accepting[q]) for q in states)
    return left if left else True


def _united(sets: Sequence[frozenset[int]]) -> dict[frozenset[int], frozenset[int]]:
    """Return sets as the unions of all that have a state in common: a controller knows the state, not the set."""
    unions: list[set[int]] = []
    for one in {*sets}:
        touching = [union for union in unions if union & one]
        unions = [union for union in unions if not union & one] + [set(one).union(*touching)]
    return {one: next(frozenset(union) for union in unions if one <= union) for one in {*sets}}


def _leaves(tree: Tree) -> set[frozenset[int]]:
    head, low, high = tree
    if isinstance(head, frozenset):
        return {head}
    assert low is not None and high is not None
    return _leaves(low) | _leaves(high)


def _counted(
    automaton: Automaton,
    names: Sequence[str],
    columns: dict[int, int],
    levels: Sequence[dict[frozenset[int], Tree]],
    merged: Sequence[dict[frozenset[int], frozenset[int] | bool]],
) -> Automaton:
    """Return the automaton whose states are times and sets; a first one reads the letter of the start."""
    number: dict[tuple[int, frozenset[int]], int] = {}
    for t, trees in enumerate(levels):
        for states in trees:
            number[t, states] = 1 + len(number)
    accepted, lost, manager = 1 + len(number), 2 + len(number), DecisionDiagrams()

    def node(t: int, tree: Tree) -> int:
        head, low, high = tree
        if isinstance(head, frozenset):
            target = merged[t][head]
            if isinstance(target, bool):
                return manager.terminal(accepted if target else lost)
            return manager.terminal(number[t + 1, target])
        assert low is not None and high is not None
        return manager.node(columns[head], node(t, low), node(t, high))

    roots = [manager.terminal(next(iter(number.values())))]
    roots += [node(t, levels[t][states]) for t, states in number]
    roots += [manager.terminal(accepted), manager.terminal(lost)]
    titles = ["start"] + [f"{'+'.join(map(str, sorted(states)))} after {t}" for t, states in number]
    accepting = [False] * len(titles) + [True, False]
    return automaton_from_diagrams(
        tuple(names), automaton.semantics, [*titles, "satisfied", "lost"], 0, accepting, manager, roots
    )


def what_asks(base: Problem, reached: Sequence[set[tuple[int, int]]], relevant: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which pairs the whole task may ask for in each state of the task on grids: bool (Q, number of pairs)."""
    result = np.zeros((base.automaton.n_states, relevant.shape[1]), dtype=bool)
    for together in reached[:-1]:
        for q, b in together:
            result[b] |= relevant[q]
    return result
