"""The certificate that a synthesis, a certificate of either kind, or the path of a file stands for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .certificate import Certificate
from .certificate_file import AnyCertificate, load_certificate
from .mixed_certificate import MixedCertificate
from .pairs_certificate import PairsCertificate
from .path_certificate import PathCertificate
from .product import ProductCertificate
from .result import Synthesis
from .start_hull import StartHull
from .team_certificate import TeamCertificate
from .timed_certificate import TimedCertificate


def as_certificate(value: Any) -> Certificate | ProductCertificate:
    """Return the certificate on grids that a value stands for.

    Parameters
    ----------
    value : Synthesis, Certificate, ProductCertificate, str or Path
        Text is the path of a certificate file.

    Raises
    ------
    ValueError
        If `value` is none of these, if the file holds no certificate, or if it is one along a path, by subtraction, or
        of a joint agent.
    """
    certificate = certificate_on_grids(value)
    if isinstance(certificate, TeamCertificate):
        raise ValueError(
            "`certificate`: expected one whose agents each look at their own state, got that of a joint agent, whose "
            "cells are those of all states together; give its `.base`, which is about the joint agent"
        )
    return certificate


def certificate_on_grids(value: Any) -> Certificate | ProductCertificate | TeamCertificate:
    """Return the certificate on grids that a value stands for, that of a joint agent included.

    Raises
    ------
    ValueError
        As for ``as_certificate``, but for joint agents on a grid.
    """
    certificate = any_certificate(value)
    parts = certificate.parts if isinstance(certificate, ProductCertificate) else (certificate,)
    if any(isinstance(part, PairsCertificate | MixedCertificate) for part in parts):
        raise ValueError(
            "`certificate`: expected one with values of all states, got one by subtraction: what pairs of agents may "
            "spoil is bounded for the whole run from the start of its problem, and for no other state or time; it can "
            "be checked, validated, stressed, simulated, compared and reported"
        )
    if any(isinstance(part, TimedCertificate) for part in parts):
        raise ValueError(
            "`certificate`: expected one of a problem that is the same at every step, got one of a problem that names "
            "the time `t`, whose values are those of the problem written out; it can be checked, validated, stressed, "
            "simulated, compared and reported, and its `.base` is about the problem written out"
        )
    bases = [part.base if isinstance(part, TeamCertificate) else part for part in parts]
    if any(isinstance(part, PathCertificate) for part in bases):
        raise ValueError(
            "`certificate`: expected one on grids, got one along a path, which says nothing of other states and times; "
            "it can be checked, validated, stressed, simulated, compared and reported, and `certified_starts` "
            "certifies a set of starts around its own"
        )
    return certificate


def speaks_of_one_start(certificate: Any) -> bool:
    """Whether a report shows the start alone: of certificates by subtraction, of joint agents, and along paths."""
    parts = certificate.parts if isinstance(certificate, ProductCertificate) else (certificate,)
    return any(
        isinstance(part, PathCertificate | PairsCertificate | MixedCertificate | TeamCertificate | TimedCertificate)
        for part in parts
    )


def any_certificate(value: Any) -> Any:
    """Return the certificate of any kind that a value stands for, on grids or not."""
    if isinstance(value, Synthesis):
        return value.certificate
    if isinstance(value, str | Path):
        value = load_certificate(value)
    if isinstance(value, StartHull):
        raise ValueError(
            "`certificate`: expected one of one start, got a set of starts; it can be checked, and `hull.at(start)` is "
            "the certificate of a start in it (on the command line: `certigym validate HULL --initial-state X`)"
        )
    if not isinstance(value, AnyCertificate):
        raise ValueError(
            f"`certificate`: expected a Synthesis, a certificate or the path of one, got {type(value).__name__}; make "
            "one with `synthesize`, `certify` or `load_certificate`"
        )
    return value


def of_one_task(value: Any, agent: int = 0) -> tuple[Certificate, int]:
    """Return the certificate of the task that an agent takes part in, and the agent's number there.

    Parameters
    ----------
    value : Synthesis, Certificate, ProductCertificate, str or Path
    agent : int
        Number of the agent in the whole problem.

    Raises
    ------
    ValueError
        If `value` stands for no certificate, or if there is no such agent.
    """
    certificate = as_certificate(value)
    if not 0 <= agent < certificate.problem.n_agents:
        raise ValueError(f"`agent`: expected a number from 0 to {certificate.problem.n_agents - 1}, got {agent}")
    if isinstance(certificate, Certificate):
        return certificate, agent
    for group, part in zip(certificate.problem.groups, certificate.parts, strict=True):
        if agent in group.agents:
            return part, group.agents.index(agent)
    raise AssertionError("every agent takes part in one task")
