"""Occupancy-weighted coordinate ascent on decentralised policies.

A sweep goes forward once under the current policies, keeping the alive mass ``mu_t,q = sum_k prod_i m_k,i``, and then
backward through the value tree. With the masked next-step terms ``g_l`` of state q, agent i's exact best response at
time t is, for every cell s (docs/theory/tree.md, "Policies: occupancy-weighted ascent"),

    argmax_u  sum_l omega_l(s) (P_u g_l,i)(s),     omega_l(s) = sum_k m_k,i(s) prod_{j != i} < m_k,j , P_j^pi g_l,j > .

Agents answer in turn. Without pruning the value at the start never falls. With pruning it may; so callers keep the best
policies and evaluate them frozen, with ``sweep(..., improve=False)``, before they report anything.

Terms are pruned by contribution, ``<mu_t,q , term>``. What is dropped is charged with the leftover mass of a truncated
occupancy, too, so that ``dropped`` is an upper bound on the loss at the start (docs/theory/tree.md, "Dropping terms").
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.arguments import tree_text
from ...abstraction.models import ActionTable, JointModel, Policies, StepPolicy, best_offered
from ...certificates.value_functions import IndexArray, MergeLog, Occupancy, Terms, compress
from ...relations.grids import FloatArray, alike_text
from .inner_products import Others, collected, inner_products
from .limits import Limits
from .occupancy import AliveMass, nowhere
from .pruning_schedule import Arrivals
from .tree import Candidates, Loss, assemble, candidates, shared, terminal_terms

MOST_WEIGHTS = 30_000_000
"""Most products of a mass term, a value term and an agent that decisions are weighed with: 240 MB."""

GLANCED = 997
"""Every so many entries of tables say whether two may be equal."""

PRODUCTS_PER_SECOND, ENTRIES_PER_SECOND, MOST_ENTRIES = 1e6, 1e8, 3e7
"""Products of a guard and a term, of each agent, and entries of their factors, that take a core second; and entries
that are held at once without more ado."""

READINGS_AT_ONCE, ANSWERED = 16.0, 4.0
"""How many factors are read in the time of one, about, and what answering takes against reading."""

Known = dict[object, tuple[NDArray, NDArray]]
"""Smoothed factors that were read, and what was read, by where they were read and some of their entries."""


@dataclass(frozen=True, eq=False, repr=False)
class Sweep:
    """Outcome of one pass over all times.

    Parameters
    ----------
    policies : Policies
        Policies the value belongs to.
    terms : Terms
        Value function at time 0.
    value : float
        Value at the start (a lower bound up to rounding).
    dropped : float
        Upper bound on what pruning took from ``value``.
    rank : int
        Largest number of terms of one state at any time.
    skeleton : tuple of Skeleton
        The tree, by time.
    stationary : bool
        Whether the policies are the same at all times, held once for all of them.
    """

    policies: Policies
    terms: Terms
    value: float
    dropped: float
    rank: int
    merge_log: tuple[MergeLog, ...]
    stationary: bool = False

    def __repr__(self) -> str:
        rows: list[tuple[str, object]] = [
            ("dropped", f"at most {self.dropped:.2g}"),
            ("rank", self.rank),
            ("policies", policies_text(self.policies, self.stationary)),
            ("terms", self.terms),
        ]
        return tree_text(f"Sweep: value {self.value:.6g}, not rounded down", rows)


def policies_text(policies: Policies, stationary: bool) -> str:
    """Return the sizes of policy tables in words."""
    times, states, _ = policies[0].shape
    cells = alike_text(str(policy.shape[-1]) for policy in policies)
    return f"{'stationary' if stationary else f'{times} times'}, {states} automaton states, cells: {cells}"


def resting_policies(joint: JointModel) -> Policies:
    """Return policies under which every agent stays where it is, at all times and states."""
    resting = [model.resting_policy(joint.horizon)[:, None] for model in joint.models]
    # Views: all states share what is the same for all.
    return tuple(np.broadcast_to(each, (len(each), joint.n_states, each.shape[2])) for each in resting)


def start_value(start: Occupancy, terms: Terms) -> float:
    """Return ``sum_q <mu_0,q , V_q>``, up to rounding."""
    total = 0.0
    for q, rows in enumerate(start.terms.index):
        if len(rows) and len(terms.index[q]):
            inner = [m @ v.T for m, v in zip(start.terms.factors, terms.factors, strict=True)]
            total += float(inner_products(inner, rows, terms.index[q]).sum())
    return total


def sweep(
    joint: JointModel,
    policies: Policies,
    start: Occupancy | None,
    limits: Limits,
    improve: bool,
    loss: Loss | None = None,
    watch: Callable[[Stage], None] | None = None,
    climb: float | None = 0.0,
    until: float = math.inf,
) -> Sweep:
    """Make one pass: alive mass forward under ``policies``, value backward; every agent answers if ``improve``.

    The value is a lower bound up to rounding; of linear agents only if they do not answer, and about right if they do.

    Parameters
    ----------
    joint : JointModel
    policies : Policies
    start : Occupancy or None
        Without a start every cell counts alike at all times and states (the paper's heuristic weights, without its
        norms), and the value is reported as 0.
    limits : Limits
    improve : bool
        Whether the agents answer; otherwise the policies stay as they are.
    loss : callable, optional
        What lost relations take from smoothed factors, see ``candidates``.
    watch : callable, optional
        Shown every (time, automaton state) once its policies are set.
    climb : float or None
        Share that uniting two terms from below may lose where steps are not additive (``pruning_schedules``); None: no
        terms are united.
    until : float
        Terms of a state at which the pass is left, with policies as they are by then.
    """
    mass = None if start is None else AliveMass(joint, policies, start, limits)
    policies = tuple(policy.copy() for policy in policies) if improve else policies
    terms = terminal_terms(joint.accepting, joint.n_cells)
    dropped, rank, skeletons = 0.0, terms.rank, []
    ones = [np.ones((1, n)) for n in joint.n_cells]
    for t in reversed(range(joint.horizon)):
        occupancy = nowhere(joint) if mass is None else mass.pop()
        if joint.spend is not None:
            joint.spend(work_of_products(joint, terms))
        arrivals = None if climb is None else _arrivals(joint, occupancy, policies, t)
        steps = joint.guards, joint.masks, joint.models, terms
        options = candidates(*steps, loss, arrivals, climb or 0.0, joint.finds_alike)
        parts, kept = [], []
        for q in range(joint.n_states):
            # Where nothing is left to decide the value is 1 or 0.
            if joint.absorbing[q]:
                rows = np.zeros((int(joint.accepting[q]), len(joint.models)), dtype=np.int64)
                parts.append((ones, rows))
                kept.append(np.zeros(0, dtype=np.int64))
                continue
            if not joint.occurs[t, q]:
                parts.append((ones, np.zeros((0, len(joint.models)), dtype=np.int64)))
                kept.append(np.zeros(0, dtype=np.int64))
                continue
            stage = Stage(joint, options, occupancy, q, [policy[t, q] for policy in policies], improve, t)
            if joint.spend is not None:
                joint.spend(stage.work(improve))
            # Answers at time t leave the occupancies up to t as they are: they depend on earlier policies only.
            if improve and len(stage.rows):
                stage.improve()
                for policy, better in zip(policies, stage.policies, strict=True):
                    policy[t, q] = better
            if watch is not None:
                watch(stage)
            # The prices of dropped terms add up (docs/theory/tree.md, "Dropping terms").
            keep, charge = stage.prune(limits)
            if len(keep) >= until:
                return Sweep(policies, terms, 0.0, dropped, len(keep), ())
            dropped += charge
            parts.append(stage.part(keep))
            kept.append(options.row[q][keep])
            del stage  # its tables would otherwise be held while those of the next time are made
        terms = assemble(shared(parts) if joint.finds_alike else parts, joint.n_cells)
        rank = max(rank, terms.rank)
        skeletons.append(MergeLog(options.origin, options.merges, tuple(kept)))
        del options
    value = 0.0 if start is None else start_value(start, terms)
    return Sweep(policies, terms, value, dropped * (1 + 1e-9), rank, tuple(reversed(skeletons)))


def work_of_products(joint: JointModel, terms: Terms) -> float:
    """Return the work of all products of a guard with a term of its target, in core seconds, before they are made."""
    guards = joint.guards
    count = int(np.array([len(rows) for rows in terms.index], dtype=np.int64)[guards.target].sum())
    entries = sum(
        min(count, len(mask) * len(factor)) * factor.shape[1]
        for mask, factor in zip(joint.masks, terms.factors, strict=True)
    )
    # Tables that are too large for the memory of most machines count for more than the time that they take.
    too_large = max(1.0, entries / MOST_ENTRIES)
    return count * len(joint.models) / PRODUCTS_PER_SECOND + too_large * entries / ENTRIES_PER_SECOND


def _arrivals(joint: JointModel, occupancy: Occupancy, policies: Policies, t: int) -> Arrivals | None:
    """Return what weighs ladders at time t: where the mass of each agent arrives; None if all steps are additive."""
    if all(model.is_additive for model in joint.models):
        return None

    def arriving(q: int) -> list[NDArray[Any]]:
        rows, factors = occupancy.terms.index[q], occupancy.terms.factors
        if not len(rows):
            return [np.full(n, 1.0 / n) for n in joint.n_cells]
        totals = np.stack([factor.sum(axis=1)[rows[:, i]] for i, factor in enumerate(factors)])
        masses = []
        for i, model in enumerate(joint.models):
            others = np.prod(np.delete(totals, i, axis=0), axis=0)
            marginal = np.bincount(rows[:, i], weights=others, minlength=len(factors[i])) @ factors[i]
            masses.append(model.kernel.propagate(marginal[None], model.choices.points(policies[i][t, q]))[0])
        return masses

    return arriving


class Stage:
    """One (time, automaton state): candidate terms, the mass that reaches them, and each agent's policy."""

    def __init__(
        self,
        joint: JointModel,
        options: Candidates,
        occupancy: Occupancy,
        q: int,
        policies: Sequence[StepPolicy],
        rough: bool = False,
        time: int = 0,
    ) -> None:
        self.rough = rough
        self.models, self.policies, self.leftover = joint.models, list(policies), occupancy.leftover
        self.time, self.q = time, q
        # What each agent may choose from, and the number of the first of these choices.
        self.offered: list[tuple[ActionTable, int]] = [model.offered(time) for model in joint.models]
        # Keep the factors that terms of this state point at, and read them at the chosen points.
        self.rows = options.index[q].copy()
        self.backed_up, self.values, known = [], [], Known()
        for i, policy in enumerate(self.policies):
            table, self.rows[:, i] = compress(options.backed_up[i], self.rows[:, i])
            self.backed_up.append(table)
            self.values.append(self._read_once(i, table, policy, known))
        self.mass_rows = occupancy.terms.index[q]
        self.is_met = len(self.mass_rows) > 0
        if self.is_met:
            self.mass_rows = self.mass_rows.copy()
            self.mass = []
            for i, factors in enumerate(occupancy.terms.factors):
                used, self.mass_rows[:, i] = compress(factors, self.mass_rows[:, i])
                self.mass.append(used)
        else:
            # No mass gets here: weigh decisions by one term that is uniform over all cells.
            pairs = zip(self.models, self.values, strict=True)
            self.mass = [np.full((1, m.n_cells), 1.0 / m.n_cells) for m, values in pairs]
            self.mass_rows = np.zeros((1, len(self.models)), dtype=np.int64)

    def _read_once(self, i: int, table: FloatArray, policy: StepPolicy, known: Known) -> FloatArray:
        """Return the factors of an agent under a policy; where reading takes long, equal agents are read once."""
        model = self.models[i]
        if not model.choices.is_read_at_length or len(self.models) == 1:
            return model.choices.read(table, policy, self.rough)
        # Tables are compared in full only where some of their entries are equal.
        key, table_there = (id(model), table.shape, table[:, ::GLANCED].tobytes(), policy.tobytes()), None
        if key in known:
            table_there, values = known[key]
        if table_there is None or not np.array_equal(table_there, table):
            values = model.choices.read(table, policy, self.rough)
            known[key] = table, values
        return values

    def work(self, improve: bool) -> float:
        """Return the work of reading all factors, and of answering to them if agents do, in core seconds."""
        each = (
            len(values) * model.n_cells / (READINGS_AT_ONCE * model.choices.read_per_second)
            for model, values in zip(self.models, self.values, strict=True)
        )
        return (ANSWERED if improve else 1.0) * sum(each)

    def improve(self) -> None:
        """Let every agent answer once, in order.

        Cells that the alive mass does not meet are weighed as if the other agents might be anywhere.
        """
        n_agents = len(self.models)
        chosen = self._heaviest(n_agents)
        met = self._met(chosen)
        anywhere = Others([_means(values)[self.rows[:, i]] for i, values in enumerate(self.values)])
        answers: dict[tuple[int, int, bytes, bytes], StepPolicy] = {}
        for i, model in enumerate(self.models):
            n_values = len(self.values[i])
            # With a single objective its weights do not matter, and equal agents have equal answers.
            if n_values == 1:
                table = self.backed_up[i]
                key = (id(model), self.offered[i][1], table.tobytes(), self.policies[i].tobytes())
                if key not in answers:
                    answers[key] = self.best(i, np.ones((model.n_cells, 1)), table)
                self.policies[i] = answers[key]
            else:
                weights = self._weights(i, met, chosen)
                unmet = ~np.any(weights > 0, axis=1)
                if bool(unmet.any()):
                    usual = np.bincount(self.rows[:, i], weights=anywhere.product(), minlength=n_values)
                    if bool(unmet.all()):  # one objective for all cells: cheap, where windows slide
                        weights = usual[None]
                    else:
                        weights[unmet] = usual
                self.policies[i] = self.best(i, weights, self.backed_up[i])
            # The next agents answer to what this one does now.
            self.values[i] = model.choices.read(self.backed_up[i], self.policies[i], self.rough)
            met.replace(self._inner_by_terms(i, chosen))
            anywhere.replace(_means(self.values[i])[self.rows[:, i]])

    def best(self, i: int, weights: FloatArray, table: FloatArray) -> StepPolicy:
        """Return the best of the choices that agent i is offered."""
        return best_offered(self.offered[i], weights, table, self.policies[i])

    def gain(self) -> float:
        """Return the largest increase of the start value if one agent changes its choices here (an estimate).

        Mass that was left out of the occupancies is not counted.
        """
        if not self.is_met or len(self.rows) == 0:
            return 0.0
        most = 0.0
        for i, (model, weights) in enumerate(zip(self.models, self.weights(), strict=True)):
            better = self.best(i, weights, self.backed_up[i])
            added = model.choices.read(self.backed_up[i], better) - self.values[i]
            most = max(most, float(np.einsum("sn,ns->", weights, added)))
        return most

    def weights(self) -> list[FloatArray]:
        """Return, per agent, the weights (S, n) of its value factors in its cells, the others' policies as they are."""
        chosen = self._heaviest(len(self.models))
        met, result = self._met(chosen), []
        for i in range(len(self.models)):
            result.append(self._weights(i, met, chosen))
            met.replace(self._inner_by_terms(i, chosen))
        return result

    def _met(self, chosen: IndexArray) -> Others:
        """Return the inner products of mass and value per agent, (mass terms, terms)."""
        return Others([self._inner_by_terms(i, chosen) for i in range(len(self.models))])

    def _weights(self, i: int, met: Others, chosen: IndexArray) -> FloatArray:
        """Return omega (S, n) of agent i's value factors in its cells: the mass there, times the others' products."""
        sums = collected(met.product(), chosen[:, i], len(self.mass[i]), self.rows[:, i], len(self.values[i]))
        weights: FloatArray = self.mass[i].T @ sums
        return weights

    def _heaviest(self, n_agents: int) -> IndexArray:
        """Return the mass terms to weigh decisions with: all, or the heaviest if the arrays would not fit."""
        room = max(1, MOST_WEIGHTS // (n_agents * max(1, len(self.rows))))
        if len(self.mass_rows) <= room:
            return self.mass_rows
        mass = np.ones(len(self.mass_rows))
        for i, factors in enumerate(self.mass):
            mass *= np.sum(factors, axis=1)[self.mass_rows[:, i]]
        return self.mass_rows[np.sort(np.argsort(-mass, kind="stable")[:room])]

    def _inner(self, i: int) -> FloatArray:
        """Return the inner products of agent i, (mass factors, value factors)."""
        inner: FloatArray = self.mass[i] @ self.values[i].T
        return inner

    def _inner_by_terms(self, i: int, chosen: IndexArray) -> FloatArray:
        """Return the same by mass terms ``chosen`` and value terms."""
        return self._inner(i)[chosen[:, i]][:, self.rows[:, i]]

    def prune(self, limits: Limits) -> tuple[IndexArray, float]:
        """Return the terms to keep, and an upper bound on the loss at the start."""
        if len(self.rows) == 0:
            return np.zeros(0, dtype=np.int64), 0.0
        # What a term contributes at the start (its price), and what it is worth averaged over all cells.
        met = np.zeros(len(self.rows))
        if self.is_met:
            met = inner_products([self._inner(i) for i in range(len(self.models))], self.mass_rows, self.rows)
        anywhere = np.ones(len(self.rows))
        for i, values in enumerate(self.values):
            anywhere *= _means(values)[self.rows[:, i]]
        # Drop the cheapest terms, but none that matters elsewhere; then the least important ones beyond the rank.
        drop = _small(met, limits.contribution) & (anywhere <= limits.elsewhere * anywhere.sum())
        if (~drop).sum() > limits.rank:
            importance = _share(met) + limits.elsewhere * _share(anywhere)
            importance[drop] = -1.0
            drop[np.argsort(-importance, kind="stable")[limits.rank :]] = True
        keep = np.flatnonzero(~drop)
        # Mass that is missing from the occupancy could meet dropped terms at their largest value, at most 1 together.
        sup = np.ones(len(self.rows))
        for i, values in enumerate(self.values):
            sup *= np.max(values, axis=1)[self.rows[:, i]]
        return keep, float(met[drop].sum() + self.leftover * min(1.0, sup[drop].sum()))

    def part(self, keep: IndexArray) -> tuple[list[FloatArray], IndexArray]:
        """Return the factors of each agent and the rows of the kept terms."""
        rows, factors = self.rows[keep], []
        for i, values in enumerate(self.values):
            used, rows[:, i] = compress(values, rows[:, i])
            factors.append(used)
        return factors, rows


def _means(factors: FloatArray) -> FloatArray:
    """Return the mean of every factor over the cells, as an array of numpy."""
    return np.mean(factors, axis=1)


def _small(values: FloatArray, share: float) -> NDArray[np.bool_]:
    """Return which values are the smallest, as many as add up to at most ``share`` of the total."""
    order = np.argsort(values, kind="stable")
    small = np.zeros(len(values), dtype=bool)
    small[order[np.cumsum(values[order]) <= share * values.sum()]] = True
    return small


def _share(values: FloatArray) -> FloatArray:
    """Return values as shares of their total, or as they are if that is 0."""
    total = values.sum()
    return values / total if total > 0 else values
