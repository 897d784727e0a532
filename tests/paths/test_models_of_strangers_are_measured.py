"""The table of ``examples/own``: every file is in it, all were valid, and a few are as quick and as good today."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import certigym as cg

ROOT = Path(__file__).parents[2]
ROWS = {row["file"]: row for row in json.loads((ROOT / "docs" / "own_models.json").read_text(encoding="utf-8"))}


def test_every_file_is_in_the_table_and_on_the_page() -> None:
    files = {file.name for file in (ROOT / "examples" / "own").glob("*.toml")}
    assert files == {*ROWS}
    page = (ROOT / "docs" / "own_models.md").read_text(encoding="utf-8")
    assert all(f"| {name} |" in page for name in files)
    assert all(row["check"] == "valid" for row in ROWS.values())
    assert all(row["rollouts"] >= row["certified"] - 1e-3 for row in ROWS.values())
    assert all(row["by_hand"] is None or 0.0 <= row["by_hand"][0] <= row["by_hand"][1] <= 1.0 for row in ROWS.values())


@pytest.mark.parametrize("name", ["docking", "rail_crossing", "moving_reference"])
@pytest.mark.thorough
@pytest.mark.full_search
def test_without_options_they_get_what_the_table_says(name: str) -> None:
    problem = cg.load(ROOT / "examples" / "own" / f"{name}.toml")
    certificate = cg.synthesize(problem).certificate
    assert certificate.lower_bound >= 0.999
    # Failures are about those of the table on other machines, too.
    assert 1.0 - certificate.lower_bound <= 1.05 * (1.0 - ROWS[f"{name}.toml"]["certified"]) + 1e-9
    assert cg.check(certificate, problem)
