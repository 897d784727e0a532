"""Certificates on disk, whatever their proof.

Reading trusts nothing: the version, the shapes and the ranges of all indices are checked before an array is used, and
files that would unpack to more than ``MAX_BYTES`` are refused before they are unpacked (``archive``).
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

from ....envs.systems.arguments import write_bytes
from ....envs.tasks.problem import problem_from_dict
from .archive import ALLOW, MAX_BYTES, VERSION, Stored, packed, unarchived
from .certificate import Certificate
from .grid_proof import GridProof
from .path_proof import PathProof
from .product_proof import ProductProof
from .proof import Proof
from .result import Synthesis
from .starts_proof import StartsProof
from .timed_proof import TimedProof
from .union_bound_proof import UnionBoundProof
from .vertex_proof import VertexProof, VertexTeamProof

PROOFS: dict[str, type[Proof]] = {
    proof.kind: proof
    for proof in (
        GridProof, PathProof, StartsProof, UnionBoundProof, TimedProof, ProductProof, VertexProof, VertexTeamProof
    )
}  # fmt: skip
"""Kinds of proofs, by their names in files."""

UNREADABLE = (
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    AttributeError,
    OverflowError,
    RecursionError,
    EOFError,
    NotImplementedError,
    zipfile.BadZipFile,
    zlib.error,
)
"""What unpacking, parsing and checking may raise when a file was damaged or made up."""


def save_certificate(certificate: Synthesis | Certificate, path: str | Path) -> None:
    """Write a certificate, or that of a synthesis, to ``path`` (``.npz``); raise ValueError for anything else."""
    certificate = certificate.certificate if isinstance(certificate, Synthesis) else certificate
    if not isinstance(certificate, Certificate):
        raise ValueError(
            f"`certificate`: expected a Certificate, got {type(certificate).__name__}; make one with `synthesize`, "
            "`certify` or `load`"
        )
    write_bytes(path, packed(certificate))


def load_certificate(path: str | Path, max_bytes: int = MAX_BYTES) -> Certificate:
    """Return the certificate in a file; it is well-formed then, but not yet checked (see ``check``).

    Until then its numbers (``lower_bound``, ``upper_bound``, ``at``, ``mean``, ``min``) are what the file says.

    Parameters
    ----------
    path : str or Path
    max_bytes : int
        Largest size, packed or unpacked, that is read (default: 1 GiB).

    Raises
    ------
    ValueError
        If the file holds no certificate, or one of another version, damaged, or inconsistent.
    OSError
        If it cannot be read.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(
            f"`{path}`: expected a certificate file, found none; write one with `save`, or `certigym run ID --out FILE`"
        )
    try:
        if (size := Path(path).stat().st_size) > max_bytes:
            raise ValueError(f"it has {size} bytes, more than {max_bytes}; {ALLOW.format(size=size)}")
        return _read(Path(path).read_bytes(), _Budget(max_bytes), frozenset(PROOFS))
    except UNREADABLE as error:
        message = str(error) or type(error).__name__
        raise ValueError(
            f"`{path}`: expected a certigym certificate, version {VERSION}, got a file that is none: {message}"
        ) from error


@dataclass
class _Budget:
    """Bytes that a file, and all files in it together, may unpack to."""

    left: int


def _read(raw: bytes, budget: _Budget, allowed: frozenset[str]) -> Certificate:
    """Return the certificate in the bytes of a file, whose proof is of one of the kinds that are allowed there."""
    header, arrays = unarchived(raw, budget.left)
    budget.left -= sum(array.nbytes for array in arrays.values())
    entry, settings = header["proof"], header["settings"]
    kind = PROOFS[entry["kind"]]
    if kind.kind not in allowed:
        raise ValueError("a part of it has parts again" if kind.inside else f"it is of the kind {kind.kind!r}")
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    proof = kind.read(problem, Stored(entry, arrays, lambda inner: _read(inner, budget, kind.inside)))
    if not isinstance(settings, dict):
        raise ValueError("its settings are none")
    return Certificate(problem, proof, settings)
