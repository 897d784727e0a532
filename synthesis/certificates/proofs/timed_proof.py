"""Proofs for problems that name the time, by those of the same problems written without it.

A problem that names the time is written out without it: regions that move are a region for each place, the automaton
counts steps, and dynamics that name the time have it as an input, the clock, which policies have to set to the time at
every step. Then runs, letters and verdicts of both problems are the same (docs/theory/time.md, "Written out").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem, states_in_time, unrolled_in_time
from ..controllers import TimedController
from .archive import Pool, Stored
from .certificate import Certificate
from .grid_proof import OnGrid
from .projection import ProjectionInTime, RunProjection
from .proof import Capability, Proof

IN_TIME = (
    "one of a problem that names the time `t`, of whose steps nothing is said beyond its horizon; its `.proof.base` is "
    "about the problem written out without the time"
)
"""What certificates of problems that name the time answer to whoever asks what happens later."""


@dataclass(frozen=True, eq=False, repr=False)
class TimedProof(Proof):
    """A bound for a problem that names the time: that of the problem written out.

    Parameters
    ----------
    base : Certificate
        Of the problem written out, on cells.
    """

    base: OnGrid

    kind = "timed"
    inside = frozenset({"grid"})
    unsupported = MappingProxyType({Capability.SAME_STEPS: IN_TIME})

    @property
    def parts(self) -> tuple[Certificate, ...]:
        """The certificate of the problem written out."""
        return (self.base,)

    @property
    def lower_bound(self) -> float:
        """Certified lower bound at the problem's start."""
        return self.base.lower_bound

    @property
    def gap(self) -> float | None:
        """If not None, ``lower_bound + gap`` is an upper bound on the satisfaction probability of this controller."""
        return self.base.gap

    @property
    def bound(self) -> str:
        """Name of the bound of the base."""
        bound: str = self.base.proof.bound
        return bound

    @property
    def has_cells(self) -> bool:
        """Whether the base is about cells."""
        return bool(self.base.proof.has_cells)

    @property
    def rank(self) -> int:
        """Largest number of terms of the value function."""
        rank: int = self.base.proof.rank
        return rank

    def agents_of(self, problem: Problem) -> Any:
        """Return what is stored of each agent of the base."""
        return self.base.proof.agents_of(self.base.problem)

    def on_cells(self, certificate: Certificate) -> Any:
        """Return the base, if that is on cells."""
        return self.base.proof.on_cells(self.base)

    def along(self, certificate: Certificate) -> Any:
        """Return the base, if that is along a path."""
        return self.base.proof.along(self.base)

    def claim(self, certificate: Certificate) -> Any:
        """Return the claim of the base."""
        return self.base.claim

    def with_claims(self, certificate: Certificate, change: Callable[[Any], Any]) -> Certificate:
        """Return the same claim, with what a function makes of its base."""
        base = self.base.proof.with_claims(self.base, change)
        return replace(certificate, proof=replace(self, base=base))

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        return {"base": pool.put_file(self.base)}

    @property
    def method(self) -> str:
        """How the bound was found, in words."""
        return f"written out in time: {self.base.proof.method}"

    def states_in_time(self, problem: Problem) -> NDArray[np.int64]:
        """Return automaton states (T + 1, Q) of the problem written out that go with those of the problem; -1: none."""
        return states_in_time(problem, self.base.problem)

    def named(self, problem: Problem) -> TimedProof:
        """Return the proof for a problem that differs from its own in names alone."""
        return TimedProof(replace(self.base, problem=unrolled_in_time(problem)))

    def seen(self, problem: Problem) -> RunProjection:
        """Return runs of the problem, as those of the problem written out."""
        clocks = tuple(bool(agent.has_clock) for agent in self.base.problem.agents)
        return ProjectionInTime(problem, self.states_in_time(problem), clocks)

    def controller(self, problem: Problem) -> TimedController:
        """Return the controllers the bound belongs to."""
        return TimedController(problem, self.base.controller, self.states_in_time(problem))

    @classmethod
    def read(cls, problem: Problem, stored: Stored) -> Self:
        """Return the proof in a file; raise ValueError if there is none."""
        base, other = stored.certificate(stored.entry["base"]), unrolled_in_time(problem)
        if other.fingerprint != base.fingerprint:
            raise ValueError("its base is not its problem written out")
        return cls(replace(base, problem=other))


def timed_certificate(problem: Problem, base: OnGrid) -> Certificate[TimedProof]:
    """Return the certificate of a problem that names the time, given that of the problem written out.

    Raises
    ------
    ValueError
        If the problem cannot be written out.
    """
    return Certificate(problem, TimedProof(base).named(problem), base.settings)
