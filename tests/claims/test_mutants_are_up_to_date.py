"""Every mutant of the trusted base still changes a line that is there."""

from __future__ import annotations

from pathlib import Path

import pytest

from mutants import MUTANTS, Mutant
from mutations import FOUND, merged, page_of, summary_of

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: Path(mutant.path).stem)
def test_the_line_is_there(mutant: Mutant) -> None:
    text = (ROOT / mutant.path).read_text(encoding="utf-8")
    assert mutant.old in text and mutant.new != mutant.old, mutant.old


def test_the_page_is_what_the_run_gave() -> None:
    rows = merged(FOUND, [])
    page = (ROOT / "docs" / "mutations.md").read_text(encoding="utf-8")
    assert page.endswith(f"{summary_of(rows)}\n\n{page_of(rows)}")


def test_every_mutant_was_shown_to_the_tests() -> None:
    """A line that is new has to be tried: ``python benchmarks/mutations.py --only .. --json docs/mutations.json``."""
    tried = {(row["module"], row["line"], row["was"]) for row in merged(FOUND, []) if row["tests"] is not None}
    assert {(mutant.path, mutant.new, mutant.old) for mutant in MUTANTS} <= tried
