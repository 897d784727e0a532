"""What every suite problem certifies with an id and no options: bound, rollouts, relation, cells, seconds.

``python benchmarks/defaults.py [--out docs/defaults.md] [ID ...]`` writes the table of the page. The bounds of version
0.1, with its defaults, stand beside those of today. Seconds are CPU seconds of one process, and depend on the machine.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import certigym as cg

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

HEAD = """# What the defaults certify

Every problem of the suite with its id and no options (`certigym run ID`), beside version 0.1. Bounds are certified
lower bounds, checked by `certigym check`; rollouts are the share of 100,000 episodes that satisfied the task, an
estimate with a standard error of up to .0016; "any policy" is an upper bound on what any policy of the continuous
system attains. Seconds are CPU seconds. Made by `python benchmarks/defaults.py`.

| id | 0.1 | certified | rollouts | any policy | relation | cells | rank | seconds | check |
|---|---|---|---|---|---|---|---|---|---|
"""


def row(name: str) -> str:
    """Synthesize, check and simulate one problem with the defaults, and return its row."""
    began = time.process_time()
    result = cg.synthesize(name)
    seconds = time.process_time() - began
    certificate = result.certificate
    parts = getattr(certificate, "parts", (certificate,))
    shapes = {" x ".join(map(str, agent.grid.shape)) for part in parts for agent in part.agents}
    kinds = {agent.relation["kind"] for part in parts for agent in part.agents}
    estimate = cg.validate(certificate, 100_000).estimate
    valid = "valid" if cg.check(certificate) else "NOT valid"
    rank = max(part.rank for part in parts)
    above = result.stats.get("continuous_upper_bound")
    most = f"{above:.4f}" if isinstance(above, float) else "none"
    numbers = f"{BEFORE.get(name, float('nan')):.4f} | {certificate.lower_bound:.4f} | {estimate:.4f} | {most}"
    return f"| {name} | {numbers} | {'/'.join(kinds)} | {', '.join(shapes)} | {rank} | {seconds:.0f} | {valid} |"


def main() -> None:
    """Print the rows and write the page, if one is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*", default=cg.problem_ids())
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = []
    for name in options.ids:
        rows.append(row(name))
        print(rows[-1], flush=True)
        if options.out is not None:
            options.out.write_text(HEAD + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
