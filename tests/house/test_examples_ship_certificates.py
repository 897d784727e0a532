"""Certificates of ``examples/certificates``: there is something to check before anything was computed.

They are what ``certigym synthesize`` finds by default, in the form that the small checker reads (``certigym
canonical``); the forged one claims more than its trajectory proves.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from certigym.cli.main import main
from kinds import mostly_thorough

FOLDER = Path(__file__).parents[2] / "examples" / "certificates"
CHECKER = Path(__file__).parents[2] / "synthesis" / "checker"
FILES = sorted(FOLDER.glob("*.npz"))


def test_there_are_a_few_small_ones() -> None:
    assert len(FILES) >= 5
    assert all(file.stat().st_size < 60_000 for file in FILES)


@mostly_thorough("file", FILES, first=2, ids=lambda file: file.stem)
def test_the_small_checker_proves_the_honest_ones_and_refuses_the_forged_one(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    is_forged = file.stem.startswith("forged")
    status, out = main(["check", str(file)]), capsys.readouterr().out
    assert status == int(is_forged) and ("PROVED" in out) != is_forged
    if is_forged:
        assert "a failure of at most 4.442e-10 follows, not 1e-12; most probable: `warm` at time 5" in out
    alone = [sys.executable, "-s", str(CHECKER), str(file)]
    done = subprocess.run(alone, capture_output=True, text=True, check=False)
    assert done.returncode == status and done.stdout.removeprefix(f"{file.parent}/") == out
