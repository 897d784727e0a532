"""What every suite problem certifies with an id and no options: the one source of the numbers on the pages.

``python benchmarks/defaults.py [ID ...]`` measures problems (all by default), each in a process of its own, so that its
peak memory is its own, and keeps what it found in ``docs/defaults.json``. ``python docs/numbers_of_pages.py`` then
writes the pages that show these numbers. With ``--longer`` settings are tried that take up to ten minutes, where these
could certify more by .02. Seconds are CPU seconds of one process, and depend on the machine. All problems take an hour
on one core.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import certigym as cg
from certigym.synthesis.certificates.proofs import is_exact, start_of_claim
from certigym.validation.policies.rollout_policies import RandomController
from certigym.validation.statistical_tests.binomial import clopper_pearson
from certigym.validation.statistical_tests.rollouts import rollout

DOCS = Path(__file__).parents[1] / "docs"
DEFAULTS = DOCS / "defaults.json"
CERTIFICATES = DOCS / "_certificates"
"""Where the certificates are kept (not in the repository): the scripts that draw the gallery read them."""

EPISODES, SEED, CONFIDENCE = 100_000, 0, 0.999
"""Of rollouts: a success rate of 1 then has a lower limit above .9999."""

LONGER: dict[str, list[dict[str, Any]]] = {
    "reach-avoid-planar-v0": [
        {"cells": 120, "relation": "linear"},
        {"cells": 100, "relation": "linear", "search": cg.SearchOptions(restarts=2)},
    ],
    "package-delivery-v0": [
        {"cells": 2000, "relation": "exact"},
        {"cells": 1000, "relation": "exact", "search": cg.SearchOptions(restarts=2)},
    ],
    "van-der-pol-v0": [{"cells": 260, "relation": "linear"}],
}
"""Settings for about ten minutes, of problems whose bound for any policy is .02 or more above what defaults certify."""


def measured(name: str) -> dict[str, Any]:
    """Synthesize, check and simulate one problem with the defaults."""
    problem = cg.make_problem(name)
    began = time.process_time()
    result = cg.synthesize(problem)
    seconds = time.process_time() - began
    certificate = result.certificate
    CERTIFICATES.mkdir(exist_ok=True)
    cg.save(certificate, CERTIFICATES / f"{name}.npz")
    parts = certificate.proof.factors or (certificate,)
    grids = [agent.grid.shape for part in parts for agent in _on_grids(part)]
    above = result.stats.get("continuous_upper_bound")
    return {
        "fingerprint": problem.fingerprint,
        "certified": float(certificate.lower_bound),
        "failure": float(getattr(certificate.proof, "failure", 1.0 - certificate.lower_bound)),
        "gap": certificate.gap,
        "exact": is_exact(certificate),
        "any policy": above if isinstance(above, float) else None,
        "these models": result.stats.get("abstract_upper_bound"),
        "start": start_of_claim(certificate),
        "method": certificate.proof.method,
        "relation": "/".join(dict.fromkeys(kind for part in parts for kind in _kinds(part))),
        "cells": ", ".join(dict.fromkeys(" x ".join(map(str, shape)) for shape in grids)) or "-",
        "rank": max(part.proof.rank for part in parts),
        "seconds": round(seconds, 1),
        "mebibytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        "check": "valid" if cg.check(certificate) else "NOT valid",
        "rollouts": _rollouts(problem, certificate.controller),
        "random": _rollouts(problem, RandomController()),
    }


def _rollouts(problem: cg.Problem, policy: Any) -> dict[str, Any]:
    """Return how many episodes satisfied the task, and the exact limits of their probability."""
    runs = rollout(problem, policy, episodes=EPISODES, seed=SEED)
    low, high = clopper_pearson(runs.successes, runs.episodes, CONFIDENCE)
    limits = {"confidence": CONFIDENCE, "low": low, "high": high}
    return {"episodes": EPISODES, "seed": SEED, "successes": runs.successes, **limits}


def _on_grids(part: Any) -> tuple[Any, ...]:
    """Return the agents of a certificate that have cells."""
    return tuple(part.proof.agents_of(part.problem)) if part.proof.has_cells else ()


def _kinds(part: Any) -> list[str]:
    """Return the relations of a certificate."""
    return [agent.relation["kind"] for agent in _on_grids(part)] or ["path"]


def longer(name: str) -> list[dict[str, Any]]:
    """Synthesize one problem with settings that take minutes, and check what comes out."""
    found = []
    for options in LONGER.get(name, []):
        began = time.process_time()
        certificate = cg.synthesize(name, **options).certificate
        seconds = round(time.process_time() - began)
        words = ", ".join(f"{key} {value}" for key, value in options.items())
        assert cg.check(certificate), name
        found.append({"settings": words, "certified": float(certificate.lower_bound), "seconds": seconds})
        print(name, found[-1], flush=True)
    return found


def main() -> None:
    """Measure, and write the file after each problem."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*", default=cg.problem_ids())
    parser.add_argument("--out", type=Path, default=DEFAULTS)
    parser.add_argument("--longer", action="store_true", help="settings of about ten minutes")
    parser.add_argument("--entry", action="store_true", help="print the entry of one problem")
    options = parser.parse_args()
    if options.entry:
        print(json.dumps(measured(options.ids[0])))
        return
    for name in options.ids:
        kept = json.loads(options.out.read_text(encoding="utf-8")) if options.out.exists() else {}
        if options.longer:
            if name in LONGER:
                kept.setdefault(name, {})["longer"] = longer(name)
        else:
            run = subprocess.run(
                [sys.executable, __file__, "--entry", name], capture_output=True, text=True, check=True
            )
            slow = {key: kept[name][key] for key in ("longer",) if key in kept.get(name, {})}
            kept[name] = json.loads(run.stdout.splitlines()[-1]) | slow
            print(name, kept[name]["certified"], kept[name]["seconds"], flush=True)
        options.out.write_text(json.dumps(dict(sorted(kept.items())), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
