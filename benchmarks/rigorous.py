"""Certificates of the suite in ball arithmetic: ``python benchmarks/rigorous.py [--json PATH] [ID ...]``.

Every problem is synthesized on the cells below, checked in double precision and in balls, on one thread. The first row
is the example of the paper: 1000 cells per agent.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse

import certigym as cg
from certigym.synthesis.checking import check_rigorous
from measuring import Row, Rows, once, save, show

CELLS = {1: 200, 2: 40, 3: 16, 4: 10}
"""Cells per axis by the number of states of an agent."""

MOST_RANK = 2000
"""Terms beyond which a tree is left out: its balls would take many minutes."""


def row_of(name: str, cells: int | None = None) -> Row:
    """Return what became of one problem."""
    problem = cg.make_problem(name)
    wanted = {agent.name: cells or CELLS.get(agent.n_states, 8) for agent in problem.agents}
    row: Row = {"problem": name, "cells": "/".join(map(str, sorted({*wanted.values()}))), "T": problem.horizon}
    row |= dict.fromkeys(("claim", "rank", "check s", "balls s", "margin", "outcome"))
    try:
        certificate = cg.synthesize(problem, wanted).certificate
    except ValueError as error:
        return row | {"outcome": f"not synthesized: {error}"[:60]}
    row |= {"claim": certificate.lower_bound, "rank": certificate.rank}
    seconds, plain = once(lambda: cg.check(certificate))
    row |= {"check s": seconds}
    if certificate.rank > MOST_RANK:
        return row | {"outcome": f"left out: {certificate.rank} terms"}
    try:
        seconds, report = once(lambda: check_rigorous(certificate))
    except ValueError as error:
        return row | {"outcome": str(error).split("; ")[0][:70]}
    margin = report.low - certificate.lower_bound
    return row | {"balls s": seconds, "margin": margin, "outcome": "proved" if report and plain else str(report)[:70]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ids", nargs="*", metavar="ID")
    parser.add_argument("--json", metavar="PATH")
    options = parser.parse_args()
    rows: Rows = []
    if not options.ids:
        rows.append(row_of("reach-avoid-v0", 1000))
    for name in options.ids or cg.problem_ids():
        rows.append(row_of(name))
        print(rows[-1], flush=True)
    show("Certificates in ball arithmetic", rows)
    save({"rows": rows}, options.json)


if __name__ == "__main__":
    main()
