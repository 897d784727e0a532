"""Certificates of ``examples/certificates``: there is something to check before anything was computed."""

from __future__ import annotations

from pathlib import Path

import pytest

from certigym.cli.main import main
from kinds import mostly_thorough

FOLDER = Path(__file__).parents[2] / "examples" / "certificates"
FILES = sorted(FOLDER.glob("*.npz"))


def test_there_are_a_few_small_ones() -> None:
    assert len(FILES) >= 5
    assert all(file.stat().st_size < 50_000 for file in FILES)


@mostly_thorough("file", FILES, first=2, ids=lambda file: file.stem)
def test_honest_ones_are_valid_and_the_forged_one_is_not(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status = main(["check", str(file)])
    out = capsys.readouterr().out
    assert (status != 0) == file.stem.startswith("forged")
    assert ("NOT valid" in out) == file.stem.startswith("forged")
