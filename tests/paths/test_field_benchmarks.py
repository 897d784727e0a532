"""The rows of the field's benchmarks: their files are those that are written, and their certificates hold."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import pytest

from certigym.cli.main import main
from certigym.validation.presentation.paper import arch
from kinds import mostly_thorough

FOLDER = Path(__file__).parents[2] / "benchmarks" / "arch"


def test_files_are_those_that_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(FOLDER)
    written: dict[str, Any] = runpy.run_path(str(FOLDER / "write_problems.py"))
    written["row"].__globals__["HERE"] = tmp_path
    rows = written["rows"]()
    assert rows == json.loads((FOLDER / "rows.json").read_text(encoding="utf-8"))
    for row in rows:
        assert (tmp_path / row["problem"]).read_text() == (FOLDER / row["problem"]).read_text()


@mostly_thorough("row", ["chain-20", "bas-7", "ba-4d", "package-delivery-0.2"])
def test_rows_are_not_below_what_is_published(row: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arch, "EPISODES", 2000)
    (result,) = arch.arch(row, FOLDER).rows(tmp_path)
    assert result["check"] == "valid" and result["outcome"].startswith("not below")
    assert result["rollouts"] > result["certified"] - 0.05
    assert row in (tmp_path / "arch.md").read_text() and row in (tmp_path / "arch.csv").read_text()


@pytest.mark.thorough
def test_means_are_over_the_starts_that_count() -> None:
    """A mean over all starts, less those in the target: a lower bound of 1 on these would make the rest too large."""
    rows = json.loads((FOLDER / "rows.json").read_text(encoding="utf-8"))
    (entry,) = [entry for entry in rows if entry["row"] == "chain-2-reach-mean"]
    result = arch._certified({**entry, "cells": 60}, FOLDER, 20_000)
    assert result["check"] == "valid" and 0.05 < result["certified"] < result["rollouts"] < 1.0
    whole = result["certified"] * (1.0 - entry["sure"]) + entry["sure"]
    assert entry["sure"] < whole < 1.0


@mostly_thorough("row", ["rooms-3-all-heated", "rooms-5-two-heaters", "decoupled-2"])
def test_rows_without_a_published_number_are_checked(row: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arch, "EPISODES", 2000)
    (result,) = arch.arch(row, FOLDER).rows(tmp_path)
    assert (
        result["check"] == "valid" and result["certified"] > 0.3 and result["outcome"].startswith("no published number")
    )


@pytest.mark.thorough
def test_the_command_names_the_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(FOLDER.parents[1])
    assert main(["reproduce", "arch", "--row", "bas-9", "--out", str(tmp_path)]) == 2
    assert "expected one of chain-2, chain-3" in capsys.readouterr().err
    # Anywhere else the rows are found as well.
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", "arch", "--row", "bas-7", "--out", str(tmp_path)]) == 0
    assert "every number is as it was recorded" in capsys.readouterr().out
