"""The value functions behind a certificate at every time, read at the cells on which its controller stands.

The functions themselves are those of ``synthesis.extended_check.claims.values_in_time``, for the audit and for the
curve of bounds against steps left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Dynamics, Worlds
from ...envs.simulation import batch_simulator as core
from ...synthesis.certificates.proofs import OnGrid, delta_of
from ...synthesis.certificates.value_functions import Terms, ValueFunction, term_depths

PRODUCTS = 4_000_000
"""Most products of factors that are formed at once: 32 MB of float64."""

CHARGE_MARGIN = 1e-9
"""Relative allowance for rounding in a charge: far above the error of its sums, far below what a test can see."""


class Charge(Protocol):
    """An amount that a bound subtracts from the value: ``Delta * Theta``, an upper bound; 0 for exact relations."""

    def __call__(self, time: int, q: NDArray[Any], cells: NDArray[Any]) -> NDArray[Any]:
        """Return the charges (M,) with ``T - time`` steps to go, in automaton states (M,) at joint cells (M, I)."""


def values_at(terms: ValueFunction, q: NDArray[Any], cells: NDArray[Any]) -> NDArray[Any]:
    """Return the values (M,) in automaton states (M,) at joint cells (M, I)."""
    values = np.zeros(len(q))
    for state in np.unique(q):
        here = np.flatnonzero(q == state)
        pieces = max(1, -(-len(here) * terms.work(int(state)) // PRODUCTS))
        for rows in np.array_split(here, pieces):
            values[rows] = terms.at(int(state), cells[rows])
    return values


def values_between(
    certificate: OnGrid,
    terms: ValueFunction,
    q: NDArray[Any],
    cells: NDArray[Any],
    states: NDArray[Any],
) -> NDArray[Any]:
    """Return the values (M,) in automaton states (M,) at joint cells (M, I), as ``values_at`` does.

    Factors of linear agents are interpolated: they are read at joint states (M, D).
    """
    if not any(part.is_linear for part in certificate.proof.agents):
        return values_at(terms, q, cells)
    assert isinstance(terms, Terms)  # linear agents have no trains
    read = []
    for i, (part, columns) in enumerate(zip(certificate.proof.agents, certificate.problem.columns, strict=True)):
        if part.is_linear:
            read.append(part.places_at(certificate.controller.agents[i].project(states[:, columns].T)))
        else:
            read.append((cells[:, i, None], np.ones((len(cells), 1))))
    values = np.zeros(len(q))
    for state in np.unique(q):
        here = np.flatnonzero(q == state)
        numbers = len(here) * terms.work(int(state)) * max(places.shape[1] for places, _ in read)
        for rows in np.array_split(here, max(1, -(-numbers // PRODUCTS))):
            at, weights = [places[rows] for places, _ in read], [weight[rows] for _, weight in read]
            values[rows] = terms.products_between(int(state), at, weights).sum(axis=1)
    return values


def charge_of(certificate: OnGrid, values: Sequence[ValueFunction]) -> Charge | None:
    """Return what the certificate's bound subtracts: ``Delta Theta``, an upper bound; None if it subtracts nothing.

    For trees, Theta is read off the depths of the terms (docs/theory/bounds.md, "A-posteriori").
    """
    if certificate.proof.bound != "a-posteriori":
        return None
    if any(part.is_linear for part in certificate.proof.agents):
        raise ValueError(
            "`certificate`: expected the same loss in a whole cell, got the a-posteriori bound with linear agents; "
            "use `validate`, or give the other agents a relation that is not lost"
        )
    automaton, horizon = certificate.problem.automaton, certificate.problem.horizon
    trees = [value for value in values if isinstance(value, Terms)]
    # Trains have no terms with depths: every step that is left is charged.
    if len(trees) < len(values):
        return StepCharge(delta_of(certificate) * (1 + CHARGE_MARGIN), horizon)
    settled = automaton.accepting, automaton.absorbing
    depths = [
        tuple(term_depths(certificate.proof.merge_log[t:], certificate.proof.guards, *settled)) for t in range(horizon)
    ]
    worth = delta_of(certificate) * (1 + CHARGE_MARGIN)
    return DepthCharge(tuple(trees), tuple(depths), worth, horizon, automaton.is_co_safe)


@dataclass(frozen=True, eq=False)
class StepCharge:
    """``Delta`` for every step that is left: the charge of tensor trains."""

    delta: float
    horizon: int

    def __call__(self, time: int, q: NDArray[Any], cells: NDArray[Any]) -> NDArray[Any]:
        """Return the charges (M,); see ``Charge``."""
        return np.full(len(q), self.delta * (self.horizon - time))


@dataclass(frozen=True, eq=False)
class DepthCharge:
    """``Delta Theta`` with ``Theta = (T - t) - sum_z v(z) (T - t - depth z)``; without the sum for finite traces.

    An accepted run of depth d saves ``T - t - d`` steps. The saving is rounded down, so that the charge is rounded up.
    """

    values: tuple[Terms, ...]
    depths: tuple[tuple[NDArray[Any], ...], ...]
    delta: float
    horizon: int
    co_safe: bool

    def __call__(self, time: int, q: NDArray[Any], cells: NDArray[Any]) -> NDArray[Any]:
        """Return the charges (M,); see ``Charge``."""
        left, terms = self.horizon - time, self.values[time]
        # Sum over the terms of a state: value at the cells times the steps that the term's runs save.
        saved = np.zeros(len(q))
        for state in np.unique(q) if self.co_safe else ():
            here, rows = np.flatnonzero(q == state), terms.index[state]
            product = np.ones((len(here), len(rows)))
            for i, factors in enumerate(terms.factors):
                product = product * factors[rows[:, i]][:, cells[here, i]].T
            saved[here] = product @ (left - np.reshape(self.depths[time][state], -1))
        return np.asarray(self.delta * (left - saved * (1 - CHARGE_MARGIN)))


def standing_cells(certificate: OnGrid, dynamics: Dynamics, worlds: Worlds, policy: Any, memory: Any) -> NDArray[Any]:
    """Return the joint cells (M, I) on which the controller acts: those it remembers, otherwise those of the states."""
    cells = cells_of(certificate, core.joint(dynamics, worlds))
    if remembers(memory):
        for block, groups, memories in zip(dynamics.blocks, policy.blocks, memory.groups, strict=True):
            for group, memory_of_group in zip(groups, memories, strict=True):
                if memory_of_group is not None:
                    cells[:, block.agents[group.members]] = memory_of_group.cells.T
    return cells


def remembers(memory: Any) -> bool:
    """Return whether any agent has a memory."""
    return any(of_group is not None for groups in getattr(memory, "groups", ()) for of_group in groups)


def cells_of(certificate: OnGrid, states: NDArray[Any]) -> NDArray[Any]:
    """Return the joint cells (M, I) of joint states (M, D); a state outside a grid counts as in the nearest cell."""
    pairs = zip(certificate.controller.agents, certificate.problem.columns, strict=True)
    return np.stack([agent.grid.cell_of(agent.project(states[:, columns].T)) for agent, columns in pairs], axis=1)


def bound_by_steps_left(certificate: OnGrid, values: Sequence[ValueFunction], state: Any) -> NDArray[Any]:
    """Return lower bounds (T,) from one joint state if only the last 1, 2, .., T steps of the policies are played."""
    state = np.atleast_2d(np.asarray(state, dtype=float))
    problem = certificate.problem
    # The automaton reads the letter of the start before the first step.
    initial = np.asarray(problem.automaton.initial)
    letter = problem.labeling.letter([state[0, columns] for columns in problem.columns])
    q = np.atleast_1d(problem.automaton.next_state(initial, letter))
    cells = cells_of(certificate, state)
    # With k steps left the policies of time T - k are played first, so the value at that time is the bound.
    charge, bounds = charge_of(certificate, values), []
    for time in reversed(range(len(values))):
        value = values_between(certificate, values[time], q, cells, state)[0]
        bound = value * (1.0 - certificate.proof.relative_rounding)
        bounds.append(bound - (0.0 if charge is None else charge(time, q, cells)[0]))
    return np.clip(np.array(bounds), 0.0, 1.0)
