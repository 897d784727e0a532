"""What learners reach with the defaults, without help: the table of ``docs/learners.md``.

``python benchmarks/learners.py [--certificates FOLDER] [--out docs/learners.md] [ID ...]`` runs `certigym train ID`
with no options, one core, and writes the page, and beside it the numbers as JSON; those of other problems that are
there already stay. Needs the extra `rl`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import certigym as cg
from probes import certificate_of

EPISODES = 20_000

HEAD = """# What learners reach with the defaults

`certigym train ID` with no options: decentralised PPO with the information of certified policies, **without help**
from any certificate (seed 0, one core). "Certified" are the rollouts of the certified controllers of the defaults; both
columns are shares of 20,000 episodes on common random numbers. The aim is .8 of the certified share within ten minutes;
the pages of the environments say why a learner misses it. Rows are of the reward of 0.3; what the reward of today
reaches is in [learned policies](how-to/learned_policies.md).

Made by `python benchmarks/learners.py`.

| id | certified | PPO | of certified | world steps | seconds |
|---|---|---|---|---|---|
"""


def learned(name: str, folder: Path | None) -> dict[str, Any]:
    """Train on one problem with the defaults and return what the actor reaches."""
    problem = cg.make_problem(name)
    training = cg.train(problem)
    policies = {"certified": certificate_of(name, folder), "ppo": training}
    result = cg.compare(problem, policies, EPISODES, seed=77)
    rates = {entry.name: entry.rate for entry in result.entries}
    return {**rates, "steps": training.steps, "seconds": round(training.seconds)}


def row(name: str, numbers: dict[str, Any]) -> str:
    """Return the row of a problem."""
    share = f"{numbers['ppo'] / numbers['certified']:.3f}" if numbers["certified"] else "-"
    cost = f"{numbers['steps']} | {numbers['seconds']}"
    return f"| {name} | {numbers['certified']:.4f} | {numbers['ppo']:.4f} | {share} | {cost} |"


def main() -> None:
    """Train on the problems one after the other, and write page and numbers after each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*", default=cg.problem_ids())
    parser.add_argument("--certificates", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/learners.md"))
    options = parser.parse_args()
    table = options.out.with_suffix(".json")
    found = json.loads(table.read_text(encoding="utf-8")) if table.is_file() else {}
    for name in options.ids:
        found[name] = learned(name, options.certificates)
        print(row(name, found[name]), flush=True)
        table.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        rows = [row(id, found[id]) for id in sorted(found)]
        options.out.write_text(HEAD + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
