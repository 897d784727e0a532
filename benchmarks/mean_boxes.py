"""What mean boxes certify, beside linear cells and rollouts on the same cells.

    python benchmarks/mean_boxes.py              every row of the table
    python benchmarks/mean_boxes.py building     rows whose name holds a word

The bounds of ``boxes`` use nothing of an agent but enclosures of its means; for linear agents they are here to be
compared with relations that know more.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import certigym as cg
from measuring import show

EPISODES = 20_000
"""Rollouts of each controller."""

MOST_CELLS = 10_000
"""Cells of an agent up to which linear cells are tried for comparison; they take minutes beyond."""


def one_cart() -> cg.Problem:
    """One agent of ``reach-avoid-kinematic-v0``, which is to come to a half plane."""
    team = cg.make_problem("reach-avoid-kinematic-v0")
    return cg.Problem(
        name="one-kinematic",
        horizon=12,
        agents=[team.agents[0]],
        propositions={"p1": team.propositions["p1"]},
        specification=cg.Specification("F p1", "co-safe"),
    )


def below_the_edge() -> cg.Problem:
    """The chain started just inside a cell: its own start lies on an edge, and counts to the cell beyond it."""
    problem = cg.make_problem("integrator-chain-v0")
    return problem.replace(name="integrator-chain, from 7.499", initial_state=[7.499, 0.0])


ROWS: tuple[tuple[Any, Any], ...] = (
    ("integrator-chain-v0", 200),
    ("integrator-chain-v0", 400),
    (below_the_edge, 200),
    (below_the_edge, 400),
    ("building-automation-v0", [50, 60]),
    (one_cart, 60),
    (one_cart, [150, 60]),
    ("reach-avoid-kinematic-v0", [75, 30]),
    ("reach-avoid-v0", 100),
    ("car-park-v0", 120),
    ("package-delivery-single-v0", 40),
    ("meeting-v0", 32),
)
"""Problems, or functions that make them, and cells."""


def measured(problem: Any, cells: Any) -> dict[str, object]:
    """Bounds of both relations on the same cells, seconds, and rollouts of the controller of ``boxes``."""
    began = time.perf_counter()
    certificate = cg.synthesize(problem, cells, relation="boxes").certificate
    seconds = time.perf_counter() - began
    began = time.perf_counter()
    is_valid = bool(cg.check(certificate))
    checked = time.perf_counter() - began
    estimate = cg.validate(certificate, EPISODES, seed=1).estimate
    bounds = {"boxes": certificate.lower_bound, "rollouts": estimate}
    if max(len(part.policy[0, 0]) for part in certificate.proof.agents) <= MOST_CELLS:
        bounds["linear"] = cg.synthesize(problem, cells, relation="linear").certificate.lower_bound
    return {
        "problem": certificate.problem.name,
        "cells": str(cells),
        **{name: f"{bound:.4f}" for name, bound in bounds.items()},
        "seconds": seconds,
        "check": is_valid,
        "seconds of the check": checked,
    }


def main() -> None:
    """Measure the rows that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("word", nargs="?", default="", help="only rows whose problem has this in its name")
    word = parser.parse_args().word
    for problem, cells in ROWS:
        made = problem() if callable(problem) else problem
        if word in (made if isinstance(made, str) else made.name):
            show("Mean boxes and linear cells", [measured(made, cells)])


if __name__ == "__main__":
    main()
