"""How good policies are to be searched for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf

from ....envs.systems.arguments import checked_count
from .limits import Limits

GOOD_SHARE = 0.99
"""Share of the upper bound from which a start is good enough and no further ones are tried, unless the caller decides.

At .9 an agent may still take a way that costs the team a few per cent; one sweep from each staged start shows it.
"""

VALUE_FORMS = ("auto", "tree", "train")
"""Forms in which the value function may be held."""

Progress = Callable[[str, float], None]
"""Called with the name of a start and the best value so far."""


@dataclass(frozen=True)
class Search:
    """How good policies are searched for.

    Parameters
    ----------
    max_sweeps : int
        Most sweeps from one start.
    limits : Limits
        Pruning of trees during the search.
    value : str
        ``"tree"``, ``"train"``, or ``"auto"`` (see the module's text).
    restarts : int
        Further starts from the best policies, perturbed: from a random step on, the plan of every agent is advanced or
        delayed by up to ``LONGEST_SHIFT`` steps, that of each agent by another number.
    progress : callable, optional
        Called with the name of a start and the best value so far.
    stationary : bool
        Whether policies do not look at the time.
    good_share : float
        Share of the upper bound from which a start is good enough and no further ones are tried.
    spend : callable, optional
        Told the work of sweeps over trees before it is done (see ``JointModel``).
    enough : float
        Value from which nothing is improved.

    Raises
    ------
    ValueError
        If a value is not one of these.
    """

    max_sweeps: int = 8
    limits: Limits = field(default_factory=Limits)
    value: str = "auto"
    restarts: int = 0
    progress: Progress | None = None
    stationary: bool = False
    good_share: float = GOOD_SHARE
    spend: Callable[[float], None] | None = None
    enough: float = inf

    def __post_init__(self) -> None:
        for name in ("max_sweeps", "restarts"):
            object.__setattr__(self, name, checked_count(getattr(self, name), name, least=0))
        if self.value not in VALUE_FORMS:
            raise ValueError(f"`value`: expected one of {', '.join(VALUE_FORMS)}, got {self.value!r}")

    def used(self) -> dict[str, object]:
        """Return what a certificate records of the search, as plain values."""
        recorded = {name: getattr(self, name) for name in ("max_sweeps", "restarts", "stationary")}
        return {**recorded, "limits": vars(self.limits)}

    def tell(self, start: str, value: float) -> None:
        """Report progress."""
        if self.progress is not None:
            self.progress(start, value)
