"""Measure what the pages of the environments report: `python docs/measure_environments.py [ID ...]`.

For every problem of the suite: the certificate of the defaults and rollouts of its controllers, where the synthesizer
can make one, and rollouts of uniformly random inputs. Writes `environments/measured.json`; with ids, only their entries
are made anew.
Every problem is measured in a process of its own, so that its peak memory is its own. The whole takes half an hour on
one core.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from typing import Any

import certigym as cg
from certigym.synthesis.certificates.proofs import is_exact, start_of_claim
from certigym.validation.policies.rollout_policies import RandomController
from certigym.validation.statistical_tests.binomial import clopper_pearson
from certigym.validation.statistical_tests.rollouts import rollout
from environment_pages import FOLDER, MEASURED

EPISODES, SEED, CONFIDENCE = 100_000, 0, 0.999
CERTIFICATES = FOLDER.parent / "_certificates"
"""Where the certificates are kept (not in the repository): `draw_gallery.py` shows them."""


def measured(id: str) -> dict[str, Any]:
    """Return the entry of one problem."""
    problem = cg.make_problem(id)
    result: dict[str, Any] = {"fingerprint": problem.fingerprint, "certificate": None}
    began = time.process_time()
    try:
        found = cg.synthesize(problem)  # with the defaults: what anybody gets who types the id
    except ValueError as error:
        result["reason"] = " ".join(str(error).split())
    else:
        seconds = time.process_time() - began
        certificate = found.certificate
        CERTIFICATES.mkdir(exist_ok=True)
        cg.save(certificate, CERTIFICATES / f"{id}.npz")
        # A certificate about pairs stands on one without them.
        base = getattr(certificate.proof, "base", certificate)
        on_cells = base.proof.has_cells  # a certificate along a path has none
        shapes = sorted({part.grid.shape for part in base.proof.agents_of(base.problem)}) if on_cells else []
        result["certificate"] = {
            "lower_bound": certificate.lower_bound,
            "gap": certificate.gap,
            "exact": is_exact(certificate),
            "abstract_upper_bound": found.stats.get("abstract_upper_bound"),
            "method": certificate.proof.method,
            "bound": certificate.proof.bound,
            "start": start_of_claim(certificate),
            "cells": [list(shape) for shape in shapes],
            "value": "none" if not on_cells else "tensor trains" if base.proof.terms is None else "tree",
            "rank": certificate.proof.rank,
            "seconds": round(seconds, 2),
            "mebibytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
            "rollouts": _rollouts(problem, certificate.controller),
        }
    result["random"] = _rollouts(problem, RandomController())
    return result


def _rollouts(problem: cg.Problem, policy: Any) -> dict[str, Any]:
    runs = rollout(problem, policy, episodes=EPISODES, seed=SEED)
    low, high = clopper_pearson(runs.successes, runs.episodes, CONFIDENCE)
    return {
        "episodes": EPISODES,
        "seed": SEED,
        "successes": runs.successes,
        "confidence": CONFIDENCE,
        "low": low,
        "high": high,
    }


def main(arguments: list[str]) -> None:
    """Measure some problems, or all; with `--entry ID`, print the entry of one."""
    if arguments[:1] == ["--entry"]:
        print(json.dumps(measured(arguments[1])))
        return
    for id in arguments or cg.problem_ids():
        run = subprocess.run([sys.executable, __file__, "--entry", id], capture_output=True, text=True, check=True)
        known = json.loads(MEASURED.read_text(encoding="utf-8")) if MEASURED.exists() else {}
        known[id] = json.loads(run.stdout)
        certificate = known[id]["certificate"]
        print(id, "no certificate" if certificate is None else f"{certificate['lower_bound']:.6f}", flush=True)
        FOLDER.mkdir(exist_ok=True)
        MEASURED.write_text(json.dumps(dict(sorted(known.items())), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
