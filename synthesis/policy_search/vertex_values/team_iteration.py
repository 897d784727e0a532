"""Value iteration of teams on grids whose vertices have inputs: a tree of products, and agents that answer to runs.

Values of which nothing is taken off go back in time as sums of products (``ascent.tree``), a factor for each agent. At
every time and in every automaton state each agent chooses inputs for the sum of its own factors, each weighted by what
the factors of the others are worth where runs of the team come to: coordinate ascent, weighted by occupancy. What the
tree kept is written down, and the check's own backups say what it proves (``vertex_grids.teams``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...abstraction.models import compile_guards
from ...certificates.proofs import VertexGrid, VertexTeamProof
from ...certificates.value_functions import MergeLog, compress, tree_rows
from ...checker import CheckedProblem
from ...extended_check.vertex_grids import Kinds, VertexKernel, kinds_of, team_value
from ...relations.grids import FloatArray, RelationRefused
from ..ascent import assemble, candidates, terminal_terms
from .counted_backups import ONCE, PRODUCT, Counted
from .input_choice import Choice
from .sampled_runs import Runs

SAMPLES, FEW = 300, 30
"""Runs in an automaton state that weights are means over, at most; and from how many on, instead of over all runs."""

RANK, LITTLE = {1: 48, 2: 12}, 0.05
"""Terms of an automaton state that are kept at most, by the most states of an agent; and share of the failure hoped
for, or aimed at, that dropping others may cost in all steps."""

UNITED = 1e-3
"""Share of the lighter of two terms that uniting them may lose."""

MOST_UNKNOWN = 8
"""Propositions of an agent that one cell may know nothing of."""

IndexArray = NDArray[Any]


@dataclass(eq=False)
class TeamGrids:
    """The grids of all agents at one level, and guards between their cells."""

    problem: Problem
    checked: CheckedProblem
    steps: list[Counted]

    def __post_init__(self) -> None:
        every = self.problem.horizon, len(self.checked.automaton.accepting)
        # which law of each agent acts (T, Q), and the tree of the last sweep
        self.laws = [np.zeros(every, dtype=np.int64) for _ in self.steps]
        self.log: list[MergeLog] = []

    @cached_property
    def kinds(self) -> list[Kinds]:
        """What is known of letters in the cells of each agent, at each time."""
        return [kinds_of(self.checked, i, own) for i, own in enumerate(self.steps)]

    @cached_property
    def guards(self) -> Any:
        """Guards between automaton states, over sets of kinds."""
        return self._compiled(None)

    @cached_property
    def start(self) -> Any:
        """Guards of the letter of time 0."""
        return self._compiled([self.problem.automaton.initial])

    def _compiled(self, states: Sequence[int] | None) -> Any:
        classes = [_classes(own.labels) for own in self.kinds]
        sets = [
            np.all((own.labels[:, None] == 0) | ((own.labels[:, None] > 0) == each), axis=2)
            for own, each in zip(self.kinds, classes, strict=True)
        ]
        return compile_guards(self.problem, sets, states, classes)

    def masks(self, t: int) -> list[NDArray[np.bool_]]:
        """Return the sets of guards at the places (K, n) of factors at a time."""
        each = zip(self.steps, self.guards.masks, self.kinds, strict=True)
        return [VertexKernel(own, np.zeros(0)).spread(sets[:, kinds.at(t)]) for own, sets, kinds in each]

    def alive(self) -> list[FloatArray]:
        """Return the least box (2, d) of each agent around all cells from which some guard leads on."""
        result = []
        for own, sets, kinds in zip(self.steps, self.guards.masks, self.kinds, strict=True):
            leads = np.any(sets.any(axis=0)[kinds.which], axis=0)
            held, box = leads.reshape(own.shape), own.agent.state_box.copy()
            for k, axis in enumerate(own.edges):
                some = np.flatnonzero(np.any(held, axis=tuple(j for j in range(held.ndim) if j != k)))
                if len(some):
                    box[:, k] = axis[some[0]], axis[some[-1] + 1]
            result.append(box)
        return result

    def proof(self, choices: Sequence[Choice], failure: float = 1.0) -> VertexTeamProof:
        """Return what is claimed of these laws and of the tree that was kept."""
        grids = tuple(
            VertexGrid(own.edges, np.stack(choice.laws), laws.copy(), own.jumps, own.near, own.window)
            for own, choice, laws in zip(self.steps, choices, self.laws, strict=True)
        )
        source, target, sets, first, first_sets = (
            np.asarray(table, dtype=np.int64)
            for table in (self.guards.source, self.guards.target, self.guards.mask, self.start.target, self.start.mask)
        )
        guards, start = (source, target, sets), (first, first_sets)
        return VertexTeamProof(grids, self.guards.masks, self.start.masks, guards, start, tree_rows(self.log), failure)

    def proved(self, choices: Sequence[Choice]) -> float:
        """Return an upper bound on the failure, by the check's own backups."""
        proof = self.proof(choices)
        sets, guards = (proof.sets, proof.start_sets), (proof.guards, proof.start)
        with np.errstate(all="ignore"):
            return 1.0 - team_value(self.checked, self.steps, proof.grids, sets, guards, proof.tree)


def _classes(labels: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Return what letters (C, P) cells with such labels (n, P) may have; RelationRefused where they are too many."""
    unknown = (labels == 0).sum(axis=1).max(initial=0)
    if unknown > MOST_UNKNOWN:
        raise RelationRefused(f"regions have {unknown} faces inside of one cell")
    found = {bits for row in labels.tolist() for bits in product(*((False, True) if x == 0 else (x > 0,) for x in row))}
    return np.array(sorted(found), dtype=bool).reshape(len(found), labels.shape[1])


class TeamIteration:
    """Sweeps of value iteration on the grids of a team; laws that were found are kept for the next sweep.

    Without runs others count as being anywhere, or, ``is_hopeful``, where it is best.
    """

    def __init__(
        self,
        grids: TeamGrids,
        runs: Runs | None,
        aim: float,
        is_coarse: bool = False,
        is_hopeful: bool = False,
    ) -> None:
        self.grids, self.is_hopeful = grids, is_hopeful
        self.rank = RANK[max(len(own.edges) for own in grids.steps)]
        failure = aim if runs is None else max(aim, runs.failure)
        self.little = LITTLE * failure / grids.problem.horizon
        self.choices = [
            Choice(own, each, aim, is_coarse) for own, each in zip(grids.steps, self._apart(runs), strict=True)
        ]

    def _apart(self, runs: Runs | None) -> list[Runs | None]:
        return [None if runs is None else runs.of_agent(columns) for columns in self.grids.problem.columns]

    def sweep(self, runs: Runs | None, answering: Sequence[int]) -> None:
        """Go back in time once; some of the agents answer to ``runs``, or to others that may be anywhere."""
        grids, problem, steps = self.grids, self.grids.problem, self.grids.steps
        automaton, apart = problem.automaton, self._apart(runs)
        places = [int(np.prod([2 * n for n in own.shape])) for own in steps]
        ones, log = [np.ones((1, n)) for n in places], list[MergeLog]()
        accepting = np.asarray(automaton.accepting, dtype=bool)
        terms = terminal_terms(accepting, places)
        stubs: list[Any] = [SimpleNamespace(kernel=SimpleNamespace(backup=lambda rows: rows)) for _ in steps]
        for t in range(problem.horizon - 1, -1, -1):
            for choice in self.choices:
                choice.enter(t)
            arriving = _Arriving(steps, apart, t + 1, self.is_hopeful)
            options = candidates(grids.guards, grids.masks(t + 1), stubs, terms, None, arriving.masses, UNITED)
            parts, kept = list[tuple[Sequence[FloatArray], IndexArray]](), list[IndexArray]()
            for q in range(len(accepting)):
                if automaton.absorbing[q] or not steps[0].reached[t][q] or not len(options.index[q]):
                    count = int(automaton.absorbing[q] and accepting[q])
                    parts.append((ones, np.zeros((count, len(steps)), dtype=np.int64)))
                    kept.append(np.zeros(0, dtype=np.int64))
                    continue
                stage = _Stage(self, options, q, t, apart, arriving)
                stage.answer(answering)
                keep = stage.worthy()
                parts.append(stage.part(keep))
                kept.append(options.row[q][keep])
            terms = assemble(parts, places)
            log.append(MergeLog(options.origin, options.merges, tuple(kept)))
        grids.log = log[::-1]
        if not any(len(rows) for rows in terms.index):
            raise RelationRefused("no inputs lead anywhere on coarse grids: is the task out of reach?")


class _Stage:
    """One time and automaton state: terms that may follow, and the law of each agent."""

    def __init__(
        self, whole: TeamIteration, options: Any, q: int, t: int, runs: Sequence[Runs | None], arriving: _Arriving
    ) -> None:
        self.whole, self.q, self.t, self.arriving = whole, q, t, arriving
        self.steps, self.rows = whole.grids.steps, options.index[q].copy()
        self.tables = list[FloatArray]()
        for i in range(len(self.steps)):
            table, self.rows[:, i] = compress(options.backed_up[i], self.rows[:, i])
            self.tables.append(table)
        self.runs = runs
        self.backed = list[FloatArray]()

    def answer(self, answering: Sequence[int]) -> None:
        """Let agents choose laws, one after the other, and take all factors one step back."""
        met = [self.arriving.means(i, table, self.q)[self.rows[:, i]] for i, table in enumerate(self.tables)]
        for i, (choice, steps, table) in enumerate(zip(self.whole.choices, self.steps, self.tables, strict=True)):
            laws, shape = self.whole.grids.laws[i], [2 * n for n in steps.shape]
            later = laws[min(self.t + 1, len(laws) - 1), [self.q]]
            if i in answering:
                weights = np.prod([own for j, own in enumerate(met) if j != i], axis=0).mean(axis=1)
                W = np.bincount(self.rows[:, i], weights=weights, minlength=len(table)) @ table
                passing = choice.passing(self.t, [self.q])
                laws[self.t, self.q], _ = choice.adjusted(W.reshape(shape), self.t, later, passing)
            images, nothing = steps.images_of(choice.laws[laws[self.t, self.q]], self.t), np.zeros(steps.shape, bool)
            steps.count(ONCE, 0.0)
            steps.count(PRODUCT * images.vertices.products * len(table))
            each = [images.vertices.below(own.reshape(shape)) for own in table]
            at = [np.maximum(own, 0.0).reshape([n + 1 for n in steps.shape]) for own in each]
            self.backed.append(np.stack([steps.on_cells(own, nothing).ravel() for own in at]))

    def worthy(self) -> IndexArray:
        """Return the terms to keep: those that are worth most where runs are."""
        here = _Arriving(self.steps, self.runs, self.t, self.whole.is_hopeful)
        met = [here.means(i, table, self.q, self.t)[self.rows[:, i]] for i, table in enumerate(self.backed)]
        worth = np.prod(met, axis=0).mean(axis=1)
        order = np.argsort(worth, kind="stable")
        # what is dropped, the least first, is little in all
        dropped = int(np.sum(np.cumsum(worth[order]) <= self.whole.little * worth.sum()))
        return np.sort(order[max(min(dropped, len(order) - 1), len(order) - self.whole.rank) :])

    def part(self, keep: IndexArray) -> tuple[list[FloatArray], IndexArray]:
        """Return the factors of each agent and the rows of terms that are kept."""
        rows, factors = self.rows[keep], list[FloatArray]()
        for i, table in enumerate(self.backed):
            used, rows[:, i] = compress(table, rows[:, i])
            factors.append(used)
        return factors, rows


class _Arriving:
    """Where the agents of runs are at a time, as weights of the places of their factors."""

    def __init__(self, steps: Sequence[Counted], runs: Sequence[Runs | None], t: int, is_hopeful: bool) -> None:
        self.steps, self.runs, self.t = steps, runs, t
        self.without_runs = np.max if is_hopeful else np.mean
        self.known = dict[tuple[int, int], tuple[IndexArray, FloatArray] | None]()

    def _of(self, i: int, q: int, when: int) -> tuple[IndexArray, FloatArray] | None:
        """Return places (2^d, M) of agent i and their weights, in runs that are in q at a time; None without any runs.

        Where few are in that state all count: what others do depends on the time, too.
        """
        if (i, q) not in self.known:
            runs, edges, found = self.runs[i], self.steps[i].edges_at(self.t), None
            if runs is not None:
                here = np.flatnonzero(runs.q[when] == q)[:SAMPLES]
                here = here if len(here) >= FEW else np.arange(SAMPLES)
                found = _places(edges, runs.states[self.t][:, here])
            self.known[i, q] = found
        return self.known[i, q]

    def means(self, i: int, table: FloatArray, q: int, when: int | None = None) -> FloatArray:
        """Return what factors (n, places) of agent i are (n, M) in runs that are in q one step before, or at ``when``.

        Without any runs, what they are on average, or at most: as if all others were where it is best.
        """
        found = self._of(i, q, self.t - 1 if when is None else when)
        if found is None:
            return np.asarray(self.without_runs(table, axis=1, keepdims=True))
        places, weights = found
        return np.einsum("npm,pm->nm", table[:, places], weights)

    def masses(self, q: int) -> list[FloatArray]:
        """Return the mass of each agent on the places of its factors that arrives from an automaton state."""
        result = []
        for i, own in enumerate(self.steps):
            count, found = int(np.prod([2 * n for n in own.shape])), self._of(i, q, self.t - 1)
            if found is None:
                result.append(np.full(count, 1.0 / count))
            else:
                places, weights = found
                result.append(np.bincount(places.ravel(), weights.ravel(), count) / places.shape[1])
        return result


def _places(edges: tuple[FloatArray, ...], x: FloatArray) -> tuple[IndexArray, FloatArray]:
    """Return the places (2^d, M) at both ends of the intervals around states x (d, M), and their weights."""
    shape, cells, shares = [2 * len(axis) - 2 for axis in edges], [], []
    for axis, own in zip(edges, x, strict=True):
        cell = np.clip(np.searchsorted(axis, own, side="right") - 1, 0, len(axis) - 2)
        cells.append(cell)
        shares.append(np.clip((own - axis[cell]) / np.diff(axis)[cell], 0.0, 1.0))
    places, weights = [], []
    for corner in np.ndindex(*[2] * len(shape)):
        places.append(np.ravel_multi_index([2 * c + up for c, up in zip(cells, corner, strict=True)], shape))
        weights.append(np.prod([s if up else 1.0 - s for s, up in zip(shares, corner, strict=True)], axis=0))
    return np.stack(places), np.stack(weights)
