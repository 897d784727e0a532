"""Networks of logRASM (CAV 2025), certified as they are from every start, beside the seconds that were published.

The weights are not part of this package (they are under another licence): a folder is given, whose files are called
``<model><layout>_<seed>.npz`` and hold ``kernel_0, bias_0, ..`` of layers ``x @ kernel + bias`` with relu between
them. Models and layouts are those of LAVA-LAB/logRASM, commit 6317272; published seconds are of a GPU.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....envs.systems.agents import Agent
from ....envs.systems.arguments import write_json, write_text
from ....envs.systems.backends import on_one_thread
from ....envs.tasks.problem import Problem, Specification
from ....envs.tasks.regions import Proposition
from ....synthesis.certificates.proofs import canonical_bytes, significant_up
from ....synthesis.checker import check_contents, parse_file
from ....synthesis.interop import as_policy
from ....synthesis.verbs.certify import certify

AIM = 1e-6
"""Failure from every start that the published certificates speak of: a probability of .999999."""

HORIZON = 60
"""Steps: the published task has no deadline, so that a bound with one is below it."""

Corners = tuple[tuple[float, ...], tuple[float, ...]]


@dataclass(frozen=True)
class Benchmark:
    """One model and layout: what moves, where runs start, what is to be avoided, and what was published."""

    title: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    dynamics: tuple[str, ...]
    noise: Any
    limit: float
    starts: tuple[Corners, ...]
    unsafe: tuple[Corners, ...]
    published: str

    def problem(self, start: Corners) -> Problem:
        """Return the problem from one of the boxes of starts: reach the target, and avoid what is unsafe before."""
        box = [self.limit] * 2
        agent = Agent(
            name="agent", states=self.states, inputs=self.inputs, dynamics=self.dynamics, noise=self.noise,
            state_space=([-self.limit] * 2, box), input_space=([-1.0] * len(self.inputs), [1.0] * len(self.inputs)),
            start=([*start[0]], [*start[1]]),
        )  # fmt: skip
        regions = {"target": Proposition("agent", [-0.2, -0.2], [0.2, 0.2])}
        regions |= {f"unsafe_{k}": Proposition("agent", *map(list, corners)) for k, corners in enumerate(self.unsafe)}
        task = Specification("!(unsafe_0 | unsafe_1) U target")
        return Problem(
            name=re.sub(r"\W+", "-", self.title),
            horizon=HORIZON,
            agents=[agent],
            propositions=regions,
            specification=task,
        )


def _triangle(half: float) -> dict[str, Any]:
    return {"law": "triangular", "low": -half, "mode": 0.0, "high": half}


LINEAR = (("x", "v"), ("u",), ("x + 0.045*v + 0.45*u", "0.9*v + 0.5*u"), [_triangle(0.01), _triangle(0.005)], 1.5)
PENDULUM = (
    ("x", "v"), ("u",), ("x + 0.05*(0.9*v + 0.75*sin(x) + 8*u)", "0.9*v + 0.75*sin(x) + 8*u"),
    {"laws": [_triangle(1.0), _triangle(1.0)], "axes": [[0.001, 0.01], [0.02, 0.0]]}, 0.7,
)  # fmt: skip
# how far the obstacles are, 1 beyond .3
ABOVE, BELOW = (f"min(1, sqrt(x^2 + (y {sign} 1)^2)/0.3)" for sign in "-+")
COLLISION = (
    ("x", "y"), ("a", "b"),
    (f"x + 0.4*{BELOW}*{ABOVE}*a", f"y + 0.2*({BELOW}*(2*{ABOVE}*b + 1 - {ABOVE}) - (1 - {BELOW}))"),
    [_triangle(0.05), _triangle(0.05)], 1.0,
)  # fmt: skip

BENCHMARKS = {
    "LinearSystem0": Benchmark(
        "linear-sys", *LINEAR, (((-0.25, -0.1), (-0.2, 0.1)), ((0.2, -0.1), (0.25, 0.1))),
        (((-1.5, -1.5), (-1.4, 0.0)), ((1.4, 0.0), (1.5, 1.5))), "37 to 54 s",
    ),
    "LinearSystem1": Benchmark(
        "linear-sys, hard layout", *LINEAR, (((-1.4, -0.1), (-1.3, 0.1)), ((1.3, -0.1), (1.4, 0.1))),
        (((-0.9, -0.2), (-0.7, 0.2)), ((0.7, -0.2), (0.9, 0.2))), "140 to 217 s",
    ),
    "MyPendulum0": Benchmark(
        "pendulum", *PENDULUM, (((-0.3, -0.3), (0.3, 0.3)),),
        (((-0.7, -0.7), (-0.6, 0.0)), ((0.6, 0.0), (0.7, 0.7))), "106 to 243 s",
    ),
    "CollisionAvoidance0": Benchmark(
        "collision-avoid", *COLLISION, (((-1.0, -0.6), (-0.9, 0.6)), ((0.9, -0.6), (1.0, 0.6))),
        (((-0.3, 0.7), (0.3, 1.0)), ((-0.3, -1.0), (0.3, -0.7))), "135 to 143 s",
    ),
}  # fmt: skip
"""By model and layout, as files are called."""


@dataclass(frozen=True)
class NetworkRow:
    """What one network gets.

    ``failure`` is an upper bound on the probability of failing from every start (1 if nothing is certified), ``cells``
    how many cells of starts there are, ``search`` and ``check`` are processor seconds.
    """

    network: str
    benchmark: str
    published: str
    failure: float
    cells: int
    search: float
    check: float
    why: str = ""


def networks_in(folder: Path) -> list[Path]:
    """Return the files of networks in a folder, in order.

    Raises
    ------
    ValueError
        If there is no such folder, or no network in it.
    """
    names = "|".join(BENCHMARKS)
    files = sorted(folder.glob("*.npz")) if folder.is_dir() else []
    found = [file for file in files if re.fullmatch(rf"({names})_\d+", file.stem)]
    if not found:
        raise ValueError(
            f"`--weights`: expected a folder with networks of logRASM, <model>_<seed>.npz of {', '.join(BENCHMARKS)}, "
            f"got {str(folder)!r}, which has none; they are in LAVA-LAB/logRASM, not in this package"
        )
    return found


def certified_networks(folder: Path) -> Iterator[NetworkRow]:
    """Yield what the networks of a folder get, one after the other."""
    for file in networks_in(folder):
        yield certified_network(file)


@on_one_thread
def certified_network(file: Path) -> NetworkRow:
    """Certify one network from all boxes of starts, and prove every certificate by its file."""
    benchmark, worst, cells, why = BENCHMARKS[file.stem.rpartition("_")[0]], 0.0, 0, ""
    search, check = 0.0, 0.0
    for start in benchmark.starts:
        problem = benchmark.problem(start)
        policy = as_policy(_layers(file), problem, env="parallel_env(automaton=hidden)", activation="relu")
        began = time.process_time()
        try:
            certificate: Any = certify(problem, policy, relation="path").certificate
        except ValueError as refused:
            worst, why, search = 1.0, str(refused), search + time.process_time() - began
            continue
        middle = time.process_time()
        verdict = check_contents(parse_file(canonical_bytes(certificate)))
        check += time.process_time() - middle
        search += middle - began
        each = (
            [failure for failure, *_ in verdict.steps] if certificate.proof.kind == "starts" else [verdict.recomputed]
        )
        worst, cells = max(worst, *each) if verdict else 1.0, cells + len(each)
    return NetworkRow(
        file.stem, benchmark.title, benchmark.published, worst, cells, round(search, 2), round(check, 2), why
    )


def _layers(file: Path) -> list[tuple[Any, Any]]:
    """Return the layers of a network, with a column for the time left, of which it is told nothing."""
    with np.load(file, allow_pickle=False) as stored:
        count = sum(name.startswith("kernel_") for name in stored.files)
        layers = [
            (stored[f"kernel_{k}"].astype(np.float32), stored[f"bias_{k}"].astype(np.float32)) for k in range(count)
        ]
    first = np.concatenate([layers[0][0], np.zeros((1, layers[0][0].shape[1]), np.float32)])
    return [(first, layers[0][1]), *layers[1:]]


COLUMNS = ("network", "published (GPU)", "failure from every start", "cells", "search + check")


def table(rows: Sequence[NetworkRow]) -> str:
    """Return rows as a table in Markdown."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    for row in rows:
        failure = significant_up(row.failure, 2) if row.failure < 1.0 else f"nothing: {row.why}"
        seconds = f"{row.search:.1f} + {row.check:.1f} s"
        lines.append(f"| {row.network} | {row.published} | {failure} | {row.cells} | {seconds} |")
    return "\n".join(lines) + "\n"


def write_networks(rows: Sequence[NetworkRow], out: Path) -> None:
    """Write rows as JSON and as a table."""
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "lograsm.json", [asdict(row) for row in rows])
    write_text(out / "lograsm.md", table(rows))
