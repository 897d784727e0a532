"""Certified bounds of networks as they are deployed, against what they attain: ``python benchmarks/raw_networks.py``.

Every problem is learned by PPO (seed 0), and its networks are certified raw, wrapped and repaired. `share` is the part
of the measured rate that the raw bound proves; aims: .98, and .9 for ``meeting-v0``, whose learner starts from
certified controllers. The row `early` is a learner that was stopped too soon: what repairs are for.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import certigym as cg
from certigym.synthesis.certificates import rounded_down
from certigym.synthesis.raw_networks import repair_network

ROWS: dict[str, dict[str, Any]] = {
    "reach-avoid-v0, T = 5": {"id": "reach-avoid-v0", "horizon": 5, "steps": 200_000, "cells": 1000},
    "reach-avoid-n-v0, early": {"id": "reach-avoid-n-v0", "steps": 1_000, "cells": 1000, "worlds": 16},
    "invariance-4-v0": {"id": "invariance-4-v0", "steps": 100_000, "cells": 500},
    "reach-avoid-n-v0": {"id": "reach-avoid-n-v0", "steps": 300_000, "cells": 2000},
    "meeting-v0, warm start": {"id": "meeting-v0", "steps": 100_000, "cells": 100, "warm_start": "certificate"},
}


def measured(row: dict[str, Any], episodes: int) -> dict[str, Any]:
    """Return bounds, rates and seconds of one row."""
    problem = cg.make_problem(row["id"])
    problem = problem.replace(horizon=row["horizon"]) if "horizon" in row else problem
    warm = {name: row[name] for name in ("warm_start", "worlds") if name in row}
    actor: Any = cg.train(problem, "ppo", steps=row["steps"], seed=0, **warm).actor
    began = time.perf_counter()
    raw = cg.certify(problem, actor, row["cells"], as_is=True)
    seconds, began = time.perf_counter() - began, time.perf_counter()
    report = cg.check(raw)
    of_check = time.perf_counter() - began
    assert report, report
    wrapped = cg.certify(problem, actor, row["cells"])
    # Boxes of planar agents, on which repairs are made, take as long again as the maps.
    planar = any(agent.n_states > 1 for agent in problem.agents)
    repaired, places = (raw, None) if planar else repair_network(problem, actor, row["cells"])
    rate = cg.rollout(problem, cg.as_controller(problem, actor), episodes=episodes, seed=1).success.mean()
    of_repaired = cg.rollout(problem, repaired.controller, episodes=episodes, seed=1).success.mean()
    return {
        "cells": row["cells"], "raw": raw.certificate.lower_bound, "rate": float(rate),
        "share": raw.certificate.lower_bound / float(rate), "wrapped": wrapped.certificate.lower_bound,
        "repaired": repaired.certificate.lower_bound, "rate_of_repaired": float(of_repaired),
        "places": repaired.stats.get("repaired"), "seconds": seconds, "check_seconds": of_check,
        "worst": None if places is None else places.worst(3),
    }  # fmt: skip


def main() -> None:
    """Print a row for each problem as soon as it is known."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", nargs="+", default=list(ROWS), choices=list(ROWS))
    parser.add_argument("--episodes", type=int, default=100_000)
    parser.add_argument("--json")
    options = parser.parse_args()
    print("| problem | cells | raw: P >= | measured | share | wrapped: P >= | repaired: P >= | measured | s | check |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    found = {}
    for name in options.rows:
        row = found[name] = measured(ROWS[name], options.episodes)
        bounds = [rounded_down(row[key], 5) for key in ("raw", "wrapped", "repaired")]
        print(
            f"| {name} | {row['cells']} | {bounds[0]} | {row['rate']:.5f} | {row['share']:.3f} | {bounds[1]} "
            f"| {bounds[2]} | {row['rate_of_repaired']:.5f} | {row['seconds']:.1f} | {row['check_seconds']:.1f} |",
            flush=True,
        )
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(found, file, indent=2)


if __name__ == "__main__":
    main()
