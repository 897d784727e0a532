"""A stranger with the file and the package can check and validate it; no other file does harm or is believed."""

from __future__ import annotations

import io
import os
import struct
import subprocess
import sys
import tracemalloc
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certificate_archives import contents, packed
from certigym.cli.main import main
from certigym.synthesis.certificates.proofs import OnGrid
from certigym.synthesis.extended_check.claims.regrown_tree import regrow
from certigym.synthesis.relations.grids import Grid
from problems import two_agents
from test_rollouts_agree_with_certificates import changed, planar

REFUSED = "expected a certigym certificate"


@pytest.fixture(scope="module")
def certificate() -> OnGrid:
    return cg.synthesize(two_agents("F (a & F c)", horizon=3), 24).certificate


@pytest.fixture(scope="module")
def raw(certificate: OnGrid, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("certificates") / "c.npz"
    cg.save(certificate, path)
    return path.read_bytes()


@pytest.mark.thorough
def test_a_stranger_needs_only_the_file(raw: bytes, tmp_path: Path) -> None:
    (tmp_path / "c.npz").write_bytes(raw)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2] / "src")}
    both = "main(['check', 'c.npz']) or main(['validate', 'c.npz', '--episodes', '500'])"
    done = subprocess.run(
        [sys.executable, "-c", f"from certigym.cli.main import main; raise SystemExit({both})"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c.npz"]


def test_every_truncation_is_refused(raw: bytes, tmp_path: Path) -> None:
    path = tmp_path / "c.npz"
    for length in [*range(0, 60, 7), *np.linspace(60, len(raw) - 1, 60).astype(int)]:
        path.write_bytes(raw[:length])
        with pytest.raises(ValueError, match=REFUSED):
            cg.load(path)


@pytest.mark.thorough
def test_flipped_bits_are_refused_or_without_effect(raw: bytes, certificate: OnGrid, tmp_path: Path) -> None:
    rng, path, refused = np.random.default_rng(0), tmp_path / "c.npz", 0
    for _ in range(125):
        bad = bytearray(raw)
        bad[rng.integers(len(raw))] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(bad))
        try:
            loaded = cg.load(path)
        except ValueError as error:
            assert REFUSED in str(error)
            refused += 1
        else:  # the bit was one of the archive's own that nobody reads, such as a date
            assert loaded.lower_bound == certificate.lower_bound and cg.check(loaded, certificate.problem)
    assert refused > 75


def test_a_forger_who_renews_the_digest_is_caught_by_the_check(raw: bytes, tmp_path: Path) -> None:
    for raise_by in (1e-6, 0.01):
        header, arrays = contents(raw)
        header["proof"]["lower_bound"] = min(1.0, header["proof"]["lower_bound"] + raise_by)
        path = packed(header, arrays, tmp_path / "c.npz")
        assert not cg.check(cg.load(path))
        assert main(["check", str(path)]) == 1
    header, arrays = contents(raw)
    for k in header["proof"]["terms"]["factors"]:
        arrays[k] = arrays[k] * 1.01
    assert not cg.check(cg.load(packed(header, arrays, tmp_path / "c.npz")))


def test_renewed_digests_alone_change_nothing(raw: bytes, certificate: OnGrid, tmp_path: Path) -> None:
    loaded = cg.load(packed(*contents(raw), tmp_path / "c.npz"))
    assert cg.check(loaded, certificate.problem) and loaded.lower_bound == certificate.lower_bound


def set_to(*path: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(header: dict[str, Any]) -> None:
        for key in path[:-1]:
            header = header[key]
        header[path[-1]] = value

    return change


def nested(depth: int) -> Any:
    value: Any = []
    for _ in range(depth):
        value = [value]
    return value


HOSTILE: dict[str, Callable[[dict[str, Any]], None]] = {
    "newer version": set_to("version", value=3),
    "no version": lambda h: h.pop("version"),
    "another format": set_to("format", value="zip"),
    "another fingerprint": set_to("fingerprint", value="0" * 64),
    "endless horizon": set_to("problem", "horizon", value=10**30),
    "long horizon": set_to("problem", "horizon", value=10**6),
    "bound above 1": set_to("proof", "lower_bound", value=1.5),
    "bound of no number": set_to("proof", "lower_bound", value=float("nan")),
    "negative gap": set_to("proof", "gap", value=-0.1),
    "rank as text": set_to("proof", "rank", value="many"),
    "rounding above 1": set_to("proof", "relative_rounding", value=7.0),
    "array that is not there": set_to("proof", "guards", 0, value=10**6),
    "huge array number": set_to("proof", "guards", 0, value=10**400),
    "no agents": set_to("proof", "agents", value=[]),
    "law as masks": lambda h: h["proof"]["agents"][0].update(law=h["proof"]["agents"][0]["masks"]),
    "lattice as law": lambda h: h["proof"]["agents"][0].update(lattice=[h["proof"]["agents"][0]["law"]]),
    "two axes": lambda h: h["proof"]["agents"][0].update(edges=h["proof"]["agents"][0]["edges"] * 2),
    "short tree": lambda h: h["proof"]["skeleton"].pop(),
    "tree of nothing": set_to("proof", "skeleton", value=[[]] * 3),
    "terms swapped": lambda h: h["proof"]["terms"].update(index=h["proof"]["terms"]["factors"]),
    "formula bomb": set_to("problem", "specification", value={"formula": "F(" * 2000, "semantics": "co-safe"}),
    "deep settings": set_to("settings", value={"a": nested(500)}),
    "proof of another kind": set_to("proof", "kind", value="path"),
    "proof of an unknown kind": set_to("proof", "kind", value="oath"),
    "no proof": lambda h: h.pop("proof"),
    "opposite that is no file": set_to("proof", "opposite", value=0),
    "no problem": lambda h: h.pop("problem"),
    "endless matrix": set_to("problem", "agents", 0, "A", value=[[1e400]]),
}


@pytest.mark.parametrize("name", [n for n in HOSTILE if n != "deep settings"])
def test_hostile_headers_are_refused_in_one_line(
    raw: bytes, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header, arrays = contents(raw)
    HOSTILE[name](header)
    try:
        path = packed(header, arrays, tmp_path / "c.npz")
    except ValueError:  # no number in JSON: write it without a digest
        path = packed(header, arrays, tmp_path / "c.npz", renew=False)
    assert main(["check", str(path)]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1 and REFUSED in said[0], said
    if "version" in name:
        with pytest.raises(ValueError, match="its version is"):
            cg.load(path)


def test_settings_may_be_anything_but_deep(raw: bytes, tmp_path: Path) -> None:
    header, arrays = contents(raw)
    HOSTILE["deep settings"](header)
    cg.load(packed(header, arrays, tmp_path / "c.npz"))
    text = b'{"format": ' + b"[" * 200_000 + b"]" * 200_000 + b"}"
    np.savez(tmp_path / "d.npz", header=np.frombuffer(text, dtype=np.uint8))
    with pytest.raises(ValueError, match=REFUSED):
        cg.load(tmp_path / "d.npz")


def npy_header(shape: tuple[int, ...], dtype: str) -> bytes:
    text = repr({"descr": dtype, "fortran_order": False, "shape": shape}).encode()
    text += b" " * (-(10 + len(text) + 1) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


@pytest.mark.parametrize(
    "member",
    [
        npy_header((2**40,), "<f8"),
        npy_header((2**31, 2**31), "|b1"),
        npy_header((10,), "|O") + b"\x80\x04N.",
        npy_header((-5,), "<f8"),
        b"\x93NUMPY\x01\x00",
        b"",
        b"\x80\x04N.",
        npy_header((3,), "<f8") + bytes(99),
    ],
    ids=["shape bomb", "overflowing shape", "objects", "negative shape", "no header", "empty", "pickle", "too long"],
)
def test_hostile_arrays_are_refused_before_memory_is_taken(raw: bytes, member: bytes, tmp_path: Path) -> None:
    path = tmp_path / "c.npz"
    with zipfile.ZipFile(io.BytesIO(raw)) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            new.writestr(name, member if name == "1.npy" else old.read(name))
    tracemalloc.start()
    with pytest.raises(ValueError, match=REFUSED):
        cg.load(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 50e6


def test_archives_that_unpack_to_too_much_are_refused(raw: bytes, tmp_path: Path) -> None:
    path = tmp_path / "c.npz"
    header, arrays = contents(raw)
    packed(header, [*arrays, np.zeros(4_000_000)], path)
    assert path.stat().st_size < 1_000_000
    with pytest.raises(ValueError, match=r"it would unpack to .* bytes, more than 10000000"):
        cg.load(path, max_bytes=10_000_000)
    assert cg.check(cg.load(path))
    with pytest.raises(ValueError, match="more than 100"):
        cg.load(path, max_bytes=100)


def test_files_are_refused_at_the_cost_of_what_they_unpack_to(raw: bytes, tmp_path: Path) -> None:
    path = tmp_path / "c.npz"
    header, arrays = contents(raw)
    packed(header, [*arrays, np.zeros(4_000_000)], path)
    size = sum(array.nbytes for array in contents(path.read_bytes())[1])
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(tmp_path / "changed.npz", "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            new.writestr(name, old.read(name)[:-1] + b"!" if name == "1.npy" else old.read(name))
    tracemalloc.start()
    with pytest.raises(ValueError, match="the digest differs"):
        cg.load(tmp_path / "changed.npz")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1.3 * size


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_arrays_of_one_name_are_refused(raw: bytes, tmp_path: Path) -> None:
    path = tmp_path / "c.npz"
    path.write_bytes(raw)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("0.npy", archive.read("1.npy"))
    with pytest.raises(ValueError, match="two arrays of one name"):
        cg.load(path)


def test_grids_that_leave_a_part_of_the_workspace_out_do_not_check() -> None:
    """A smaller grid would lend its edge cells to far states."""
    problem = planar()
    certificate = cg.synthesize(problem, {"plane": [12, 12], "line": 16}, relation="exact").certificate
    assert cg.check(certificate)
    part = certificate.proof.agents[0]
    inner = np.zeros(part.grid.shape, dtype=bool)
    inner[3:, 3:] = True
    kept = inner.ravel()
    cut = replace(
        part,
        grid=Grid(tuple(edges[3:].copy() for edges in part.grid.edges)),
        masks=part.masks[:, kept],
        start_masks=part.start_masks[:, kept],
        policy=part.policy[:, :, kept],
    )
    bad = changed(certificate, agents=(cut, *certificate.proof.agents[1:]), lower_bound=0.0)
    bad = changed(bad, terms=regrow(bad))
    report = cg.check(bad)
    assert not report and "does not tile" in report.failures[0]
