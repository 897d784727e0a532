"""How much better than the certified controllers a learner does that starts from them: the table of ``docs/probes.md``.

``python benchmarks/probes.py [--seconds 120] [--certificates FOLDER] [--out docs/probes.md] [ID ...]`` probes suite
problems and writes the page, and beside it the numbers as JSON; those of other problems that are there already stay.
Certificates are made with the defaults, and kept in the folder if one is given. Needs the extra `rl`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import certigym as cg

HEAD = """# What a probe gains over the certified controllers

`certigym probe ID` lets a learner try to beat the certified controllers with the same information: it clones them,
improves the clone by PPO, and meets them on new episodes with common random numbers ([how](how-to/probe.md)). The gain
is the success probability of the learner less that of the controllers, with exact 99.9 % limits. A gain above 0 says
that the certificate leaves something on the table; a gain around 0 proves nothing. Bounds are those of
[defaults](defaults.md). Made by `python benchmarks/probes.py`, 20,000 episodes each; rows are of the certificates at
that time.

| id | controllers | clone | learner | gain | its limits | world steps | seconds |
|---|---|---|---|---|---|---|---|
"""


def certificate_of(name: str, folder: Path | None) -> cg.Certificate:
    """Return the certificate of the defaults, from the folder if it is there."""
    path = None if folder is None else folder / f"{name}.npz"
    if path is not None and path.is_file():
        return cg.load(path)
    certificate = cg.synthesize(name).certificate
    if path is not None:
        cg.save(certificate, path)
    return certificate


def probed(name: str, seconds: float, folder: Path | None) -> dict[str, Any]:
    """Probe one problem and return its numbers."""
    found = cg.probe(name, certificate_of(name, folder), 20_000, seconds=seconds)
    return {
        "certified": round(found.lower_bound, 6),
        "controllers": found.certified / found.episodes,
        "clone": found.cloned,
        "learner": found.learned / found.episodes,
        "gain": round(found.gain, 6),
        "gain_low": round(found.gain_low, 6),
        "gain_high": round(found.gain_high, 6),
        "steps": sum(attempt.steps for attempt in found.attempts),
        "seconds": round(found.seconds),
    }


def row(name: str, numbers: dict[str, Any]) -> str:
    """Return the row of a problem."""
    rates = " | ".join(f"{numbers[key]:.4f}" for key in ("controllers", "clone", "learner"))
    limits = f"[{numbers['gain_low']:+.4f}, {numbers['gain_high']:+.4f}]"
    cost = f"{numbers['steps']} | {numbers['seconds']}"
    return f"| {name} | {rates} | {numbers['gain']:+.4f} | {limits} | {cost} |"


def main() -> None:
    """Probe the problems one after the other, and write page and numbers after each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*", default=cg.problem_ids())
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--certificates", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/probes.md"))
    options = parser.parse_args()
    table = options.out.with_suffix(".json")
    found = json.loads(table.read_text(encoding="utf-8")) if table.is_file() else {}
    for name in options.ids:
        found[name] = probed(name, options.seconds, options.certificates)
        print(row(name, found[name]), flush=True)
        table.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        rows = [row(id, found[id]) for id in sorted(found)]
        options.out.write_text(HEAD + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
