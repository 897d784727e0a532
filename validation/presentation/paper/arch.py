"""The field's own benchmarks, certified here beside what was published about them.

Problem files and published numbers lie in ``benchmarks/arch`` of a checkout, and are packed into wheels. Every row is
synthesized as it is asked for there, checked, and met by rollouts. Published seconds are of other machines, ours are
processor seconds of this one, imports apart: they are of one order, and no race.
"""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Sequence
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

from ....envs.systems.arguments import write_json, write_text
from ....envs.tasks.problem import load_problem
from ....synthesis.certificates.proofs import significant_down, significant_up
from ....synthesis.verbs.synthesize import synthesize
from ...statistical_tests import clopper_pearson, rollout
from .reproduction import PieceResult, Reproduction

Row = dict[str, Any]

PACKED = Path(__file__).parent / "field"
"""Where the rows lie in an installed package."""

FOLDER = PACKED if PACKED.is_dir() else Path(__file__).resolve().parents[3] / "benchmarks" / "arch"
"""Where the rows lie: beside this file, or in the checkout that it belongs to."""

EPISODES, ERROR = 100_000, 1e-6
"""Rollouts of every row, and the probability that their limits miss the truth."""

COLUMNS = (
    "row", "asked", "published", "tool", "published_seconds", "machine", "certified", "failure", "seconds", "check",
    "rollouts", "upper_limit", "outcome", "note",
)  # fmt: skip


def arch(row: str | None = None, folder: Path = FOLDER) -> Reproduction:
    """Certify the rows of the field's benchmarks, or one of them.

    Raises
    ------
    ValueError
        If there is no such row, or no folder with rows.
    """
    if not (folder / "rows.json").is_file():
        raise ValueError(f"`arch`: expected the folder {folder} with rows.json; install the package anew")
    wanted = json.loads((folder / "rows.json").read_text(encoding="utf-8"))
    names = [entry["row"] for entry in wanted]
    if row is not None and row not in names:
        raise ValueError(f"`--row`: expected one of {', '.join(names)}, got {row!r}")
    pieces = {e["row"]: partial(_found, e, folder, EPISODES) for e in wanted if row in (None, e["row"])}
    return Reproduction(pieces, _written)


def _written(rows: Sequence[Row], out: Path) -> list[Row]:
    """Write the rows as CSV, JSON and a page, and return them."""
    out.mkdir(parents=True, exist_ok=True)
    text = StringIO()
    writer = csv.DictWriter(text, COLUMNS)
    writer.writeheader()
    writer.writerows(rows)
    write_text(out / "arch.csv", text.getvalue())
    write_json(out / "arch.json", rows)
    write_text(out / "arch.md", _page(rows))
    return list(rows)


def _found(entry: Row, folder: Path, episodes: int) -> PieceResult:
    """Return the row of an entry, and how it is told of."""
    row = _certified(entry, folder, episodes)
    beside = "" if row["published"] is None else f", published {row['published']:.10g}"
    return PieceResult(row, f"{significant_down(row['certified'], 6)}{beside}")


def _certified(entry: Row, folder: Path, episodes: int = EPISODES) -> Row:
    """Return a row with what is certified, how long that took, and what rollouts say."""
    problem = load_problem(folder / entry["problem"])
    assert problem.automaton  # translating the formula is no part of what is timed
    began = time.process_time()
    found = synthesize(problem, entry.get("cells"), relation=entry["relation"])
    certificate: Any = found.certificate
    spent: Any = found.stats["seconds"]
    report, seconds = found.checked, time.process_time() - began - spent["check"]
    successes = rollout(problem, certificate.controller, episodes, seed=0).successes
    _, high = clopper_pearson(successes, episodes, 1.0 - ERROR)
    # What is claimed, met and printed is the probability of a start that is neither in the target nor lost at once.
    share = 1.0 - entry.get("sure", 0.0) - entry.get("lost", 0.0)
    bound, met, high = (
        (value - entry.get("sure", 0.0)) / share for value in (certificate.lower_bound, successes / episodes, high)
    )
    published, failure = entry["published"], getattr(certificate.proof, "failure", 1.0 - bound)
    outcome = "no published number"
    if published is not None:
        outcome = "not below" if bound >= published else "below the published number"
    if entry["seconds"] is not None and seconds > entry["seconds"]:
        outcome += ", slower"
    return {
        "row": entry["row"],
        "asked": _asked(entry),
        "published": published,
        "tool": entry["tool"],
        "published_seconds": entry["seconds"],
        "machine": entry["machine"],
        "certified": bound,
        "failure": failure,
        "seconds": round(seconds, 4),
        "check": "valid" if report and bound <= high else "NOT valid",
        "rollouts": met,
        "upper_limit": high,
        "outcome": outcome,
        "note": entry["note"],
    }


def _asked(entry: Row) -> str:
    """Return what is asked for: the defaults, a relation, or cells as well."""
    cells = entry.get("cells")
    if cells is None:
        return "defaults" if entry["relation"] == "auto" else str(entry["relation"])
    return f"{entry['relation']}, {' x '.join(map(str, cells)) if isinstance(cells, list) else cells}"


def _page(rows: Sequence[Row]) -> str:
    """Return the rows as a table in Markdown."""
    lines = [
        "| row | published | tool, seconds, machine | asked for | certified | failure at most | seconds | check "
        "| rollouts | outcome |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        seconds = "" if row["published_seconds"] is None else f", {row['published_seconds']:g} s, {row['machine']}"
        published = "-" if row["published"] is None else f"{row['published']:.10g}"
        cells = [row["row"], published, f"{row['tool'] or '-'}{seconds}", row["asked"]]
        cells += [significant_down(row["certified"], 6), significant_up(row["failure"], 3)]
        cells += [f"{row['seconds']:g}", row["check"], f"{row['rollouts']:.5f}", row["outcome"]]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, "", *(f"- **{row['row']}**: {row['note']}" for row in rows)]) + "\n"
