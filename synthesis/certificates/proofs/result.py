"""What a synthesis returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ....envs.systems.arguments import tree_text
from ..controllers import Controller
from .certificate import Certificate
from .check_report import CheckReport, told_claim
from .digits import rounded_up, shown_bound
from .summaries import certificate_facts, certificate_html

BOUNDS_FROM_ABOVE = {
    "abstract_upper_bound": "no policy of these finite models does better than",
    "continuous_upper_bound": "no policy of the continuous system does better than",
}
"""Bounds from above in the statistics, and what they bound, in words."""


BROKEN_OFF = "broken off by Ctrl-C"
"""What is said of what the user had no time for."""


@dataclass(frozen=True, eq=False, repr=False)
class Synthesis:
    """A certificate, the controllers it belongs to, and how they were found.

    Parameters
    ----------
    certificate : Certificate
    controller : Controller
    stats : dict
        ``seconds`` (abstract, synthesize), ``sweeps`` (value after each), ``starts`` (the best value from each),
        ``rank``, ``dropped``, ``abstract_upper_bound`` (no policy of any kind does better on this abstraction; see
        ``optimum``), ``continuous_upper_bound`` (no policy of the continuous system does better; None if there is no
        bound), ``unilateral_gain`` (an estimate of what one agent alone could gain by other choices at one time and
        automaton state: mass that was left out does not count; None for stationary policies), and, if relations were
        compared, what was ``tried``: the lower bound of each, or why there is none.
    checked : CheckReport or None
        What ``check`` says of the certificate; None if it was not asked, or stopped.
    """

    certificate: Certificate
    controller: Controller
    stats: dict[str, object]
    checked: CheckReport | None = None

    @property
    def lower_bound(self) -> float:
        """Certified lower bound on the satisfaction probability at the problem's start: that of the certificate."""
        return self.certificate.lower_bound

    @property
    def policy(self) -> Controller:
        """The controllers that the certificate is about."""
        return self.controller

    @property
    def is_broken_off(self) -> bool:
        """Whether Ctrl-C ended the search or the check: then this is what there was by then."""
        tried: Any = self.stats.get("tried") or {}
        return self.checked is None or any(BROKEN_OFF in str(told) for told in tried.values())

    @property
    def claim(self) -> str:
        """The bound in words, called a claim where the check refuses it, or was not asked."""
        return told_claim(shown_bound(self.certificate.lower_bound, self.certificate.gap), self.checked)

    def __repr__(self) -> str:
        facts = [*certificate_facts(self.certificate, self.claim), ("seconds", _seconds_text(self.stats))]
        return tree_text(f"Synthesis of {self.certificate.problem.name!r}", facts)

    def _repr_html_(self) -> str:
        more = []
        for name, words in BOUNDS_FROM_ABOVE.items():
            value: Any = self.stats.get(name)
            if value is not None:
                more.append((words, rounded_up(value)))
        more.append(("seconds", _seconds_text(self.stats)))
        return certificate_html(f"Synthesis of {self.certificate.problem.name}", self.certificate, more, self.claim)


def _seconds_text(stats: dict[str, Any]) -> str:
    """Return the seconds of a synthesis, all together."""
    seconds = stats.get("seconds", {})
    return f"{sum(seconds.values()):.3g}" if seconds else "not measured"
