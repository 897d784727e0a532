"""Times on one core against their targets: ``python benchmarks/targets.py [--json PATH]``.

Times are CPU seconds, with imports if a command is run. Rollouts are also shown as a ratio to drawing their noise with
the same generators and chunks. Machines differ: `unit` relates times to a product of two 1000 x 1000 matrices of the
same run.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import resource
import subprocess
import sys
import tracemalloc
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import certigym as cg
from certigym.envs.simulation import batch_simulator as core
from certigym.synthesis.abstraction.models.guards import compile_guards
from certigym.synthesis.abstraction.models.joint import join, start_of
from certigym.synthesis.certificates.controllers.controller import Controller
from certigym.synthesis.policy_search.ascent.coordinate_ascent import resting_policies, sweep
from certigym.synthesis.policy_search.ascent.limits import Limits
from certigym.synthesis.verbs.abstract import abstract
from certigym.validation.statistical_tests.loop import CHUNK, BatchPolicy
from measuring import Row, Rows, cpu, options, save, show

DELIVERY_START = [-17.8375, 3.2875, -16.8625, 3.2875, 1.4125, 3.2875, 3.3625, 3.2875]


def command(*words: str) -> float:
    """Return the CPU seconds of one command in a separate process: the least of three."""
    best = float("inf")
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-m", "certigym", *words], check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        best = min(best, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return best


def delivery_sweep() -> float:
    """Measure one improving sweep of the package delivery at the paper's size, with the usual limits on terms."""
    problem = cg.make_problem("package-delivery-v0").replace(initial_state=DELIVERY_START)
    joint = join(problem, abstract(problem, 1200, relation="exact"))
    start = start_of(problem, joint)
    policies = sweep(joint, resting_policies(joint), start, Limits(), improve=True).policies
    return cpu(lambda: sweep(joint, policies, start, Limits(), improve=True))[0]


def guards_row(n_agents: int) -> Row:
    """Measure compiling guards for so many agents and for a quarter of them: the ratio is 4 if it is linear."""
    seconds = []
    for n in (n_agents // 4, n_agents):
        problem = cg.make_problem("invariance-v0", n_agents=n)
        sets = [np.eye(len(classes), dtype=bool) for classes in problem.labeling.classes]
        seconds.append(cpu(lambda problem=problem, sets=sets: compile_guards(problem, sets))[0])
    return {
        "task": f"invariance, {n_agents} agents",
        "seconds": seconds[1],
        "as a multiple of a quarter of them": seconds[1] / seconds[0],
    }


def noise_alone(problem: cg.Problem, episodes: int) -> None:
    """Draw the noise of rollouts of so many episodes of which none is decided early, and do nothing with it."""
    dynamics = core.Dynamics.of(problem)
    for number in range(-(-episodes // CHUNK)):
        rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(number,)))
        for _ in range(problem.horizon):
            core.noise(dynamics, rng, CHUNK)


@dataclass(frozen=True)
class ToTheEnd:
    """A controller that cannot select its memory: all worlds of a chunk are simulated until all are decided."""

    controller: Controller

    def batch(self, dynamics: core.Dynamics) -> ToTheEnd.Policy:
        return self.Policy(self.controller.batch(dynamics))

    @dataclass(frozen=True)
    class Policy:
        policy: BatchPolicy

        def begin(self, worlds: core.Worlds, rng: np.random.Generator) -> Any:
            return self.policy.begin(worlds, rng)

        def act(self, worlds: core.Worlds, memory: Any) -> tuple[tuple[np.ndarray, ...], Any]:
            return self.policy.act(worlds, memory)


COUPLED: tuple[tuple[str, dict[str, Any], dict[str, Any]], ...] = (
    ("reach-avoid-v0", {}, {"cells": 200, "relation": "paper", "search": cg.SearchOptions(epsilon=0.2)}),
)
"""Controllers that remember an abstract state: problem, what is replaced in it, and settings."""


def rollout_row(name: str, changes: dict[str, Any], settings: dict[str, Any], episodes: int = 100_000) -> Row:
    """Measure rollouts against drawing their noise, and the memory that numpy and Python allocate meanwhile."""
    problem = cg.make_problem(name).replace(**changes)
    search = replace(settings.get("search", cg.SearchOptions()), max_sweeps=1)
    result = cg.synthesize(problem, **{**settings, "search": search})
    controller = result.controller
    alone, _ = cpu(lambda: noise_alone(problem, episodes))
    seconds, runs = cpu(lambda: cg.rollout(problem, controller, episodes))
    to_the_end, _ = cpu(lambda: cg.rollout(problem, ToTheEnd(controller), episodes))
    tracemalloc.start()
    cg.rollout(problem, controller, episodes)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    relations = {agent.relation["kind"] for agent in result.certificate.proof.agents}
    return {
        "task": name,
        "relation": ", ".join(sorted(relations)),
        "T": problem.horizon,
        "episodes": episodes,
        "seconds": seconds,
        "noise alone": alone,
        "ratio": seconds / alone,
        "target": 3.0,
        "all to the end": to_the_end / alone,
        "MiB": peak / 2**20,
        "successes": runs.successes,
    }


def main() -> None:
    chosen = options(__doc__)
    matrix = np.random.default_rng(0).random((1000, 1000))
    unit, _ = cpu(lambda: matrix @ matrix)
    problem = cg.make_problem("reach-avoid-v0", horizon=7)
    reach_avoid, _ = cpu(lambda: cg.synthesize(problem, 1000))
    with_rollouts = ("run", "reach-avoid-v0", "--episodes", "100000")
    measured: Rows = [
        {"work": "RA2, T = 7, 1000 cells: synthesis", "seconds": reach_avoid, "target": 0.2},
        {"work": "PD8, T = 20, 1200 cells: one sweep", "seconds": delivery_sweep(), "target": 5.0},
        {"work": " ".join(("certigym", *with_rollouts)), "seconds": command(*with_rollouts), "target": 4.0},
        {"work": "certigym --help", "seconds": command("--help"), "target": 0.3},
    ]
    for row in measured:
        row["units"] = row["seconds"] / unit
    memoryless = (("reach-avoid-v0", {}, {"cells": 1000}), ("package-delivery-v0", {}, {"cells": 250}))
    results = {
        "one core": measured,
        "rollouts against their noise": [rollout_row(*case) for case in (*memoryless, *COUPLED)],
        "guards": [guards_row(n) for n in (1000, 2000)],
    }
    for title, rows in results.items():
        show(title, rows)
    save(results, chosen.json)


if __name__ == "__main__":
    main()
