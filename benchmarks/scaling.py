"""Cost against agents, cells, horizon and rank: ``python benchmarks/scaling.py [--json PATH] [--plot PATH]``.

CPU seconds of one improving sweep, or of one backup for the rank, on one thread. Exponents are slopes of least-squares
lines through the logarithms over the larger half of the sizes, where fixed costs hardly count.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from collections.abc import Callable

import numpy as np

import certigym as cg
from certigym.synthesis.models.abstraction import abstract
from certigym.synthesis.models.choices import gather
from certigym.synthesis.models.joint import join, start_of
from certigym.synthesis.search.ascent import resting_policies, sweep
from certigym.synthesis.search.limits import Limits
from certigym.synthesis.search.tree import candidates
from certigym.synthesis.values.terms import Terms
from certigym.validation.figures.figure_style import MARKS, SERIES, new_figure
from measuring import Row, Rows, cpu, save, show

Curve = list[tuple[int, float]]


def sweep_seconds(problem: cg.Problem, cells: int) -> float:
    """Measure one improving sweep from the policies of an earlier one."""
    joint = join(problem, abstract(problem, cells, relation="exact"))
    start = start_of(problem, joint)
    policies = sweep(joint, resting_policies(joint), start, Limits(), improve=True).policies
    return cpu(lambda: sweep(joint, policies, start, Limits(), improve=True), 2)[0]


def backup_seconds(rank: int) -> float:
    """Measure one step of the value tree of two agents on 1000 cells with ``rank`` random terms."""
    problem = cg.make_problem("reach-avoid-v0")
    joint = join(problem, abstract(problem, 1000, relation="exact"))
    rng = np.random.default_rng(0)
    factors = tuple(rng.random((rank, n)) for n in joint.n_cells)
    rows = np.repeat(np.arange(rank)[:, None], len(factors), axis=1)
    index = tuple(rows[:1] if absorbed else rows for absorbed in joint.absorbing)
    policies = [model.choices.points(model.choices.resting_choice) for model in joint.models]

    def backup() -> None:
        options = candidates(joint.guards, joint.masks, joint.models, Terms(factors, index))
        for smoothed, policy in zip(options.smoothed, policies):
            gather(smoothed, policy)

    return cpu(backup, 2)[0]


def joined_seconds(n_agents: int) -> float:
    """Measure abstracting and joining: grids, kernels and guards."""
    problem = cg.make_problem("invariance-v0", n_agents=n_agents)
    return cpu(lambda: join(problem, abstract(problem, 100, relation="exact")), least=0.1)[0]


def invariance(n_agents: int) -> float:
    return sweep_seconds(cg.make_problem("invariance-v0", n_agents=n_agents), 100)


def reach_avoid(n_agents: int) -> float:
    return sweep_seconds(cg.make_problem("reach-avoid-n-v0", n_agents=n_agents), 100)


def two_agents(cells: int = 500, horizon: int = 7) -> float:
    return sweep_seconds(cg.make_problem("reach-avoid-v0", horizon=horizon), cells)


def eight_agents(cells: int = 250, horizon: int = 20) -> float:
    return sweep_seconds(cg.make_problem("package-delivery-v0", horizon=horizon), cells)


def curves() -> dict[str, dict[str, Curve]]:
    """Return panels of curves of size and seconds."""
    many, long = (8, 16, 32, 64, 128, 256, 512), (5, 10, 20, 40, 80, 160)
    return {
        "agents": {
            "invariance, 100 cells, one sweep": _curve(invariance, many),
            "abstracting and joining": _curve(joined_seconds, many),
            "reach-avoid, 100 cells, one sweep": _curve(reach_avoid, (2, 4, 8, 16, 32)),
        },
        "cells per axis": {
            "two agents, T = 7, one sweep": _curve(two_agents, (125, 250, 500, 1000, 2000, 4000)),
            "eight agents, T = 20, one sweep": _curve(eight_agents, (150, 300, 600, 1200)),
        },
        "horizon": {
            "two agents, 500 cells, one sweep": _curve(lambda t: two_agents(horizon=t), long),
            "eight agents, 250 cells, one sweep": _curve(lambda t: eight_agents(horizon=t), long[1:5]),
        },
        "rank": {"one backup, two agents, 1000 cells": _curve(backup_seconds, (4, 8, 16, 32, 64, 128, 256, 512))},
    }


def _curve(seconds: Callable[[int], float], sizes: tuple[int, ...]) -> Curve:
    return [(size, seconds(size)) for size in sizes]


def exponent(curve: Curve) -> float:
    """Return the slope of the logarithms over the larger half of the sizes."""
    sizes, seconds = np.log(np.array(curve[-max(2, (len(curve) + 1) // 2) :])).T
    return float(np.polyfit(sizes, seconds, 1)[0])


def table(panels: dict[str, dict[str, Curve]]) -> Rows:
    """Return one row per curve: exponent, smallest and largest case."""
    rows: list[Row] = []
    for axis, lines in panels.items():
        for name, curve in lines.items():
            (first, quick), (last, slow) = curve[0], curve[-1]
            rows.append(
                {
                    "against": axis,
                    "task": name,
                    "exponent": exponent(curve),
                    "from": first,
                    "ms": 1e3 * quick,
                    "to": last,
                    "then ms": 1e3 * slow,
                }
            )
    return rows


def plot(panels: dict[str, dict[str, Curve]], path: str) -> None:
    """Draw logarithmic plots, one per panel, and label each curve with its exponent."""
    figure, axes = new_figure(9.0, 6.4, 2, 2)
    for panel, (axis, lines) in zip(axes, panels.items()):
        for k, (name, curve) in enumerate(lines.items()):
            sizes, seconds = np.array(curve).T
            label = f"{name}: exponent {exponent(curve):.2f}"
            panel.loglog(sizes, seconds, marker=MARKS[k], color=SERIES[k], markersize=4, label=label)
        panel.set_xlabel(axis)
        panel.set_ylabel("CPU seconds")
        ticks: list[int] = []
        for size in sorted({size for curve in lines.values() for size, _ in curve}):
            if not ticks or size >= 1.5 * ticks[-1]:
                ticks.append(size)
        panel.set_xticks(ticks, labels=[str(size) for size in ticks], fontsize=8)
        panel.minorticks_off()
        panel.legend(loc="upper left", fontsize=8, frameon=False)
        panel.set_ylim(top=panel.get_ylim()[1] * 8)
    figure.savefig(path, metadata={"Date": None} if path.endswith(".svg") else None)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--json", metavar="PATH")
    parser.add_argument("--plot", metavar="PATH")
    chosen = parser.parse_args()
    panels = curves()
    show("growth of cost", table(panels))
    save({"curves": panels, "exponents": table(panels)}, chosen.json)
    if chosen.plot:
        plot(panels, chosen.plot)


if __name__ == "__main__":
    main()
