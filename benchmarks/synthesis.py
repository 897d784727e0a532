"""Measure synthesis, rollouts and the paper's method: ``python benchmarks/synthesis.py [--json PATH]``.

Times are CPU seconds of this process on one thread; machines differ, so the last column relates each time to a matrix
product of the same run (1000 x 1000 times 1000 x 1000, float64).
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import certigym as cg
from certigym.synthesis.models.abstraction import abstract
from certigym.synthesis.models.joint import join
from certigym.validation.paper.heuristics import paper_steps


def measured(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the CPU seconds of one call, and what it returned."""
    began = time.process_time()
    result = work()
    return time.process_time() - began, result


def paper_method(problem: cg.Problem, cells: int) -> int:
    """Run the paper's robust tree; return the largest number of terms of its last step."""
    joint = join(problem, abstract(problem, cells, relation="paper", epsilon=0.1))
    *_, last = paper_steps(joint, "robust tree")
    return last.terms.rank


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", metavar="PATH")
    options = parser.parse_args()
    matrix = np.random.default_rng(0).random((1000, 1000))
    unit = min(measured(lambda: matrix @ matrix)[0] for _ in range(5))
    rows = []

    def row(name: str, seconds: float, result: str) -> None:
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        rows.append(
            {"job": name, "cpu_seconds": seconds, "products": seconds / unit, "peak_mib": memory, "result": result}
        )
        print(f"{name:<52} {seconds:8.2f} s {seconds / unit:9.1f} products {memory:7.0f} MiB  {result}", flush=True)

    for horizon in (6, 7):
        problem = cg.make_problem("reach-avoid-v0", horizon=horizon)
        seconds, result = measured(lambda problem=problem: cg.synthesize(problem, 1000))
        row(f"RA2 exact, T={horizon}, 1000 cells", seconds, f"P >= {result.certificate.lower_bound:.6f}")
    problem = cg.make_problem("reach-avoid-v0", horizon=12)
    result = cg.synthesize(problem, 1000)
    seconds, runs = measured(lambda: cg.rollout(problem, result.controller, 100_000))
    row("RA2 100,000 rollouts, T=12", seconds, f"{runs.successes} successes")
    for n in (20, 1000):
        problem = cg.make_problem("invariance-v0", n_agents=n)
        seconds, result = measured(lambda problem=problem: cg.synthesize(problem, 100))
        row(f"IV-{n} exact, T=7, 100 cells", seconds, f"P >= {result.certificate.lower_bound:.8f}")
    seconds, rank = measured(lambda: paper_method(cg.make_problem("reach-avoid-v0", horizon=20), 1000))
    row("RA2 paper's method, T=20, 1000 cells", seconds, f"rank {rank}; published implementation 7.3 s")
    seconds, rank = measured(lambda: paper_method(cg.make_problem("package-delivery-v0"), 1200))
    row("PD8 paper's method, T=20, 1200 cells", seconds, f"rank {rank}; published implementation 60.5 s")
    problem = cg.make_problem("package-delivery-v0")
    seconds, result = measured(lambda: cg.synthesize(problem, 250))
    row("PD8 exact, T=20, 250 cells, all starts", seconds, f"P >= {result.certificate.lower_bound:.4f}")
    if options.json:
        Path(options.json).write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
