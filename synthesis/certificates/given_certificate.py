"""The certificate that a synthesis, a certificate of either kind, or the path of a file stands for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .certificate import Certificate
from .certificate_file import AnyCertificate, load_certificate
from .product import ProductCertificate
from .result import Synthesis
from .start_hull import StartHull
from .team_certificate import TeamCertificate
from .two_ended import Offer, require


def as_certificate(value: Any) -> Any:
    """Return the certificate on grids that a value stands for.

    Parameters
    ----------
    value : Synthesis, Certificate, ProductCertificate, str or Path
        Text is the path of a certificate file.

    Raises
    ------
    ValueError
        If `value` is none of these, if the file holds no certificate, or if it is one along a path, by subtraction, or
        of a joint agent. That of a problem that names the time stands for the one of the problem written out.
    """
    certificate = certificate_on_grids(value)
    require(certificate, Offer.OWN_STATES)
    return certificate if certificate.on_cells is None else certificate.on_cells


def certificate_on_grids(value: Any) -> Certificate | ProductCertificate | TeamCertificate:
    """Return the certificate on grids that a value stands for, that of a joint agent included.

    Raises
    ------
    ValueError
        As for ``as_certificate``, but for joint agents on a grid.
    """
    certificate = any_certificate(value)
    require(certificate, Offer.VALUES)
    return certificate


def speaks_of_one_start(certificate: Any) -> bool:
    """Whether a report shows the start alone: of certificates by subtraction, of joint agents, and along paths."""
    return any(member.on_cells is not member for member in certificate.members)


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
    if certificate.on_cells is not None:
        return certificate.on_cells, agent
    for group, member in zip(certificate.problem.groups, certificate.members, strict=True):
        if agent in group.agents:
            return member.on_cells, group.agents.index(agent)
    raise AssertionError("every agent takes part in one task")
