"""Files that say what is not so are refused or unreadable: every entry, array and byte of one was changed in turn.

A change may be harmless (a name, a wider workspace). Then the claim must still be true, which a simulator that shares
no code with the checker is asked. With a false-alarm probability of 1e-6 for all changes together it sees failures that
are .071 above the claim (Hoeffding: 2,000 runs, 500 changes).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np
import pytest

from canonical_simulator import Simulator
from certificate_files import (
    Path,
    archive,
    at,
    changed,
    file_of,
    members_of,
    npy,
    one_crane,
    places,
    two_carts,
    two_tanks,
    without,
)
from certigym.synthesis.checker import Unreadable, check_contents, parse_file
from kinds import mostly_thorough

RUNS, FALSE_ALARM, CHANGES = 2000, 1e-6, 500
SLACK = math.sqrt(math.log(CHANGES / FALSE_ALARM) / (2.0 * RUNS))

WRONG_VALUES: tuple[Any, ...] = (
    None,
    True,
    False,
    -1,
    0,
    1,
    2,
    3,
    10**9,
    2**63,
    0.5,
    -0.0,
    1e-320,
    1e308,
    "x",
    "x + w",
    "true",
    [],
    {},
    [1],
)


def verdict_of(raw: bytes) -> str:
    """``proved``, ``refused`` or ``unreadable``; anything else is an error of the checker."""
    try:
        return "proved" if check_contents(parse_file(raw)) else "refused"
    except Unreadable:
        return "unreadable"


def is_true(header: dict[str, Any], arrays: list[np.ndarray]) -> bool:
    """Whether simulations agree with what a changed file claims, disturbances at either end of their ranges."""
    claim, rng = header["claim"]["failure"], np.random.default_rng(0)
    simulator = Simulator(header["problem"])
    disturbed = any(agent.get("disturbances") for agent in header["problem"]["agents"])
    extremes = (0.0, 1.0) if disturbed else (0.0,)
    failed = max(simulator.failures(header["proof"], arrays, rng, RUNS, extreme) for extreme in extremes)
    return failed / RUNS <= claim + SLACK


KINDS = mostly_thorough("made", [two_carts, two_tanks, one_crane], ids=["trajectory", "cells", "crane"])
SHARES = mostly_thorough(
    ("made", "every"),
    [(two_carts, 5), (two_carts, 1), (two_tanks, 1), (one_crane, 1)],
    ids=["a fifth of trajectory", "trajectory", "cells", "crane"],
)


@pytest.fixture(autouse=True)
def arithmetic_is_right(monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine's arithmetic is asked elsewhere, and not once for each of thousands of files."""
    monkeypatch.setattr("certigym.synthesis.checker.verdict.wrong_arithmetic", lambda: "")


@KINDS
def test_the_file_itself_is_proved_and_true(made: Any) -> None:
    header, arrays = made()
    assert verdict_of(file_of(header, arrays)) == "proved"
    assert is_true(header, arrays)


@KINDS
def test_a_claim_a_little_too_good_is_refused(made: Any) -> None:
    header, arrays = made()
    failure = check_contents(parse_file(file_of(header, arrays))).recomputed
    assert 0.02 < failure < 0.06
    assert verdict_of(file_of(changed(header, ("claim", "failure"), failure), arrays)) == "proved"
    assert verdict_of(file_of(changed(header, ("claim", "failure"), failure * (1 - 1e-12)), arrays)) == "refused"


def header_changes(header: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every entry of the header left out, longer, and replaced by what does not belong there.

    Other numbers in the place of a number are three of all at random. Of entries that are like one before, in another
    list or of another agent, two changes stand for all.
    """
    seen: set[str] = set()
    rng = np.random.default_rng(0)
    for path in places(header):
        here = at(header, path)
        like, changes = (
            json.dumps([[key for key in path if isinstance(key, str)], here]),
            list(changes_at(header, path)),
        )
        if is_number(here):
            numbers = [change for change in changes if is_number(change[2])]
            changes = [change for change in changes if not is_number(change[2])]
            changes += [numbers[k] for k in rng.choice(len(numbers), 3, replace=False)]
        if like in seen:
            changes = [changes[k] for k in rng.choice(len(changes), 2, replace=False)]
        seen.add(like)
        yield from ((what, forged) for what, forged, _ in changes)


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def changes_at(header: dict[str, Any], path: Path) -> Iterator[tuple[str, dict[str, Any], Any]]:
    """What is changed, the header, and what stands there instead."""
    here = at(header, path)
    yield f"without {path}", without(header, path), None
    values = [value for value in WRONG_VALUES if type(here) is not type(value) or here != value]
    if isinstance(here, list) and here:
        values += [[*here, here[-1]], here[::-1]]
    if is_number(here):
        values += [here + 1, here - 1, -here]
    for value in values:
        yield f"{path} = {value!r}", changed(header, path, value), value


@SHARES
def test_every_change_of_the_header_is_refused_or_harmless(made: Any, every: int) -> None:
    header, arrays = made()
    false, proved, count = [], 0, 0
    for what, forged in islice(header_changes(header), 0, None, every):
        count += 1
        if verdict_of(file_of(forged, arrays)) == "proved":
            proved += 1
            if not is_true(forged, arrays):
                false.append(what)
    assert false == []
    assert count > (700 if every == 1 else 400) and 0 < proved < CHANGES  # names, and limits that nothing rests on


def test_unknown_keys_and_keys_given_twice_are_unreadable() -> None:
    header, arrays = two_carts()
    tables: list[Path] = [path for path in [(), *places(header)] if isinstance(at(header, path), dict)]
    for path in tables:
        if path[-1:] == ("disturbances",):
            continue  # its keys are names
        forged = json.loads(json.dumps(header))
        at(forged, path)["more"] = 1
        assert verdict_of(file_of(forged, arrays)) == "unreadable", path
    text = json.dumps(header)
    for key in ("horizon", "failure", "name", "low", "kind", "format", "formula", "letters"):
        twice = text.replace(f'"{key}":', f'"{key}": 1, "{key}":', 1)
        assert verdict_of(archive(members_of(twice, arrays))) == "unreadable", key


@pytest.mark.parametrize("token", ["NaN", "Infinity", "-Infinity", "1e400", "1" * 400, "-1e999", "0x1", "1_0", "01"])
def test_tokens_that_are_no_numbers_are_unreadable(token: str) -> None:
    header, arrays = two_carts()
    for before in ('"failure": ', '"start_low": [', '"horizon": ', '"noise": [['):
        start = json.dumps(header).index(before) + len(before)
        text = json.dumps(header)
        end = min(text.index(c, start) for c in ",]}" if c in text[start:])
        assert verdict_of(archive(members_of(text[:start] + token + text[end:], arrays))) == "unreadable", before


@pytest.mark.parametrize("token", ["NaN", "Infinity", "-Infinity"])
def test_notes_hold_no_such_tokens_either(token: str) -> None:
    header, arrays = two_carts()
    text = json.dumps({**header, "notes": [1.5]})
    assert verdict_of(archive(members_of(text, arrays))) != "unreadable"
    assert verdict_of(archive(members_of(text.replace("1.5]", f"{token}]"), arrays))) == "unreadable"


def array_changes(array: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """An array with one number changed, other shapes, other types."""
    rng = np.random.default_rng(0)
    floats = (np.nan, np.inf, -np.inf, 1e308, -1e-320, 1e6, -1.0, 0.0)
    numbers = floats if array.dtype.kind == "f" else (-128, 127, 1, 0, -1)
    # of long arrays some places, and of each place some numbers: all of them stand in the first two places
    places = list(np.ndindex(array.shape))
    places = places if len(places) < 10 else [places[k] for k in (0, 1, *rng.choice(len(places), 8, replace=False))]
    for k, place in enumerate(places):
        for number in numbers if k < 2 else rng.choice(numbers, 2, replace=False):
            forged = array.copy()
            forged[place] = number
            yield f"{place} = {number}", forged
    yield "one step less", array[:-1]
    yield "one step more", np.concatenate([array, array[-1:]])
    yield "reversed", array[::-1]
    yield "one column more", np.concatenate([array, array[..., -1:]], axis=-1)
    yield "flat", array.ravel()
    yield "in one more dimension", array[..., None]
    yield "empty", array[:0]
    for dtype in ("<f4", "<f8", "<i8", "<i4", "|i1", "<u4", "|b1", ">f8", ">i4", "<c16", "<U4"):
        if np.dtype(dtype) != array.dtype:
            yield dtype, array.astype(dtype)


@pytest.mark.filterwarnings("ignore:invalid value", "ignore:Casting complex")
@SHARES
def test_every_change_of_an_array_is_refused_or_harmless(made: Any, every: int) -> None:
    header, arrays = made()
    false, proved, count = [], 0, 0
    with np.errstate(all="ignore"):
        for number, array in enumerate(arrays):
            for what, forged in islice(array_changes(array), number % every, None, every):
                count += 1
                files = [*arrays[:number], forged, *arrays[number + 1 :]]
                if verdict_of(file_of(header, files)) == "proved":
                    proved += 1
                    if not is_true(header, files):
                        false.append((number, what))
    assert false == []
    assert count > (100 if every == 1 else 60) and 0 < proved < CHANGES


def test_arrays_that_nothing_names_and_names_without_array_are_unreadable() -> None:
    header, arrays = two_carts()
    assert verdict_of(file_of(header, [*arrays, np.zeros(3)])) == "unreadable"
    assert verdict_of(file_of(header, arrays[:-1])) == "unreadable"
    assert verdict_of(file_of(changed(header, ("proof", "letters"), 9), [*arrays])) == "unreadable"


def test_no_byte_of_an_archive_can_be_changed_unseen() -> None:
    """Members are as they were written, or nothing is read: only versions and attributes mean nothing."""
    raw = file_of(*two_carts())
    meaningless = set()
    at_directory, count = raw.index(b"PK\x01\x02"), 10
    place = 0
    for _ in range(count):  # version needed of each member, and in the directory version, version needed, attributes
        meaningless |= {place + 4, place + 5}
        place += (
            30
            + int.from_bytes(raw[place + 26 : place + 28], "little")
            + int.from_bytes(raw[place + 22 : place + 26], "little")
        )
    place = at_directory
    for _ in range(count):
        meaningless |= {place + k for k in (4, 5, 6, 7, *range(34, 42))}
        place += 46 + int.from_bytes(raw[place + 28 : place + 30], "little")
    rng = np.random.default_rng(0)
    for k in [*range(60), *rng.integers(60, at_directory, 600).tolist(), *range(at_directory, len(raw))]:
        if k in meaningless:
            continue
        forged = bytearray(raw)
        forged[k] ^= int(rng.integers(1, 256))
        assert verdict_of(bytes(forged)) == "unreadable", k


def test_files_that_are_cut_off_or_longer_are_unreadable() -> None:
    raw = file_of(*two_carts())
    for k in [*range(0, len(raw), 97), len(raw) - 1]:
        assert verdict_of(raw[:k]) == "unreadable", k
    assert verdict_of(raw + b"\0") == "unreadable"
    assert verdict_of(b"\0" + raw) == "unreadable"


def test_members_are_what_and_where_they_should_be() -> None:
    members = members_of(*two_carts())
    assert verdict_of(archive(members)) == "proved"
    for wrong in (
        members[1:],
        members[::-1],
        [*members, ("0.npy", members[1][1])],
        [*members, ("header.json", members[0][1])],
        [*members[:-1], ("../8.npy", members[-1][1])],
        [*members[:-1], ("x" * 50, members[-1][1])],
        [("header.json", b"\xff" + members[0][1]), *members[1:]],
        [("header.json", b"[" * 100_000), *members[1:]],
        [("header.json", b"[]"), *members[1:]],
        [members[0], ("0.npy", members[1][1].replace(b"False", b"True ")), *members[2:]],
        [members[0], ("0.npy", b"\x93NUMPY\x02\x00" + members[1][1][8:]), *members[2:]],
        [members[0], ("0.npy", npy(np.zeros(5))[:-1]), *members[2:]],
        [members[0], ("0.npy", npy(np.zeros((5, 4))).replace(b"(5, 4)", b"(5, 10**9)")), *members[2:]],
        [members[0], ("0.npy", npy(np.zeros((5, 4))).replace(b"(5, 4)", b"(" + b"9" * 5000 + b", 4)")), *members[2:]],
    ):
        assert verdict_of(archive(wrong)) == "unreadable"
