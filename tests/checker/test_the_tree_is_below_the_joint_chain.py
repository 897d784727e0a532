"""The value of the tree at the start is at most that of the joint chain, by programming over all joint states.

Agents move on finite chains with probabilities that are multiples of 2^-7: values are compared as rational numbers.
Automata, labels (some of them unknown), guards, unions, remainders and starts are random. Where all vertices are there
and nothing is united the value is the truth; trees that count a vertex twice or name what is not there are refused, and
so are guards that overlap or lead elsewhere.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from certigym.synthesis.checker import tree
from certigym.synthesis.checker.automaton import CO_SAFE, FINITE_TRACE, Automaton
from certigym.synthesis.checker.fields import Refused
from certigym.synthesis.checker.tree import Guards, Team, Tree, check_guards, value_at_start
from kinds import mostly_thorough


@dataclass
class Chain:
    """A kernel of an agent on a finite chain: probabilities (choice, from, to); no lattice between."""

    P: np.ndarray
    corners: bool = False
    inputs: int = 0

    @property
    def places(self) -> int:
        return int(self.P.shape[1])

    def values(self, factors: np.ndarray) -> np.ndarray:
        return factors

    def backup(self, values: np.ndarray, largest: np.ndarray, policy: np.ndarray) -> np.ndarray:
        assert np.all(values.max(axis=1, initial=0.0) <= largest)
        rows = np.where((policy >= 0)[:, None], self.P[policy, np.arange(len(policy))], 0.0)
        return values @ rows.T


@dataclass
class Cells:
    """What the tree asks of the cells of an agent."""

    kernel: Chain
    sets: np.ndarray
    policy: np.ndarray
    start: np.ndarray

    def sets_at(self, t: int) -> np.ndarray:
        return self.sets

    def policy_at(self, t: int, q: int) -> np.ndarray:
        return np.asarray(self.policy[min(t, len(self.policy) - 1), q])


class World:
    """A random automaton, labels, guards that pass the check, chains and policies."""

    def __init__(self, rng: np.random.Generator, complete: bool) -> None:
        self.rng, n_agents = rng, int(rng.integers(1, 4))
        self.sizes = [int(rng.integers(2, 4 if n_agents > 2 else 5)) for _ in range(n_agents)]
        self.owned = [[i] for i in range(n_agents)]
        if rng.random() < 0.4:
            self.owned[-1].append(n_agents)
        self.n_props = sum(map(len, self.owned))
        self.automaton = self._automaton()
        unknown = 0.0 if complete else 0.12
        self.labels = [
            rng.choice((-1, 1, 0), (n, len(own)), p=((1 - unknown) / 2, (1 - unknown) / 2, unknown)).astype(np.int8)
            for n, own in zip(self.sizes, self.owned, strict=True)
        ]
        self.truth = [np.where(own == 0, rng.choice((-1, 1), own.shape), own) for own in self.labels]
        self.sets = [self._sets(own, complete) for own in self.labels]
        self.guards = self._guards(complete)
        self.T = int(rng.integers(1, 4))
        self.chains = []
        for n in self.sizes:
            P = rng.integers(0, 40, (2, n, n)) * (rng.random((2, n, n)) < 0.8)
            self.chains.append(P // np.maximum(1, -(-P.sum(axis=2, keepdims=True) // 127)) / 128.0)
        Q = len(self.automaton.accepting)
        self.policies = [rng.integers(0 if complete else -1, 2, (self.T, Q, n)) for n in self.sizes]

    @property
    def known(self) -> list[tuple[list[int], np.ndarray]]:
        return list(zip(self.owned, self.labels, strict=True))

    def _automaton(self) -> Automaton:
        rng, n = self.rng, int(self.rng.integers(2, 5))
        accepting = rng.random(n) < 0.4
        accepting[-1], accepting[0] = True, False
        semantics = str(rng.choice((CO_SAFE, FINITE_TRACE)))
        variable: list[int] = []
        low: list[int] = []
        high: list[int] = []

        def build(p: int) -> int:
            if p == self.n_props or rng.random() < 0.2:
                return -1 - int(rng.integers(n))
            a, b = build(p + 1), build(p + 1)
            if a == b:
                return a
            variable.append(p)
            low.append(a)
            high.append(b)
            return len(variable) - 1

        root = [-1 - q if semantics == CO_SAFE and accepting[q] else build(0) for q in range(n)]
        names = tuple(f"p{k}" for k in range(self.n_props))
        lists = (tuple(own) for own in (root, variable, low, high))
        return Automaton(names, semantics, 0, tuple(accepting.tolist()), *lists)

    def _sets(self, labels: np.ndarray, complete: bool) -> np.ndarray:
        classes = [np.all(labels == row, axis=1) for row in np.unique(labels, axis=0)]
        if complete:
            return np.array(classes)
        more = self.rng.random((3, len(labels))) < 0.4
        return np.concatenate([np.array(classes), more, np.eye(len(labels), dtype=bool)])

    def step(self, q: int, cells: tuple[int, ...]) -> int:
        """Where the letter of these cells leads."""
        holds = {p: self.truth[i][c, k] > 0 for i, c in enumerate(cells) for k, p in enumerate(self.owned[i])}
        entry = self.automaton.root[q]
        while entry >= 0:
            entry = self.automaton.high[entry] if holds[self.automaton.variable[entry]] else self.automaton.low[entry]
        return -1 - entry

    def is_done(self, q: int) -> bool:
        return self.automaton.is_co_safe and self.automaton.accepting[q]

    def _guards(self, complete: bool) -> Guards:
        source: list[int] = []
        target: list[int] = []
        sets: list[Any] = []
        for q in range(len(self.automaton.accepting)):
            if self.is_done(q):
                continue
            choices = list(itertools.product(*(range(len(own)) for own in self.sets)))
            if not complete:
                choices = [choices[k] for k in self.rng.permutation(len(choices))[:40]]
            for choice in choices:
                cells = tuple(int(np.argmax(own[k])) for own, k in zip(self.sets, choice, strict=True))
                where = self.step(q, cells) if self.rng.random() < 0.9 or complete else int(self.rng.integers(2))
                more = [*source, q], [*target, where], [*sets, choice]
                if self.passes(as_guards(*more), self.sets):
                    source, target, sets = more
        return as_guards(source, target, sets)

    def passes(self, guards: Guards, sets: list[np.ndarray]) -> bool:
        try:
            check_guards(self.automaton, guards, sets, self.known)
        except Refused:
            return False
        return True

    def is_right(self, guards: Guards, sets: list[np.ndarray]) -> bool:
        """Whether guards out of a state are disjoint and lead where they say, by all joint cells and letters."""
        joint = list(itertools.product(*map(range, self.sizes)))
        if any(self.is_done(q) for q in guards.source.tolist()):
            return False
        for cells in joint:
            inside = [
                all(own[k][c] for own, k, c in zip(sets, row, cells, strict=True)) for row in guards.sets.tolist()
            ]
            sources = [q for q, here in zip(guards.source.tolist(), inside, strict=True) if here]
            if len(sources) != len(set(sources)):
                return False
            for q, target, here in zip(guards.source.tolist(), guards.target.tolist(), inside, strict=True):
                if here and not all(x == target or self.is_done(x) for x in self.possible(q, cells)):
                    return False
        return True

    def possible(self, q: int, cells: tuple[int, ...]) -> set[int]:
        """Where letters lead that agree with the labels of cells."""
        truth, found = self.truth, set()
        rows = [own[c] for own, c in zip(self.labels, cells, strict=True)]
        for guess in itertools.product(*(((v,) if v else (-1, 1)) for row in rows for v in row)):
            values = iter(guess)
            self.truth = [np.tile([next(values) for _ in row], (n, 1)) for row, n in zip(rows, self.sizes, strict=True)]
            found.add(self.step(q, cells))
        self.truth = truth
        return found

    def cells(self, starts: list[np.ndarray]) -> Any:
        return [
            Cells(Chain(P), sets, policy, start)
            for P, sets, policy, start in zip(self.chains, self.sets, self.policies, starts, strict=True)
        ]

    def truth_at(self, q: int, cells: tuple[int, ...]) -> Fraction:
        """The probability to satisfy the task from a joint state at time 0, of which the letter was read."""
        joint = list(itertools.product(*map(range, self.sizes)))
        chains = [[[[Fraction(p) for p in row] for row in one] for one in P.tolist()] for P in self.chains]
        Q = range(len(self.automaton.accepting))
        value = {(p, x): Fraction(int(self.automaton.accepting[p])) for p in Q for x in joint}
        for t in reversed(range(self.T)):
            earlier = {}
            for p in Q:
                for x in joint:
                    if self.is_done(p):
                        earlier[p, x] = Fraction(1)
                        continue
                    chosen = [own[t, p, c] for own, c in zip(self.policies, x, strict=True)]
                    rows = [P[a][c] if a >= 0 else [Fraction(0)] * len(P[0]) for P, a, c in zip(chains, chosen, x)]
                    total = Fraction(0)
                    for y in joint:
                        weight = Fraction(1)
                        for row, c in zip(rows, y, strict=True):
                            weight *= row[c]
                        if weight:
                            total += weight * value[self.step(p, y), y]
                    earlier[p, x] = total
            value = earlier
        return value[q, cells]


def as_guards(source: list[int], target: list[int], sets: list[Any]) -> Guards:
    table = np.array(sets, dtype=np.int64).reshape(len(source), -1)
    return Guards(np.array(source, dtype=np.int64), np.array(target, dtype=np.int64), table)


def random_tree(world: World, complete: bool) -> Tree:
    """Vertices of all guards and children, some of them united or dropped; all of them if it is to be complete."""
    rng, guards, n_agents = world.rng, world.guards, len(world.sizes)
    size = [int(own) for own in world.automaton.accepting]
    vertices: list[tuple[int, ...]] = []
    unions: list[tuple[int, ...]] = []
    kept: list[tuple[int, ...]] = []
    for t in reversed(range(world.T)):
        new, rows = [], ([], [], [])  # type: ignore[var-annotated]
        for q in range(len(size)):
            if world.is_done(q):
                new.append(1)
                continue
            pairs = [(g, c) for g in np.flatnonzero(guards.source == q).tolist() for c in range(size[guards.target[g]])]
            pairs = [pairs[k] for k in rng.permutation(len(pairs))]
            if not complete:
                pairs = pairs[:30] if rng.random() < 0.7 else pairs[: max(0, len(pairs) - 1)][:30]
            gone: set[int] = set()
            own: list[tuple[int, ...]] = []
            for _ in range(0 if complete else int(rng.integers(0, len(pairs) + 1))):
                alive = [k for k in range(len(pairs)) if k not in gone]
                if len(alive) < 2:
                    break
                a, b = rng.choice(alive, 2, replace=False).tolist()
                agent = int(rng.integers(n_agents))
                others = [j + 1 for j in range(n_agents) if j != agent]
                rest = 0 if not others or rng.random() < 0.4 else int(rng.choice(others) * rng.choice((-1, 1)))
                if not rest:
                    gone.add(b)
                own.append((t, q, a, b, agent, rest))
            left = [k for k in range(len(pairs)) if k not in gone and (complete or rng.random() < 0.95)]
            rows[0].extend((t, q, g, c) for g, c in pairs)
            rows[1].extend(own)
            rows[2].extend((t, q, k) for k in left)
            new.append(len(left))
        size = new
        for table, more in zip((vertices, unions, kept), rows, strict=True):
            table[:0] = more
    shapes = ((vertices, 4), (unions, 6), (kept, 3))
    return Tree(*(np.array(table, dtype=np.int64).reshape(-1, n) for table, n in shapes))


def from_one_start(world: World) -> tuple[list[np.ndarray], Guards, Fraction]:
    """Shares of a point, the guard of its letter, and the truth."""
    start = tuple(int(world.rng.integers(n)) for n in world.sizes)
    shares = [np.eye(n)[[c]] for n, c in zip(world.sizes, start, strict=True)]
    q = world.step(0, start)
    guard = as_guards([0], [q], [[0] * len(start)])
    return shares, guard, world.truth_at(q, start)


@mostly_thorough("seed", [0, 4, 5])
def test_the_value_is_at_most_that_of_the_joint_chain(seed: int) -> None:
    rng, positive, united = np.random.default_rng(seed), 0, 0
    for _ in range(40):
        world = World(rng, complete=False)
        own = random_tree(world, complete=False)
        shares, start, exact = from_one_start(world)
        got = value_at_start(Team(world.automaton, world.T, world.cells(shares), world.guards, start), own)
        assert Fraction(got) <= exact, (float(got - exact), world.automaton)
        positive += 0 < got < 1
        united += len(own.unions)
    assert positive > 6 and united > 50


@mostly_thorough("seed", [1, 6])
def test_a_tree_with_all_vertices_is_worth_what_the_joint_chain_says(seed: int) -> None:
    """Nothing is lost but rounding; a box of starts is worth the mean of its points."""
    rng, positive = np.random.default_rng(seed), 0
    for _ in range(30):
        world = World(rng, complete=True)
        own = random_tree(world, complete=True)
        if len(own.vertices) > 3000:
            continue
        shares, start, exact = from_one_start(world)
        got = value_at_start(Team(world.automaton, world.T, world.cells(shares), world.guards, start), own)
        assert exact * (1 - Fraction(1, 10**9)) <= Fraction(got) <= exact
        positive += got > 0
        # half of the runs of the first agent start in its first cell, half in its last one
        ends = [0, world.sizes[0] - 1]
        others = tuple(int(row[0].argmax()) for row in shares[1:])
        half = np.zeros((2, world.sizes[0]))
        half[0, ends[0]] += 0.5
        half[1, ends[1]] += 0.5
        targets = [world.step(0, (c, *others)) for c in ends]
        both = as_guards([0, 0], targets, [[k] + [0] * len(others) for k in (0, 1)])
        got = value_at_start(Team(world.automaton, world.T, world.cells([half, *shares[1:]]), world.guards, both), own)
        mean = sum(world.truth_at(q, (c, *others)) for q, c in zip(targets, ends, strict=True)) / 2
        assert mean * (1 - Fraction(1, 10**9)) <= Fraction(got) <= mean
    assert positive > 10


@mostly_thorough("seed", [2, 7])
def test_guards_are_refused_unless_they_are_disjoint_and_lead_where_they_say(seed: int) -> None:
    """Sound against all joint cells and letters; sabotaged ones are seen."""
    rng, refused, passed = np.random.default_rng(seed), 0, 0
    for _ in range(40):
        world = World(rng, complete=bool(rng.random() < 0.5))
        assert world.is_right(world.guards, world.sets)
        G, Q = len(world.guards.source), len(world.automaton.accepting)
        for _change in range(6 if G else 0):
            columns = [own.copy() for own in (world.guards.source, world.guards.target, world.guards.sets)]
            g, kind = int(rng.integers(G)), int(rng.integers(4))
            if kind == 0:
                columns[1][g] = rng.integers(Q)
            elif kind == 1:
                columns[0][g] = rng.integers(Q)
            elif kind == 2:
                i = int(rng.integers(len(world.sizes)))
                columns[2][g, i] = rng.integers(len(world.sets[i]))
            else:
                columns = [np.concatenate([own, own[g : g + 1]]) for own in columns]
            forged = Guards(*columns)
            if world.passes(forged, world.sets):
                passed += 1
                assert world.is_right(forged, world.sets)
            else:
                refused += 1
        sets = [own.copy() for own in world.sets]
        i = int(rng.integers(len(sets)))
        k, c = int(rng.integers(len(sets[i]))), int(rng.integers(world.sizes[i]))
        sets[i][k, c] ^= True
        if world.passes(world.guards, sets):
            assert world.is_right(world.guards, sets)
    assert refused > 60 and passed > 5


@pytest.fixture
def small() -> tuple[World, Tree, list[np.ndarray], Guards]:
    """A world with at least four vertices at one time and state, and its tree."""
    rng = np.random.default_rng(3)
    while True:
        world = World(rng, complete=True)
        own = random_tree(world, complete=True)
        shares, start, exact = from_one_start(world)
        if exact > 0 and len(world.sizes) > 1 and world.T > 1 and len(own.vertices) < 200 and enough(own):
            return world, own, shares, start


def enough(own: Tree) -> bool:
    return np.unique(own.kept[:, :2], axis=0, return_counts=True)[1].max(initial=0) >= 4


def place_of(own: Tree) -> tuple[int, int]:
    """A time and a state with at least four vertices."""
    places, counts = np.unique(own.kept[:, :2], axis=0, return_counts=True)
    t, q = places[counts.argmax()].tolist()
    return t, q


def with_rows(own: Tree, **more: list[tuple[int, ...]]) -> Tree:
    tables = {}
    for name in ("vertices", "unions", "kept"):
        rows = np.concatenate(
            [getattr(own, name), np.array(more.get(name, []), np.int64).reshape(-1, getattr(own, name).shape[1])]
        )
        tables[name] = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    return Tree(**tables)


def test_trees_that_count_a_vertex_twice_are_refused(small: Any) -> None:
    world, own, shares, start = small
    t, q = place_of(own)
    n = len(own.at(t, q)[0])
    first = tuple(own.vertices[(own.vertices[:, 0] == t) & (own.vertices[:, 1] == q)][0].tolist())
    cells = world.cells(shares)

    def value(forged: Tree) -> float:
        return value_at_start(Team(world.automaton, world.T, cells, world.guards, start), forged)

    assert value(own) > 0.0
    g = first[2]
    other = (
        next(k for k, source in enumerate(world.guards.source.tolist()) if source != q)
        if np.any(world.guards.source != q)
        else None
    )
    wrong: dict[str, dict[str, list[tuple[int, ...]]]] = {
        "the same vertex twice": {"vertices": [first]},
        "kept twice": {"kept": [(t, q, 0)]},
        "kept beyond the end": {"kept": [(t, q, n)]},
        "a child that is not there": {"vertices": [(t, q, g, 10**6)]},
        "united with itself": {"unions": [(t, q, 1, 1, 0, 0)]},
        "absorbed and kept": {"unions": [(t, q, 0, 1, 0, 0)]},
        "beyond the end": {"unions": [(t, q, 0, n, 0, 2)]},
        "into what is not there": {"unions": [(t, q, n, 0, 0, 2)]},
        "no agent": {"unions": [(t, q, 0, 1, len(world.sizes), 1)]},
        "a remainder of no agent": {"unions": [(t, q, 0, 1, 0, len(world.sizes) + 1)]},
        "a remainder below all agents": {"unions": [(t, q, 0, 1, 0, -len(world.sizes) - 1)]},
        "a remainder of the agent that is added": {"unions": [(t, q, 0, 1, 0, 1)]},
        "a negative one of it": {"unions": [(t, q, 0, 1, 1, -2)]},
    }
    if other is not None:
        wrong["a guard of another state"] = {"vertices": [(t, q, other, 0)]}
    for what, rows in wrong.items():
        with pytest.raises(Refused):
            pytest.fail(f"{what}: {value(with_rows(own, **rows))}")
    # absorbed, and united once more
    gone = own.kept[~((own.kept[:, 0] == t) & (own.kept[:, 1] == q) & (own.kept[:, 2] == 1))]
    twice: list[list[tuple[int, ...]]] = [
        [(t, q, 0, 1, 0, 0), (t, q, 0, 1, 0, 0)],
        [(t, q, 0, 1, 0, 0), (t, q, 1, 2, 0, 2)],
    ]
    for unions in twice:
        with pytest.raises(Refused):
            value(with_rows(Tree(own.vertices, own.unions, gone), unions=unions))
    value(with_rows(Tree(own.vertices, own.unions, gone), unions=[(t, q, 0, 1, 0, 0)]))
    value(with_rows(own, unions=[(t, q, 0, 1, 0, 2)]))


def test_rows_out_of_order_are_refused(small: Any) -> None:
    world, own, shares, start = small
    for name in ("vertices", "kept"):
        tables = {key: getattr(own, key) for key in ("vertices", "unions", "kept")}
        tables[name] = tables[name][::-1]
        with pytest.raises(Refused, match="order"):
            value_at_start(Team(world.automaton, world.T, world.cells(shares), world.guards, start), Tree(**tables))


def test_equal_factors_of_other_agents_are_not_taken_for_one_another() -> None:
    """Agents with the same number of cells and other chains share nothing of a step."""
    first, second = Chain(np.array([[[0.5, 0.25], [0.0, 1.0]]])), Chain(np.array([[[0.25, 0.25], [0.5, 0.0]]]))
    automaton = Automaton(("a",), FINITE_TRACE, 0, (True,), (-1,), (), (), ())
    sets, policy = np.ones((1, 2), dtype=bool), np.zeros((1, 1, 2), dtype=np.int64)
    cells: Any = [Cells(own, sets, policy, np.eye(2)[[0]]) for own in (first, second, first)]
    guards, start = as_guards([0], [0], [[0, 0, 0]]), as_guards([0], [0], [[0, 0, 0]])
    own = Tree(np.array([[0, 0, 0, 0]]), np.zeros((0, 6), np.int64), np.array([[0, 0, 0]]))
    got = value_at_start(Team(automaton, 1, cells, guards, start), own)
    assert 0.28 < got <= 0.75 * 0.5 * 0.75


def test_remainders_of_steps_that_are_not_additive_are_taken_from_less(small: Any) -> None:
    """``KEPT`` of a factor: remainders of kernels that move are smaller by more than digits are lost, and no larger."""
    vertex = np.array([[0.5, 0.25], [0.5 - 1e-12, 0.25]])
    for share in (1.0, tree.KEPT):
        own = vertex.copy()
        tree._unite(own, np.array([[0, 1, 0, 2]]), 1, share)
        assert own[0].tolist() == [0.5 - 1e-12, 0.25]
        assert np.all(own[1] <= np.maximum(vertex[0] * share - vertex.min(axis=0), 0.0))
    assert own[1].tolist() == [0.0, 0.0]
    own = vertex.copy()
    tree._unite(own, np.array([[0, 1, 1, -1]]), 1, 1.0)
    assert own.tolist() == [(vertex[0] + vertex[1]).tolist(), vertex[1].tolist()]
