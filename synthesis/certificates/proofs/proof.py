"""What proofs of all kinds have in common, and what may be asked of them.

A proof says how the lower bound of a certificate comes about. It knows nothing of the problem that it is about: that is
the certificate's, and is handed to it where it is needed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import Enum
from types import MappingProxyType
from typing import Any, ClassVar, Self

from ....envs.tasks.problem import Problem
from .archive import Pool, Stored
from .digits import shown_bound, significant_up
from .projection import RunProjection


class Capability(Enum):
    """What may be asked of a certificate; the text says what was expected where it lacks that."""

    VALUES = "one with values of all states"
    """Values at every state, automaton state and time: shields, audits, fields, figures."""
    OTHER_STARTS = "one on grids"
    """Bounds from other starts than the problem's."""
    SAME_STEPS = "one of a problem that is the same at every step"
    """Steps beyond the horizon that are like those before: rates at which safety is lost."""


class Proof:
    """How a lower bound is proved; every kind of proof is a frozen record of what its check needs.

    Attributes
    ----------
    lower_bound : float
        Certified lower bound on the satisfaction probability.
    gap : float or None
        If not None, ``lower_bound + gap`` is an upper bound for these very controllers.
    bound : str
        Name of the theorem.
    method : str
        How controllers and bound were found, in words.
    rank : int
        Largest number of terms of one automaton state, or of columns of a bond; 1 without values.
    parts : tuple of Certificate
        The certificates that it is put together of.
    """

    kind: ClassVar[str]
    """Its name in files."""
    inside: ClassVar[frozenset[str]] = frozenset()
    """Kinds of proofs that its parts may have."""
    unsupported: Mapping[Capability, str] = MappingProxyType({})
    """What it does not offer, and what is said to whoever asks for it."""
    about: Mapping[str, str] = MappingProxyType({})
    """What reports say of it besides."""
    has_cells: Any = False
    """Whether it is about cells."""

    lower_bound: Any
    gap: Any
    bound: Any
    method: Any
    rank: Any
    parts: Any
    factors: Any = ()
    """Its parts, if they are of independent tasks, whose bounds are multiplied."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}: {shown_bound(self.lower_bound, None)}, {self.method}"

    def gap_of(self, problem: Problem) -> float | None:
        """Return the gap, where the certificate is about this problem."""
        gap: float | None = self.gap
        return gap

    def named(self, problem: Problem) -> Proof:
        """Return the proof for a problem that differs from its own in names alone."""
        return self

    def controller(self, problem: Problem) -> Any:
        """Return the controllers that the bound belongs to."""
        raise NotImplementedError

    def claim(self, certificate: Any) -> Any:
        """Return what is claimed of other starts: something with ``at``, ``mean`` and ``min``."""
        raise NotImplementedError

    def agents_of(self, problem: Problem) -> Any:
        """Return what is stored of each agent, in order, if it ``has_cells``."""
        raise NotImplementedError

    def on_cells(self, certificate: Any) -> Any:
        """Return the certificate on cells whose values are those of this one; None if there is none."""
        return None

    def along(self, certificate: Any) -> Any:
        """Return the certificate along a path that this one is or rests on; None if there is none."""
        return None

    def seen(self, problem: Problem) -> RunProjection:
        """Return how runs of the problem are seen by the certificate on cells."""
        return RunProjection(problem)

    def with_claims(self, certificate: Any, change: Callable[[Any], Any]) -> Any:
        """Return the same claim, with what a function makes of the certificates on cells that it is put together of."""
        return certificate

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file, its arrays and parts put into the pool."""
        raise NotImplementedError

    @classmethod
    def read(cls, problem: Problem, stored: Stored) -> Self:
        """Return the proof in a file, about a problem; raise ValueError if there is none.

        What the entries say is not trusted: shapes, ranges of indices and numbers are checked before they are used.
        """
        raise NotImplementedError


class FailureProof(Proof):
    """A proof that states an upper bound on the probability of failing, and has no values."""

    failure: Any
    """Upper bound on the probability that the task is not satisfied."""
    gap = None
    rank = 1
    parts = ()

    @property
    def about(self) -> dict[str, str]:  # type: ignore[override]
        """What summaries say of it besides: how it may fail."""
        return {"failure": f"at most {significant_up(self.failure, 3)}"}

    @property
    def lower_bound(self) -> float:
        """Certified lower bound on the probability that the task is satisfied, rounded down."""
        return max(0.0, math.nextafter(1.0 - self.failure, 0.0))
