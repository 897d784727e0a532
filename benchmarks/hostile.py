"""Hostile files, formulas and options, one by one under limits of time and memory.

    python benchmarks/hostile.py                     all of them, each in a process of its own
    python benchmarks/hostile.py --only NAME ...     some of them, in this process: what ``limited`` starts

Each must be refused with ``ValueError`` or ``OSError``, or be answered, within ``SECONDS`` and ``BYTES``. Anything else
is a finding: another exception, more time, more memory.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import resource
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import certigym as cg
from certigym.synthesis.certificates.proofs import CheckReport
from forgeries import opened, written

SECONDS, BYTES = 20.0, 3 * 2**30
"""Limits of one case, in CPU time; libraries alone reserve about one GiB of addresses."""

PATIENCE = 15.0
"""Wall seconds per CPU second after which a process is given up: other work may have the machine."""

Case = Callable[[Path], object]


def scalar(**changes: Any) -> dict[str, Any]:
    """Return the arguments of a harmless agent on [-1, 1], some of them changed."""
    agent: dict[str, Any] = {
        "name": "robot", "A": [[0.9]], "B": [[1.0]], "noise_covariance": [[0.04]], "state_low": [-1.0],
        "state_high": [1.0], "input_low": [-0.5], "input_high": [0.5], "initial_state": [0.1],
    }  # fmt: skip
    return agent | changes


def problem(task: str, semantics: str = "co-safe", horizon: int = 4, **changes: Any) -> cg.Problem:
    """Return a problem of one scalar agent with a region ``g`` in the middle."""
    region = changes.pop("region", ([0.0], [0.5]))
    return cg.Problem(
        name="hostile",
        horizon=horizon,
        agents=[cg.LinearAgent(**scalar(**changes))],
        propositions={"g": cg.Proposition("robot", *region)},
        specification=cg.Specification(task, semantics),
    )


def forged(folder: Path, forge: Callable[[dict[str, Any], list[np.ndarray]], None], **options: Any) -> object:
    """Check a small certificate whose header or arrays were changed, the digest computed anew."""
    file = folder / "certificate.npz"
    cg.save(cg.synthesize(problem("F g"), 12, **options), file)
    header, arrays = opened(file)
    forge(header, arrays)
    written(file, header, arrays)
    return cg.check(cg.load(file))


def _in_header(key: str, value: Any, **options: Any) -> Case:
    def case(folder: Path) -> object:
        def forge(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
            (header if key in header else header["proof"])[key] = value

        return forged(folder, forge, **options)

    return case


def _in_relation(entry: str, value: Any, **options: Any) -> Case:
    def forge(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
        header["proof"]["agents"][0]["relation"][entry] = value

    return lambda folder: forged(folder, forge, **options)


def _of_formula(text: str, semantics: str = "co-safe", horizon: int = 4) -> Case:
    return lambda folder: cg.synthesize(problem(text, semantics, horizon), 12)


def _bytes(data: bytes) -> Case:
    def case(folder: Path) -> object:
        file = folder / "certificate.npz"
        file.write_bytes(data)
        return cg.load(file)

    return case


def long_header(folder: Path) -> object:
    """Load a file of 175 kB whose header unpacks to 180 MB of JSON."""
    file, text = folder / "certificate.npz", io.BytesIO()
    numbers = b"[" + b"0," * 90_000_000 + b"0]"
    header = b'{"format": "certigym-certificate", "version": 2, "settings": ' + numbers + b"}"
    np.lib.format.write_array(text, np.frombuffer(header, dtype=np.uint8))
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("header.npy", text.getvalue())
    return cg.load(file)


def zip_bomb(folder: Path) -> object:
    """Load a file whose array would unpack to 4 GB."""
    file = folder / "certificate.npz"
    description = {"descr": "|u1", "fortran_order": False, "shape": (2**32,)}
    with (
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("0.npy", "w", force_zip64=True) as entry,
    ):
        np.lib.format.write_array_header_1_0(entry, description)
        for _ in range(256):
            entry.write(bytes(2**24))
    return cg.load(file)


def nested_header(folder: Path) -> object:
    """Load a file whose header is nested a hundred thousand times."""
    file, text = folder / "certificate.npz", io.BytesIO()
    np.lib.format.write_array(text, np.frombuffer(b"[" * 100_000 + b"]" * 100_000, dtype=np.uint8))
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("header.npy", text.getvalue())
    return cg.load(file)


def many_cells(folder: Path) -> object:
    """Three agents in the plane, 7 cells per axis with 64 targets each: few cells, and many lattice points."""
    d, agents = 2, []
    for i in range(3):
        agent = scalar(name=f"robot_{i}", A=[[0.4, 0.05 + 0.01 * i], [0.03, 0.3]], B=np.eye(d).tolist())
        agent |= {"noise_covariance": (0.2 * np.eye(d)).tolist(), "initial_state": [0.9] * d}
        agent |= {"state_low": [-1.0] * d, "state_high": [1.0] * d, "input_low": [-3.0] * d, "input_high": [3.0] * d}
        agents.append(cg.LinearAgent(**agent))
    regions = {f"g{i}": cg.Proposition(f"robot_{i}", [-0.7] * d, [0.7] * d) for i in range(3)}
    task = cg.Problem(
        name="many",
        horizon=3,
        agents=agents,
        propositions=regions,
        specification=cg.Specification("F (g0 & g1 & g2)", "co-safe"),
    )
    return cg.synthesize(task, 7, relation="exact", search=cg.SearchOptions(targets_per_cell=8))


def problem_file(text: str) -> Case:
    """Return a case that loads a problem from TOML."""

    def case(folder: Path) -> object:
        file = folder / "problem.toml"
        file.write_text(text, encoding="utf-8")
        return cg.load(file)

    return case


def _window(step: int) -> str:
    return " & ".join(f"F[{k},{k + step}] g" for k in range(0, 40, 2))


CASES: dict[str, Case] = {
    # files
    "rank of 400 digits": _in_header("rank", 10**400),
    "rank below 0": _in_header("rank", -5),
    "bound as a list": _in_header("lower_bound", [0.9]),
    "gap of 400 digits": _in_header("gap", 10**400),
    "bounds of 400 digits": _in_header("bounds", {"nominal": 10**400}),
    "settings are a number": _in_header("settings", 3),
    "no agents": _in_header("agents", []),
    "guards are text": _in_header("guards", "abc"),
    "skeleton is deep": _in_header("skeleton", json.loads("[" * 50 + "]" * 50)),
    "relation of 0.3": _in_relation("kind", "tube", relation="paper"),
    "feedback 1e308": _in_relation("feedback", 1e308, relation="paper"),
    "paper inputs 5e8": _in_relation("inputs", 500_000_000, relation="paper"),
    "paper inputs of 400 digits": _in_relation("inputs", 10**400, relation="paper"),
    "paper epsilon 1e308": _in_relation("epsilon", 1e308, relation="paper"),
    "linear menu of numbers": _in_relation("menu", 0.0, relation="linear"),
    "linear menu 1e308": _in_relation("menu", [[1e308]], relation="linear"),
    "long header": long_header,
    "zip bomb": zip_bomb,
    "nested header": nested_header,
    "empty file": _bytes(b""),
    "not a zip": _bytes(b"PK\x03\x04" + bytes(1000)),
    "half a pickle": _bytes(b"\x93NUMPY\x01\x00v\x00{'descr': '|O'"),
    "problem of a million agents": problem_file('name = "a"\nhorizon = 3\n[[agents]]\nname = "r"\ncopies = 1000000\n'),
    "problem that is no TOML": problem_file("[[[["),
    # numbers
    "region up to 2.66e-239": lambda folder: cg.synthesize(problem("F g", A=[[5.0]], region=([0.0], [2.66e-239])), 12),
    "states of 1e300": lambda folder: cg.synthesize(
        problem("F g", state_low=[-1e300], state_high=[1e300], noise_covariance=[[1e300]], region=([0.0], [1e299])), 12
    ),
    "states of 1e-300": lambda folder: cg.synthesize(
        problem("F g", state_low=[-1e-300], state_high=[1e-300], initial_state=[0.0], region=([0.0], [1e-301])), 12
    ),
    "noise of 1e300": lambda folder: cg.synthesize(problem("F g", noise_covariance=[[1e300]]), 12),
    "noise of 1e-300": lambda folder: cg.synthesize(problem("F g", noise_covariance=[[1e-300]]), 12),
    "A of 1e200": lambda folder: cg.synthesize(problem("F g", A=[[1e200]]), 12),
    "inputs of 1e300": lambda folder: cg.synthesize(problem("F g", input_low=[-1e300], input_high=[1e300]), 12),
    "paper, 5e8 inputs": lambda folder: cg.synthesize(
        problem("F g"), 12, relation="paper", search=cg.SearchOptions(inputs=500_000_000)
    ),
    "1e9 cells": lambda folder: cg.synthesize(problem("F g"), 10**9),
    "1e9 targets per cell": lambda folder: cg.synthesize(
        problem("F g"), 12, relation="exact", search=cg.SearchOptions(targets_per_cell=10**9)
    ),
    "many lattice points": many_cells,
    # formulas
    "X[999]": _of_formula("X[999] g"),
    "X[99999]": _of_formula("X[99999] g"),
    "F[0,2400]": _of_formula("F[0,2400] g"),
    "F[999,1999] G": _of_formula("F[999,1999] G[0,99] g"),
    "windows in windows": _of_formula("F[0,99] (g & F[0,99] (!g & F[0,99] g))"),
    "many windows": _of_formula(_window(20)),
    "ten thousand brackets": _of_formula("(" * 10_000 + "g" + ")" * 10_000),
    "ten thousand negations": _of_formula("!" * 10_000 + "g", "finite-trace"),
    "half a million letters": _of_formula(" & ".join(["g"] * 125_000)),
    "bound of 400 digits": _of_formula(f"F[0,{10**400}] g"),
    "horizon 1e9": _of_formula("F g", horizon=10**9),
}  # fmt: skip


def outcome(name: str) -> dict[str, Any]:
    """Run one case in this process: what became of it, seconds, and largest memory in bytes."""
    began = time.process_time()
    with TemporaryDirectory() as folder:
        try:
            answer = CASES[name](Path(folder))
            result = "refused" if isinstance(answer, CheckReport) and not answer else "answered"
        except (ValueError, OSError) as error:
            result = "refused" if str(error) else "crashed: no words"
        except MemoryError:
            result = "crashed: MemoryError"
        except Exception as error:  # noqa: BLE001 every other exception is a finding
            result = f"crashed: {type(error).__name__}: {str(error)[:80]}"
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {"case": name, "outcome": result, "seconds": time.process_time() - began, "bytes": peak}


def limited(names: list[str], seconds: float = SECONDS, most: int = BYTES) -> Iterator[dict[str, Any]]:
    """Run cases, one after the other, in one process under limits of memory and of CPU ``seconds`` for all of them."""
    limits = ["--bytes", str(most), "--seconds", str(seconds)]
    command = [sys.executable, "-W", "error::RuntimeWarning", __file__, *limits, "--only", *names]
    paths = [path for path in sys.path if path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE * seconds)
    except subprocess.TimeoutExpired as late:
        lines = (late.stdout or b"").decode().splitlines()
        yield from map(json.loads, lines)
        yield {"case": names[min(len(lines), len(names) - 1)], "outcome": "crashed: it does not end"}
        return
    lines = done.stdout.splitlines()
    yield from map(json.loads, lines)
    if done.returncode != 0 or len(lines) < len(names):
        spent = done.returncode == -signal.SIGXCPU
        last = f"more than {seconds:g} s" if spent else (done.stderr.splitlines() or [f"exit {done.returncode}"])[-1]
        yield {"case": names[min(len(lines), len(names) - 1)], "outcome": f"crashed: {last[:80]}"}


def main() -> int:
    """Run the cases; the exit status is 1 if there are findings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", metavar="NAME")
    parser.add_argument("--bytes", type=int, default=BYTES)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    given = parser.parse_args()
    if given.only:
        resource.setrlimit(resource.RLIMIT_AS, (given.bytes, given.bytes))
        resource.setrlimit(resource.RLIMIT_CPU, (round(given.seconds), round(given.seconds) + 5))
        for name in given.only:
            print(json.dumps(outcome(name)), flush=True)
        return 0
    findings = 0
    for name in CASES:
        for row in limited([name]):
            findings += row["outcome"].startswith("crashed")
            seconds, peak = row.get("seconds", float("nan")), row.get("bytes", float("nan")) / 2**20
            print(f"{row['case']:32} {row['outcome']:60} {seconds:7.2f} s {peak:7.0f} MiB", flush=True)
    return int(findings > 0)


if __name__ == "__main__":
    raise SystemExit(main())
