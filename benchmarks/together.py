"""Teams that must not collide: ``python benchmarks/together.py [--json PATH] [--large]``.

CPU seconds on one thread of whole syntheses and of their checks, bounds, and rollouts. The last table shows time
against the number of pairs; its exponent is the slope over the larger half. ``--large`` adds the largest teams.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from typing import Any

import certigym as cg
from measuring import Row, Rows, once, options, save, show
from scaling import exponent

EPISODES = 20_000

AIMS: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("swarm-v0", {"n_agents": 2}, "bound within .02 of the rollouts"),
    ("swarm-v0", {"n_agents": 20}, "bound .95 in 120 s"),
    ("platoon-distance-v0", {"n_agents": 100}, "bound .95 in 60 s"),
    ("corridor-v0", {}, "one robot waits"),
    ("rendezvous-v0", {}, "stay near a leader"),
)
"""Problems, their arguments, and what is aimed at."""

PLATOONS, SWARMS = (25, 50, 100, 200), (5, 10, 20, 30)
"""Numbers of agents in the tables of times."""


def measured(id: str, arguments: dict[str, Any], aim: str = "") -> Row:
    """Return one row: a synthesis, its check, and rollouts of its controllers."""
    problem = cg.make_problem(id, **arguments)
    seconds, result = once(lambda: cg.synthesize(problem))
    check_seconds, report = once(lambda: cg.check(result))
    validation = cg.validate(result, episodes=EPISODES)
    return {
        "problem": problem.name,
        "agents": problem.n_agents,
        "pairs": len(problem.labeling.pairs),
        "bound": result.certificate.lower_bound,
        "rollouts": validation.estimate,
        "verdict": validation.verdict,
        "check": "valid" if report else "NOT valid",
        "seconds": seconds,
        "check s": check_seconds,
        **({"aim": aim} if aim else {}),
    }


def main() -> None:
    """Measure, print and save."""
    arguments = options(__doc__, ["--large"])
    aims: Rows = [measured(id, given, aim) for id, given, aim in AIMS]
    show("Aims", aims)
    results: dict[str, Any] = {"aims": aims}
    for id, sizes in (("platoon-distance-v0", PLATOONS), ("swarm-v0", SWARMS)):
        rows = [measured(id, {"n_agents": n}) for n in (sizes if arguments.large else sizes[:-1])]
        show(f"{id}: time against pairs", rows)
        slope = exponent([(row["pairs"], row["seconds"]) for row in rows])
        print(f"  seconds grow like pairs to the power {slope:.2f}")
        results[id] = {"rows": rows, "exponent": slope}
    save(results, arguments.json)


if __name__ == "__main__":
    main()
