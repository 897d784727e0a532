"""Every mutant of the trusted base still changes a line that is there."""

from __future__ import annotations

from pathlib import Path

import pytest

from mutants import MUTANTS, Mutant

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: Path(mutant.path).stem)
def test_the_line_is_there(mutant: Mutant) -> None:
    text = (ROOT / mutant.path).read_text(encoding="utf-8")
    assert mutant.old in text and mutant.new != mutant.old, mutant.old
