"""Whatever can be certified can be asked everything that mathematics allows: the matrix of capabilities.

Rows are ways to move and to certify, columns are what users ask of a certificate (``composing``). A cell is a result
that is compared with a dense program of the joint system, or a refusal in words with the reason of mathematics
(``CANNOT``): nothing that could be is missing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pytest

import limits_table
from composing import COLUMNS, RESOLUTION, ROWS, Claims, certificate_of, optimum

EVERY_CELL = [(row, column) for row in ROWS for column in COLUMNS]

BOXES = [row for row in ROWS if row.startswith("boxes")]
LINEAR = [row for row in ROWS if row.startswith("linear")]
TIMED = ["exact in time", "linear in time"]
PATHS = ["path", "path in time"]


@dataclass(frozen=True)
class Reason:
    """Why something cannot be: words of the message that says so, and the reason of mathematics."""

    said: str
    why: str


ON_PATHS = Reason("along a path", "a path proves one run from one start: it has no cells, and no values elsewhere")
PATHS_HAVE_NO_END = Reason(
    "no upper end", "a path proves that runs succeed near it; those that leave it may succeed, too"
)
OWN_FEEDBACK = Reason("expected one of auto", "a path has a feedback of its own: no policy is given to it")
BY_SUBTRACTION = Reason(
    "by subtraction",
    "what pairs may spoil is bounded for the whole run from its start, and is no function of the state",
)
AT_PAIRS = replace(BY_SUBTRACTION, said="about pairs of agents")
GROWS = Reason(
    "what pairs may spoil grows with every step",
    "what is subtracted is a sum over all steps: nothing is left of it without a deadline",
)
NOT_ADDITIVE = Reason(
    "expected 'auto' or 'tree'",
    "trains are rounded between sums of factors: a step must take sums to sums, and least values over cells do not",
)
BOTH_SIGNS = Reason(
    "factors have both signs",
    "factors of trains have both signs: no least value of such a sum is read off the least factors",
)
MAY_BE_LOST = Reason("delta = 0", "what may be lost at every step cannot be promised to others, nor for all times")
ON_LINEAR_CELLS = Reason(
    "along its trajectory", "networks on cells have linear cells, whose noise is Gaussian and the same everywhere"
)
LINEAR_ONLY = Reason(
    "along its trajectory",
    "networks on cells move agents with linear dynamics that no pair is about; others are certified along trajectories",
)
MODES = Reason(
    "along its trajectory", "networks on cells have a mode for each automaton state, which written out counts"
)
RUNS_EMPTY = Reason("falls to 0", "a battery runs empty in the end: no rate bounds what falls to 0")
LOOK_AT_TIME = Reason(
    "policies have to look at it", "rates are those of steps that are all the same, which steps in time are not"
)
STEPS_DIFFER = Reason("the same at every step", "beyond its horizon nothing is said of a problem whose steps differ")

CANNOT: dict[str, dict[str, Reason]] = {
    "train": dict.fromkeys(BOXES + LINEAR, NOT_ADDITIVE),
    "own upper end": dict.fromkeys(PATHS, PATHS_HAVE_NO_END),
    "opposite end": dict.fromkeys(PATHS, PATHS_HAVE_NO_END),
    "shield": {
        "train": BOTH_SIGNS,
        "paper": MAY_BE_LOST,
        **dict.fromkeys(PATHS, ON_PATHS),
        "subtraction": BY_SUBTRACTION,
    },
    "certify": dict.fromkeys(PATHS, OWN_FEEDBACK),
    "network": dict.fromkeys(["exact Laplace", "boxes Laplace", "boxes noise scale", "boxes no noise"], ON_LINEAR_CELLS)
    | dict.fromkeys(
        [
            "exact expressions",
            "linear expressions",
            "boxes expressions",
            "boxes disturbance",
            "boxes coupled",
            "subtraction",
        ],
        LINEAR_ONLY,
    )
    | dict.fromkeys([*TIMED, "path in time"], MODES),
    "at": {**dict.fromkeys(PATHS, ON_PATHS), "subtraction": AT_PAIRS},
    "values in time": {**dict.fromkeys(PATHS, ON_PATHS), "subtraction": BY_SUBTRACTION},
    "audit": {**dict.fromkeys(PATHS, ON_PATHS), "subtraction": BY_SUBTRACTION},
    "field": {**dict.fromkeys(PATHS, ON_PATHS), "subtraction": BY_SUBTRACTION},
    "safety rate": {
        "train": BOTH_SIGNS,
        "paper": MAY_BE_LOST,
        "boxes no noise": RUNS_EMPTY,
        **dict.fromkeys(TIMED, LOOK_AT_TIME),
        **dict.fromkeys(PATHS, ON_PATHS),
        "subtraction": GROWS,
    },
    "no deadline": {"subtraction": GROWS, **dict.fromkeys([*TIMED, "path in time"], STEPS_DIFFER)},
    "start=": dict.fromkeys(PATHS, ON_PATHS),
}
"""Refusals by mathematics: column, row, and why. The page of limits lists them (``docs/limits_table.py``)."""

SAME_END = "where something is lost, the opposite task is asked by the column `own upper end`"
ROUNDED_OUTWARD = (
    "along a path the checker rounds every operation outward, which `tests/checker` compares with 300 bits"
)

NOTHING_LOST = ["exact matrices", "exact Laplace", "exact expressions", "exact in time", "subtraction", "train"]
"""Rows whose certificates know what their policies attain at most without the opposite task."""

ELSEWHERE: dict[str, dict[str, str]] = {
    "opposite end": {row: SAME_END for row in ROWS if row not in [*NOTHING_LOST, *PATHS]},
    "rigorous": dict.fromkeys(PATHS, ROUNDED_OUTWARD),
}
"""Cells that other tests imply: column, row, which."""

CELLS = [(row, column) for row, column in EVERY_CELL if row not in ELSEWHERE.get(column, {})]


def spread(of: int) -> set[tuple[str, str]]:
    """One cell of every row (0) or of every column (1), each in another place than the one before."""
    lines: dict[str, list[tuple[str, str]]] = {}
    for cell in CELLS:
        lines.setdefault(cell[of], []).append(cell)
    return {cells[7 * k % len(cells)] for k, cells in enumerate(lines.values())}


FEW = spread(0) | spread(1)
"""Cells that are asked for at every commit."""

ASKED = [cell if cell in FEW else pytest.param(*cell, marks=pytest.mark.thorough) for cell in CELLS]


@pytest.mark.parametrize(("row", "column"), ASKED, ids=lambda name: name)
def test_cell(row: str, column: str, tmp_path: Path) -> None:
    if reason := CANNOT.get(column, {}).get(row):
        with pytest.raises(ValueError, match=reason.said):
            COLUMNS[column](row, tmp_path)
        return
    agrees(row, COLUMNS[column](row, tmp_path))


def agrees(row: str, claims: Claims) -> None:
    """What some policy attains is no more than the dense program attains, and it does not exceed upper ends."""
    if not claims.attained and not claims.exceeded_by_none:
        return
    most = optimum(row, claims.start)
    assert all(0.0 <= value <= most + RESOLUTION for value in claims.attained), (claims, most)
    assert all(value >= most - RESOLUTION for value in claims.exceeded_by_none), (claims, most)


def test_the_tables_name_cells_of_the_matrix() -> None:
    """A cell cannot be, or works, here or in other tests; and there is nothing else in the tables."""
    cannot = {(row, column) for column, rows in CANNOT.items() for row in rows}
    elsewhere = {(row, column) for column, rows in ELSEWHERE.items() for row in rows}
    assert cannot <= {*CELLS} and elsewhere <= {*EVERY_CELL}


def test_certificates_of_which_nothing_is_lost_are_those_that_know_their_end() -> None:
    assert [row for row in ROWS if certificate_of(row).gap is not None] == NOTHING_LOST


def test_dense_programs_see_claims_that_are_too_large() -> None:
    """Their resolution is small against what is at stake: for some rows a claim of .1 more would be seen."""
    seen = [row for row in ROWS if optimum(row) + RESOLUTION < 1.0]
    assert len(seen) >= 2


def test_the_page_of_limits_lists_them() -> None:
    page = limits_table.PAGE.read_text(encoding="utf-8")
    assert limits_table.with_table(page, limits_table.table(CANNOT)) == page, "run python docs/limits_table.py"
