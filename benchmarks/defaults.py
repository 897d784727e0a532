"""What every suite problem certifies with an id and no options: bound, rollouts, relation, cells, seconds.

``python benchmarks/defaults.py [--out docs/defaults.md] [ID ...]`` measures problems (all by default), keeps what it
found in a JSON file beside the page, and writes the page. The bounds of version 0.1, with its defaults, stand beside
those of today. With ``--longer`` settings are tried that take up to ten minutes, where these could certify more by .02.
Seconds are CPU seconds of one process, and depend on the machine.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import certigym as cg
from certigym.synthesis.certificates.proofs import rounded_down, rounded_up

BEFORE = {
    "building-automation-v0": 0.2597,
    "car-park-planar-v0": 0.9751,
    "car-park-v0": 0.8967,
    "cyclic-delivery-v0": 0.9683,
    "decoupled-chain-14-v0": 0.0007,
    "decoupled-chain-v0": 0.3514,
    "door-formation-v0": 0.9998,
    "integrator-chain-v0": 0.3241,
    "invariance-20-v0": 1.0,
    "invariance-4-v0": 1.0,
    "invariance-b-100-v0": 0.9991,
    "invariance-b-20-v0": 0.9998,
    "invariance-v0": 1.0,
    "meeting-v0": 0.5325,
    "package-delivery-eased-v0": 0.9996,
    "package-delivery-kinematic-v0": 0.2455,
    "package-delivery-single-v0": 0.9964,
    "package-delivery-v0": 0.0458,
    "patrol-recharge-v0": 0.9855,
    "reach-avoid-20-v0": 0.9687,
    "reach-avoid-kinematic-v0": 0.9449,
    "reach-avoid-n-v0": 0.9936,
    "reach-avoid-planar-v0": 0.4279,
    "reach-avoid-v0": 0.99998,
}
"""Bounds of version 0.1 with its defaults."""

LONGER: dict[str, list[dict[str, Any]]] = {
    "reach-avoid-planar-v0": [
        {"cells": 120, "relation": "linear"},
        {"cells": 100, "relation": "linear", "search": cg.SearchOptions(restarts=2)},
    ],
    "package-delivery-v0": [
        {"cells": 2000, "relation": "exact"},
        {"cells": 1000, "relation": "exact", "search": cg.SearchOptions(restarts=2)},
    ],
    "van-der-pol-v0": [{"cells": 260, "relation": "linear"}, {"cells": [500, 80], "relation": "boxes"}],
}
"""Settings for about ten minutes, of problems whose bound for any policy is .02 or more above what defaults certify."""

HEAD = """# What the defaults certify

Every problem of the suite with its id and no options (`certigym run ID`), beside version 0.1. Bounds are certified
lower bounds, rounded down, checked by `certigym check`; rollouts are the share of 100,000 episodes that satisfied the
task, an estimate with a standard error of up to .0016; "any policy" is an upper bound, rounded up, on what any policy
of the continuous system attains. Seconds are CPU seconds. Made by `python benchmarks/defaults.py`.

What is tried, in which order, and where that ends is [one table](how-to/choose_cells.md#the-default), by work that is
counted and not measured. A path is kept where its bound is .99 or more and it was cheaper than grids, or where every
grid that was tried fails more than 1.05 times as often: a grid has values, shields and starts everywhere besides.

| id | 0.1 | certified | rollouts | any policy | relation | cells | rank | seconds | check |
|---|---|---|---|---|---|---|---|---|---|
"""

TAIL = """
No upper bound for any policy is known of agents with expressions, nor of tasks about pairs of agents.

## What ten minutes certify

A setting cannot certify more than the upper bound for any policy, or than 1. So the defaults are within .02 of the
best bound that any setting can give wherever these are that near. For the other problems settings were tried that take
minutes (`python benchmarks/defaults.py --longer`):

| id | defaults | settings | certified | seconds |
|---|---|---|---|---|
"""


def measured(name: str) -> dict[str, Any]:
    """Synthesize, check and simulate one problem with the defaults."""
    began = time.process_time()
    result = cg.synthesize(name)
    seconds = time.process_time() - began
    certificate = result.certificate
    parts = certificate.proof.factors or (certificate,)
    above = result.stats.get("continuous_upper_bound")
    return {
        "certified": float(certificate.lower_bound),
        "rollouts": cg.validate(certificate, 100_000).estimate,
        "any policy": above if isinstance(above, float) else None,
        "relation": "/".join(dict.fromkeys(kind for part in parts for kind in _kinds(part))),
        "cells": ", ".join(
            dict.fromkeys(" x ".join(map(str, agent.grid.shape)) for part in parts for agent in _on_grids(part))
        )
        or "-",
        "rank": max(part.proof.rank for part in parts),
        "seconds": round(seconds),
        "check": "valid" if cg.check(certificate) else "NOT valid",
    }


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


def row(name: str, found: dict[str, Any]) -> str:
    """Return the row of the table."""
    before = f"{BEFORE[name]:.4f}" if name in BEFORE else "-"
    most = "none" if found["any policy"] is None else rounded_up(found["any policy"], 4)
    numbers = f"{before} | {rounded_down(found['certified'], 4)} | {found['rollouts']:.4f} | {most}"
    rest = " | ".join(str(found[key]) for key in ("relation", "cells", "rank", "seconds", "check"))
    return f"| {name} | {numbers} | {rest} |"


def page(kept: dict[str, Any]) -> str:
    """Return the page of all that was measured."""
    names = [name for name in cg.problem_ids() if name in kept]
    rows = "\n".join(row(name, kept[name]) for name in names)
    slow = [
        f"| {name} | {rounded_down(kept[name]['certified'], 4)} | {one['settings']} | "
        f"{rounded_down(one['certified'], 4)} | {one['seconds']} |"
        for name in names
        for one in kept[name].get("longer", [])
    ]
    return HEAD + rows + "\n" + TAIL + "\n".join(slow) + "\n"


def main() -> None:
    """Measure, and write the page and the file beside it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*", default=cg.problem_ids())
    parser.add_argument("--out", type=Path, default=Path("docs/defaults.md"))
    parser.add_argument("--longer", action="store_true")
    options = parser.parse_args()
    file = options.out.with_suffix(".json")
    for name in options.ids:
        kept = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
        if options.longer:
            if name in LONGER:
                kept.setdefault(name, {})["longer"] = longer(name)
        else:
            kept[name] = {**kept.get(name, {}), **measured(name)}
            print(row(name, kept[name]), flush=True)
        file.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
        options.out.write_text(page(kept), encoding="utf-8")


if __name__ == "__main__":
    main()
