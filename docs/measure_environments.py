"""Measure what the pages of the environments report: `python docs/measure_environments.py [ID ...]`.

For every problem of the suite: a certificate and rollouts of its controllers, where the synthesizer can make one, and
rollouts of uniformly random inputs. Writes `environments/measured.json`; with ids, only their entries are made anew.
The whole takes some minutes on one core.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import certigym as cg
from certigym.validation.policies import RandomController
from certigym.validation.rollout import rollout
from certigym.validation.verdict import clopper_pearson
from environment_pages import FOLDER, MEASURED

EPISODES, SEED, CONFIDENCE = 20_000, 0, 0.999
CELLS = {
    "building-automation-v0": 100,
    "car-park-planar-v0": 100,
    "cyclic-delivery-v0": 100,
    "door-formation-v0": 24,
    "meeting-v0": 64,
    "package-delivery-eased-v0": 250,
    "package-delivery-kinematic-v0": 30,
    "package-delivery-single-v0": 60,
    "package-delivery-v0": 250,
    "patrol-recharge-v0": 160,
    "reach-avoid-kinematic-v0": 60,
    "reach-avoid-planar-v0": 80,
}
"""Cells per axis where the default would be too many for a page, or too few."""


def measured(id: str) -> dict[str, Any]:
    """Return the entry of one problem."""
    problem = cg.make_problem(id)
    result: dict[str, Any] = {"fingerprint": problem.fingerprint, "certificate": None}
    try:
        certificate = cg.synthesize(problem, CELLS.get(id)).certificate
    except ValueError as error:
        result["reason"] = " ".join(str(error).split())
    else:
        result["certificate"] = {
            "lower_bound": certificate.lower_bound,
            "method": certificate.method,
            "bound": certificate.bound,
            "start": certificate.start,
            "cells": CELLS.get(id),
            "rollouts": _rollouts(problem, certificate.controller),
        }
    result["random"] = _rollouts(problem, RandomController())
    return result


def _rollouts(problem: cg.Problem, policy: Any) -> dict[str, Any]:
    runs = rollout(problem, policy, EPISODES, SEED)
    low, high = clopper_pearson(runs.successes, runs.episodes, CONFIDENCE)
    return {"episodes": EPISODES, "seed": SEED, "successes": runs.successes,
            "confidence": CONFIDENCE, "low": low, "high": high}  # fmt: skip


def main(ids: list[str]) -> None:
    """Measure some problems, or all."""
    known = json.loads(MEASURED.read_text(encoding="utf-8")) if MEASURED.exists() else {}
    for id in ids or cg.problem_ids():
        known[id] = measured(id)
        certificate = known[id]["certificate"]
        print(id, "no certificate" if certificate is None else f"{certificate['lower_bound']:.6f}", flush=True)
        FOLDER.mkdir(exist_ok=True)
        MEASURED.write_text(json.dumps(dict(sorted(known.items())), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
