"""The certified value at any time: what a certificate promises at a state, an automaton state and steps left.

A certificate stores the value function of time 0. Those of later times are grown again from its policies and its tree,
by the recursion of the check, once for each certificate. Shields, learners and audits read them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.arguments import tree_text
from ....envs.systems.backends import is_whole
from ....envs.tasks.problem import Problem
from ...certificates.cell_probabilities import regrow_trains
from ...certificates.proofs import (
    Certificate,
    Claim,
    OnGrid,
    RunProjection,
    VertexProof,
    certificate_from,
    checked_certificate,
    joint_states,
    seen_by,
    value_of,
)
from ...certificates.value_functions import Terms, Trains
from ...relations.grids import FloatArray
from .checked_first import standing
from .grid_values import VertexValues
from .regrown_tree import regrow


@dataclass(frozen=True, eq=False, repr=False)
class ValueInTime:
    """Lower bounds on the satisfaction probability in the middle of a run under a certificate's controllers.

    Parameters
    ----------
    certificate : Certificate
    functions : tuple of Terms or Trains
        Value functions at times 0 .. T - 1, lower bounds up to rounding.
    seen : Seen
        How runs of the problem that is asked about are seen by the certificate.
    """

    certificate: OnGrid
    functions: tuple[Terms | Trains, ...]
    seen: RunProjection

    def __repr__(self) -> str:
        rows = [("times", f"0 .. {len(self.functions) - 1}"), ("claim", self.certificate.claim)]
        return tree_text(f"Value in time of {self.certificate.problem.name!r}", rows)

    @cached_property
    def _claims(self) -> tuple[Claim, ...]:
        """Claims of every time, with everything taken off that is taken off at time 0."""
        claim = self.certificate.claim
        # What accepting early saves is counted at time 0 alone: it may be left out of a lower bound.
        return (claim, *(replace(claim, value=value) for value in self.functions[1:]))

    def at(self, states: Any, q: Any, steps_left: Any) -> FloatArray:
        """Return lower bounds (M,) on the probability that a run satisfies the task from here on.

        The run is at a joint state, in an automaton state that has read the letter of this state, with some steps to
        go, and the controllers of the certificate act as they do with as many steps to go. Controllers with a memory
        begin anew.

        Parameters
        ----------
        states : array_like, shape (M, D) or (D,), or mapping from agent name to (d_i,) vector
            Joint states in agent order, in state units.
        q : int or (M,) int array
            Automaton states.
        steps_left : int or (M,) int array
            Steps to go, 0 to T.

        Raises
        ------
        ValueError
            If a shape does not fit, or a number is none of these.
        """
        problem = self.seen.problem
        joint, state, left = _asked(problem, states, q, steps_left)
        values = np.zeros(len(joint))
        on_cells = self.seen.automaton_states(state, problem.horizon - left)
        for steps in np.unique(left):
            here = np.flatnonzero((left == steps) & (on_cells >= 0))  # elsewhere no run comes to
            if steps:
                values[here] = self._claims[problem.horizon - steps].in_state(joint[here], on_cells[here])
        return _or_decided(problem, state, left, values)


@dataclass(frozen=True, eq=False, repr=False)
class VertexValueInTime:
    """The same for a certificate on a grid of vertices: lower bounds, up to the rounding of what is read."""

    certificate: Certificate[VertexProof]
    values: VertexValues

    def __repr__(self) -> str:
        rows = [
            ("times", f"0 .. {self.certificate.problem.horizon - 1}"),
            ("cells", self.certificate.proof.grid.size_text),
        ]
        return tree_text(f"Value in time of {self.certificate.problem.name!r}", rows)

    def at(self, states: Any, q: Any, steps_left: Any) -> FloatArray:
        """Return lower bounds (M,) on the probability that a run satisfies the task; see ``ValueInTime.at``."""
        problem = self.certificate.problem
        joint, state, left = _asked(problem, states, q, steps_left)
        return _or_decided(problem, state, left, self.values.at(joint, state, left))


def _asked(
    problem: Problem, states: Any, q: Any, steps_left: Any
) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.int64]]:
    """Return joint states (M, D), automaton states (M,) and steps to go (M,)."""
    joint = joint_states(problem, states)
    state = _whole(q, len(joint), "q", problem.automaton.n_states - 1)
    return joint, state, _whole(steps_left, len(joint), "steps_left", problem.horizon)


def _or_decided(problem: Problem, state: NDArray[np.int64], left: NDArray[np.int64], values: FloatArray) -> FloatArray:
    """Return values (M,): of runs that are decided, and those that are at their end, what they have come to."""
    finished = problem.automaton.absorbing[state] | (left == 0)
    return np.where(finished, problem.automaton.accepting[state], values).astype(float)


def _whole(numbers: Any, count: int, name: str, most: int) -> NDArray[np.int64]:
    """Return whole numbers (count,) between 0 and ``most``."""
    array = np.asarray(numbers)
    if not is_whole(array) or array.shape not in ((), (1,), (count,)):
        raise ValueError(f"`{name}`: expected a whole number, or {count} of them, got {numbers!r}")
    if array.size and not (array.min() >= 0 and array.max() <= most):
        raise ValueError(f"`{name}`: expected numbers from 0 to {most}, got {array.min()} .. {array.max()}")
    return np.broadcast_to(array.astype(np.int64), (count,)).copy()


def value_in_time(certificate: Any) -> ValueInTime | VertexValueInTime:
    """Return the value functions of a certificate at every time, lower bounds at every state.

    The certificate is checked first, once. Growing the values takes about as long again; reading them is quick.

    Parameters
    ----------
    certificate : certificate on cells, or on the grid of vertices of one agent
        Of one task; give one of the ``parts`` of a product. Automaton states are those of the
        problem, also where it names the time.

    Raises
    ------
    ValueError
        If it is no such certificate, or ``check`` refuses it.
    """
    given = certificate_from(certificate)
    if isinstance(given.proof, VertexProof):
        standing(given)
        return VertexValueInTime(given, VertexValues(given))
    held = checked_certificate(certificate)
    standing(certificate)
    return ValueInTime(held, claimed_values(held), seen_by(certificate))


def claimed_values(certificate: OnGrid) -> tuple[Terms | Trains, ...]:
    """Return the value functions at times 0 .. T - 1 (lower bounds up to rounding): the stored one, others regrown.

    They are what the certificate claims: whether they are bounds is for ``check`` to say. Audits test them.

    Raises
    ------
    ValueError
        If the certificate's tree is broken.
    """
    horizon = certificate.problem.horizon
    if certificate.proof.terms is None and certificate.proof.rounding is not None:
        trains: dict[int, Terms | Trains] = {}
        regrow_trains(
            certificate.problem,
            certificate.proof.agents,
            certificate.proof.guards,
            certificate.proof.rounding,
            trains.__setitem__,
        )
        return tuple(trains[time] for time in range(horizon))
    # At time 0 keep the stored value, which is the one that the bound is read from.
    values: list[Terms | Trains] = [value_of(certificate)] * horizon

    def note(time: int, terms: Terms) -> None:
        if time > 0:
            values[time] = terms

    regrow(certificate, note)
    return tuple(values)
