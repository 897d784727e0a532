"""Archives of certificates: one ``.npz`` with a JSON header and numbered arrays, read without pickle.

Arrays are stored once each under a number, and the header says which number is what; a thousand agents with one grid
store one grid. A digest of everything shows accidents and careless changes. It is no signature: whoever changes a file
can renew it, and only ``check`` says whether a certificate is true.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

FORMAT = "certigym-certificate"
"""What the header of every file says."""

VERSION = 2
"""Version of the format that is written and read."""

MAX_BYTES = 2**30
"""Largest unpacked size that is read, unless the caller allows more."""

ALLOW = "if you trust it, allow more with `load(path, max_bytes={size})`, or `--max-bytes {size}` on the command line"
"""How a larger size is allowed."""

MAX_HEADER = 2**24
"""Largest header in bytes: reading text takes longer than reading numbers."""


@dataclass
class Pool:
    """Arrays, each stored once, and the number of each by its content."""

    arrays: list[NDArray] = field(default_factory=list)
    numbers: dict[tuple[str, tuple[int, ...], bytes], int] = field(default_factory=dict)

    def put_file(self, certificate: Any) -> int:
        """Return the number of the file of a certificate, which is stored in this one."""
        return self.put(np.frombuffer(packed(certificate), np.uint8))

    def put(self, array: NDArray) -> int:
        """Return the number of an array, stored under a new one if no equal array is there."""
        array = np.ascontiguousarray(array)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self.numbers:
            self.numbers[key] = len(self.arrays)
            self.arrays.append(array)
        return self.numbers[key]


@dataclass
class Stored:
    """What a file holds of a proof.

    Parameters
    ----------
    entry : dict
        Its part of the header.
    arrays : dict
        By their numbers, as text.
    read : callable
        Reads the file of a part, given its bytes.
    """

    entry: dict[str, Any]
    arrays: dict[str, NDArray]
    read: Callable[[bytes], Any]
    known: dict[str, Any] = field(default_factory=dict)

    def array(self, number: Any) -> NDArray:
        """Return the array with a number."""
        return self.arrays[str(int(number))]

    def numbers(self, number: Any) -> NDArray[np.float64]:
        """Return the array with a number as floating-point numbers."""
        return np.asarray(self.array(number), dtype=float)

    def certificate(self, number: Any) -> Any:
        """Return the certificate whose file has a number: the same one for all who name it."""
        name = str(int(number))
        if name not in self.known:
            self.known[name] = self.read(self.arrays[name].astype(np.uint8, copy=False).tobytes())
        return self.known[name]


def packed(certificate: Any) -> bytes:
    """Return the bytes of the file of a certificate."""
    pool = Pool()
    header = {
        "format": FORMAT,
        "version": VERSION,
        "problem": certificate.problem.to_dict(),
        "fingerprint": certificate.fingerprint,
        "settings": certificate.settings,
        "proof": {"kind": certificate.proof.kind, **certificate.proof.written(pool)},
    }
    return _archived(header, pool)


def _archived(header: dict[str, Any], pool: Pool) -> bytes:
    """Return the bytes of an archive of a header, to which its digest is added, and arrays."""
    header["digest"] = _digest(header, pool.arrays)
    text = np.frombuffer(json.dumps(header, allow_nan=False).encode(), dtype=np.uint8)
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, header=text, **{str(k): a for k, a in enumerate(pool.arrays)})
    return file.getvalue()


def unarchived(raw: bytes, max_bytes: int) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """Return header and arrays of an archive, after their digest was checked."""
    # Look at the sizes before unpacking anything: a small file may announce gigabytes.
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        check_sizes(archive, max_bytes)
        if "header.json" in archive.namelist():
            raise ValueError("it is in the canonical form, which `check` reads; other verbs read what `save` writes")
    with np.load(io.BytesIO(raw), allow_pickle=False) as archive:
        header = json.loads(bytes(archive["header"]).decode())
        _check_version(header)
        count = len(archive.files) - 1
        if set(archive.files) != {"header", *map(str, range(count))}:
            raise ValueError("its arrays are not numbered")
        arrays = {str(k): archive[str(k)] for k in range(count)}
    if header.get("digest") != _digest(header, [*arrays.values()]):
        raise ValueError("its content was changed after it was written (the digest differs)")
    return header, arrays


def check_sizes(archive: zipfile.ZipFile, max_bytes: int) -> None:
    """Raise ValueError if an archive would unpack to too much, or its arrays announce more numbers than they hold."""
    # Other methods have decoders with errors of their own, and nobody writes them.
    if any(entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for entry in archive.infolist()):
        raise ValueError("an array is compressed in another way than `save` does")
    size = sum(entry.file_size for entry in archive.infolist())
    if size > max_bytes:
        raise ValueError(f"it would unpack to {size} bytes, more than {max_bytes}; {ALLOW.format(size=size)}")
    if any(entry.filename == "header.npy" and entry.file_size > MAX_HEADER for entry in archive.infolist()):
        raise ValueError(f"its header has more than {MAX_HEADER} bytes")
    if len(set(archive.namelist())) != len(archive.namelist()):
        raise ValueError("it holds two arrays of one name")
    # Read the headers of all arrays before numpy reserves memory for any.
    for entry in archive.infolist():
        if entry.filename == "header.json":
            continue
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
        raise ValueError(f"its version is {header.get('version')!r}; synthesize anew, or use the release that wrote it")


def _digest(header: dict[str, Any], arrays: list[NDArray]) -> str:
    """Return the SHA-256 over the header, but for the digest itself, and all arrays with their types and shapes."""
    content = {name: value for name, value in header.items() if name != "digest"}
    state = hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode())
    for array in arrays:
        state.update(f"{array.dtype.str}{array.shape}".encode())
        # The bytes of the array itself: a copy would take as much memory again.
        state.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    return state.hexdigest()
