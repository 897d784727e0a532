"""Certificates of the suite in ball arithmetic: ``python benchmarks/rigorous.py [--json PATH] [ID ...]``.

Every problem of the suite is synthesized on the cells below, checked in double precision and in balls, on one thread.
Its row says what became of it: proved, or what was not; seconds are those of the processor. The first row is the
example of the paper: 1000 cells per agent. ``--markdown`` prints the table of docs/trusted-base.md, which a test
compares with the suite.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import math

import certigym as cg
from certigym.synthesis.balls import check_rigorous
from measuring import Row, Rows, once, save, show

CELLS = {1: 200, 2: 40, 3: 16, 4: 10}
"""Cells per axis by the number of states of an agent."""


def row_of(name: str, cells: int | None = None) -> Row:
    """Return what became of one problem."""
    problem = cg.make_problem(name)
    wanted = {agent.name: cells or CELLS.get(agent.n_states, 8) for agent in problem.agents}
    # Where no grid reaches, a path has no cells.
    on_path = any(agent.n_states > max(CELLS) or (problem.labeling.pairs and isinstance(agent, cg.Agent))
                  for agent in problem.agents)  # fmt: skip
    told = "-" if on_path else "/".join(map(str, sorted({*wanted.values()})))
    row: Row = {"problem": name, "cells": told, "T": problem.horizon}
    row |= dict.fromkeys(("claim", "rank", "check s", "balls s", "margin", "outcome"))
    try:
        certificate = cg.synthesize(problem, None if on_path else wanted).certificate
    except ValueError as error:
        return row | {"outcome": f"not synthesized: {_short(error)}"}
    rank = certificate.proof.rank
    row |= {"claim": certificate.lower_bound, "rank": rank}
    seconds, plain = once(lambda: cg.check(certificate))
    row |= {"check s": seconds}
    try:
        seconds, report = once(lambda: check_rigorous(certificate))
    except ValueError as error:
        return row | {"outcome": f"refused: {_short(error)}"}
    margin = report.low - certificate.lower_bound
    return row | {"balls s": seconds, "margin": margin, "outcome": "proved" if report and plain else str(report)}


def _short(error: ValueError) -> str:
    """What was expected and what came, without the remedy."""
    return str(error).split("; ")[0].removeprefix("`--rigorous`: ")


def markdown(rows: Rows) -> str:
    """The rows as a table of a page."""
    lines = [
        "| problem | cells | steps | claim | terms | check, s | balls, s | margin | |",
        "|---|---|" + "---:|" * 6 + "---|",
    ]
    for row in rows:
        claim = "" if row["claim"] is None else f"{math.floor(row['claim'] * 1e6) / 1e6:.6f}"
        numbers = ["" if row[key] is None else f"{max(0.0, row[key]):.2g}" for key in ("check s", "balls s", "margin")]
        rank = "" if row["rank"] is None else str(row["rank"])
        cells = [row["problem"], row["cells"], str(row["T"]), claim, rank, *numbers, row["outcome"]]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ids", nargs="*", metavar="ID")
    parser.add_argument("--json", metavar="PATH")
    parser.add_argument("--markdown", action="store_true", help="print the table of docs/trusted-base.md")
    options = parser.parse_args()
    rows: Rows = []
    if not options.ids:
        rows.append(row_of("reach-avoid-v0", 1000))
    for name in options.ids or cg.problem_ids():
        rows.append(row_of(name))
        print(rows[-1], flush=True)
    show("Certificates in ball arithmetic", rows)
    if options.markdown:
        print(markdown(rows))
    save({"rows": rows}, options.json)


if __name__ == "__main__":
    main()
