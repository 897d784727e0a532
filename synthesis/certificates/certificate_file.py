"""Certificates on disk, of all kinds.

Reading trusts nothing: the version, the shapes and the ranges of all indices are checked before an array is used, and
files that would unpack to more than ``MAX_BYTES`` are refused before they are unpacked (``archive``).
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import write_bytes
from ...envs.problem import problem_from_dict
from .archive import MAX_BYTES, VERSION, packed, unarchived
from .certificate import Certificate, checked_certificate
from .certificate_reader import CertificateReader
from .mixed_certificate import MixedCertificate, mixed_in
from .pairs_certificate import PairsCertificate, pairs_in
from .path_certificate import PathCertificate, path_in
from .product import ProductCertificate, product_certificate
from .result import Synthesis
from .start_hull import StartHull, hull_in
from .team_certificate import TeamCertificate, team_in
from .timed_certificate import TimedCertificate, timed_in

AnyCertificate = (
    Certificate
    | ProductCertificate
    | PathCertificate
    | PairsCertificate
    | MixedCertificate
    | TeamCertificate
    | TimedCertificate
)

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


def save_certificate(certificate: Synthesis | AnyCertificate | StartHull, path: str | Path) -> None:
    """Write a certificate, that of a synthesis, or a set of starts to ``path`` (``.npz``); ValueError otherwise."""
    certificate = certificate.certificate if isinstance(certificate, Synthesis) else certificate
    if not isinstance(certificate, AnyCertificate | StartHull):
        checked_certificate(certificate)
    write_bytes(path, packed(certificate))


def load_certificate(path: str | Path, max_bytes: int = MAX_BYTES) -> Certificate:
    """Return the certificate in a file; it is well-formed then, but not yet checked (see ``check``).

    Until then its numbers (``lower_bound``, ``unbounded``, ``at``, ``mean``, ``min``) are what the file says.

    From a file of independent tasks a ``ProductCertificate`` is returned, from one of a set of starts a ``StartHull``.

    Parameters
    ----------
    path : str or Path
    max_bytes : int
        Largest size, packed or unpacked, that is read.

    Raises
    ------
    ValueError
        If the file holds no certificate, or one of another version, damaged, or inconsistent.
    OSError
        If it cannot be read.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(
            f"`{path}`: expected a certificate file, found none; write one with `save_certificate`, or "
            "`certigym run ID --out FILE`"
        )
    try:
        if (size := Path(path).stat().st_size) > max_bytes:
            raise ValueError(f"it has {size} bytes, more than {max_bytes}")
        return _read(Path(path).read_bytes(), _Budget(max_bytes), frozenset(READERS))
    except UNREADABLE as error:
        message = str(error) or type(error).__name__
        raise ValueError(
            f"`{path}`: expected a certigym certificate of version {VERSION}, got a file that is not one: {message}"
        ) from error


def certificate_in(raw: bytes, max_bytes: int = MAX_BYTES) -> Certificate:
    """Return the certificate of one task in the bytes of a file; raise one of ``UNREADABLE`` if there is none."""
    found: Certificate = _read(raw, _Budget(max_bytes), frozenset())
    return found


@dataclass
class _Budget:
    """Bytes that a file, and all files in it together, may unpack to."""

    left: int


def _read(raw: bytes, budget: _Budget, allowed: frozenset[str]) -> Any:
    """Return the certificate in the bytes of a file, on cells or of one of the kinds that are allowed there."""
    header, arrays = unarchived(raw, budget.left)
    budget.left -= sum(array.nbytes for array in arrays.values())
    kind = next((name for name in READERS if name in header), None)
    if kind is None:
        return _on_cells(header, arrays, budget)
    if kind not in allowed:
        raise ValueError("a part of it has parts again")
    inside = INSIDE.get(kind, frozenset())
    return READERS[kind](header, arrays, lambda inner: _read(inner, budget, inside))


def _on_cells(header: dict[str, Any], arrays: dict[str, NDArray], budget: _Budget) -> Certificate:
    """Return the certificate on cells that a header describes, with that of the opposite task if it has one."""
    certificate = CertificateReader(header, arrays).certificate()
    if "opposite" not in header:
        return certificate
    opposite = _read(arrays[str(int(header["opposite"]))].astype(np.uint8).tobytes(), budget, frozenset())
    return replace(certificate, opposite=opposite)


def _product(
    header: dict[str, Any], arrays: dict[str, NDArray], read: Callable[[bytes], Certificate]
) -> ProductCertificate:
    """Return the certificates of independent tasks; the problem itself says which tasks these are."""
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    if not problem.groups:
        raise ValueError("its problem does not decompose into independent tasks")
    parts = {name: read(array.astype(np.uint8).tobytes()) for name, array in arrays.items()}
    return product_certificate(problem, tuple(parts[str(int(number))] for number in header["parts"]))


READERS: dict[str, Callable[[dict[str, Any], dict[str, NDArray], Callable[[bytes], Any]], Any]] = {
    "parts": _product,
    "path": lambda header, arrays, read: path_in(header, arrays),
    "hull": lambda header, arrays, read: hull_in(header, arrays),
    "mixed": mixed_in,
    "without_pairs": pairs_in,
    "written_out": timed_in,
    "team": team_in,
}
"""What reads a file, by the entry that its header has; a file without any of them is about cells."""

INSIDE = {
    "parts": frozenset({"path", "written_out"}),
    "mixed": frozenset({"path", "without_pairs"}),
    "team": frozenset({"path"}),
}
"""Of which kinds, but for those about cells, files may be that lie in others."""
