"""Disjoint product guards of the robust automaton.

A term of the value function is a product over agents, so that the automaton's edges must be *disjoint* cubes
``prod_i S_i`` of sets of what each agent's abstraction knows (docs/theory/guards.md, "Disjoint products"). Per cell the
abstraction knows a set ``L_i`` of classes ("label set"; a single class when the grid is aligned). The robust automaton
goes from q to q' under ``(L_1, .., L_I)`` if every letter of ``prod L_i`` leads to q'; with co-safe acceptance, also if
every letter leads to q' or to acceptance (the value of acceptance is 1, that of q' at most 1). Otherwise it fails
(docs/theory/guards.md, "What the abstraction knows").

Guards are the paths of one decision tree per automaton state. The agents are its variables, and label sets with equal
cofactors share a branch: the paths are disjoint and complete by construction. Label sets that a labelling excludes are
never asked about. Up to ``OPTIMAL_LIMIT`` agents the tree has the fewest paths to live successors; beyond that the
agents are split in the order of the decision diagrams.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from ....envs.tasks.problem import Problem
from ...certificates.value_functions import BoolArray, Guards
from ...relations.grids import RelationRefused

OPTIMAL_LIMIT = 8
"""Most agents a decision tree is optimised over: the search tries them in every order."""

MAX_GUARDS = 200_000
"""Tasks with more guards out of one automaton state are refused: every step pairs all of them with terms."""

MOST_COMPARISONS = 10_000_000
"""Most numbers that are compared to unite guards; beyond, they stay as the decision tree gives them."""

FAILED = -1
"""Terminal of the robust automaton: the task can no longer be satisfied, or not with certainty."""

Cube = tuple[int, ...]
"""One guard: per agent the label sets it admits, as the bits of an integer."""

TreePath = tuple[int, int, Any] | None
"""Way from the root of a decision tree, last split first: agent, its label sets as bits, way to there."""


def compile_guards(
    problem: Problem,
    label_sets: Sequence[BoolArray],
    states: Collection[int] | None = None,
    classes: Sequence[BoolArray] | None = None,
) -> Guards:
    """Return disjoint guards of ``problem``'s automaton over the label sets that occur in each agent's cells (exact).

    Parameters
    ----------
    problem : Problem
    label_sets : sequence of (n_i, C_i) bool arrays
        Label sets of each agent.
    states : collection of int, optional
        Automaton states whose guards are wanted; default: all.
    classes : sequence of (C_i, P_i) bool arrays, optional
        What the classes of each agent say of its propositions; default: those of regions that stand still.

    Raises
    ------
    ValueError
        If a state has more than ``MAX_GUARDS`` guards.
    """
    robust = _RobustAutomaton(problem, label_sets, classes)
    source, target, rows = [], [], []
    for q, root in enumerate(robust.roots):
        if states is not None and q not in states:
            continue
        if problem.automaton.absorbing[q]:
            continue
        # Two paths part at some agent where they take disjoint label sets, so that their cubes are disjoint.
        cubes = _merge_neighbours(robust.cubes(root))
        source += [q] * len(cubes)
        target += [t for t, _ in cubes]
        rows += [cube for _, cube in cubes]
    # Number the distinct factors of each agent and unpack their bits: a factor is shared by many guards.
    masks, mask = [], np.zeros((len(rows), len(label_sets)), dtype=np.int32)
    for i, sets in enumerate(label_sets):
        number: dict[int, int] = {}
        for g, cube in enumerate(rows):
            mask[g, i] = number.setdefault(cube[i], len(number))
        masks.append(
            np.array([[bits >> n & 1 for n in range(len(sets))] for bits in number], dtype=bool).reshape(-1, len(sets))
        )
    return Guards(tuple(masks), np.array(source, dtype=np.int32), np.array(target, dtype=np.int32), mask)


class _RobustAutomaton:
    """The robust automaton as decision diagrams, and the decision trees made from them."""

    def __init__(
        self, problem: Problem, label_sets: Sequence[BoolArray], classes: Sequence[BoolArray] | None = None
    ) -> None:
        automaton = problem.automaton
        self.diagrams, roots = automaton.diagrams()
        finished = np.flatnonzero(automaton.finished).tolist()
        self.goal = finished[0] if finished else None
        self.n_agents = len(label_sets)
        self.full = tuple((1 << len(sets)) - 1 for sets in label_sets)
        propositions = [[int(p) for p in problem.labeling.agent_propositions[i]] for i in range(self.n_agents)]
        self.agent_of = {p: i for i, numbers in enumerate(propositions) for p in numbers}
        classes = [problem.labeling.classes[i] for i in range(self.n_agents)] if classes is None else classes
        # Per agent and class: the truth value of each proposition of the agent.
        self.assignments = [
            [dict(zip(numbers, (bool(b) for b in row), strict=True)) for row in rows]
            for numbers, rows in zip(propositions, classes, strict=True)
        ]
        self.members = [[np.flatnonzero(row) for row in sets] for sets in label_sets]
        self._cofactors: dict[tuple[int, int], list[tuple[int, int]]] = {}
        self._meet_memo: dict = {}
        self._cost: dict[int, tuple[int, int]] = {}
        # States from which acceptance cannot be reached are failure; those that finish the task are one goal.
        simplify: dict = {}
        fail = self.diagrams.terminal(FAILED)
        dead, goal, is_finished = automaton.dead, self.goal, automaton.finished

        def canonical(value: int, _: int) -> int:
            if dead[value]:
                return FAILED
            return goal if goal is not None and is_finished[value] else value

        self.roots = [self.diagrams.apply(canonical, root, fail, simplify) for root in roots]

    def _meet(self, a: int, b: int) -> int:
        """Return the greatest lower bound of two outcomes: failure below every state, the goal above."""
        if a == b:
            return a
        if self.goal is not None and self.goal in (a, b):
            return b if a == self.goal else a
        return FAILED

    def cofactors(self, f: int, i: int) -> list[tuple[int, int]]:
        """Return the distinct cofactors of f under agent i's label sets.

        They are pairs of a diagram and the label sets that lead to it, as bits.
        """
        key = (f, i)
        if key not in self._cofactors:
            by_class = [self.diagrams.restrict(f, assignment) for assignment in self.assignments[i]]
            grouped: dict[int, int] = {}
            for n, members in enumerate(self.members[i]):
                # The outcome of a label set is what holds whichever of its classes is the true one: their meet.
                cofactor = by_class[members[0]]
                for c in members[1:]:
                    cofactor = self.diagrams.apply(self._meet, cofactor, by_class[c], self._meet_memo)
                grouped[cofactor] = grouped.get(cofactor, 0) | 1 << n
            self._cofactors[key] = list(grouped.items())
        return self._cofactors[key]

    def support(self, f: int) -> list[int]:
        """Return the agents that f depends on, in agent order."""
        return sorted({self.agent_of[p] for p in self.diagrams.support(f)})

    def _is_live_terminal(self, f: int) -> bool:
        """Return whether f is an automaton state from which acceptance can be reached."""
        return self.diagrams.is_terminal(f) and self.diagrams.value(f) != FAILED

    def _choose(self, f: int) -> tuple[int, int]:
        """Return the fewest paths to live successors of any decision tree of f, and the agent that it splits first."""
        if self.diagrams.is_terminal(f):
            return int(self._is_live_terminal(f)), -1
        if f not in self._cost:
            agents = self.support(f)
            self._cost[f] = min((sum(self._choose(c)[0] for c, _ in self.cofactors(f, i)), i) for i in agents)
        return self._cost[f]

    def _split(self, f: int, optimal: bool) -> int:
        """Return the agent to split f on."""
        if optimal:
            return self._choose(f)[1]
        return self.agent_of[self.diagrams.variable(f)]

    def cubes(self, root: int) -> list[tuple[int, Cube]]:
        """Return the paths of the decision tree of ``root`` to live successors, as (successor, cube)."""
        optimal = len(self.support(root)) <= OPTIMAL_LIMIT
        cubes: list[tuple[int, Cube]] = []
        # Depth first, with a stack of its own: a tree may be as deep as there are agents.
        stack: list[tuple[int, TreePath]] = [(root, None)]
        while stack:
            f, path = stack.pop()
            if self.diagrams.is_terminal(f):
                if self._is_live_terminal(f):
                    cubes.append((self.diagrams.value(f), self._cube(path)))
                    if len(cubes) > MAX_GUARDS:
                        raise RelationRefused(
                            f"`specification`: one automaton state needs more than {MAX_GUARDS} disjoint guards; "
                            "write the task with fewer agents that matter at the same time"
                        )
                continue
            i = self._split(f, optimal)
            stack += [(cofactor, (i, bits, path)) for cofactor, bits in reversed(self.cofactors(f, i))]
        return cubes

    def _cube(self, path: TreePath) -> Cube:
        """Return the bits of every agent along a path; all label sets where the path does not split the agent."""
        bits = list(self.full)
        while path is not None:
            i, bits[i], path = path
        return tuple(bits)


def _merge_neighbours(cubes: list[tuple[int, Cube]]) -> list[tuple[int, Cube]]:
    """Unite cubes with one successor that differ in one agent only, as long as there are any (exact).

    The cubes are disjoint, and so are the united ones. With very many agents the ordered decision tree has shared what
    there is to share, and the search is left out.
    """
    if not cubes or len(cubes) * len(cubes[0][1]) ** 2 > MOST_COMPARISONS:
        return cubes
    merged, changed = list(cubes), True
    while changed:
        changed = False
        for i in range(len(merged[0][1])):
            united: dict[tuple[int, Cube], int] = {}
            for target, cube in merged:
                key = (target, cube[:i] + cube[i + 1 :])
                united[key] = united.get(key, 0) | cube[i]
            if len(united) < len(merged):
                changed = True
                merged = [(t, (*others[:i], bits, *others[i:])) for (t, others), bits in united.items()]
    return merged
