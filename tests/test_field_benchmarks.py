"""The rows of the field's benchmarks: their files are those that are written, and their certificates hold."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import pytest

from certigym.cli.main import main
from certigym.validation.paper import arch

FOLDER = Path(__file__).parents[1] / "benchmarks" / "arch"


def test_files_are_those_that_are_written(tmp_path: Path) -> None:
    written: dict[str, Any] = runpy.run_path(str(FOLDER / "write_problems.py"))
    written["row"].__globals__["HERE"] = tmp_path
    rows = written["rows"]()
    assert rows == json.loads((FOLDER / "rows.json").read_text(encoding="utf-8"))
    for row in rows:
        assert (tmp_path / row["problem"]).read_text() == (FOLDER / row["problem"]).read_text()


@pytest.mark.parametrize("row", ["chain-100", "bas-7", "bas-4-deviation", "ba-4d"])
def test_rows_are_not_below_what_is_published(row: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arch, "EPISODES", 2000)
    (result,) = arch.arch(tmp_path, row, FOLDER, progress=lambda text: None)
    assert result["check"] == "valid" and result["outcome"] == "not below"
    assert result["rollouts"] > result["certified"] - 0.05
    assert row in (tmp_path / "arch.md").read_text() and row in (tmp_path / "arch.csv").read_text()


def test_the_command_names_the_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(FOLDER.parents[1])
    assert main(["reproduce", "arch", "--row", "bas-9", "--out", str(tmp_path)]) == 2
    assert "expected one of chain-2, chain-3" in capsys.readouterr().err
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", "arch", "--out", str(tmp_path)]) == 2
    assert "at the root of a checkout" in capsys.readouterr().err
