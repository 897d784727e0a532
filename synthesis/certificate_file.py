"""Certificates on disk: one ``.npz`` with a JSON header, read without pickle.

Arrays are stored once each under a number, and the header says which number is what; a thousand agents with one grid
store one grid. Reading trusts nothing: the version, the shapes and the ranges of all indices are checked before an
array is used, and files larger than ``MAX_BYTES`` when unpacked are refused before they are. A digest of everything
in the file tells accidents and careless changes; it is no signature: whoever changes a file can renew it, and only
``check`` says whether a certificate is true.
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

from ..envs.problem import Problem
from .ascent import Skeleton
from .certificate import AgentPart, Certificate, checked_certificate
from .described_relation import check_description
from .grid import Grid
from .product import ProductCertificate, product_certificate
from .terms import Merges, Terms
from .train_value import Rounding

FORMAT = "certigym-certificate"
VERSION = 1
MAX_BYTES = 2 * 2**30
"""Largest unpacked size that is read, unless the caller allows more."""


def save_certificate(certificate: Certificate | ProductCertificate, path: str | Path) -> None:
    """Write a certificate to ``path`` (``.npz``); ValueError if it is none."""
    data = _packed_product(certificate) if isinstance(certificate, ProductCertificate) else _packed(certificate)
    Path(path).write_bytes(data)


def _packed_product(product: ProductCertificate) -> bytes:
    """Bytes of a file that holds the files of all parts, those that differ in names alone once."""
    pool = _Pool()
    files = {}
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


def _packed(certificate: Certificate) -> bytes:
    """Bytes of the file of a single certificate."""
    checked_certificate(certificate)
    pool = _Pool()
    header = {
        "format": FORMAT,
        "version": VERSION,
        "problem": certificate.problem.to_dict(),
        "fingerprint": certificate.fingerprint,
        **{name: getattr(certificate, name) for name in _NUMBERS},
        "settings": certificate.settings,
        "agents": [_put_agent(pool, part) for part in certificate.agents],
        "guards": [pool.put(a) for a in (certificate.guard_source, certificate.guard_target, certificate.guard_mask)],
        "start_guards": [pool.put(certificate.start_target), pool.put(certificate.start_mask)],
        "skeleton": [_put_skeleton(pool, step) for step in certificate.skeleton],
        "terms": None
        if certificate.terms is None
        else {
            "factors": [pool.put(a) for a in certificate.terms.factors],
            "index": [pool.put(a) for a in certificate.terms.index],
        },
        "rounding": None
        if certificate.rounding is None
        else {
            "tolerance": certificate.rounding.tolerance,
            "visited": [
                None if c is None else [pool.put(own.astype(np.int32)) for own in c]
                for c in certificate.rounding.visited
            ],
        },
    }
    return _archived(header, pool)


def _archived(header: dict[str, Any], pool: _Pool) -> bytes:
    """Bytes of an archive of a header, its digest added, and arrays."""
    header["digest"] = _digest(header, pool.arrays)
    text = np.frombuffer(json.dumps(header, allow_nan=False).encode(), dtype=np.uint8)
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, header=text, **{str(k): a for k, a in enumerate(pool.arrays)})
    return file.getvalue()


_NUMBERS = ("method", "bound", "bounds", "start", "lower_bound", "gap", "exact", "relative_rounding", "rank")


def load_certificate(path: str | Path, max_bytes: int = MAX_BYTES) -> Certificate:
    """Read a certificate; it is well-formed then, but not yet checked (see ``check``).

    A file of independent tasks gives a ``ProductCertificate``.

    Parameters
    ----------
    path : str or Path
    max_bytes : int
        Largest size, packed or unpacked, that is read.

    Raises
    ------
    ValueError
        If the file is no certificate, of another version, damaged, or inconsistent.
    OSError
        If it cannot be read.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"`{path}`: expected a certificate file, found none; write one with `save_certificate`")
    try:
        if (size := Path(path).stat().st_size) > max_bytes:
            raise ValueError(f"it has {size} bytes, more than {max_bytes}")
        header, arrays = _unarchived(Path(path).read_bytes(), max_bytes)
        if "parts" in header:
            return _product(header, arrays, max_bytes)  # type: ignore[return-value]
        return _Reader(header, arrays).certificate()
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError, RecursionError, EOFError,
            NotImplementedError, zipfile.BadZipFile, zlib.error) as error:  # fmt: skip
        message = str(error) or type(error).__name__
        raise ValueError(
            f"`{path}`: expected a certigym certificate of version {VERSION}, got a file that is none: {message}"
        ) from error


def _unarchived(raw: bytes, max_bytes: int) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """Header and arrays of an archive, their digest checked."""
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        _check_sizes(archive, max_bytes)
    with np.load(io.BytesIO(raw), allow_pickle=False) as archive:
        header = json.loads(bytes(archive["header"]).decode())
        _check_version(header)
        arrays = {name: archive[name] for name in archive.files if name != "header"}
    _check_digest(header, arrays)
    return header, arrays


def _product(header: dict[str, Any], arrays: dict[str, NDArray], max_bytes: int) -> ProductCertificate:
    """Certificates of independent tasks; which these are is found out again from the problem."""
    problem = Problem.from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    if not problem.groups:
        raise ValueError("its problem does not fall apart into independent tasks")
    found: dict[str, Certificate] = {}
    left = max_bytes
    for name, array in arrays.items():
        own, inner = _unarchived(array.astype(np.uint8).tobytes(), left)
        left -= sum(a.nbytes for a in inner.values())
        if "parts" in own:
            raise ValueError("a part falls apart again")
        found[name] = _Reader(own, inner).certificate()
    return product_certificate(problem, tuple(found[str(int(number))] for number in header["parts"]))


def _check_sizes(archive: zipfile.ZipFile, max_bytes: int) -> None:
    """Refuse archives whose arrays would need more memory than they have bytes for."""
    if sum(entry.file_size for entry in archive.infolist()) > max_bytes:
        raise ValueError(f"it would unpack to more than {max_bytes} bytes; allow more with `max_bytes`")
    if len(set(archive.namelist())) != len(archive.namelist()):
        raise ValueError("it holds two arrays of one name")
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
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ValueError("its header does not say it is one")
    if header.get("version") != VERSION:
        raise ValueError(f"its version is {header.get('version')!r}; use the certigym release that wrote it")


def _digest(header: dict[str, Any], arrays: list[NDArray]) -> str:
    """SHA-256 over the header, but for the digest itself, and all arrays with their types and shapes."""
    rest = {name: value for name, value in header.items() if name != "digest"}
    state = hashlib.sha256(json.dumps(rest, sort_keys=True, allow_nan=False).encode())
    for array in arrays:
        state.update(f"{array.dtype.str}{array.shape}".encode())
        state.update(np.ascontiguousarray(array).tobytes())
    return state.hexdigest()


def _check_digest(header: dict[str, Any], arrays: dict[str, NDArray]) -> None:
    if set(arrays) != {str(k) for k in range(len(arrays))}:
        raise ValueError("its arrays are not numbered")
    if header.get("digest") != _digest(header, [arrays[str(k)] for k in range(len(arrays))]):
        raise ValueError("its content was changed after it was written (the digest differs)")


@dataclass
class _Pool:
    """Arrays by content."""

    arrays: list[NDArray] = field(default_factory=list)
    known: dict[tuple[str, tuple[int, ...], bytes], int] = field(default_factory=dict)

    def put(self, array: NDArray) -> int:
        array = np.ascontiguousarray(array)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self.known:
            self.known[key] = len(self.arrays)
            self.arrays.append(array)
        return self.known[key]


def _put_agent(pool: _Pool, part: AgentPart) -> dict[str, Any]:
    return {
        "edges": [pool.put(a) for a in part.grid.edges],
        "coordinates": pool.put(part.coordinates),
        "lattice": [pool.put(a) for a in part.lattice],
        "relation": part.relation,
        "masks": pool.put(part.masks),
        "start_masks": pool.put(part.start_masks),
        "law": pool.put(part.law),
        "menu": None if part.menu is None else pool.put(part.menu),
    }


def _put_skeleton(pool: _Pool, step: Skeleton) -> list[list[int]]:
    states = zip(step.origin, step.merges, step.kept, strict=True)
    small = np.int32
    return [
        [pool.put(a.astype(small)) for a in (origin, merges.into, merges.absorbed, merges.agent, kept)]
        for origin, merges, kept in states
    ]


class _Reader:
    """Rebuilds a certificate from header and arrays, checking every shape and index on the way."""

    def __init__(self, header: dict[str, Any], arrays: dict[str, NDArray]) -> None:
        self.header, self.arrays = header, arrays
        self.problem = Problem.from_dict(header["problem"])
        self.n_agents, self.n_states = self.problem.n_agents, self.problem.automaton.n_states

    def certificate(self) -> Certificate:
        header = self.header
        if header["fingerprint"] != self.problem.fingerprint:
            raise ValueError("the fingerprint does not belong to the problem in it")
        agents = self._each(header["agents"], self.n_agents, self._agent)
        source, target = (self._integers(header["guards"][k], (None,), self.n_states) for k in (0, 1))
        mask = self._integers(header["guards"][2], (len(source), self.n_agents), None)
        if len(target) != len(source) or any(mask[:, i].max(initial=-1) >= len(a.masks) for i, a in enumerate(agents)):
            raise ValueError("its guards are inconsistent")
        start_target = self._integers(header["start_guards"][0], (None,), self.n_states)
        start_mask = self._integers(header["start_guards"][1], (len(start_target), self.n_agents), None)
        if any(start_mask[:, i].max(initial=-1) >= len(a.start_masks) for i, a in enumerate(agents)):
            raise ValueError("its start guards are inconsistent")
        numbers = {name: header[name] for name in _NUMBERS}
        _check_numbers(numbers)
        trains = header.get("rounding") is not None
        if trains and (header["terms"] is not None or header["skeleton"]):
            raise ValueError("it holds a value tree beside its tensor trains")
        return Certificate(
            problem=self.problem,
            agents=tuple(agents),
            guard_source=source,
            guard_target=target,
            guard_mask=mask,
            start_target=start_target,
            start_mask=start_mask,
            skeleton=() if trains else tuple(self._each(header["skeleton"], self.problem.horizon, self._step)),
            terms=None if trains else self._terms(agents),
            rounding=self._rounding(agents) if trains else None,
            settings=dict(header["settings"]),
            **numbers,
        )

    def _each(self, items: Any, count: int, read: Any) -> list[Any]:
        if not isinstance(items, list) or len(items) != count:
            raise ValueError(f"a list of {count} entries is missing")
        self._position = 0
        result = []
        for self._position, item in enumerate(items):
            result.append(read(item))
        return result

    def _array(self, number: Any, kinds: str, shape: tuple[int | None, ...]) -> NDArray:
        array = self.arrays[str(int(number))]
        fits = array.ndim == len(shape) and all(b is None or a == b for a, b in zip(array.shape, shape, strict=True))
        if array.dtype.kind not in kinds or not fits:
            raise ValueError(f"array {number} has type {array.dtype} and shape {array.shape}, expected {shape}")
        if kinds == "f" and not np.all(np.isfinite(array)):
            raise ValueError(f"array {number} holds numbers that are not finite")
        array.setflags(write=False)
        return array

    def _integers(self, number: Any, shape: tuple[int | None, ...], below: int | None, least: int = 0) -> NDArray:
        array = self._array(number, "iu", shape)
        if array.size and (array.min() < least or (below is not None and array.max() >= below)):
            raise ValueError(f"array {number} holds indices out of range")
        return array

    def _agent(self, entry: dict[str, Any]) -> AgentPart:
        d = self.problem.agents[self._position].n_states
        if len(entry["edges"]) != d or len(entry["lattice"]) != d:
            raise ValueError("an agent has the wrong number of axes")
        grid = Grid(tuple(self._array(k, "f", (None,)) for k in entry["edges"]))
        lattice = tuple(self._array(k, "f", (None,)) for k in entry["lattice"])
        points = math.prod(len(axis) for axis in lattice)
        times = 1 if self.arrays[str(int(entry["law"]))].shape[:1] == (1,) else self.problem.horizon
        shape = (times, self.n_states, grid.n_cells)
        menu = None if entry["menu"] is None else self._integers(entry["menu"], (grid.n_cells, None), points)
        check_description(entry["relation"], self.problem.agents[self._position])
        if (entry["relation"]["kind"] != "exact") != (menu is not None):
            raise ValueError("a relation and its choices do not belong together")
        return AgentPart(
            grid=grid,
            coordinates=self._array(entry["coordinates"], "f", (d, d)),
            lattice=lattice,
            relation=entry["relation"],
            masks=self._array(entry["masks"], "b", (None, grid.n_cells)),
            start_masks=self._array(entry["start_masks"], "b", (None, grid.n_cells)),
            law=self._integers(entry["law"], shape, points if menu is None else menu.shape[1], least=-1),
            menu=menu,
        )

    def _step(self, entry: Any) -> Skeleton:
        if len(entry) != self.n_states:
            raise ValueError("the tree has the wrong number of states")
        origins, merges, kept = [], [], []
        for numbers in entry:
            origin = self._integers(numbers[0], (None, 2), None).astype(np.int64)
            n = len(origin)
            into = self._integers(numbers[1], (None,), n).astype(np.int64)
            absorbed = self._integers(numbers[2], (len(into),), n).astype(np.int64)
            agent = self._integers(numbers[3], (len(into),), self.n_agents).astype(np.int64)
            origins.append(origin)
            merges.append(Merges(into, absorbed, agent))
            kept.append(self._integers(numbers[4], (None,), n).astype(np.int64))
        return Skeleton(tuple(origins), tuple(merges), tuple(kept))

    def _rounding(self, agents: list[AgentPart]) -> Rounding:
        entry = self.header["rounding"]
        tolerance = entry["tolerance"]
        if not isinstance(tolerance, float) or not 0 < tolerance < 1:
            raise ValueError("its rounding has no tolerance between 0 and 1")
        visited: list[tuple[NDArray, ...] | None] = []
        for cells in self._each(entry["visited"], self.problem.horizon + 1, lambda item: item):
            if cells is not None and len(cells) != self.n_agents:
                raise ValueError("its rounding does not name the cells of every agent")
            visited.append(
                None
                if cells is None
                else tuple(
                    self._integers(k, (None,), a.grid.n_cells).astype(np.int64)
                    for k, a in zip(cells, agents, strict=True)
                )
            )
        return Rounding(tolerance, tuple(visited))

    def _terms(self, agents: list[AgentPart]) -> Terms:
        entry = self.header["terms"]
        if len(entry["factors"]) != self.n_agents or len(entry["index"]) != self.n_states:
            raise ValueError("the value function has the wrong size")
        factors = tuple(
            self._array(k, "f", (None, a.grid.n_cells)) for k, a in zip(entry["factors"], agents, strict=True)
        )
        index = tuple(self._integers(k, (None, self.n_agents), None) for k in entry["index"])
        for rows in index:
            if len(rows) and any(rows[:, i].max() >= len(own) for i, own in enumerate(factors)):
                raise ValueError("the value function points at factors that are not there")
        return Terms(factors, index)


def _check_numbers(numbers: dict[str, Any]) -> None:
    """Types and ranges of the numbers in the header."""
    lower, gap, relative = numbers["lower_bound"], numbers["gap"], numbers["relative_rounding"]
    texts = all(isinstance(numbers[k], str) for k in ("method", "bound", "start"))
    bounds = numbers["bounds"]
    if any(isinstance(value, bool) for value in (lower, gap)):
        raise ValueError("its bound is no number")
    if not isinstance(bounds, dict) or not all(isinstance(v, float | int) for v in bounds.values()):
        raise ValueError("its bounds are no numbers")
    if (
        not texts
        or not isinstance(numbers["exact"], bool)
        or isinstance(numbers["rank"], bool)
        or not isinstance(numbers["rank"], int)
    ):
        raise ValueError("its header holds values of the wrong type")
    if not (
        isinstance(lower, float | int) and 0 <= lower <= 1 and isinstance(relative, float) and 0 <= relative <= 1e-3
    ):
        raise ValueError("its bound is no probability")
    if gap is not None and not (isinstance(gap, float | int) and 0 <= gap <= 1):
        raise ValueError("its gap is no probability")
