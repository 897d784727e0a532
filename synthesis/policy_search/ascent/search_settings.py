"""How good policies are to be searched for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import floor

from tqdm import tqdm

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


BEGINS = "way: "
"""What begins texts of progress that name a way or a level; others name a start of a search."""

BAR = "[{elapsed}] {desc}{postfix}"
"""What a bar shows: how long all took, the bound so far, the way that is tried, and the value of this search.

A narrow terminal cuts off the end: what counts stands first."""


def sweep_bar() -> Progress:
    """Return a progress bar of sweeps, for terminals and notebooks; it closes when nobody holds it any more."""
    return shown_on(tqdm(bar_format=BAR, leave=False))


def shown_on(bar: tqdm) -> Progress:
    """Return what shows on a bar which way is tried, and the largest bound so far."""
    bound = 0.0

    def report(text: str, value: float) -> None:
        nonlocal bound
        if text.startswith(BEGINS):
            bound = max(bound, value)
            so_far = f"P >= {floor(1e6 * bound) / 1e6:.6f} so far" if bound > 0.0 else "nothing certified yet"
            bar.set_description_str(f"{so_far}; {text.removeprefix(BEGINS)}", refresh=False)
            bar.set_postfix_str("")
        else:
            # What is hardly above 0 may be found below it, by rounding.
            bar.set_postfix_str(f"this search: {max(value, 0.0):.6f}", refresh=False)
            bar.update()

    return report


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
