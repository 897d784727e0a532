"""What certificates of all kinds have in common: whose claim it is, its two ends, and what else it offers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import Enum
from types import MappingProxyType
from typing import Any, ClassVar, Self

from ...envs.problem import Problem
from .seen import Seen


class Offer(Enum):
    """What may be asked of a certificate; the text says what was expected where it lacks that."""

    VALUES = "one with values of all states"
    """Values at every state, automaton state and time: shields, audits, fields, figures, menus."""
    OWN_STATES = "one whose agents each look at their own state"
    """Cells of every agent by itself: figures of an agent."""
    SAME_STEPS = "one of a problem that is the same at every step"
    """Steps beyond the horizon that are like those before: rates at which safety is lost."""


class TwoEnded:
    """A claim about the probability with which controllers satisfy the task of a problem.

    Attributes
    ----------
    problem : Problem
    lower_bound : float
        Certified lower bound.
    gap : float or None
        If not None, ``lower_bound + gap`` is an upper bound for these very controllers.
    settings : dict
        How it was found.
    """

    problem: Problem
    lower_bound: Any
    gap: Any
    settings: Any

    lacks: ClassVar[Mapping[Offer, str]] = MappingProxyType({})
    """What it does not offer, and what is said to whoever asks for it."""

    @property
    def members(self) -> tuple[Any, ...]:
        """The claims that it is the product of: itself, but for independent tasks."""
        return (self,)

    @property
    def member_agents(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the agents that each of them is about."""
        return (tuple(range(self.problem.n_agents)),)

    @property
    def alike(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the members, those that differ in nothing but names together."""
        return ((0,),)

    @property
    def relations_tried(self) -> dict[str, float | str]:
        """Bound of each relation that was tried, or why there is none."""
        return dict(self.settings.get("relations_tried", {}))

    @property
    def why_nothing(self) -> str:
        """Why nothing was certified, as the search said; "" where something was, or that is not known."""
        return "" if self.lower_bound > 0.0 else str(self.settings.get("nothing", ""))

    @property
    def about_pairs(self) -> dict[str, str]:
        """What reports say of pairs of agents."""
        return {}

    @property
    def along(self) -> Any:
        """The certificate along a path that it is or rests on, if there is one (None: no)."""
        return None

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


def require(certificate: Any, *offers: Offer) -> None:
    """Raise ValueError, with what can be done instead, unless a certificate and its members offer all of this."""
    for offer in offers:
        for member in certificate.members:
            if offer in member.lacks:
                raise ValueError(f"`certificate`: expected {offer.value}, got {member.lacks[offer]}")
