"""What a synthesis returns."""

from __future__ import annotations

from dataclasses import dataclass

from ..controllers import Controller
from .certificate import Certificate


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A certificate, the controllers it belongs to, and how they were found.

    Parameters
    ----------
    certificate : Certificate or ProductCertificate
    controller : Controller
    stats : dict
        ``seconds`` (abstract, synthesize), ``sweeps`` (value after each), ``starts`` (the best value from each),
        ``rank``, ``dropped``, ``abstract_upper_bound`` (no policy of any kind does better on this abstraction; see
        ``optimum``), ``continuous_upper_bound`` (no policy of the continuous system does better; None where there is
        no bound), ``unilateral_gain`` (about what one agent alone could gain by other choices at one time and automaton
        state: mass that was left out does not count; None for stationary policies), and, where relations were compared,
        what was ``tried``: the lower bound of each, or why there is none.
    """

    certificate: Certificate
    controller: Controller
    stats: dict[str, object]
