"""Certificates on disk: one ``.npz`` with a JSON header, read without pickle.

Arrays are stored once each under a number, and the header says which number is what; a thousand agents with one grid
store one grid. Reading trusts nothing: the version, the shapes and the ranges of all indices are checked before an
array is used, and files that would unpack to more than ``MAX_BYTES`` are refused before they are unpacked. A digest of
everything in the file shows accidents and careless changes. It is no signature: whoever changes a file can renew it,
and only ``check`` says whether a certificate is true.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import write_bytes
from ...envs.problem import problem_from_dict
from ..values import Merges, Rounding, Skeleton, Terms
from .certificate import Certificate, checked_certificate
from .certificate_reader import CLAIM_FIELDS, CertificateReader
from .hull_file import hull_header, hull_in
from .mixed_certificate import MixedCertificate
from .pairs_certificate import PairsCertificate
from .pairs_file import mixed_header, mixed_in, pairs_header, pairs_in, team_header, team_in, timed_header, timed_in
from .part import AgentPart
from .path_certificate import PathCertificate
from .path_file import path_header, path_in
from .product import ProductCertificate, product_certificate
from .result import Synthesis
from .start_hull import StartHull
from .team_certificate import TeamCertificate
from .timed_certificate import TimedCertificate

AnyCertificate = (
    Certificate
    | ProductCertificate
    | PathCertificate
    | PairsCertificate
    | MixedCertificate
    | TeamCertificate
    | TimedCertificate
)

FORMAT = "certigym-certificate"
"""What the header of every file says."""

VERSION = 1
"""Version of the format that is written, and the only one that is read."""

MAX_BYTES = 2 * 2**30
"""Largest unpacked size that is read, unless the caller allows more."""

MAX_HEADER = 2**24
"""Largest header in bytes: reading text takes longer than reading numbers."""

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
    data = _packed_product(certificate) if isinstance(certificate, ProductCertificate) else _packed(certificate)
    write_bytes(path, data)


def _packed_product(product: ProductCertificate) -> bytes:
    """Return the bytes of a file that holds the files of all parts, those that differ in names alone once."""
    pool = _Pool()
    files = {}
    # Parts that differ in names alone share one file in the archive.
    for same in product.alike:
        file = pool.put(np.frombuffer(_packed(product.parts[same[0]]), np.uint8))
        files.update(dict.fromkeys(same, file))
    header = {
        "format": FORMAT,
        "version": VERSION,
        "problem": product.problem.to_dict(),
        "fingerprint": product.fingerprint,
        "parts": [files[k] for k in range(len(product.parts))],
    }
    return _archived(header, pool)


def _packed(
    certificate: Certificate
    | PathCertificate
    | PairsCertificate
    | MixedCertificate
    | TeamCertificate
    | TimedCertificate
    | StartHull,
) -> bytes:
    """Return the bytes of the file of a single certificate."""
    pool = _Pool()
    if isinstance(certificate, MixedCertificate):
        parts = [_packed(part) for part in (certificate.grids, certificate.paths)]
        more = mixed_header(certificate, parts, pool.put)
        return _archived({"format": FORMAT, "version": VERSION, **more}, pool)
    if isinstance(certificate, PairsCertificate):
        more = pairs_header(certificate, _packed(certificate.base), pool.put)
        return _archived({"format": FORMAT, "version": VERSION, **more}, pool)
    if isinstance(certificate, TeamCertificate):
        more = team_header(certificate, _packed(certificate.base), pool.put)
        return _archived({"format": FORMAT, "version": VERSION, **more}, pool)
    if isinstance(certificate, TimedCertificate):
        more = timed_header(certificate, _packed(certificate.base), pool.put)
        return _archived({"format": FORMAT, "version": VERSION, **more}, pool)
    if isinstance(certificate, PathCertificate):
        return _archived({"format": FORMAT, "version": VERSION, **path_header(certificate, pool.put)}, pool)
    if isinstance(certificate, StartHull):
        return _archived({"format": FORMAT, "version": VERSION, **hull_header(certificate, pool.put)}, pool)
    checked_certificate(certificate)
    terms, rounding = certificate.terms, certificate.rounding
    header = {
        "format": FORMAT,
        "version": VERSION,
        "problem": certificate.problem.to_dict(),
        "fingerprint": certificate.fingerprint,
        **{name: getattr(certificate, name) for name in CLAIM_FIELDS},
        "settings": certificate.settings,
        "agents": [_put_agent(pool, part) for part in certificate.agents],
        "guards": [pool.put(a) for a in (certificate.guard_source, certificate.guard_target, certificate.guard_mask)],
        "start_guards": [pool.put(certificate.start_target), pool.put(certificate.start_mask)],
        "skeleton": [_put_skeleton(pool, step) for step in certificate.skeleton],
        "terms": None if terms is None else _put_terms(pool, terms),
        "rounding": None if rounding is None else _put_rounding(pool, rounding),
    }
    return _archived(header, pool)


def _archived(header: dict[str, Any], pool: _Pool) -> bytes:
    """Return the bytes of an archive of a header, to which its digest is added, and arrays."""
    header["digest"] = _digest(header, pool.arrays)
    text = np.frombuffer(json.dumps(header, allow_nan=False).encode(), dtype=np.uint8)
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, header=text, **{str(k): a for k, a in enumerate(pool.arrays)})
    return file.getvalue()


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
        header, arrays = _unarchived(Path(path).read_bytes(), max_bytes)
        if "parts" in header:
            return _product(header, arrays, max_bytes)  # type: ignore[return-value]
        if "path" in header:
            return path_in(header, arrays)  # type: ignore[return-value]
        if "hull" in header:
            return hull_in(header, arrays)  # type: ignore[return-value]
        if "mixed" in header:
            return mixed_in(header, arrays, lambda raw: _part_of_team(raw, max_bytes))  # type: ignore[return-value]
        if "without_pairs" in header:
            return pairs_in(header, arrays, lambda raw: certificate_in(raw, max_bytes))  # type: ignore[return-value]
        if "written_out" in header:
            return timed_in(header, arrays, lambda raw: certificate_in(raw, max_bytes))  # type: ignore[return-value]
        if "team" in header:
            return team_in(header, arrays, lambda raw: _single(raw, max_bytes))  # type: ignore[return-value]
        return CertificateReader(header, arrays).certificate()
    except UNREADABLE as error:
        message = str(error) or type(error).__name__
        raise ValueError(
            f"`{path}`: expected a certigym certificate of version {VERSION}, got a file that is not one: {message}"
        ) from error


def certificate_bytes(certificate: Certificate) -> bytes:
    """Return the bytes of the file of a certificate of one task, to be put into another file."""
    return _packed(certificate)


def certificate_in(raw: bytes, max_bytes: int = MAX_BYTES) -> Certificate:
    """Return the certificate of one task in the bytes of a file; raise one of ``UNREADABLE`` if there is none."""
    header, arrays = _unarchived(raw, max_bytes)
    return CertificateReader(header, arrays).certificate()


def _part_of_team(raw: bytes, max_bytes: int) -> Certificate | PathCertificate | PairsCertificate:
    """Return the certificate of the agents on grids, or along paths, of a mixed team in the bytes of a file."""
    header, arrays = _unarchived(raw, max_bytes)
    if "without_pairs" in header:
        return pairs_in(header, arrays, lambda inner: certificate_in(inner, max_bytes))
    return path_in(header, arrays) if "path" in header else CertificateReader(header, arrays).certificate()


def _single(raw: bytes, max_bytes: int) -> Certificate | PathCertificate:
    """Return the certificate of one task, on grids or along a path, in the bytes of a file."""
    header, arrays = _unarchived(raw, max_bytes)
    return path_in(header, arrays) if "path" in header else CertificateReader(header, arrays).certificate()


def _unarchived(raw: bytes, max_bytes: int) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """Return header and arrays of an archive, after their digest was checked."""
    # Look at the sizes before unpacking anything: a small file may announce gigabytes.
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        _check_sizes(archive, max_bytes)
    with np.load(io.BytesIO(raw), allow_pickle=False) as archive:
        header = json.loads(bytes(archive["header"]).decode())
        _check_version(header)
        arrays = {name: archive[name] for name in archive.files if name != "header"}
    _check_digest(header, arrays)
    return header, arrays


def _product(header: dict[str, Any], arrays: dict[str, NDArray], max_bytes: int) -> ProductCertificate:
    """Return the certificates of independent tasks; the problem itself says which tasks these are."""
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    if not problem.groups:
        raise ValueError("its problem does not decompose into independent tasks")
    # All parts together may unpack to no more than a single file.
    certificates: dict[str, Certificate] = {}
    bytes_left = max_bytes
    for name, array in arrays.items():
        part_header, part_arrays = _unarchived(array.astype(np.uint8).tobytes(), bytes_left)
        bytes_left -= sum(a.nbytes for a in part_arrays.values())
        if not {"parts", "hull", "without_pairs", "team", "mixed"}.isdisjoint(part_header):
            raise ValueError("a part of it has parts again")
        certificates[name] = _part(part_header, part_arrays, bytes_left)
    return product_certificate(problem, tuple(certificates[str(int(number))] for number in header["parts"]))


def _part(header: dict[str, Any], arrays: dict[str, NDArray], max_bytes: int) -> Any:
    """Return the certificate of one of several independent tasks."""
    if "written_out" in header:
        return timed_in(header, arrays, lambda raw: certificate_in(raw, max_bytes))
    return path_in(header, arrays) if "path" in header else _read(header, arrays)


def _read(header: dict[str, Any], arrays: dict[str, NDArray]) -> Certificate:
    """Return the certificate on grids that a header describes."""
    return CertificateReader(header, arrays).certificate()


def _check_sizes(archive: zipfile.ZipFile, max_bytes: int) -> None:
    """Raise ValueError if an archive would unpack to too much, or its arrays announce more numbers than they hold."""
    if sum(entry.file_size for entry in archive.infolist()) > max_bytes:
        raise ValueError(f"it would unpack to more than {max_bytes} bytes; allow more with `max_bytes`")
    if any(entry.filename == "header.npy" and entry.file_size > MAX_HEADER for entry in archive.infolist()):
        raise ValueError(f"its header has more than {MAX_HEADER} bytes")
    if len(set(archive.namelist())) != len(archive.namelist()):
        raise ValueError("it holds two arrays of one name")
    # Read the headers of all arrays before numpy reserves memory for any.
    for entry in archive.infolist():
        with archive.open(entry) as file:
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(file)
            if dtype.hasobject or math.prod(shape) * dtype.itemsize != entry.file_size - file.tell():
                raise ValueError(
                    f"array {entry.filename} announces {shape} numbers of type {dtype}, which it does not hold"
                )


def _check_version(header: Any) -> None:
    """Raise ValueError unless a header is that of a certificate of this version."""
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ValueError("its header does not say it is one")
    if header.get("version") != VERSION:
        raise ValueError(f"its version is {header.get('version')!r}; use the certigym release that wrote it")


def _digest(header: dict[str, Any], arrays: list[NDArray]) -> str:
    """Return the SHA-256 over the header, but for the digest itself, and all arrays with their types and shapes."""
    content = {name: value for name, value in header.items() if name != "digest"}
    state = hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode())
    for array in arrays:
        state.update(f"{array.dtype.str}{array.shape}".encode())
        state.update(np.ascontiguousarray(array).tobytes())
    return state.hexdigest()


def _check_digest(header: dict[str, Any], arrays: dict[str, NDArray]) -> None:
    """Raise ValueError if the digest is not that of header and arrays."""
    if set(arrays) != {str(k) for k in range(len(arrays))}:
        raise ValueError("its arrays are not numbered")
    if header.get("digest") != _digest(header, [arrays[str(k)] for k in range(len(arrays))]):
        raise ValueError("its content was changed after it was written (the digest differs)")


@dataclass
class _Pool:
    """Arrays, each stored once, and the number of each by its content."""

    arrays: list[NDArray] = field(default_factory=list)
    numbers: dict[tuple[str, tuple[int, ...], bytes], int] = field(default_factory=dict)

    def put(self, array: NDArray) -> int:
        """Return the number of an array, stored under a new one if no equal array is there."""
        array = np.ascontiguousarray(array)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self.numbers:
            self.numbers[key] = len(self.arrays)
            self.arrays.append(array)
        return self.numbers[key]


def _put_agent(pool: _Pool, part: AgentPart) -> dict[str, Any]:
    """Return the entry of an agent, its arrays put into the pool."""
    return {
        "edges": [pool.put(a) for a in part.grid.edges],
        "coordinates": pool.put(part.coordinates),
        "lattice": [pool.put(a) for a in part.lattice],
        "relation": part.relation,
        "masks": pool.put(part.masks),
        "start_masks": pool.put(part.start_masks),
        "law": pool.put(part.policy),
        "menu": None if part.menu is None else pool.put(part.menu),
    }


def _put_terms(pool: _Pool, terms: Terms) -> dict[str, Any]:
    """Return the entry of a value tree, its arrays put into the pool."""
    return {"factors": [pool.put(a) for a in terms.factors], "index": [pool.put(a) for a in terms.index]}


def _put_rounding(pool: _Pool, rounding: Rounding) -> dict[str, Any]:
    """Return the entry of how trains were rounded, its arrays put into the pool."""
    visited = [
        None if cells is None else [pool.put(numbers.astype(np.int32)) for numbers in cells]
        for cells in rounding.visited
    ]
    return {"tolerance": rounding.tolerance, "visited": visited}


def _rests(merges: Merges) -> list[NDArray[Any]]:
    """Return the remainders of unions as one array, where there are any."""
    return [merges.rests] if np.any(merges.rests) else []


def _put_skeleton(pool: _Pool, step: Skeleton) -> list[list[int]]:
    """Return the entry of one time of the tree, its arrays put into the pool."""
    states = zip(step.origin, step.merges, step.kept, strict=True)
    small = np.int32
    return [
        [pool.put(a.astype(small)) for a in (origin, merges.into, merges.absorbed, merges.agent, kept, *_rests(merges))]
        for origin, merges, kept in states
    ]
