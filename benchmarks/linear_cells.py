"""What cells, targets and relations cost and certify: linear cells beside ``exact``, in one run.

``python benchmarks/linear_cells.py [ID ...]`` prints, for each problem, the bound, the CPU seconds and the peak memory
of a synthesis without improving sweeps beyond two, over cells per axis and targets per cell; seconds are also given as
a ratio to ``exact`` on the same cells with one target, since machines differ.
"""

from __future__ import annotations

import argparse
import time
import tracemalloc

import certigym as cg

PROBLEMS = {"reach-avoid-planar-v0": (40, 60), "meeting-v0": (32, 48), "car-park-planar-v0": (30, 60)}
"""Problems by id, and their cells per axis."""

WAYS = (("exact", 1), ("exact", 2), ("exact", 3), ("linear", 2), ("linear", 4), ("linear", 8))
"""Relations and targets, or points that are read, per cell and axis."""


def measured(name: str, cells: int, relation: str, targets: int) -> tuple[float, float]:
    """Return the bound and the CPU seconds of one synthesis."""
    began = time.process_time()
    result = cg.synthesize(name, cells, relation=relation, targets_per_cell=targets, max_sweeps=2)
    return result.certificate.lower_bound, time.process_time() - began


def peak(name: str, cells: int, relation: str, targets: int) -> float:
    """Return the peak of the memory that numpy and Python allocate in such a synthesis, in MiB."""
    tracemalloc.start()
    cg.synthesize(name, cells, relation=relation, targets_per_cell=targets, max_sweeps=1)
    bytes_at_peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return bytes_at_peak / 2**20


def main() -> None:
    """Print one row per problem, cells, relation and targets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*", default=list(PROBLEMS))
    parser.add_argument("--cells", nargs="+", type=int)
    options = parser.parse_args()
    print("| id | cells | relation | targets | bound | seconds | times exact | MiB |")
    print("|---|---|---|---|---|---|---|---|")
    for name in options.ids:
        for cells in options.cells or PROBLEMS.get(name, (40,)):
            unit = 0.0
            for relation, targets in WAYS:
                bound, seconds = measured(name, cells, relation, targets)
                unit = unit or seconds
                memory = peak(name, cells, relation, targets)
                numbers = f"{bound:.4f} | {seconds:.1f} | {seconds / unit:.1f} | {memory:.0f}"
                print(f"| {name} | {cells} | {relation} | {targets} | {numbers} |", flush=True)


if __name__ == "__main__":
    main()
