"""Sweeps on devices, as a multiple of numpy's time: ``python benchmarks/devices.py [--json PATH] [DEVICE ..]``.

Devices are named as for ``certigym synthesize --device``; the default is ``torch:cpu``, which shows the cost of the
detour without any gain. Times are wall-clock times, because a device computes while the processor waits; numpy's time
stands beside them.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from collections.abc import Callable
from typing import Any

import certigym as cg
from certigym.synthesis.models.abstraction import abstract
from certigym.synthesis.models.joint import join, start_of
from certigym.synthesis.search.ascent import Sweep, resting_policies, sweep
from certigym.synthesis.search.limits import Limits
from measuring import Rows, save, show
from targets import DELIVERY_START

TASKS: tuple[tuple[str, int, dict[str, Any]], ...] = (
    ("reach-avoid-v0", 1000, {}),
    ("reach-avoid-v0", 4000, {}),
    ("package-delivery-v0", 1200, {"initial_state": DELIVERY_START}),
    ("reach-avoid-planar-v0", 60, {}),
    ("invariance-b-100-v0", 200, {}),
)


def wall(work: Callable[[], Sweep]) -> tuple[float, Sweep]:
    """Return the wall-clock seconds of one call, the least of three after a warm-up, and what it returned."""
    result, best = work(), float("inf")
    for _ in range(3):
        began = time.perf_counter()
        result = work()
        best = min(best, time.perf_counter() - began)
    return best, result


def rows_of(name: str, cells: int, changes: dict[str, Any], devices: list[str]) -> Rows:
    """Measure one improving sweep from the naive policies with numpy and on every device."""
    problem = cg.make_problem(name).replace(**changes)
    abstraction = abstract(problem, cells)
    rows: Rows = []
    here = join(problem, abstraction)
    start, policies = (
        start_of(problem, here),
        sweep(here, resting_policies(here), None, Limits(), improve=True).policies,
    )
    for device in ("numpy", *devices):
        joint = join(problem, abstraction, device)
        seconds, found = wall(lambda joint=joint: sweep(joint, policies, start, Limits(), improve=True))
        rows.append({"task": name, "cells": cells, "device": device, "seconds": seconds, "value": found.value})
        rows[-1]["ratio"] = seconds / rows[0]["seconds"]
        rows[-1]["relative difference"] = abs(found.value / rows[0]["value"] - 1.0)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("devices", nargs="*", default=["torch:cpu"], metavar="DEVICE")
    parser.add_argument("--json", metavar="PATH")
    chosen = parser.parse_args()
    results = {"one sweep": [row for task in TASKS for row in rows_of(*task, chosen.devices)]}
    show("one sweep", results["one sweep"])
    save(results, chosen.json)


if __name__ == "__main__":
    main()
