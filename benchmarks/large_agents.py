"""Measure agents of several axes and many cells: ``python benchmarks/large_agents.py [--json PATH] [ROW ...]``.

The rows are robots in the plane with 400 x 400 cells, robots in space with 60 x 60 x 60, agents of position and
velocity, and the same robots split into their axes. Every row runs in a separate process and shows the CPU seconds of
the synthesis on one thread, the peak memory of the process with its imports, and the certified bound against rollouts.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import resource
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

import certigym as cg
from certigym.synthesis.certificates.digits import rounded_down, rounded_up
from measuring import once, save, show

EPISODES = 20_000


def drones(n_agents: int, horizon: int = 12) -> cg.Problem:
    """Drones in space fly around a tower and meet in a corner."""
    agents = cg.LinearAgent(
        name="drone",
        A=0.9 * np.eye(3),
        B=0.7 * np.eye(3),
        noise_covariance=0.2 * np.eye(3),
        state_low=[-6.0] * 3,
        state_high=[6.0] * 3,
        input_low=[-1.5] * 3,
        input_high=[1.5] * 3,
        initial_state=[-4.0] * 3,
    ).copies(n_agents)
    return cg.Problem(
        name="drones",
        horizon=horizon,
        agents=agents,
        propositions={
            "goal": cg.Proposition("drone_*", [2.0] * 3, [6.0] * 3),
            "tower": cg.Proposition("drone_*", [-1.0, -1.0, -6.0], [1.0, 1.0, 2.0]),
        },
        specification=cg.Specification("!any(tower) U all(goal)", "co-safe"),
    )


def motor() -> cg.Problem:
    """A cart whose motor lags: position, velocity and force, with one input."""
    cart = cg.LinearAgent(
        name="cart",
        A=[[1.0, 0.5, 0.0], [0.0, 1.0, 0.5], [0.0, 0.0, 0.5]],
        B=[[0.0], [0.0], [0.5]],
        noise_covariance=0.04 * np.eye(3),
        state_low=[-6.0, -3.0, -3.0],
        state_high=[6.0, 3.0, 3.0],
        input_low=[-6.0],
        input_high=[6.0],
        initial_state=[-3.0, 0.0, 0.0],
    )
    goal = cg.Proposition("cart", [1.0, -3.0, -3.0], [5.0, 3.0, 3.0])
    task = cg.Specification("F goal", "co-safe")
    return cg.Problem(name="motor", horizon=10, agents=[cart], propositions={"goal": goal}, specification=task)


def region(speed: float) -> cg.Problem:
    """RA4 over 20 steps from the positions of the paper's RA2 region, with velocities up to ``speed``."""
    starts = [agent.initial for agent in cg.make_problem("reach-avoid-v0").agents]
    low, high = [[*start.low, -speed] for start in starts], [[*start.high, speed] for start in starts]
    return cg.make_problem("reach-avoid-kinematic-v0", horizon=20).replace(initial_low=low, initial_high=high)


Row = tuple[Callable[[], cg.Problem], Any]
ROWS: dict[str, Row] = {
    "car park, whole, 400 x 400": (lambda: cg.make_problem("car-park-planar-v0"), 400),
    "car park, split, 400": (lambda: cg.split_axes(cg.make_problem("car-park-planar-v0")), 400),
    "delivery, whole, 240 x 240": (lambda: cg.make_problem("package-delivery-single-v0"), 240),
    "delivery, whole, 400 x 400": (lambda: cg.make_problem("package-delivery-single-v0"), 400),
    "delivery, split, 240": (lambda: cg.split_axes(cg.make_problem("package-delivery-single-v0")), 240),
    "one drone, 60 x 60 x 60": (lambda: drones(1), 60),
    "one drone, split, 60": (lambda: cg.split_axes(drones(1)), 60),
    "two drones, 60 x 60 x 60": (lambda: drones(2), 60),
    "two drones, split, 60": (lambda: cg.split_axes(drones(2)), 60),
    "two drones, split, 300": (lambda: cg.split_axes(drones(2)), 300),
    "cart with a motor, 60 x 60 x 60": (motor, 60),
    "integrator chain, 400 x 400": (lambda: cg.make_problem("integrator-chain-v0"), 400),
    "RA4, 60 x 60": (lambda: cg.make_problem("reach-avoid-kinematic-v0"), 60),
    "RA4, 150 x 60": (lambda: cg.make_problem("reach-avoid-kinematic-v0"), [150, 60]),
    "RA4, 250 x 100": (lambda: cg.make_problem("reach-avoid-kinematic-v0"), [250, 100]),
    "RA4, region at rest, 150 x 60": (lambda: region(0.0), [150, 60]),
    "RA4, region at all velocities, 150 x 60": (lambda: region(5.0), [150, 60]),
    "RA4, region at all velocities, 250 x 100": (lambda: region(5.0), [250, 100]),
}


def measured(name: str) -> dict[str, Any]:
    """Measure one row."""
    make, cells = ROWS[name]
    problem = make()
    seconds, found = once(lambda: cg.synthesize(problem, cells))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    report = cg.validate(found, episodes=EPISODES, seed=0)
    return {
        "job": name,
        "cpu seconds": round(seconds, 2),
        "MiB": memory,
        "rank": found.certificate.proof.rank,
        "certified": rounded_down(found.certificate.lower_bound),
        "optimum at most": rounded_up(found.stats["abstract_upper_bound"]),
        "rollouts": report.estimate,
        "verdict": str(report.verdict),
    }


def main() -> None:
    """Measure some rows, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help="default: all")
    parser.add_argument("--json", metavar="PATH")
    parser.add_argument("--row", metavar="ROW", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.row:
        print(json.dumps(measured(options.row)))
        return
    rows = []
    for name in options.rows or ROWS:
        run = subprocess.run([sys.executable, __file__, "--row", name], capture_output=True, text=True, check=True)
        rows.append(json.loads(run.stdout))
        show("Large agents", rows[-1:])
    show("Large agents", rows)
    save({"large_agents": rows}, options.json)


if __name__ == "__main__":
    main()
