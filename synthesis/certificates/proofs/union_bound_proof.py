"""Proofs by subtraction: a task in which agents must keep apart, or stay near each other.

The same task with every proposition about pairs taken as usual (false, or true where the task wants it) has a
certificate by itself, on grids, with the relation ``exact`` for every agent. What its policies do is known as a
distribution. The probability that a pair is ever otherwise while it matters is bounded from above, pair by pair and
step by step, and subtracted:

    P(task)  >=  P(task without pairs)  -  sum over steps and pairs of P(undecided before, not as usual now) .

Reference: docs/theory/pairs.md, "Subtraction".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from ....envs.tasks.problem import Problem
from ..cell_probabilities import AgentRecord
from ..controllers import Controller
from ..value_functions import UNIT
from .archive import Pool, Stored
from .certificate import Certificate
from .digits import significant_up
from .grid_proof import OnGrid
from .path_proof import probability
from .proof import Capability, Proof

SPOILED = (
    "one by subtraction: what pairs of agents may spoil is bounded for the whole run from the start of its problem, "
    "and for no other state or time; it can be checked, validated, stressed, simulated, compared and reported"
)
"""What certificates by subtraction answer to whoever asks for values."""

OTHER_STARTS = (
    "one about pairs of agents, which says nothing of other starts; synthesize the problem with another `initial_state`"
)
"""What certificates by subtraction answer to whoever asks for other starts."""


@dataclass(frozen=True, eq=False, repr=False)
class UnionBoundProof(Proof):
    """A bound for a task with propositions about pairs: that of the task without them, less what pairs may spoil.

    Parameters
    ----------
    base : Certificate
        Of the same task with every proposition about a pair taken as usual, on grids.
    usual : tuple of bool
        What each proposition about a pair is taken to be.
    near : float
        Upper bound on the probability that a pair is ever otherwise while the task is open and its automaton asks.
    """

    base: OnGrid
    usual: tuple[bool, ...]
    near: float

    kind = "subtraction"
    inside = frozenset({"grid"})
    unsupported = MappingProxyType({Capability.VALUES: SPOILED, Capability.OTHER_STARTS: OTHER_STARTS})
    bound = "subtraction"
    has_cells = True

    @property
    def parts(self) -> tuple[OnGrid, ...]:
        """The certificate without pairs."""
        return (self.base,)

    @property
    def about(self) -> dict[str, str]:  # type: ignore[override]
        """What reports say of pairs of agents."""
        return spoiled_at_most(self.near)

    @property
    def lower_bound(self) -> float:
        """Certified lower bound on the probability that the task is satisfied, rounded down."""
        return max(0.0, math.nextafter(self.base.lower_bound - self.near, -1.0))

    @property
    def gap(self) -> float | None:
        """If not None, ``lower_bound + gap`` is an upper bound on the satisfaction probability of this controller.

        It is that of the base, and what pairs may spoil once more: where they do, the task may be satisfied as well.
        """
        if self.base.gap is None:
            return None
        most = (self.base.lower_bound + self.base.gap + self.near) * (1.0 + 8.0 * UNIT)
        return min(1.0, most) - self.lower_bound

    @property
    def method(self) -> str:
        """Relation, policy search and bound, in words."""
        return f"{self.base.proof.method}, less what pairs may spoil"

    @property
    def rank(self) -> int:
        """Largest number of terms of the value function without pairs."""
        return self.base.proof.rank

    def agents_of(self, problem: Problem) -> tuple[AgentRecord, ...]:
        """Return what is stored of each agent."""
        return self.base.proof.agents

    def with_claims(self, certificate: Certificate, change: Callable[[Any], Any]) -> Certificate:
        """Return the same claim, with what a function makes of its base; itself where its base bounds nothing above."""
        # Where pairs that are not as usual may save what is lost without them, an end of the base is none of the task.
        if not np.array_equal(self.base.problem.automaton.dead, certificate.problem.automaton.dead):
            return certificate
        return replace(certificate, proof=replace(self, base=change(self.base)))

    def controller(self, problem: Problem) -> Controller:
        """Return the controllers: every agent sees its own state, the automaton state and the time."""
        return Controller(problem, self.base.controller.agents)

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        return {"near": float(self.near), "usual": list(self.usual), "base": pool.put_file(self.base)}

    @classmethod
    def read(cls, problem: Problem, stored: Stored) -> Self:
        """Return the proof in a file; raise ValueError if there is none."""
        near, usual = probability(stored.entry["near"]), usual_in(problem, stored)
        base = stored.certificate(stored.entry["base"])
        if base.problem.n_agents != problem.n_agents or base.problem.automaton.n_states != problem.automaton.n_states:
            raise ValueError("its base does not fit the problem")
        return cls(base, usual, near)


def spoiled_at_most(near: float) -> dict[str, str]:
    """Return what reports say of pairs that may spoil this much at most."""
    return {"pairs": f"not as they should be with probability {significant_up(near, 3)} at most"}


def usual_in(problem: Problem, stored: Stored) -> tuple[bool, ...]:
    """Return what each proposition about a pair is taken to be, as a file says."""
    usual = stored.entry["usual"]
    if not isinstance(usual, list) or len(usual) != len(problem.labeling.pairs) or not {*usual} <= {True, False}:
        raise ValueError("what it takes its pairs to be does not fit the problem")
    return tuple(bool(value) for value in usual)
