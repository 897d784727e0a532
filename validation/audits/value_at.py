"""The value functions behind a certificate at every time, read at the cells its controller stands on.

A certificate stores its value function at time 0 only; those of later times are grown again from its policies and its
tree (``synthesis.check.regrow``), for the audit and for the curve of bounds against the steps that are left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...envs.dynamics import Dynamics, Worlds
from ...envs.dynamics import worlds as core
from ...synthesis.certificates import Certificate, regrow_trains
from ...synthesis.checking import regrow
from ...synthesis.values import Terms, Trains, ValueFunction, term_depths

PRODUCTS = 4_000_000
"""Most products of factors that are formed at once."""


class Charge(Protocol):
    """What a bound subtracts from the value, ``Delta * Theta``, an upper bound; 0 for exact relations."""

    def __call__(self, time: int, q: NDArray[Any], cells: NDArray[Any]) -> NDArray[Any]:
        """Charges (M,) with ``T - time`` steps to go, in automaton states (M,) and joint cells (M, I)."""


def claimed_values(certificate: Certificate) -> tuple[Terms | Trains, ...]:
    """Value functions at times 0 .. T - 1 (lower bounds up to rounding): the stored one, and the regrown others.

    Raises
    ------
    ValueError
        If the certificate's tree is broken.
    """
    horizon = certificate.problem.horizon
    if certificate.terms is None and certificate.rounding is not None:
        trains: dict[int, Terms | Trains] = {}
        regrow_trains(
            certificate.problem, certificate.agents, certificate.guards, certificate.rounding, trains.__setitem__
        )
        return tuple(trains[time] for time in range(horizon))
    values: list[Terms | Trains] = [certificate.value] * horizon

    def keep(time: int, terms: Terms) -> None:
        if time > 0:
            values[time] = terms

    regrow(certificate, keep)
    return tuple(values)


def values_at(terms: ValueFunction, q: NDArray[Any], cells: NDArray[Any]) -> NDArray[Any]:
    """Values (M,) in automaton states (M,) at joint cells (M, I)."""
    values = np.zeros(len(q))
    for state in np.unique(q):
        here = np.flatnonzero(q == state)
        parts = max(1, -(-len(here) * terms.work(int(state)) // PRODUCTS))
        for rows in np.array_split(here, parts):
            values[rows] = terms.at(int(state), cells[rows])
    return values


def charge_of(certificate: Certificate, values: Sequence[ValueFunction]) -> Charge | None:
    """What the certificate's bound subtracts, ``Delta Theta`` read off the depths of its tree; None if nothing."""
    if certificate.bound != "a-posteriori":
        return None
    automaton, horizon = certificate.problem.automaton, certificate.problem.horizon
    trees = [value for value in values if isinstance(value, Terms)]
    if len(trees) < len(values):
        return StepCharge(certificate.delta * (1 + 1e-9), horizon)
    settled = automaton.accepting, automaton.absorbing
    depths = [tuple(term_depths(certificate.skeleton[t:], certificate.guards, *settled)) for t in range(horizon)]
    worth = certificate.delta * (1 + 1e-9)
    return DepthCharge(tuple(trees), tuple(depths), worth, horizon, automaton.is_co_safe)


@dataclass(frozen=True, eq=False)
class StepCharge:
    """``Delta`` for every step that is left: the bound of tensor trains."""

    delta: float
    horizon: int

    def __call__(self, time: int, q: NDArray[Any], cells: NDArray[Any]) -> NDArray[Any]:
        """Charges (M,); see ``Charge``."""
        return np.full(len(q), self.delta * (self.horizon - time))


@dataclass(frozen=True, eq=False)
class DepthCharge:
    """``Delta Theta`` with ``Theta = (T - t) - sum_z v(z) (T - t - depth z)``; without the sum for finite traces."""

    values: tuple[Terms, ...]
    depths: tuple[tuple[NDArray[Any], ...], ...]
    delta: float
    horizon: int
    co_safe: bool

    def __call__(self, time: int, q: NDArray[Any], cells: NDArray[Any]) -> NDArray[Any]:
        """Charges (M,); see ``Charge``."""
        left, terms = self.horizon - time, self.values[time]
        saved = np.zeros(len(q))
        for state in np.unique(q) if self.co_safe else ():
            here, rows = np.flatnonzero(q == state), terms.index[state]
            product = np.ones((len(here), len(rows)))
            for i, factors in enumerate(terms.factors):
                product = product * factors[rows[:, i]][:, cells[here, i]].T
            saved[here] = product @ (left - np.reshape(self.depths[time][state], -1))
        return np.asarray(self.delta * (left - saved * (1 - 1e-9)))


def standing_cells(
    certificate: Certificate, dynamics: Dynamics, worlds: Worlds, policy: Any, memory: Any
) -> NDArray[Any]:
    """Joint cells (M, I) that the controller acts on: those it remembers where it does, else those of the states."""
    cells = cells_of(certificate, core.joint(dynamics, worlds))
    if remembers(memory):
        for block, groups, memories in zip(dynamics.blocks, policy.blocks, memory.groups, strict=True):
            for group, own in zip(groups, memories, strict=True):
                if own is not None:
                    cells[:, block.agents[group.members]] = own.cells.T
    return cells


def remembers(memory: Any) -> bool:
    """Whether any agent has a memory."""
    return any(own is not None for groups in getattr(memory, "groups", ()) for own in groups)


def cells_of(certificate: Certificate, states: NDArray[Any]) -> NDArray[Any]:
    """Joint cells (M, I) that hold the joint states (M, D); states outside the grids count with the nearest cell."""
    ends = np.cumsum([agent.n_states for agent in certificate.problem.agents])[:-1]
    own = np.split(states, ends, axis=1)
    agents = certificate.controller.agents
    return np.stack([a.grid.cell_of(a.project(x.T)) for a, x in zip(agents, own, strict=True)], axis=1)


def bound_by_steps_left(certificate: Certificate, values: Sequence[ValueFunction], state: Any) -> NDArray[Any]:
    """Lower bounds (T,) from one joint state when the last 1, 2, .., T steps of the policies are played."""
    state = np.atleast_2d(np.asarray(state, dtype=float))
    problem = certificate.problem
    own = np.split(state[0], np.cumsum([agent.n_states for agent in problem.agents])[:-1])
    initial = np.asarray(problem.automaton.initial)
    q = np.atleast_1d(problem.automaton.next_state(initial, problem.labeling.letter(own)))
    cells = cells_of(certificate, state)
    charge, bounds = charge_of(certificate, values), []
    for time in reversed(range(len(values))):
        bound = values_at(values[time], q, cells)[0] * (1.0 - certificate.relative_rounding)
        bounds.append(bound - (0.0 if charge is None else charge(time, q, cells)[0]))
    return np.clip(np.array(bounds), 0.0, 1.0)
