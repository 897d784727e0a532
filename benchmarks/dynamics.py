"""What nonlinear, coupled and disturbed agents are certified for: `python benchmarks/dynamics.py [NAME ...]`.

For each case: the bound, CPU seconds of synthesis and check, and 100,000 rollouts with 99.9 % limits, which must not
refute the bound. One thread is assumed (OMP_NUM_THREADS=1).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import certigym as cg
from certigym.validation.statistics.binomial import clopper_pearson

EPISODES, CONFIDENCE = 100_000, 0.999


CASES: dict[str, tuple[Callable[[], cg.Problem], dict[str, Any]]] = {
    "van der Pol, 40 steps": (lambda: cg.make_problem("van-der-pol-v0"), {"cells": [240, 34]}),
    "van der Pol, 200 steps": (lambda: cg.make_problem("van-der-pol-v0", horizon=200), {"cells": [160, 24]}),
    "van der Pol, linear cells": (lambda: cg.make_problem("van-der-pol-v0"), {"cells": 60, "relation": "linear"}),
    "van der Pol, linear, 100 steps": (
        lambda: cg.make_problem("van-der-pol-v0", horizon=100),
        {"cells": 40, "relation": "linear"},
    ),
    "dubins, 1, linear cells": (
        lambda: cg.make_problem("dubins-team-v0", n_agents=1),
        {"cells": [32, 32, 24], "relation": "linear"},
    ),
    "van der Pol, default": (lambda: cg.make_problem("van-der-pol-v0"), {}),
    "rooms, 8": (lambda: cg.make_problem("room-network-v0", n_agents=8), {"cells": 64}),
    "rooms, 100": (lambda: cg.make_problem("room-network-v0", n_agents=100), {"cells": 64, "max_sweeps": 0}),
    "rooms, 1000": (lambda: cg.make_problem("room-network-v0", n_agents=1000), {"cells": 64, "max_sweeps": 0}),
    "platoon, 100": (lambda: cg.make_problem("platoon-v0", n_agents=100), {"cells": [60, 20], "max_sweeps": 0}),
    "dubins, 8": (lambda: cg.make_problem("dubins-team-v0", n_agents=8), {"cells": [32, 32, 24], "max_sweeps": 0}),
}


def measure(name: str, problem: cg.Problem, settings: dict[str, Any]) -> bool:
    """Print one line; return whether the certificate was verified and not refuted."""
    began = time.process_time()
    result = cg.synthesize(problem, **settings)
    made = time.process_time()
    verified = bool(cg.check(result.certificate))
    checked = time.process_time()
    runs = cg.rollout(problem, result.controller, episodes=EPISODES, seed=0)
    low, high = clopper_pearson(runs.successes, runs.episodes, CONFIDENCE)
    bound = result.certificate.lower_bound
    words = f"{made - began:.1f} s, check {checked - made:.1f} s{'' if verified else ', NOT VERIFIED'}"
    print(f"{name:32} P >= {bound:.6f}  {words}, rollouts [{low:.5f}, {high:.5f}]", flush=True)
    return verified and bound <= high


def main(names: list[str]) -> int:
    """Measure the cases whose names are given, or all."""
    chosen = names or [*CASES]
    held = [measure(name, CASES[name][0](), CASES[name][1]) for name in chosen]
    return 0 if all(held) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
