"""Forged certificates: every field of a file changed, one at a time, the digest computed anew.

The forger adapts the claim to what the changed file would prove. So a forgery counts as harmless only if it is refused,
or if its own controllers keep what it claims in an independent simulation.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

Header = dict[str, Any]
Arrays = list[np.ndarray]
Forgery = tuple[str, Callable[[Header, Arrays], None]]
"""A name, and a change of header and arrays in place."""


def opened(path: Path) -> tuple[Header, Arrays]:
    """Header and arrays of a certificate's file, free to be changed."""
    with np.load(path) as archive:
        header = json.loads(bytes(archive["header"]).decode())
        return header, [archive[str(k)].copy() for k in range(len(archive.files) - 1)]


def written(path: Path, header: Header, arrays: Arrays) -> None:
    """Write header and arrays with the digest that belongs to them."""
    header = {name: value for name, value in header.items() if name != "digest"}
    state = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
    for array in arrays:
        state.update(f"{array.dtype.str}{array.shape}".encode())
        state.update(np.ascontiguousarray(array).tobytes())
    header["digest"] = state.hexdigest()
    file = io.BytesIO()
    text = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    np.savez_compressed(file, header=text, **{str(k): array for k, array in enumerate(arrays)})  # type: ignore[arg-type]
    path.write_bytes(file.getvalue())


def forgeries(header: Header, arrays: Arrays, rng: np.random.Generator, per_array: int) -> Iterator[Forgery]:
    """All forgeries of one file; of each array, ``per_array`` random ones."""
    yield from _claims()
    yield from _of_numbers(header, ())
    yield from _of_structure(header)
    for number in range(len(arrays)):
        changes = list(_of_array(arrays[number], rng))
        for k in rng.permutation(len(changes))[:per_array]:
            name, change = changes[k]
            yield f"array {number}: {name}", _on_array(number, change)


def _on_array(number: int, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Header, Arrays], None]:
    def forge(header: Header, arrays: Arrays) -> None:
        arrays[number] = change(arrays[number])

    return forge


def _claims() -> Iterator[Forgery]:
    def raised(header: Header, arrays: Arrays) -> None:
        header["proof"]["lower_bound"] = min(1.0, 1.01 * header["proof"]["lower_bound"] + 0.001)
        header["proof"]["bounds"] = dict.fromkeys(header["proof"]["bounds"], header["proof"]["lower_bound"])

    def listed(header: Header, arrays: Arrays) -> None:
        header["proof"]["bounds"] = dict.fromkeys(
            header["proof"]["bounds"], min(1.0, 1.01 * header["proof"]["lower_bound"] + 0.001)
        )

    def exact(header: Header, arrays: Arrays) -> None:
        header["proof"]["gap"] = 0.0

    def unreserved(header: Header, arrays: Arrays) -> None:
        header["proof"]["relative_rounding"] = 0.0

    yield "bound raised", raised
    yield "another bound raised", listed
    yield "said to be exact", exact
    yield "no reserve for rounding", unreserved


def _of_numbers(entry: Any, path: tuple[Any, ...]) -> Iterator[Forgery]:
    """Every number and word of the header but for the problem and the numbers of the arrays."""
    items = entry.items() if isinstance(entry, dict) else enumerate(entry) if isinstance(entry, list) else ()
    for key, value in items:
        here = (*path, key)
        if here in (
            ("problem",),
            ("fingerprint",),
            ("digest",),
            ("settings",),
            ("proof", "skeleton"),
            ("proof", "terms"),
        ):
            continue
        if isinstance(value, dict | list):
            yield from _of_numbers(value, here)
            continue
        others: list[Any] = []
        if isinstance(value, bool):
            others = [not value]
        elif isinstance(value, int):
            others = [value + 1, value - 1, 10**400, -(10**30), 0.5]
        elif isinstance(value, float):
            others = [0.0, 0.5 * value, 1.1 * value, -value, 1e-300, 1e300, 10**400]
        elif isinstance(value, str):
            others = ["", "exact", "paper", "nominal", "a-posteriori", "robust tree", "mean"]
        for other in (*others, None, [], "x" * 50):
            if other != value:
                yield f"{'.'.join(map(str, here))} = {str(other)[:12]}", _set(here, other)


def _set(path: tuple[Any, ...], value: Any) -> Callable[[Header, Arrays], None]:
    def forge(header: Header, arrays: Arrays) -> None:
        entry: Any = header
        for key in path[:-1]:
            entry = entry[key]
        entry[path[-1]] = value

    return forge


def _of_structure(header: Header) -> Iterator[Forgery]:
    """Vertices listed twice, agents exchanged, guards repeated."""

    def doubled(header: Header, arrays: Arrays) -> None:
        for entry in header["proof"]["skeleton"][0]:
            origin, kept = arrays[entry[0]], arrays[entry[4]]
            entry[0], entry[4] = len(arrays), len(arrays) + 1
            twice = np.concatenate([kept, kept + len(origin)]).astype(kept.dtype)
            arrays += [np.concatenate([origin, origin]), twice]
        for q, entry in enumerate(header["proof"]["skeleton"][0]):
            if len(arrays[entry[0]]):
                rows = arrays[header["proof"]["terms"]["index"][q]]
                header["proof"]["terms"]["index"][q] = len(arrays)
                arrays.append(np.concatenate([rows, rows]))

    def exchanged(header: Header, arrays: Arrays) -> None:
        header["proof"]["agents"] = header["proof"]["agents"][::-1]

    def repeated(name: str) -> Callable[[Header, Arrays], None]:
        def forge(header: Header, arrays: Arrays) -> None:
            header["proof"][name] = [len(arrays) + k for k in range(len(header["proof"][name]))]
            arrays += [np.concatenate([arrays[k], arrays[k]]) for k in original[name]]

        original = {name: header["proof"][name]}
        return forge

    if header["proof"].get("skeleton"):
        yield "vertices listed twice", doubled
    yield "agents exchanged", exchanged
    yield "guards repeated", repeated("guards")
    yield "start guards repeated", repeated("start_guards")


def _of_array(array: np.ndarray, rng: np.random.Generator) -> Iterator[tuple[str, Callable[[np.ndarray], np.ndarray]]]:
    """Changes of one array."""
    if array.size == 0:
        yield "one more", lambda a: np.zeros((1, *a.shape[1:]), dtype=a.dtype)
        return
    place = tuple(int(rng.integers(n)) for n in array.shape)

    def put(value: Any) -> Callable[[np.ndarray], np.ndarray]:
        def change(a: np.ndarray) -> np.ndarray:
            a = a.copy()
            a[place] = value
            return a

        return change

    if array.dtype.kind == "b":
        yield "one flipped", lambda a: np.where(_at(a, place), ~a, a)
        yield "all true", lambda a: np.ones_like(a)
        yield "all flipped", lambda a: ~a
    elif array.dtype.kind in "iu":
        info = np.iinfo(array.dtype)
        for value in (
            0,
            -1 if array.dtype.kind == "i" else 0,
            int(array.max()),
            int(array.max()) + 1,
            info.max,
            info.min,
        ):
            yield f"one is {value}", put(value)
        yield "all the largest", lambda a: np.full_like(a, a.max())
        yield "all 0", lambda a: np.zeros_like(a)
        yield "all but one higher", lambda a: np.minimum(a + 1, a.max()).astype(a.dtype)
    else:
        spread = float(np.ptp(array)) or 1.0
        held = float(array[place])
        for other in (0.0, 2 * held, held + 0.01 * spread, held - 0.01 * spread, 1e300, 5e-324, np.nan, np.inf):
            yield f"one is {other:g}", put(other)
        for factor in (1.001, 1.1, 0.9, -1.0, 1e9):
            yield f"times {factor:g}", lambda a, factor=factor: a * factor  # type: ignore[misc]
        yield "moved", lambda a: a + 0.01 * spread
        yield "all ones", lambda a: np.ones_like(a)
    yield "shuffled", lambda a: rng.permutation(a)
    yield "reversed", lambda a: a[::-1].copy()
    yield "twice", lambda a: np.concatenate([a, a])
    yield "without its last", lambda a: a[:-1].copy()
    yield "empty", lambda a: a[:0].copy()
    yield "of another type", lambda a: a.astype(np.float32 if a.dtype.kind == "f" else np.float64)


def _at(array: np.ndarray, place: tuple[int, ...]) -> np.ndarray:
    mask = np.zeros(array.shape, dtype=bool)
    mask[place] = True
    return mask
