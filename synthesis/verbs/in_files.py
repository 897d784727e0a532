"""What is kept in files, whatever it is: ``save`` it, ``load`` it, and ``check`` what it claims."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...envs.suite import as_problem
from ...envs.systems.arguments import names_arguments
from ...envs.tasks.problem import load_problem
from ..certificates.beliefs import alarm_in, is_canonical
from ..certificates.proofs import (
    MAX_BYTES,
    Certificate,
    CheckReport,
    Synthesis,
    load_certificate,
    require_about,
    save_certificate,
)
from ..checker import bound_of, check_contents, read_file
from ..extended_check.claims import check as check_certificate
from ..interop import is_written_policy, save_policy


@names_arguments()
def save(kept: Any, path: str | Path, *, agent: str | None = None) -> Path:
    """Write what has a file to ``path``, completely or not at all; return it.

    Parameters
    ----------
    kept : Certificate or Synthesis; or a policy, if the path ends in ``.onnx`` or ``.h``
        Certificates become ``.npz`` files, which ``load`` and ``check`` read. A policy becomes a file
        that runs elsewhere: ``.onnx`` for networks, as a graph from rows (N, n) to actions (N, m), float32 (the extra
        ``onnx``), which ``as_policy`` reads; ``.h`` for the tables of certified controllers of the relations ``exact``
        and ``linear`` as C, with the same inputs to the last bit.
    path : str or Path
    agent : str, optional
        Whose policy, if the path is that of one: needed for ONNX where agents have networks of their own.

    Raises
    ------
    ValueError
        If it has no file, or not one of that form.
    """
    if is_written_policy(path):
        save_policy(kept, path, agent)
    elif agent is not None:
        raise ValueError(f"`agent`: expected none for `{path}`, which holds no policy; leave it out")
    elif isinstance(kept, Certificate | Synthesis):
        save_certificate(kept, path)
    else:
        raise ValueError(
            f"`kept`: expected a certificate for `{path}`, got {type(kept).__name__}; make one with "
            "`synthesize` or `certify`; policies are saved as .onnx or .h"
        )
    return Path(path)


@names_arguments()
def load(path: str | Path, max_bytes: int = MAX_BYTES) -> Any:
    """Return what a file holds: a Problem (``.toml``) or a Certificate (``.npz``).

    What is read is well-formed, and nothing it claims is trusted: its numbers are what the file says until ``check``
    has verified them.

    Parameters
    ----------
    path : str or Path
    max_bytes : int
        Largest size, packed or unpacked, that is read (default: 1 GiB).

    Raises
    ------
    ValueError
        If the file holds none of these, or one that is damaged or inconsistent.
    OSError
        If it cannot be read.
    """
    if Path(path).suffix == ".toml":
        return load_problem(path)
    return load_certificate(path, max_bytes)


@names_arguments()
def check(claim: Any, problem: Any = None) -> CheckReport:
    """Verify what a certificate claims, by separate code that no search reaches.

    Parameters
    ----------
    claim : Synthesis, Certificate, or path of one
        Of files in the canonical form the small checker gives the verdict (docs/reference/certificate_format.md).
    problem : Problem, id or path, optional
        What is claimed must have been made for exactly this problem (fingerprint); by default the one inside it.

    Returns
    -------
    CheckReport
        Truthy if the lower bounds were verified: at the start and, factor by factor, elsewhere; and the upper end of
        the claim (``gap``) where it has one, unless ``above`` is None.

    Raises
    ------
    ValueError
        If it is none of these.
    """
    if isinstance(claim, str | Path) and Path(claim).is_file() and is_canonical(claim):
        contents = read_file(claim)
        require_about(contents, None if problem is None else as_problem(problem))
        verdict = check_contents(contents)
        numbers = bound_of(verdict.claimed), bound_of(verdict.recomputed)
        failures = () if verdict.proved else (verdict.reason,)
        return CheckReport(verdict.proved, *numbers, failures, alarm=alarm_in(contents, verdict))
    return check_certificate(claim, problem)
