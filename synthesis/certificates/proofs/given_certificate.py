"""The certificate that a synthesis, a certificate, or the path of a file stands for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .certificate import Certificate, member_agents, members_of, on_cells, require
from .certificate_file import load_certificate
from .grid_proof import OnGrid
from .proof import Capability
from .result import Synthesis


def certificate_from(value: Any, argument: str = "certificate") -> Certificate:
    """Return the certificate that a value, given as ``argument``, stands for, one of a set of starts included.

    Parameters
    ----------
    value : Synthesis, Certificate, str or Path
        Text is the path of a certificate file.

    Raises
    ------
    ValueError
        If `value` is none of these, or if the file holds no certificate.
    """
    if isinstance(value, Synthesis):
        return value.certificate
    if isinstance(value, str | Path):
        value = load_certificate(value)
    if not isinstance(value, Certificate):
        raise ValueError(
            f"`{argument}`: expected a Synthesis, a certificate or the path of one, got {type(value).__name__}; make "
            "one with `synthesize`, `certify` or `load`"
        )
    return value


def certificate_on_grids(value: Any) -> Certificate:
    """Return the certificate with values of all states that a value stands for.

    Raises
    ------
    ValueError
        If `value` stands for no certificate, or for one along a path or by subtraction.
    """
    certificate = certificate_from(value)
    require(certificate, Capability.VALUES)
    return certificate


def as_certificate(value: Any) -> Certificate:
    """Return the certificate on grids that a value stands for.

    Raises
    ------
    ValueError
        As for ``certificate_on_grids``. That of a problem that names the time stands for the one of the problem written
        out.
    """
    certificate = certificate_on_grids(value)
    return on_cells(certificate) or certificate


def of_first_task(value: Any) -> OnGrid:
    """Return the certificate of the task that the first agent takes part in.

    Raises
    ------
    ValueError
        If `value` stands for no certificate.
    """
    certificate = as_certificate(value)
    [member] = [
        member
        for agents, member in zip(member_agents(certificate), members_of(certificate), strict=True)
        if 0 in agents
    ]
    return on_cells(member)


def checked_certificate(value: Any, argument: str = "certificate") -> OnGrid:
    """Return the certificate of one task on cells that a value, given as ``argument``, stands for; else ValueError."""
    certificate = certificate_from(value, argument)
    if parts := certificate.proof.factors:
        raise ValueError(f"`{argument}`: expected that of one task, got {len(parts)}; give one of its `.proof.parts`")
    held: OnGrid | None = on_cells(certificate)
    if held is None:
        lack = certificate.proof.unsupported[Capability.VALUES]
        raise ValueError(f"`{argument}`: expected {Capability.VALUES.value}, got {lack}")
    return held


def speaks_of_one_start(certificate: Certificate) -> bool:
    """Return whether a report shows the start alone: by subtraction, and along paths."""
    return any(on_cells(member) is not member for member in members_of(certificate))
