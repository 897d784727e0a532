"""Learned policies raw, certified and improved, beside ours: ``python benchmarks/learned_policies.py [--json PATH]``.

For every task, decentralised PPO is trained with several seeds; each actor is simulated unchanged ("raw"), wrapped on
the cells ("certified"), and improved ("improved"), beside policies synthesized without it ("ours") on the same cells.
All policies meet the same starts and noise. Times are wall-clock seconds on one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
from pathlib import Path
from typing import Any

import certigym as cg
from certigym.baselines import RandomController
from certigym.validation.policies import Comparison

TASKS: dict[str, tuple[str, dict[str, Any], int]] = {
    "RA2, T = 7": ("reach-avoid-v0", {}, 2000),
    "RA2, T = 5": ("reach-avoid-v0", {"horizon": 5}, 2000),
    "IV-4": ("invariance-4-v0", {}, 1000),
    "RA-N, 4 agents": ("reach-avoid-n-v0", {}, 2000),
}
"""Id, arguments and cells per axis."""


def compared(name: str, seeds: list[int], steps: int | None, episodes: int) -> Comparison:
    """Simulate all policies of one task on common random numbers."""
    id, arguments, cells = TASKS[name]
    problem = cg.make_problem(id, **arguments)
    policies: dict[str, Any] = {}
    for seed in seeds:
        training = cg.train(problem, "ppo", steps, seed)
        actor: Any = training.actor
        policies[f"PPO raw, seed {seed}"] = training
        policies[f"PPO certified, seed {seed}"] = cg.certify(problem, actor, cells)
        policies[f"PPO improved, seed {seed}"] = cg.improve(problem, actor, cells)
    policies["ours"] = cg.synthesize(problem, cells)
    policies["random"] = RandomController()
    for result in policies.values():
        if hasattr(result, "certificate"):
            report = cg.check(result.certificate, problem)
            assert report, report
    return cg.compare(problem, policies, episodes, seed=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", metavar="PATH")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--steps", type=int, default=100_000, help="world steps of each training (default: 100000)")
    parser.add_argument("--episodes", type=int, default=100_000)
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    options = parser.parse_args()
    results = {}
    for name in options.tasks:
        comparison = compared(name, options.seeds, options.steps, options.episodes)
        results[name] = comparison.to_dict()
        print(f"\n| {name} | success | 99 % limits | certified P >= | seconds |\n|---|---|---|---|---|")
        for e in comparison.entries:
            bound = "" if e.lower_bound is None else f"{int(e.lower_bound * 1e6) / 1e6:.6f}"
            seconds = "" if e.seconds is None else f"{e.seconds:.2f}"
            print(f"| {e.name} | {e.rate:.5f} | [{e.ci_low:.5f}, {e.ci_high:.5f}] | {bound} | {seconds} |", flush=True)
        kept = {frozenset((p.first, p.second)): p for p in comparison.pairs}
        for seed in options.seeds:
            pair = kept[frozenset((f"PPO raw, seed {seed}", "ours"))]
            print(
                f"{pair.first} / {pair.second}: {pair.only_first} / {pair.only_second} won alone, exact McNemar p = "
                f"{pair.p_value:.2g}"
            )
    if options.json:
        Path(options.json).write_text(json.dumps(results, indent=2, allow_nan=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
