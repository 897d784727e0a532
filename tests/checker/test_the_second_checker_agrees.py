"""The checker and a second one in C, written from the page of the format, say the same of certificate files.

What one proves the other one proves, with next to the same failure, for files made by hand and by the search. No change
of a file makes the second one crash, nor prove what the first one refuses.
"""

from __future__ import annotations

import copy
import io
import json
import re
import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certificate_files import archive, changed, file_of, members_of, npy, two_carts, two_tanks
from certigym.envs.suite import make_problem
from certigym.envs.tasks.problem import load_problem
from certigym.synthesis.certificates.proofs.canonical import canonical_bytes
from certigym.synthesis.checker import Unreadable, check_contents, parse_file
from kinds import mostly_thorough
from test_forged_files_are_refused import array_changes, header_changes

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "benchmarks" / "second_checker" / "checker.c"
COMPILER = next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)
pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler on this machine")

WORDS = {0: "PROVED", 1: "REFUSED", 2: "UNREADABLE", 3: "NOT COVERED"}


def compiled(folder: Path, *options: str) -> Path | None:
    """The second checker, or nothing if the compiler does not know the options."""
    program = folder / "checker"
    common = ["-std=c11", "-ffp-contract=off", "-frounding-math"]
    command = [str(COMPILER), *common, *options, "-o", str(program), str(SOURCE), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    return program if done.returncode == 0 else None


class Second:
    """The second checker, as files and exit statuses."""

    def __init__(self, program: Path, folder: Path) -> None:
        self.program, self.file = program, folder / "file.npz"

    def __call__(self, raw: bytes) -> tuple[int, float, str]:
        """Exit status, failure (2 if there is none), and what was printed."""
        self.file.write_bytes(raw)
        done = subprocess.run([str(self.program), str(self.file)], capture_output=True, text=True, timeout=300)
        assert done.stderr == "" and done.returncode in WORDS, (done.returncode, done.stdout, done.stderr)
        assert done.stdout.startswith(WORDS[done.returncode] + ": ") and done.stdout.count("\n") == 1
        found = re.search(r"failure <= (\S+)", done.stdout)
        return done.returncode, float(found[1]) if found else 2.0, done.stdout


@pytest.fixture(scope="module")
def second(tmp_path_factory: pytest.TempPathFactory) -> Second:
    folder = tmp_path_factory.mktemp("second_checker")
    program = compiled(folder, "-O2", "-Wall", "-Wextra", "-Werror")
    assert program, "checker.c does not compile"
    return Second(program, folder)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Second:
    """The second checker with every access and operation watched, where the compiler can do so."""
    folder = tmp_path_factory.mktemp("watched_checker")
    program = compiled(folder, "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all") or compiled(folder)
    assert program, "checker.c does not compile"
    return Second(program, folder)


def first(raw: bytes) -> tuple[str, float]:
    """What the checker says, and the failure that it computes."""
    try:
        with np.errstate(all="ignore"):
            verdict = check_contents(parse_file(raw))
    except Unreadable:
        return "unreadable", 2.0
    return ("proved", verdict.recomputed) if verdict else ("refused", 2.0)


def two_tanks_of_targets() -> tuple[dict[str, Any], list[np.ndarray]]:
    """The tanks made by hand, where the second one has targets alone, too."""
    header, arrays = two_tanks()
    edges, lattice, inputs = arrays[6], arrays[7], arrays[12]
    middles = 0.5 * edges[:-1] + 0.5 * edges[1:]
    aim = int(np.searchsorted(lattice, 2.0))
    policy = np.full_like(arrays[14], -1)
    policy[0, 0, np.abs(2.0 - 0.8 * middles) < 2.7] = aim
    arrays[14], arrays[12] = policy, np.zeros((0, inputs.shape[1]))
    header = copy.deepcopy(header)
    header["proof"]["agents"][1]["values"] = "cells"
    header["claim"]["failure"] = 0.5
    return header, arrays


MADE_BY_HAND = pytest.mark.parametrize("made", [two_carts, two_tanks_of_targets], ids=["trajectory", "cells"])


@cache
def found(name: str) -> bytes:
    """The file of a certificate that the search finds."""
    if name.endswith(".toml"):
        certificate = cg.synthesize(load_problem(ROOT / "examples" / "own" / name)).certificate
    elif name == "reach-avoid-v0":
        certificate = cg.synthesize(make_problem(name), 60, relation="exact").certificate
    else:
        certificate = cg.synthesize(make_problem(name)).certificate
    assert certificate is not None
    return canonical_bytes(certificate)


def members_in(raw: bytes) -> list[tuple[str, bytes]]:
    """Names and contents of the members of a file."""
    with zipfile.ZipFile(io.BytesIO(raw)) as members:
        return [(name, members.read(name)) for name in members.namelist()]


@MADE_BY_HAND
def test_files_made_by_hand_have_one_verdict(made: Any, second: Second) -> None:
    header, arrays = made()
    raw = file_of(header, arrays)
    (word, failure), (status, other, text) = first(raw), second(raw)
    assert word == "proved" and status == 0, text
    # the second one counts what a strip leaves of a constraint a little more sharply
    assert abs(other - failure) <= (0.02 * failure if made is two_carts else 1e-9)
    for one in (changed(header, ("claim", "failure"), factor * min(failure, other)) for factor in (0.98, 0.5, 0.0)):
        assert first(file_of(one, arrays))[0] == "refused"
        assert second(file_of(one, arrays))[0] == 1


def test_what_is_not_covered_is_said(second: Second) -> None:
    header, arrays = two_tanks()
    assert second(file_of(header, arrays))[0] == 3
    header, arrays = two_carts()
    scaled = changed(header, ("problem", "agents", 0, "noise"), [[0.1]])
    scaled["problem"]["agents"][0]["noise_scale"] = ["1"]
    assert second(file_of(scaled, arrays))[0] == 3
    of_another_law = copy.deepcopy(header)
    of_another_law["problem"]["agents"][0]["distributions"] = [{"law": "laplace", "scale": 1.0}]
    assert second(file_of(of_another_law, arrays))[0] == 3


@mostly_thorough(
    "name",
    ["integrator-chain-v0", "reach-avoid-v0", "car-slalom-v0", "rendezvous-v0", "tanks_side_by_side.toml"],
    first=2,
)
def test_certificates_of_the_search_are_proved_by_both(name: str, second: Second) -> None:
    raw = found(name)
    members = members_in(raw)
    header = json.loads(members[0][1])
    header["claim"]["failure"] = min(1.0, 1.03 * header["claim"]["failure"] + 1e-9)
    looser = archive([("header.json", json.dumps(header).encode()), *members[1:]])
    (word, failure), (status, other, text) = first(raw), second(looser)
    assert word == "proved" and status == 0, text
    if header["proof"]["kind"] == "cells":
        assert abs(other - failure) <= 1e-9
    else:
        assert abs(other - failure) <= 0.03 * failure or max(other, failure) < 1e-15, (failure, other)


def test_the_claim_decides(second: Second) -> None:
    """The failure that the second checker prints is the least one that it proves."""
    header, arrays = two_carts()
    failure = second(file_of(header, arrays))[1]
    assert second(file_of(changed(header, ("claim", "failure"), failure), arrays))[0] == 0
    assert second(file_of(changed(header, ("claim", "failure"), np.nextafter(failure, 0.0)), arrays))[0] == 1


def forged_files(made: Any, every: int) -> Iterator[tuple[str, bytes]]:
    """One of `every` changes of header, arrays, and members."""
    header, arrays = made()
    for k, (what, forged) in enumerate(header_changes(header)):
        if k % every == 0:
            yield what, file_of(forged, arrays)
    with np.errstate(all="ignore"):
        for number, array in enumerate(arrays):
            for k, (what, other) in enumerate(array_changes(array)):
                if (k + number) % every == 0:
                    yield f"array {number}: {what}", file_of(header, [*arrays[:number], other, *arrays[number + 1 :]])


def damaged_files(made: Any, count: int) -> Iterator[tuple[str, bytes]]:
    """Files with other bytes, cut off, longer, with members elsewhere; check sums are right, or not."""
    header, arrays = made()
    raw, rng = file_of(header, arrays), np.random.default_rng(0)
    for place in rng.integers(0, len(raw), count).tolist():
        forged = bytearray(raw)
        forged[place] ^= int(rng.integers(1, 256))
        yield f"byte {place}", bytes(forged)
        yield f"cut at {place}", raw[:place]
    for _ in range(count):  # bytes of members, with check sums renewed
        members = members_of(header, arrays)
        k = int(rng.integers(0, len(members)))
        data = bytearray(members[k][1])
        place = int(rng.integers(0, len(data)))
        data[place] = int(rng.integers(0, 256))
        yield f"byte {place} of member {k}", archive([*members[:k], (members[k][0], bytes(data)), *members[k + 1 :]])
    members = members_of(header, arrays)
    for k, wrong in enumerate(
        (
            members[1:],
            members[::-1],
            [*members, ("0.npy", members[1][1])],
            [("header.json", b"[" * 100_000), *members[1:]],
            [("header.json", b'"\\u'), *members[1:]],
            [("header.json", b'{"a": 1' + b"0" * 500), *members[1:]],
            [("header.json", b""), *members[1:]],
            [members[0], ("0.npy", b"\x93NUMPY\x02\x00" + members[1][1][8:]), *members[2:]],
            [members[0], ("0.npy", npy(np.zeros((5, 4))).replace(b"(5, 4)", b"(5, 10**9)")), *members[2:]],
            [members[0], ("0.npy", npy(np.zeros((5, 4))).replace(b"(5, 4)", b"(99999999999, 4)")), *members[2:]],
            [members[0], ("0.npy", b""), *members[2:]],
        )
    ):
        yield f"members {k}", archive(wrong)
    yield "longer", raw + b"\0"
    yield "empty", b""


def agree(files: Iterator[tuple[str, bytes]], program: Second) -> tuple[int, list[str]]:
    """How many files both proved, and those that the second checker alone proved."""
    both, wrong = 0, []
    for what, raw in files:
        status, _, text = program(raw)
        if status == 0:
            word, other = first(raw)
            both += word == "proved"
            if word != "proved":
                wrong.append(f"{what}: {text.strip()}, the other one {word} ({other})")
    return both, wrong


@pytest.mark.thorough
@MADE_BY_HAND
def test_no_forged_file_is_proved_by_the_second_checker_alone(made: Any, second: Second) -> None:
    both, wrong = agree(forged_files(made, 3), second)
    assert wrong == [] and both > 15


@pytest.mark.thorough
@MADE_BY_HAND
def test_no_forged_file_makes_the_second_checker_stumble(made: Any, watched: Second) -> None:
    both, wrong = agree(forged_files(made, 15), watched)
    assert wrong == [] and both > 3
    _, wrong = agree(damaged_files(made, 50), watched)
    assert wrong == []
