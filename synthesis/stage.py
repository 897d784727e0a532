"""One time and automaton state of the ascent: the terms on offer, the mass that meets them, and the agents' answers.

Cells are weighed by what the alive mass and the other agents make of them (THEORY section 5); terms are pruned by what
they contribute, and what goes is charged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .arrays import add_rows, beside, namespace, take, to_host
from .best_response import best_choices
from .choices import Law
from .grid import FloatArray
from .joint import JointModel
from .occupancy import Occupancy
from .terms import IndexArray, compress
from .value import Candidates, gather


@dataclass(frozen=True)
class Limits:
    """How much a sweep may leave out.

    Parameters
    ----------
    contribution : float
        Share of the value of one (time, state) that pruned terms may amount to.
    elsewhere : float
        A term is kept in spite of that if its share of the value averaged over all cells exceeds this.
    mass : float
        Share of the alive mass that may be dropped per step.
    rank : int
        Most terms per state, of the value and of the mass.
    """

    contribution: float = 1e-9
    elsewhere: float = 1e-3
    mass: float = 1e-9
    rank: int = 400


class Stage:
    """One (time, automaton state): the terms on offer, the mass that meets them, and the agents' laws."""

    def __init__(
        self, joint: JointModel, options: Candidates, occupancy: Occupancy, q: int, laws: Sequence[Law]
    ) -> None:
        self.models, self.laws, self.leftover, self.q = joint.models, list(laws), occupancy.leftover, q
        self.rows = options.index[q].copy()
        self.smoothed, self.values = [], []
        for i, law in enumerate(self.laws):
            table, self.rows[:, i] = compress(options.smoothed[i], self.rows[:, i])
            self.smoothed.append(table)
            self.values.append(gather(table, self.models[i].choices.points(law)))
        self.mass_rows = occupancy.terms.index[q]
        self.is_met = len(self.mass_rows) > 0
        if self.is_met:
            self.mass_rows = self.mass_rows.copy()
            self.mass = []
            for i, factors in enumerate(occupancy.terms.factors):
                own, self.mass_rows[:, i] = compress(factors, self.mass_rows[:, i])
                self.mass.append(own)
        else:
            pairs = zip(self.models, self.values, strict=True)
            self.mass = [beside(np.full((1, m.n_cells), 1.0 / m.n_cells), own) for m, own in pairs]
            self.mass_rows = np.zeros((1, len(self.models)), dtype=np.int64)

    def improve(self) -> None:
        """Let every agent answer once, in order.

        Cells that the alive mass does not meet are weighed as if the other agents might be anywhere.
        """
        n_agents = len(self.models)
        chosen = self._heaviest(n_agents)
        met = self._met(chosen)
        anywhere = _Others([_means(own)[self.rows[:, i]] for i, own in enumerate(self.values)])
        answers: dict[tuple[int, bytes, bytes], Law] = {}
        for i, model in enumerate(self.models):
            n_values = len(self.values[i])
            if n_values == 1:  # a single objective: weights do not matter, and equal agents have equal answers
                table = to_host(self.smoothed[i])
                key = (id(model), table.tobytes(), self.laws[i].tobytes())
                if key not in answers:
                    answers[key] = best_choices(model.choices, np.ones((model.n_cells, 1)), table, self.laws[i])
                self.laws[i] = answers[key]
            else:
                weights = self._weights(i, met, chosen)
                unmet = ~namespace(weights).any(weights > 0, axis=1)
                if bool(unmet.any()):
                    usual = np.bincount(self.rows[:, i], weights=anywhere.product(), minlength=n_values)
                    if bool(unmet.all()):  # one objective for all cells: cheap, where windows slide
                        weights = beside(usual[None], weights)
                    else:
                        weights[unmet] = beside(usual, weights)
                self.laws[i] = best_choices(model.choices, weights, self.smoothed[i], self.laws[i])
            self.values[i] = gather(self.smoothed[i], model.choices.points(self.laws[i]))
            met.replace(self._inner_by_terms(i, chosen))
            anywhere.replace(_means(self.values[i])[self.rows[:, i]])

    def gain(self) -> float:
        """Most that one agent alone could add to the value at the start by other choices here.

        Mass that was left out of the occupancies is not counted.
        """
        if not self.is_met or len(self.rows) == 0:
            return 0.0
        most = 0.0
        for i, (model, weights) in enumerate(zip(self.models, self.weights(), strict=True)):
            better = best_choices(model.choices, weights, self.smoothed[i], self.laws[i])
            added = gather(self.smoothed[i], model.choices.points(better)) - self.values[i]
            most = max(most, float(namespace(added).einsum("sn,ns->", weights, added)))
        return most

    def weights(self) -> list[FloatArray]:
        """Per agent (S, n), the weight of its value factors in its cells, the laws of the others as they are."""
        chosen = self._heaviest(len(self.models))
        met, result = self._met(chosen), []
        for i in range(len(self.models)):
            result.append(self._weights(i, met, chosen))
            met.replace(self._inner_by_terms(i, chosen))
        return result

    def _met(self, chosen: IndexArray) -> _Others:
        """Inner products of mass and value per agent, (mass terms, terms)."""
        return _Others([self._inner_by_terms(i, chosen) for i in range(len(self.models))])

    def _weights(self, i: int, met: _Others, chosen: IndexArray) -> FloatArray:
        """(S, n) weight of agent i's value factors in its cells: the mass there, times what the other agents make."""
        collected = _collect(met.product(), chosen[:, i], len(self.mass[i]), self.rows[:, i], len(self.values[i]))
        weights: FloatArray = self.mass[i].T @ collected
        return weights

    def _heaviest(self, n_agents: int) -> IndexArray:
        """Mass terms to weigh decisions with: all of them, unless the work arrays would not fit into memory."""
        room = max(1, 30_000_000 // (n_agents * max(1, len(self.rows))))
        if len(self.mass_rows) <= room:
            return self.mass_rows
        mass = np.ones(len(self.mass_rows))
        for i, own in enumerate(self.mass):
            mass *= to_host(namespace(own).sum(own, axis=1))[self.mass_rows[:, i]]
        return self.mass_rows[np.sort(np.argsort(-mass, kind="stable")[:room])]

    def _inner(self, i: int) -> FloatArray:
        """(mass factors, value factors) inner products of agent i."""
        inner: FloatArray = self.mass[i] @ self.values[i].T
        return inner

    def _inner_by_terms(self, i: int, chosen: IndexArray) -> FloatArray:
        """The same by mass terms ``chosen`` and value terms."""
        return take(take(self._inner(i), chosen[:, i]), self.rows[:, i], axis=1)

    def prune(self, limits: Limits) -> tuple[IndexArray, float]:
        """Terms to keep and an upper bound on the loss at the start."""
        if len(self.rows) == 0:
            return np.zeros(0, dtype=np.int64), 0.0
        met = np.zeros(len(self.rows))
        if self.is_met:
            met = to_host(inner_products([self._inner(i) for i in range(len(self.models))], self.mass_rows, self.rows))
        anywhere = np.ones(len(self.rows))
        for i, own in enumerate(self.values):
            anywhere *= _means(own)[self.rows[:, i]]
        drop = _small(met, limits.contribution) & (anywhere <= limits.elsewhere * anywhere.sum())
        if (~drop).sum() > limits.rank:
            importance = _share(met) + limits.elsewhere * _share(anywhere)
            importance[drop] = -1.0
            drop[np.argsort(-importance, kind="stable")[limits.rank :]] = True
        keep = np.flatnonzero(~drop)
        sup = np.ones(len(self.rows))
        for i, own in enumerate(self.values):
            sup *= to_host(namespace(own).max(own, axis=1))[self.rows[:, i]]
        return keep, float(met[drop].sum() + self.leftover * min(1.0, sup[drop].sum()))

    def part(self, keep: IndexArray) -> tuple[list[FloatArray], IndexArray]:
        """Factors of each agent and rows of the kept terms."""
        rows, factors = self.rows[keep], []
        for i, own in enumerate(self.values):
            used, rows[:, i] = compress(own, rows[:, i])
            factors.append(used)
        return factors, rows


class _Others:
    """Products of per-agent arrays over all agents but one, the agents being replaced one after the other."""

    def __init__(self, factors: Sequence[FloatArray]) -> None:
        self.before = namespace(factors[0]).ones_like(factors[0])
        self.after = [self.before]
        for factor in reversed(factors[1:]):
            self.after.append(self.after[-1] * factor)

    def product(self) -> FloatArray:
        """Product over the agents other than the current one."""
        return self.before * self.after[-1]

    def replace(self, factor: FloatArray) -> None:
        """Set the current agent's factor and go on to the next agent."""
        self.before = self.before * factor
        self.after.pop()


def inner_products(inner: Sequence[FloatArray], mass_rows: IndexArray, rows: IndexArray) -> FloatArray:
    """``sum_k prod_i inner[i][mass_rows[k, i], rows[l, i]]`` for every term l, in chunks of mass terms."""
    total = beside(np.zeros(len(rows)), inner[0])
    chunk = max(1, 4_000_000 // max(1, len(rows)))
    for first in range(0, len(mass_rows), chunk):
        part = mass_rows[first : first + chunk]
        product = take(take(inner[0], part[:, 0]), rows[:, 0], axis=1)
        for i in range(1, len(inner)):
            product *= take(take(inner[i], part[:, i]), rows[:, i], axis=1)
        total += product.sum(axis=0)
    return total


def _means(factors: FloatArray) -> FloatArray:
    """Mean of every factor over the cells, by numpy."""
    return to_host(namespace(factors).mean(factors, axis=1))


def _collect(values: FloatArray, rows: IndexArray, n_rows: int, columns: IndexArray, n_columns: int) -> FloatArray:
    """Sum entries of ``values`` that share a row number and a column number: (K, L) -> (n_rows, n_columns)."""
    if n_columns < len(columns) or not np.array_equal(columns, np.arange(n_columns)):
        values = add_rows(values.T, columns, n_columns).T
    if n_rows < len(rows) or not np.array_equal(rows, np.arange(n_rows)):
        values = add_rows(values, rows, n_rows)
    return values


def _small(values: FloatArray, share: float) -> NDArray[np.bool_]:
    """The smallest values, as many as add up to at most ``share`` of the total."""
    order = np.argsort(values, kind="stable")
    small = np.zeros(len(values), dtype=bool)
    small[order[np.cumsum(values[order]) <= share * values.sum()]] = True
    return small


def _share(values: FloatArray) -> FloatArray:
    """Values as shares of their total."""
    total = values.sum()
    return values / total if total > 0 else values
