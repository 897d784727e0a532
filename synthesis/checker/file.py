"""The file of a certificate: one ``.npz`` whose members are stored as they are, read byte by byte without pickle.

A file is a ZIP archive with the member ``header.json`` first, and arrays ``0.npy``, ``1.npy``, .. after it. So that all
readers see the same thing, there is one way to write it: members are stored and not deflated, they follow one another
without gaps, the directory and the end of the archive follow them and end the file, and no member has flags, extra
fields or comments. Arrays are of version 1.0, little-endian, in C order, of floats, whole numbers or truth values.

Sizes are read from the file's own length and compared before an array is made: reading takes no more memory than the
file, its header and its arrays together.
"""

from __future__ import annotations

import json
import math
import re
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .fields import Entry, Unreadable

FORMAT, VERSION = "certigym-certificate", 3
MOST_BYTES = 2**30  # largest file that is read unless the user allows more; arrays are views of its bytes
MOST_HEADER = 2**26  # largest header: reading text takes some thirty times its size
LOCAL, CENTRAL, END = b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06"
NPY = b"\x93NUMPY\x01\x00"
NPY_HEADER = re.compile(
    r"\{'descr': '([<|][fib][0-9])', 'fortran_order': False, 'shape': \(((?:[0-9]{1,12}, ?)*(?:[0-9]{1,12})?)\), \} *\n"
)
TYPES = {"<f8": np.float64, "<i8": np.int64, "<i4": np.int32, "|i1": np.int8, "|b1": np.bool_}


@dataclass(frozen=True, eq=False)
class Contents:
    """Header and arrays of a file, by number; and which of the arrays were asked for."""

    header: dict[str, Any]
    arrays: tuple[NDArray[Any], ...]
    used: set[int]

    def entry(self, key: str) -> Entry:
        """Return an entry of the header, which may name arrays."""
        return Entry(self.header[key], key, self.arrays, self.used)

    def everything_was_used(self) -> None:
        """Raise ``Unreadable`` if an array is there that nobody asked for."""
        if len(self.used) != len(self.arrays):
            raise Unreadable(f"array {min(set(range(len(self.arrays))) - self.used)} belongs to nothing")


def read_file(path: str | Path, most_bytes: int = MOST_BYTES) -> Contents:
    """Return header and arrays of a file; ``Unreadable`` if it is larger than allowed, or of another format."""
    size = Path(path).stat().st_size
    if size > most_bytes:
        raise Unreadable(f"the file has {size} bytes, more than {most_bytes}; allow more with --most-bytes")
    return parse_file(Path(path).read_bytes())


def parse_file(raw: bytes) -> Contents:
    """Return header and arrays in the bytes of a file."""
    # Members in order: the header, then arrays by number.
    members = _members(memoryview(raw))
    if not members or members[0][0] != "header.json":
        raise Unreadable("its first member is not `header.json`: it is no certificate of this format")
    header = _header(bytes(members[0][1]))
    arrays = []
    for number, (name, data) in enumerate(members[1:]):
        if name != f"{number}.npy":
            raise Unreadable(f"member {name[:40]!r} stands where `{number}.npy` is expected")
        arrays.append(_array(name, data))
    return Contents(header, tuple(arrays), set())


def _members(raw: memoryview) -> list[tuple[str, memoryview]]:
    """Return names and contents of the members of an archive, which its directory has to repeat."""
    local, at = [], 0
    while bytes(raw[at : at + 4]) == LOCAL:
        name, entry, start, end = _local(raw, at)
        local.append((name, entry, at, raw[start:end]))
        at = end
    directory = at
    # The directory has to say of every member what stands before it.
    for name, entry, offset, data in local:
        if len(raw) < at + 46 or bytes(raw[at : at + 4]) != CENTRAL:
            raise Unreadable("its directory is cut off")
        own = struct.unpack("<HHHHHHIIIHHHHHII", raw[at + 4 : at + 46])
        # versions and attributes mean nothing here; all else has to be what stands before the member
        same = own[2:9] == entry[1:8] and own[9:13] == (len(name), 0, 0, 0) and own[15] == offset
        if not same or bytes(raw[at + 46 : at + 46 + len(name)]) != name.encode("ascii"):
            raise Unreadable(f"its directory says something else of {name[:40]!r} than stands there")
        if zlib.crc32(data) != entry[5]:  # over contents, not names
            raise Unreadable(f"{name[:40]!r} was changed by accident: its check sum differs")
        at += 46 + len(name)
    # Nothing may follow: the end of the archive is known to the byte.
    closing = struct.pack("<4sHHHHIIH", END, 0, 0, len(local), len(local), at - directory, directory, 0)
    if bytes(raw[at:]) != closing:
        raise Unreadable("it does not end where its directory ends, or holds more than its members")
    return [(name, data) for name, _, _, data in local]


def _local(raw: memoryview, at: int) -> tuple[str, tuple[int, ...], int, int]:
    """Return the name of a member, the numbers before it, and where its content begins and ends."""
    if len(raw) < at + 30:
        raise Unreadable("a member is cut off")
    entry = struct.unpack("<HHHHHIIIHH", raw[at + 4 : at + 30])
    _, flags, method, _, _, _, packed, size, name_length, extra = entry
    if flags or method or extra or packed != size or name_length > 40:  # no bit has a meaning here
        raise Unreadable("a member is deflated, encrypted, or has extra fields; members are stored as they are")
    start = at + 30 + name_length
    if start + size > len(raw):
        raise Unreadable("a member announces more bytes than the file has")
    name = bytes(raw[at + 30 : start])
    if not re.fullmatch(rb"[a-z0-9.]+", name):
        raise Unreadable(f"{name!r} is no name of a member")
    return name.decode("ascii"), entry, start, start + size


def _header(raw: bytes) -> dict[str, Any]:
    """Return the header, in which no key stands twice and no number is nan or infinite."""
    if len(raw) > MOST_HEADER:
        raise Unreadable(f"its header has more than {MOST_HEADER} bytes")

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) != len(pairs):
            raise Unreadable("a key stands twice in one table of the header")
        return found

    def constant(word: str) -> Any:
        raise Unreadable(f"the header holds {word}, which is no number")

    def whole(digits: str) -> int:
        if len(digits) > 19:
            raise Unreadable("the header holds a whole number of more than 18 digits")
        return int(digits)

    try:
        header = json.loads(raw.decode("utf-8"), object_pairs_hook=unique, parse_constant=constant, parse_int=whole)
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise Unreadable(f"its header is no JSON: {str(error)[:80]}") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise Unreadable(f"its header does not say that it is a {FORMAT}")
    if header.get("version") != VERSION:
        raise Unreadable(f"its version is {str(header.get('version'))[:20]}, and version {VERSION} is read here")
    Entry(header, "header").table(("format", "version", "name", "problem", "claim", "proof"), ("notes",))["name"].text()
    return header


def _array(name: str, data: memoryview) -> NDArray[Any]:
    """Return the array in a member, a read-only view of its bytes."""
    length = struct.unpack("<H", data[8:10])[0] if len(data) >= 10 and bytes(data[:8]) == NPY else -1
    if length < 0 or len(data) < 10 + length:
        raise Unreadable(f"{name}: it is no array of version 1.0")
    # The text of an array has one form; a length that does not fit is refused before memory is used.
    match = NPY_HEADER.fullmatch(bytes(data[10 : 10 + length]).decode("latin-1"))
    if match is None or match[1] not in TYPES:
        raise Unreadable(f"{name}: expected an array in C order of type {', '.join(TYPES)}")
    shape = tuple(int(n) for n in match[2].replace(" ", "").split(",") if n)
    dtype, content = np.dtype(TYPES[match[1]]), data[10 + length :]
    if len(shape) > 4 or math.prod(shape) * dtype.itemsize != len(content):
        raise Unreadable(f"{name}: it announces {shape} numbers of type {match[1]}, which it does not hold")
    array = (np.frombuffer(content, dtype=dtype) if len(content) else np.zeros(0, dtype)).reshape(shape)
    array.setflags(write=False)  # all readers see one and the same
    return array
