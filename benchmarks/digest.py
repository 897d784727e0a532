"""Digests of some twenty certificates and rollouts: ``python benchmarks/digest.py [--json PATH] [--against PATH]``.

Run it before and after a change that must not change results: equal digests mean equal bounds, certificate files and
rollouts, to the last bit, on this machine with these libraries. Only the public interface is used, so that the script
runs on both sides of a reorganisation. Each row has its CPU seconds; ``--against`` prints the ratio to a former run.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import hashlib
import json
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import certigym as cg
from measuring import once, save, show

EPISODES = 4000
"""Rollouts of each certificate; enough that a changed step would change some outcome."""


def digest_of_file(path: Path) -> str:
    """Return a digest of all members of a certificate file (the archive itself holds times)."""
    total = hashlib.sha256()
    with zipfile.ZipFile(path) as archive:
        for name in sorted(archive.namelist()):
            total.update(name.encode() + hashlib.sha256(archive.read(name)).digest())
    return total.hexdigest()[:16]


def digest_of_result(certificate: Any, stats: dict[str, Any]) -> dict[str, Any]:
    """Return what must not change: the bound, the file, the rollouts, and the bounds from above."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "certificate.npz"
        cg.save(certificate, path)
        file = digest_of_file(path)
    rollouts = cg.rollout(certificate.problem, certificate.controller, EPISODES, seed=7)
    above = [stats.get(name) for name in ("abstract_upper_bound", "continuous_upper_bound")]
    if "cells_chosen" in certificate.settings:  # this record holds seconds
        file = ""
    return {
        "bound": float(certificate.lower_bound).hex(),
        "above": ["" if value is None else float(value).hex() for value in above],  # type: ignore[arg-type]
        "file": file,
        "rollouts": hashlib.sha256(np.packbits(rollouts.success).tobytes()).hexdigest()[:16],
    }


def synthesized(id: str, *, arguments: dict[str, Any] | None = None, **settings: Any) -> Callable[[], dict[str, Any]]:
    """Return a case: the synthesis of a suite problem with some settings."""

    def case() -> dict[str, Any]:
        result = cg.synthesize(cg.make_problem(id, **(arguments or {})), **settings)
        return digest_of_result(result.certificate, result.stats)

    return case


def certified_policy() -> dict[str, Any]:
    """Certify a policy written by hand, and improve it."""
    problem = cg.make_problem("reach-avoid-v0", horizon=5)

    def towards(x: Any, q: int, t: int) -> Any:
        return np.array([4.0 if t < 3 else 1.0])

    policies = dict.fromkeys(problem.agent_names, towards)
    given = cg.certify(problem, policies, cells=100)
    better = cg.improve(problem, policies, cells=100, search=cg.SearchOptions(max_sweeps=2))
    first = digest_of_result(given.certificate, given.stats)
    second = digest_of_result(better.certificate, better.stats)
    return {name: [first[name], second[name]] for name in first}


def audited() -> dict[str, Any]:
    """Validate one certificate, test it at a field of starts, and audit it."""
    problem = cg.make_problem("reach-avoid-v0", horizon=5)
    certificate = cg.synthesize(problem, 150).certificate
    report = cg.validate(certificate, episodes=EPISODES, seed=3)
    audit = cg.audit(certificate, episodes=EPISODES, seed=3)
    states = certificate.at([[-10.0, -4.0], [-5.0, -3.0], [0.0, 0.0]])
    return {
        "bound": [float(value).hex() for value in states],
        "above": [],
        "file": str(audit.verdict),
        "rollouts": f"{report.successes} {report.verdict}",
    }


def episode() -> dict[str, Any]:
    """Play one episode of the PettingZoo environment under the certified controllers, and one with random actions."""
    total = hashlib.sha256()
    for id in ("door-formation-v0", "meeting-v0", "cyclic-delivery-v0"):
        env = cg.parallel_env(id)
        observations, _ = env.reset(seed=11)
        actions = np.random.default_rng(5)
        while env.agents:
            step = {a: actions.uniform(env.action_space(a).low, env.action_space(a).high) for a in env.agents}
            observations, rewards, *_ = env.step(step)
            for name in sorted(observations):
                total.update(np.asarray(observations[name], dtype=float).tobytes())
                total.update(np.float64(rewards[name]).tobytes())
    return {"bound": "", "above": [], "file": "", "rollouts": total.hexdigest()[:16]}


CASES: dict[str, Callable[[], dict[str, Any]]] = {
    "exact, T = 6": synthesized("reach-avoid-v0", cells=600, arguments={"horizon": 6}),
    "exact, default cells": synthesized("reach-avoid-v0"),
    "paper": synthesized(
        "reach-avoid-v0", cells=400, relation="paper", search=cg.SearchOptions(epsilon=0.1), arguments={"horizon": 4}
    ),
    "relations compared": synthesized("reach-avoid-kinematic-v0", cells=[40, 20]),
    "tensor trains": synthesized("door-formation-v0", cells=24),
    "trains, four robots": synthesized("cyclic-delivery-v0", cells=25, search=cg.SearchOptions(max_sweeps=0)),
    "trains asked for": synthesized(
        "reach-avoid-n-v0", cells=40, search=cg.SearchOptions(value="train"), arguments={"n_agents": 4}
    ),
    "independent tasks": synthesized("invariance-20-v0", cells=50),
    "decoupled": synthesized("decoupled-chain-14-v0"),
    "a team": synthesized("reach-avoid-20-v0", cells=60, search=cg.SearchOptions(max_sweeps=2)),
    "planar": synthesized("reach-avoid-planar-v0", cells=30, search=cg.SearchOptions(max_sweeps=3)),
    "meeting": synthesized("meeting-v0", cells=16, search=cg.SearchOptions(max_sweeps=2)),
    "patrol": synthesized("patrol-recharge-v0", cells=40, search=cg.SearchOptions(max_sweeps=2)),
    "delivery by jumps": synthesized("package-delivery-v0", cells=200, search=cg.SearchOptions(max_sweeps=2)),
    "eased delivery": synthesized("package-delivery-eased-v0", cells=150, search=cg.SearchOptions(max_sweeps=1)),
    "single delivery": synthesized("package-delivery-single-v0", cells=60),
    "car park": synthesized("car-park-planar-v0", cells=60),
    "building": synthesized("building-automation-v0", cells=60),
    "docking chain": synthesized("integrator-chain-v0"),
    "restarts": synthesized("reach-avoid-v0", cells=80, search=cg.SearchOptions(restarts=2)),
    "stationary": synthesized("car-park-v0", cells=100, search=cg.SearchOptions(stationary=True)),
    "given policies": certified_policy,
    "validated": audited,
    "episodes": episode,
}


def main() -> None:
    """Print one row per case."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--json", metavar="PATH")
    parser.add_argument("--against", metavar="PATH", help="JSON of a former run to compare with")
    parser.add_argument("--only", metavar="TEXT", help="cases whose name contains this")
    options = parser.parse_args()
    former = json.loads(Path(options.against).read_text(encoding="utf-8")) if options.against else {}
    rows, results = [], {}
    for name, case in CASES.items():
        if options.only and options.only not in name:
            continue
        seconds, results[name] = once(case)
        line = {"case": name, "s": seconds, **{key: str(value)[:34] for key, value in results[name].items()}}
        results[name]["seconds"] = seconds
        if name in former:
            line["ratio"] = seconds / former[name]["seconds"]
            keys = ("bound", "above", "file", "rollouts")
            line["same"] = " ".join(key for key in keys if results[name][key] != former[name][key]) or "yes"
        rows.append(line)
        print(f"{name}: {seconds:.1f} s {line.get('same', '')}", flush=True)
    show("digests", rows)
    save(results, options.json)


if __name__ == "__main__":
    main()
