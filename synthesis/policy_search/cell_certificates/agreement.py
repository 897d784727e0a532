"""What the check says of results, and claims along paths that it agrees with.

Every verb that makes a certificate asks the check before it returns (``judged``). Search, check and the small checker
enclose the same expressions by code of their own, and none is always the narrowest one. A claim that one of them would
refuse by a little is of no use to anybody: of paths the largest probability of failing is claimed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from ....envs.tasks.problem import Problem, out_of_reach
from ...certificates.proofs import AlongPath, NotCanonicalError, Synthesis, changed, path_under, verdict_of
from ...extended_check.claims import checked_once
from ...relations.grids import NoRunFound, RelationRefused
from ...trajectories.planning import CountedWork, path_certificate

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def judged(verb: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Return a verb whose results, one Synthesis or several, carry what the check says of their certificates."""

    @wraps(verb)
    def asked(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        found: Any = verb(*arguments, **named)
        tell = named.get("progress")
        told = tell if callable(tell) else lambda words, bound: None
        return [_judged(one, told) for one in found] if isinstance(found, list) else _judged(found, told)  # type: ignore[return-value]

    return asked


def _judged(found: Synthesis, tell: Callable[[str, float], None]) -> Synthesis:
    """Return a synthesis with what the check says of its certificate; Ctrl-C leaves it unchecked, and says so."""
    began = time.perf_counter()
    try:
        tell("way: separate code computes it again", found.certificate.lower_bound)
        checked = checked_once(found.certificate)
    except KeyboardInterrupt:
        return found
    seconds: Any = found.stats.get("seconds", {})
    return replace(
        found, checked=checked, stats={**found.stats, "seconds": {**seconds, "check": time.perf_counter() - began}}
    )


def along_path(problem: Problem, work: CountedWork) -> Synthesis:
    """Return a synthesis along a path that claims no more than search and check both prove.

    Raises
    ------
    RelationRefused
        If there is none; NoRunFound if no run without noise satisfies the task, as is known without a search.
    """
    if not work.is_hopeless and (lost := out_of_reach(problem, rare=0.0)) is not None:
        raise NoRunFound(f"no nominal path satisfies the task: {lost.why}")
    return agreed(path_certificate(problem, work))


def agreed(found: Synthesis) -> Synthesis:
    """Return a synthesis whose certificate, if it is along a path, claims no more than the check proves."""
    certificate = found.certificate
    if path_under(certificate) is not certificate or (modest := agreed_path(certificate)) is certificate:
        return found
    return replace(found, certificate=modest, controller=modest.controller)


def agreed_path(certificate: AlongPath) -> AlongPath:
    """Return a certificate along a path that claims what the checker proves; nothing if it cannot be written for it."""
    try:
        proved = verdict_of(certificate).recomputed
    except NotCanonicalError as reason:
        raise RelationRefused(f"nothing can be proved along a trajectory: {reason}") from reason
    return changed(certificate, failure=min(1.0, proved * (1.0 + 1e-9)))
