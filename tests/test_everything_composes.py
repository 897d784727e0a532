"""Whatever can be certified can be asked everything that mathematics allows: the matrix of capabilities.

Rows are ways to move and to certify, columns are what users ask of a certificate (``composing``). A cell is a result
that is compared with a dense program of the joint system, or a refusal in words with the reason of mathematics
(``CANNOT``). What could be and is not yet there is ``MISSING``: an expected failure that fails when it is filled.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from composing import COLUMNS, RESOLUTION, ROWS, Claims, optimum

EVERY_CELL = [(row, column) for row in ROWS for column in COLUMNS]

BOXES = [row for row in ROWS if row.startswith("boxes")]
LINEAR = [row for row in ROWS if row.startswith("linear")]
TIMED = ["exact in time", "linear in time"]
NO_VALUES_ON_PATHS = "along a path"
"""A path proves one run from one start: it has no values at other states and times, and no cells."""

NO_VALUES_BY_SUBTRACTION = "by subtraction"
"""What pairs may spoil is bounded for the whole run: what is subtracted is no function of the state."""

GROWS = "what pairs may spoil grows with every step"
"""What is subtracted is a sum over all steps: nothing is left of it without a deadline."""

CANNOT: dict[str, dict[str, str]] = {
    # Trains round sums of factors: a step must take sums to sums, which least values over boxes and corners do not.
    "train": dict.fromkeys(BOXES + LINEAR, "expected 'auto' or 'tree'"),
    "own upper end": {"path": "no upper end", "path in time": "no upper end"},
    "opposite end": {"path": "no upper end", "path in time": "no upper end"},
    # What may be lost at every step cannot be promised; an abstract state is not the state that a shield sees; inputs
    # that others rely on cannot be left to a learner.
    "shield": {
        "tube": "without memory",
        "ellipsoid": "without memory",
        "ellipsoid with delta": "delta = 0",
        "paper": "delta = 0",
        "boxes common input": "chosen in common",
        "path": NO_VALUES_ON_PATHS,
        "path in time": NO_VALUES_ON_PATHS,
        "subtraction": NO_VALUES_BY_SUBTRACTION,
    },
    # Permissions are sets of inputs at states: choices of an abstract state are none. Inputs that others rely on are
    # the same everywhere: nothing is left to choose cell by cell.
    "permission": {
        "boxes common input": "chosen in common",
        "tube": "expected the relation",
        "ellipsoid": "expected the relation",
        "ellipsoid with delta": "expected the relation",
        "paper": "expected the relation",
        "path": NO_VALUES_ON_PATHS,
        "path in time": NO_VALUES_ON_PATHS,
        "subtraction": NO_VALUES_BY_SUBTRACTION,
    },
    # A policy that looks at the state is not known to others; a path has a feedback of its own.
    "certify": {
        "boxes common input": "whose inputs depend on states",
        "path": "expected one of auto",
        "path in time": "expected one of auto",
    },
    "at": {"path": NO_VALUES_ON_PATHS, "path in time": NO_VALUES_ON_PATHS, "subtraction": "about pairs of agents"},
    "values in time": {
        "path": NO_VALUES_ON_PATHS,
        "path in time": NO_VALUES_ON_PATHS,
        "subtraction": NO_VALUES_BY_SUBTRACTION,
    },
    "audit": {"path": NO_VALUES_ON_PATHS, "path in time": NO_VALUES_ON_PATHS, "subtraction": NO_VALUES_BY_SUBTRACTION},
    "field": {"path": NO_VALUES_ON_PATHS, "path in time": NO_VALUES_ON_PATHS, "subtraction": "."},
    # Rates are read from least values: nothing is bounded where one of them is 0, as when a battery runs empty.
    "safety rate": {
        "ellipsoid with delta": "delta = 0",
        "paper": "delta = 0",
        "boxes no noise": "falls to 0",
        **dict.fromkeys(TIMED, "policies have to look at it"),
        "path": NO_VALUES_ON_PATHS,
        "path in time": NO_VALUES_ON_PATHS,
        "subtraction": GROWS,
    },
    # Beyond the horizon nothing is said of the time, and policies that do not look at it cannot know it.
    "no deadline": {"subtraction": GROWS, **dict.fromkeys([*TIMED, "path in time"], "the same at every step")},
    "budget": {"path": "has no grid", "path in time": "which has no grid"},
    "start=": dict.fromkeys(["path", "path in time"], NO_VALUES_ON_PATHS),
}
"""Refusals by mathematics: column, row, and what the message says."""

WRITTEN_OUT = "it is about the problem written out alone"

MISSING: dict[str, dict[str, str]] = {
    "train": {"subtraction": "tasks about pairs do not ask for trains"},
    "shield": {"train": "values in time of trains are not read"},
    "permission": {"train": "permissions read trees alone"},
    "start box": {
        "exact correlated": "start boxes are read on cells that are boxes of states",
        "subtraction": "pairs are read at points",
    },
    "safety rate": {"train": "rates read trees alone"},
    "budget": {"subtraction": "tasks about pairs do not ask for budgets"},
}
"""What could be and is not there yet: column, row, why."""

MENUS = "test_menus_of_inputs_keep_what_they_promise asks the same and more of these rows"
OTHER_ROWS = "cells are chosen by the relation, the noise and the neighbours, of which other rows have each"

ELSEWHERE: dict[str, dict[str, str]] = {
    "permission": dict.fromkeys(
        [
            "linear matrices",
            "linear expressions",
            "boxes matrices",
            "boxes Laplace",
            "boxes noise scale",
            "boxes no noise",
        ],
        MENUS,
    ),
    "budget": dict.fromkeys(
        [
            "ellipsoid",
            "linear matrices",
            "linear in time",
            "boxes expressions",
            "boxes Laplace",
            "boxes disturbance",
        ],
        OTHER_ROWS,
    ),
}
"""Cells that other tests imply: column, row, which."""

CELLS = [(row, column) for row, column in EVERY_CELL if row not in ELSEWHERE.get(column, {})]


def expected(row: str, column: str) -> Any:
    marks = []
    if reason := MISSING.get(column, {}).get(row):
        marks.append(pytest.mark.xfail(strict=True, reason=reason, raises=(ValueError, AssertionError)))
    return pytest.param(row, column, marks=marks, id=f"{row} - {column}")


@pytest.mark.parametrize(("row", "column"), [expected(*cell) for cell in CELLS])
def test_cell(row: str, column: str, tmp_path: Path) -> None:
    if column == "device":
        pytest.importorskip("torch", reason="the extra `rl` brings a device")
    if said := CANNOT.get(column, {}).get(row):
        with pytest.raises(ValueError, match=said):
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
    """A cell cannot be, or is missing, or works: not two of these; and there is nothing else in the tables.

    What other tests imply works.
    """
    cannot = {(row, column) for column, rows in CANNOT.items() for row in rows}
    missing = {(row, column) for column, rows in MISSING.items() for row in rows}
    elsewhere = {(row, column) for column, rows in ELSEWHERE.items() for row in rows}
    assert not cannot & missing and cannot | missing <= {*CELLS} and cannot | missing | elsewhere <= {*EVERY_CELL}


def test_dense_programs_see_claims_that_are_too_large() -> None:
    """Their resolution is small against what is at stake: for most rows a claim of .1 more would be seen."""
    seen = [row for row in ROWS if optimum(row) + RESOLUTION < 1.0]
    assert len(seen) >= 3
