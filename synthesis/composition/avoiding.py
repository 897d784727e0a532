"""Policies of teams whose agents keep apart: each answers to where the others are now.

An agent that heeds others is taken away, on arriving in a cell, with the probability that one of them is near it there;
or that it is not near, where agents are to stay near each other. The best policy under this threat goes around places
that are taken, waits, or follows. Agents answer in turn: at first each
heeds those before it, as in prioritised planning, and then everybody. All of this only finds policies: what is
certified is computed from the policies that were found.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...envs.tasks.regions import PairRegion
from ..abstraction.models import Policies
from ..certificates.value_functions import Guards
from ..policy_search.ascent import favourable_successors, relax_one
from ..relations.grids import FloatArray
from .collision_probability import CollisionProbability
from .compared_states import compared_axes

Presence = list[NDArray[np.float64]]
"""Per time 0 .. T: the mass (S,) of an agent in its cells."""


class Avoidance:
    """The search of one problem: who is where, and what each answers.

    Parameters
    ----------
    masses : NearMass
    """

    def __init__(self, masses: CollisionProbability) -> None:
        self.masses, self.joint = masses, masses.joint
        self.follows = favourable_successors(masses.base)
        self._tables: dict[object, list[FloatArray]] = {}

    def answers(self, policies: Policies, heed_all: bool) -> Policies:
        """Return the policies after each agent has answered once, in turn.

        Parameters
        ----------
        policies : Policies
        heed_all : bool
            Whether each heeds all others as they are then, or only those before it.
        """
        current = list(policies)
        presences = [self.presence(i, policies) for i in range(len(policies))]
        for i, model in enumerate(self.joint.models):
            thinned = self.thinned(i, presences, range(len(policies)) if heed_all else range(i))
            if thinned is None and heed_all:
                continue
            if thinned is None:  # the first to answer has the way to itself
                thinned = np.ones((self.joint.horizon + 1, model.n_cells))
            incumbent = current[i] if heed_all else None
            current[i] = relax_one(self.joint, model, self.follows[i], thinned, incumbent).policy
            presences[i] = self.presence(i, current)
        return tuple(current)

    def presence(self, i: int, policies: Sequence[NDArray[np.int32]]) -> Presence:
        """Return where agent i is at times 0 .. T, the automaton taken to be where the others' favour leads it.

        The automaton state is that of the fewest changes: the one that the agent's own cell forces on it.
        """
        model, base = self.joint.models[i], self.masses.base
        result = [np.zeros(model.n_cells) for _ in range(self.joint.horizon + 1)]
        states = self._begun(i, model.share(base.agents[i].initial.low, base.agents[i].initial.high))
        result[0] = sum(states.values(), start=result[0])
        for t in range(self.joint.horizon):
            moved: dict[int, FloatArray] = {}
            for state, mass in states.items():
                propagated = model.kernel.propagate(mass[None], model.choices.points(policies[i][t, state]))[0]
                for target, cells in self._ways(i, state, self.joint.guards, self.joint.masks).items():
                    arrived = np.where(cells, propagated, 0.0)
                    moved[target] = moved[target] + arrived if target in moved else arrived
                    result[t + 1] = result[t + 1] + arrived
            states = moved
        return result

    def _begun(self, i: int, share: FloatArray) -> dict[int, FloatArray]:
        """Return the mass of agent i at the start in each undecided automaton state after the first letter."""
        q, initial = self.masses.base.initial_q, self.masses.base.automaton.initial
        if q is not None:
            return {} if self.joint.absorbing[q] else {q: share}
        ways = self._ways(i, initial, self.joint.start_guards, self.joint.start_masks)
        return {state: np.where(cells, share, 0.0) for state, cells in ways.items()}

    def _ways(self, i: int, state: int, guards: Guards, masks: Sequence[NDArray]) -> dict[int, NDArray[np.bool_]]:
        """Return, per undecided automaton state, the cells in which agent i is taken to lead there: each cell once."""
        left, ways = np.ones(self.joint.models[i].n_cells, dtype=bool), {}
        # States beyond this one come first: others are taken to do their part.
        targets = [q for q in self.masses.alive if q != state] + [state]
        for target in targets:
            rows = guards.mask[(guards.source == state) & (guards.target == target), i]
            if len(rows):
                cells = np.asarray(masks[i][np.unique(rows)], dtype=bool).any(axis=0) & left
                ways[int(target)] = cells
                left &= ~cells
        return ways

    def thinned(self, i: int, presences: Sequence[Presence], heeded: Sequence[int]) -> FloatArray | None:
        """Return the chance (T + 1, S) that those heeded are as usual to agent i; None if it heeds nobody."""
        result: FloatArray | None = None
        for pair, usual in zip(self.masses.pairs, self.masses.usual.tolist(), strict=True):
            if i not in (pair.first, pair.second):
                continue
            other = pair.second if pair.first == i else pair.first
            if other not in heeded:
                continue
            if result is None:
                result = np.ones((self.joint.horizon + 1, self.joint.models[i].n_cells))
            for t, presence in enumerate(presences[other]):
                near = self.near(pair, (i, other), presence, usual)
                result[t] *= near if usual else np.maximum(0.0, 1.0 - near)
        return result

    def near(self, pair: PairRegion, agents: tuple[int, int], presence: FloatArray, surely: bool) -> FloatArray:
        """Return the mass (S_i,) of the second agent that may be, or surely is, near each cell of the first one."""
        i, other = agents
        axes = compared_axes(self.masses.problem, pair)
        own_axes, other_axes = axes if pair.first == i else axes[::-1]
        grids = [self.joint.models[k].grid for k in (i, other)]
        tensor = presence.reshape(grids[1].shape)
        dropped = tuple(k for k in range(tensor.ndim) if k not in other_axes)
        kept = sorted(other_axes)
        tensor = tensor.sum(axis=dropped).transpose([kept.index(k) for k in other_axes])
        for axis, table in enumerate(self._near_cells(pair, i, (own_axes, other_axes), surely)):
            tensor = np.moveaxis(np.tensordot(table, tensor, axes=(1, axis)), 0, axis)
        # Back to the cells of agent i: axes that are not compared do not matter.
        order = np.argsort(own_axes)
        tensor = tensor.transpose(order)
        shape = [n if k in own_axes else 1 for k, n in enumerate(grids[0].shape)]
        return np.broadcast_to(tensor.reshape(shape), grids[0].shape).reshape(-1)

    def _near_cells(
        self, pair: PairRegion, i: int, axes: tuple[Sequence[int], Sequence[int]], surely: bool
    ) -> list[FloatArray]:
        """Return, per axis compared, whether some points of two cells are near, or all: (S_i, S_j) of 0 and 1."""
        j = pair.second if pair.first == i else pair.first
        grids = self.joint.models[i].grid, self.joint.models[j].grid
        edges = [(grids[0].edges[a], grids[1].edges[b]) for a, b in zip(*axes)]
        key = (
            surely,
            pair.first == i,
            pair.low.tobytes(),
            pair.high.tobytes(),
            *(e.tobytes() for both in edges for e in both),
        )
        if key not in self._tables:
            tables = []
            for (own, others), low, high in zip(edges, pair.low, pair.high, strict=True):
                # The box is for first less second: turn it round for the second agent.
                a, b = (low, high) if pair.first == i else (-high, -low)
                most, least = own[1:, None] - others[None, :-1], own[:-1, None] - others[None, 1:]
                near = (least >= a) & (most <= b) if surely else (most >= a) & (least <= b)
                tables.append(near.astype(float))
            self._tables[key] = tables
        return self._tables[key]
