"""What certificates of all kinds have in common: whose claim it is, its two ends, and what else it offers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Self

from ...envs.problem import Problem
from .offers import Offer
from .seen import Seen


class TwoEnded:
    """A claim about the probability with which controllers satisfy the task of a problem.

    Attributes
    ----------
    problem : Problem
    lower_bound : float
        Certified lower bound.
    gap : float or None
        If not None, ``lower_bound + gap`` is an upper bound for these very controllers.
    """

    problem: Problem
    lower_bound: Any
    gap: Any

    lacks: ClassVar[Mapping[Offer, str]] = MappingProxyType({})
    """What it does not offer, and what is said to whoever asks for it."""

    @property
    def members(self) -> tuple[Any, ...]:
        """The claims that it is the product of: itself, but for independent tasks."""
        return (self,)

    @property
    def on_cells(self) -> Any:
        """The certificate on cells whose values are those of this one, if there is one (None: no)."""
        return None

    @property
    def seen(self) -> Seen:
        """How runs of its problem are seen by that certificate."""
        return Seen(self.problem)

    @property
    def upper_bound(self) -> float:
        """Upper bound on the satisfaction probability of these very controllers; 1 where nothing is known."""
        return 1.0 if self.gap is None else min(1.0, math.nextafter(self.lower_bound + self.gap, 2.0))

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the problem."""
        return self.problem.fingerprint

    def with_claims(self, change: Callable[[Any], Any]) -> Self:
        """Return the same claim, with what a function makes of the certificates on cells that it is put together of."""
        return self
