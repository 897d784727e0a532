"""Certificates: a lower bound, the policies it belongs to, and everything needed to check it again.

A certificate speaks of one problem (dynamics, regions, automaton, horizon, start: its fingerprint) and one set of
policies. It holds the value tree's skeleton (which vertices were kept), so that the bound can be computed again from
the policies by a short separate program (``check``), and the value function at time 0, so that other starts can be
asked for: at every state the value there is a lower bound too (THEORY section 5).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..envs.agent import LinearAgent
from ..envs.problem import Problem
from .abstraction import Relation
from .agent_controller import AgentController
from .ascent import Skeleton
from .bounds import joint_delta, term_depths
from .controller import Controller
from .described_relation import relation_from
from .grid import FloatArray, Grid, start_share
from .guards import Guards
from .terms import Terms
from .train_value import Rounding, Trains, Unread

MAX_JOINT_CELLS = 20_000_000
"""Largest number of joint cells over which ``min`` is taken cell by cell."""

EXACT_GAP = 1e-6
"""A value is called exact when lower bound and upper bound of the closed loop are closer than this."""


@dataclass(frozen=True, eq=False)
class AgentPart:
    """What a certificate stores of one agent: grid, relation, lattice, guards' masks on the cells, policy.

    Parameters
    ----------
    grid : Grid
    coordinates : (d, d) array
        State = coordinates @ grid coordinates.
    relation : dict
        Kind and numbers, see ``described_relation``.
    lattice : tuple of (Z_k,) arrays
        Means per axis.
    masks, start_masks : (K, S), (K0, S) bool arrays
        Factors of the guards on the cells, for arriving and for starting in them.
    law : (T, Q, S) int32 array, or (1, Q, S) for a stationary policy
        Choice of each cell, -1 for none: a lattice point (``exact``) or an input (all others).
    menu : (S, A) int32 array or None
        Lattice point that each input of each cell leads to.
    """

    grid: Grid
    coordinates: FloatArray
    relation: dict[str, Any]
    lattice: tuple[FloatArray, ...]
    masks: NDArray[np.bool_]
    start_masks: NDArray[np.bool_]
    law: NDArray[np.int32]
    menu: NDArray[np.int32] | None = None

    def relation_of(self, agent: LinearAgent) -> Relation:
        """The relation of ``agent`` that is described, its numbers computed anew."""
        return relation_from(self.relation, agent, self.grid, self.coordinates)

    def points(self, t: int, q: int) -> NDArray[Any]:
        """Lattice point (S,) that each cell leads to at time t in automaton state q; -1 for none."""
        law = self.law[min(t, len(self.law) - 1), q]
        if self.menu is None:
            return law
        chosen = np.take_along_axis(self.menu, np.maximum(law, 0)[:, None].astype(np.int64), axis=1)[:, 0]
        return np.where(law < 0, -1, chosen)

    @property
    def lattice_shape(self) -> tuple[int, ...]:
        """Lattice points per axis."""
        return tuple(len(axis) for axis in self.lattice)


def checked_certificate(value: Any) -> Certificate:
    """Return a certificate, or raise ValueError with what to do."""
    if isinstance(value, Certificate):
        return value
    inside = isinstance(getattr(value, "certificate", None), Certificate)
    if hasattr(value, "parts"):
        raise ValueError(f"`certificate`: expected that of one task, got {len(value.parts)}; give one of its `.parts`")
    remedy = "give its `.certificate`" if inside else "make one with `synthesize`, `certify` or `load_certificate`"
    raise ValueError(f"`certificate`: expected a Certificate, got {type(value).__name__}; {remedy}")


@dataclass(frozen=True, eq=False)
class Certificate:
    """A certified lower bound on the satisfaction probability of the continuous closed loop.

    Parameters
    ----------
    problem : Problem
        What it is about.
    method : str
        Relation, bound and policy search, in words.
    bound : str
        Name of the bound that gives ``lower_bound``: ``nominal``, ``a-posteriori`` or ``robust tree`` (see ``bounds``).
    bounds : dict
        All bounds that were computed, by name.
    start : str
        ``"point"``: the bound holds from the problem's initial state; ``"mean"``: on average over a start drawn
        uniformly from the initial boxes.
    lower_bound : float
        Certified lower bound at the problem's start.
    gap : float or None
        If not None, ``lower_bound + gap`` is an upper bound on the satisfaction probability of this very controller.
    exact : bool
        Whether the probability is known to ``EXACT_GAP``: the bound is then tested by rollouts from both sides.
    relative_rounding : float
        Relative reserve for floating point, also taken off in ``at``, ``mean`` and ``min``.
    agents : tuple of AgentPart
    guard_source, guard_target : (G,) int32 arrays
        Automaton states that each guard connects.
    guard_mask : (G, I) int32 array
        Factor of each agent in each guard, an index into ``agents[i].masks``.
    start_target : (G0,) int32 array
        Automaton state after the letter of time 0.
    start_mask : (G0, I) int32 array
        The same for reading that letter, an index into ``agents[i].start_masks``.
    skeleton : tuple of Skeleton
        Vertices of the value tree, by time; empty if the value function is held as tensor trains.
    terms : Terms or None
        Value function at time 0; None for tensor trains, which are grown again from the policies when asked for.
    rank : int
        Largest number of terms of one automaton state, or of columns of a bond.
    settings : dict
        Every setting of abstraction and policy search.
    rounding : Rounding or None
        How tensor trains were rounded; None for a value tree.
    """

    problem: Problem
    method: str
    bound: str
    bounds: dict[str, float]
    start: str
    lower_bound: float
    gap: float | None
    exact: bool
    relative_rounding: float
    agents: tuple[AgentPart, ...]
    guard_source: NDArray[np.int32]
    guard_target: NDArray[np.int32]
    guard_mask: NDArray[np.int32]
    start_target: NDArray[np.int32]
    start_mask: NDArray[np.int32]
    skeleton: tuple[Skeleton, ...]
    terms: Terms | None
    rank: int
    settings: dict[str, Any]
    rounding: Rounding | None = None

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the problem."""
        return self.problem.fingerprint

    @cached_property
    def controller(self) -> Controller:
        """The controllers the bound belongs to."""
        parts = zip(self.problem.agents, self.agents, self._relations, strict=True)
        controllers = (AgentController(a.name, p.grid, p.lattice, r, p.law, p.menu) for a, p, r in parts)
        return Controller(self.problem, tuple(controllers))

    @property
    def stationary(self) -> bool:
        """Whether no agent looks at the time."""
        return all(len(part.law) == 1 for part in self.agents)

    @property
    def unbounded(self) -> float | None:
        """Lower bound on satisfying a co-safe task at any time, without a deadline; None for other tasks.

        What is satisfied by the horizon stays satisfied. Afterwards controllers go on with their last choices, those of
        stationary policies as before.
        """
        return self.lower_bound if self.problem.automaton.semantics == "co-safe" else None

    @property
    def delta(self) -> float:
        """Upper bound on the probability, per step, that any relation is lost."""
        return joint_delta([relation.delta for relation in self._relations])

    @cached_property
    def _relations(self) -> tuple[Relation, ...]:
        return tuple(part.relation_of(a) for a, part in zip(self.problem.agents, self.agents, strict=True))

    def at(self, states: Any) -> FloatArray:
        """Lower bounds (M,) on the satisfaction probability from each of M joint initial states.

        Parameters
        ----------
        states : array_like, shape (M, D) or (D,), or mapping from agent name to (d_i,) vector
            Joint states in agent order, ``D = sum d_i``, in state units. A single state gives an array of length 1.

        Raises
        ------
        ValueError
            If the shape does not fit.
        """
        joint = joint_states(self.problem, states)
        automaton = self.problem.automaton
        cells = np.empty((len(joint), len(self.agents)), dtype=np.int64)
        inside = np.ones(len(joint), dtype=bool)
        split = np.split(joint, np.cumsum([a.n_states for a in self.problem.agents])[:-1], axis=1)
        holds = []
        for i, (agent, part, own) in enumerate(zip(self.problem.agents, self.agents, split, strict=True)):
            inside &= np.all((agent.workspace.low <= own) & (own <= agent.workspace.high), axis=1)
            cells[:, i] = part.grid.cell_of(self._relations[i].to_grid(own.T))
            holds.append(self.problem.labeling.class_at(i, own.T))
        q = automaton.next_state(np.full(len(joint), automaton.initial), np.concatenate(holds))
        values = np.zeros(len(joint))
        for state in np.unique(q):
            here = np.flatnonzero(inside & (q == state))
            for chunk in np.array_split(here, max(1, len(here) * self._corrected.work(state) // 2_000_000 + 1)):
                values[chunk] = self._corrected.at(int(state), cells[chunk])
        return self._rounded(values)

    def mean(self, low: Any, high: Any) -> float:
        """Lower bound on the satisfaction probability from a start drawn uniformly from the box ``[low, high)``.

        Parameters
        ----------
        low, high : array_like, shape (D,), or mappings from agent name to (d_i,) vector
            Corners in joint state space; equal coordinates are points. The box is averaged cell by cell, each cell with
            the letters that are certain in it.
        """
        weights = self._box(low, high)
        return float(self._rounded(np.array([self._unread.total(0, weights)]))[0])

    def min(self, low: Any, high: Any) -> float:
        """Lower bound on the satisfaction probability from every start in the box: the smallest value of its cells.

        Raises
        ------
        ValueError
            If the box holds more than ``MAX_JOINT_CELLS`` joint cells.
        """
        cells = [np.flatnonzero(w) for w in self._box(low, high)]
        shape = tuple(len(own) for own in cells)
        count = float(np.prod(shape, dtype=float))
        if count > MAX_JOINT_CELLS:
            raise ValueError(
                f"`low`, `high`: expected at most {MAX_JOINT_CELLS} joint cells, got {count:.3g}; ask for a smaller box"
            )
        smallest, chunk = np.inf, max(1, 2_000_000 // max(1, self._unread.work(0)))
        for first in range(0, int(count), chunk):
            numbers = np.unravel_index(np.arange(first, min(first + chunk, int(count))), shape)
            joint = np.column_stack([own[n] for own, n in zip(cells, numbers, strict=True)])
            smallest = min(smallest, float(self._unread.at(0, joint).min()))
        return float(self._rounded(np.array([smallest if count else 0.0]))[0])

    @cached_property
    def _correction(self) -> float:
        """What lost relations may cost a run that is undecided to the end: ``Delta T`` of the a-posteriori bound."""
        return self.delta * self.problem.horizon * (1 + 1e-9) if self.bound == "a-posteriori" else 0.0

    @property
    def tree(self) -> Terms:
        """Value function at time 0 as the terms of the value tree.

        Raises
        ------
        ValueError
            If the value function is held as tensor trains, which have no terms.
        """
        if self.terms is None:
            raise ValueError(
                "`certificate`: expected one with a value tree, got tensor trains, which have no terms; synthesize "
                'with `value="tree"` where the tree has few of them'
            )
        return self.terms

    @cached_property
    def value(self) -> Terms | Trains:
        """Value function at time 0: the stored terms, or the tensor trains grown from the policies on first use."""
        if self.terms is not None:
            return self.terms
        from .regrow_trains import regrow_trains  # it reads certificates

        return regrow_trains(self)

    @cached_property
    def _corrected(self) -> Terms | Trains:
        """Value function; under the a-posteriori bound each term gains ``Delta`` per step saved by accepting early."""
        if self._correction == 0.0 or self.terms is None:
            return self.value
        guards = Guards(tuple(p.masks for p in self.agents), self.guard_source, self.guard_target, self.guard_mask)
        automaton = self.problem.automaton
        co_safe = automaton.semantics == "co-safe"
        absorbing = automaton.dead | automaton.accepting if co_safe else automaton.dead
        depths = term_depths(self.skeleton, guards, automaton.accepting, absorbing)
        horizon = self.problem.horizon
        worth = self.delta * (1 - 1e-9) if co_safe else 0.0
        gains = [np.asarray(1.0 + worth * (horizon - depth)) for depth in depths]
        factors, index = list(self.terms.factors), [rows.astype(np.int64) for rows in self.terms.index]
        scaled = [factors[0][rows[:, 0]] * np.reshape(gain, (-1, 1)) for rows, gain in zip(index, gains, strict=True)]
        ends = np.cumsum([0, *(len(part) for part in scaled)])
        for rows, first in zip(index, ends, strict=False):
            rows[:, 0] = first + np.arange(len(rows))
        return Terms((np.concatenate(scaled), *factors[1:]), tuple(index))

    @cached_property
    def _unread(self) -> Terms | Unread:
        """Value before the first letter is read, as terms of a single state: the start guards and what they lead to."""
        initial, terms = self.problem.automaton.initial, self._corrected
        if isinstance(terms, Trains):
            if self.problem.automaton.semantics == "co-safe" and self.problem.automaton.accepting[initial]:
                everywhere = tuple(np.ones((1, part.grid.n_cells)) for part in self.agents)
                return Unread(terms, np.array([initial]), np.zeros((1, len(self.agents)), dtype=int), everywhere)
            return Unread(terms, self.start_target, self.start_mask, tuple(part.start_masks for part in self.agents))
        if self.problem.automaton.semantics == "co-safe" and self.problem.automaton.accepting[initial]:
            return Terms(terms.factors, (terms.index[initial],))
        counts = [len(terms.index[q]) for q in self.start_target]
        guard = np.repeat(np.arange(len(counts)), counts)
        none = np.zeros((0, len(self.agents)), dtype=np.int64)
        child = np.concatenate([terms.index[q] for q in self.start_target] or [none])
        factors, rows = [], np.zeros(child.shape, dtype=np.int64)
        for i, part in enumerate(self.agents):
            key = self.start_mask[guard, i].astype(np.int64) * len(terms.factors[i]) + child[:, i]
            pairs, rows[:, i] = np.unique(key, return_inverse=True)
            mask, factor = np.divmod(pairs, max(1, len(terms.factors[i])))
            factors.append(part.start_masks[mask] * terms.factors[i][factor])
        return Terms(tuple(factors), (rows,))

    def _rounded(self, values: FloatArray) -> FloatArray:
        """Certified values: rounding and, under the a-posteriori bound, lost relations taken off."""
        return np.clip(values * (1.0 - self.relative_rounding) - self._correction, 0.0, 1.0)

    def _box(self, low: Any, high: Any) -> list[FloatArray]:
        """Share of the box in each agent's cells; it sums to 1 where the box lies inside the workspace."""
        corners = joint_states(self.problem, low)[0], joint_states(self.problem, high)[0]
        splits = np.cumsum([a.n_states for a in self.problem.agents])[:-1]
        weights = []
        for i, (a, b) in enumerate(zip(*(np.split(corner, splits) for corner in corners), strict=True)):
            if np.any(a > b):
                raise ValueError(
                    f"`low`, `high`: expected low <= high for agent `{self.problem.agent_names[i]}`, got {a} and {b}"
                )
            weights.append(start_share(self.agents[i].grid, self.agents[i].coordinates, a, b))
        return weights


def joint_states(problem: Problem, states: Any) -> FloatArray:
    """States as an (M, D) array: joint states (M, D) or (D,), or a mapping from agent name to (d_i,) vector."""
    if isinstance(states, Mapping):
        missing = sorted(set(problem.agent_names) ^ set(states))
        if missing:
            raise ValueError(f"`states`: expected one vector per agent, got a mismatch at {', '.join(missing[:5])}")
        states = np.concatenate([np.atleast_1d(np.asarray(states[n], dtype=float)) for n in problem.agent_names])
    joint = np.atleast_2d(np.asarray(states, dtype=float))
    if joint.ndim != 2 or joint.shape[1] != problem.n_states:
        raise ValueError(f"`states`: expected shape (M, {problem.n_states}), got {joint.shape}")
    return joint
