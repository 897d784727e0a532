"""Time and memory against the number of agents: ``python benchmarks/many_agents.py [--json PATH] [--plot PATH]``.

Whole syntheses (abstraction, guards, search, certificate) of three families: pairs that have to meet, each with another
start; one reach-avoid task for all; staying in a set. CPU seconds on one thread; memory is the largest amount that
numpy and Python allocate, measured in a second run. Exponents are slopes over the larger half of the sizes.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import tracemalloc
from collections.abc import Callable

import numpy as np

import certigym as cg
from certigym.validation.figures.figure_style import MARKS, SERIES, new_figure
from measuring import Rows, once, save, show
from scaling import exponent


def pairs(n_agents: int, horizon: int = 8) -> cg.Problem:
    """Every pair has to meet in one of two places, and all agents have to stay safe; all pairs start differently."""
    n = n_agents // 2
    drone = cg.LinearAgent(
        name="left",
        A=[[0.9]],
        B=[[0.5]],
        noise_covariance=[[0.1]],
        state_low=[-4.0],
        state_high=[4.0],
        input_low=[-2.0],
        input_high=[2.0],
        initial_state=[-2.0],
    )
    starts = np.linspace(1.0, 3.0, n)
    left = [a.replace(initial_state=[-x]) for a, x in zip(drone.copies(n), starts, strict=True)]
    right = [a.replace(initial_state=[x]) for a, x in zip(drone.replace(name="right").copies(n), starts, strict=True)]
    regions = {
        f"{name}_{side}": cg.Proposition(f"{side}_*", [low], [high])
        for side in ("left", "right")
        for name, low, high in (("here", -1.0, 0.0), ("there", 0.0, 1.0), ("safe", -3.5, 3.5))
    }
    meet = [f"F (here_left_{k} & here_right_{k} | there_left_{k} & there_right_{k})" for k in range(n)]
    task = f"G (all(safe_left) & all(safe_right)) & {' & '.join(meet)}"
    return cg.Problem(
        name="pairs",
        horizon=horizon,
        agents=[*left, *right],
        propositions=regions,
        specification=cg.Specification(task, "finite-trace"),
    )


CELLS = 40

FAMILIES: dict[str, tuple[Callable[[int], cg.Problem], tuple[int, ...]]] = {
    "pairs that meet": (pairs, (20, 50, 100, 200)),
    "reach-avoid": (lambda n: cg.make_problem("reach-avoid-n-v0", n_agents=n), (5, 10, 20, 40)),
    "invariance": (lambda n: cg.make_problem("invariance-v0", n_agents=n), (10, 30, 100, 300, 1000)),
}


def measured() -> Rows:
    """Measure one row per family and number of agents."""
    rows: Rows = []
    for family, (make, sizes) in FAMILIES.items():
        for n in sizes:
            problem = make(n)
            seconds, result = once(lambda problem=problem: cg.synthesize(problem, CELLS))
            tracemalloc.start()
            cg.synthesize(problem, CELLS)
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            rows.append(
                {
                    "task": family,
                    "agents": n,
                    "seconds": seconds,
                    "MiB": peak / 2**20,
                    "certified": result.certificate.lower_bound,
                    "rank": result.certificate.proof.rank,
                }
            )
    return rows


def exponents(rows: Rows) -> Rows:
    """Return the growth of time and memory, one row per family."""
    found: Rows = []
    for family in FAMILIES:
        own = [row for row in rows if row["task"] == family]
        slopes = {key: exponent([(row["agents"], row[key]) for row in own]) for key in ("seconds", "MiB")}
        found.append({"task": family, **slopes})
    return found


def plot(rows: Rows, path: str) -> None:
    """Draw time and memory against the number of agents on logarithmic axes."""
    figure, axes = new_figure(9.0, 3.4, 1, 2)
    slopes = {row["task"]: row for row in exponents(rows)}
    for panel, key in zip(axes, ("seconds", "MiB"), strict=True):
        for k, family in enumerate(FAMILIES):
            own = [row for row in rows if row["task"] == family]
            label = f"{family}: exponent {slopes[family][key]:.2f}"
            x, y = [row["agents"] for row in own], [row[key] for row in own]
            panel.loglog(x, y, marker=MARKS[k], color=SERIES[k], markersize=4, label=label)
        panel.set_xlabel("agents")
        panel.set_ylabel("CPU seconds" if key == "seconds" else "MiB at most")
        panel.legend(loc="upper left", fontsize=8, frameon=False)
        panel.set_ylim(top=panel.get_ylim()[1] * 10)
    figure.savefig(path, metadata={"Date": None} if path.endswith(".svg") else None)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--json", metavar="PATH")
    parser.add_argument("--plot", metavar="PATH")
    chosen = parser.parse_args()
    rows = measured()
    show(f"whole syntheses, {CELLS} cells per axis", rows)
    show("growth with the number of agents", exponents(rows))
    save({"rows": rows, "exponents": exponents(rows)}, chosen.json)
    if chosen.plot:
        plot(rows, chosen.plot)


if __name__ == "__main__":
    main()
