"""Pages are short enough to be read: 90,000 words in all, and tutorials of ten minutes with a picture each."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *(page for page in sorted(DOCS.rglob("*.md")) if "_build" not in page.parts)]
MOST_WORDS, MOST_OF_A_TUTORIAL = 90_000, 450


def words(page: Path) -> int:
    """As ``wc -w`` counts them, signs of tables and code included."""
    return len(page.read_text(encoding="utf-8").split())


def test_all_pages_together() -> None:
    longest = sorted(((words(page), page.name) for page in PAGES), reverse=True)[:5]
    assert sum(map(words, PAGES)) <= MOST_WORDS, f"shorten a page; the longest are {longest}"


@pytest.mark.parametrize("name", ["my_robot", "sb3_policy", "safety_filter", "check_a_certificate", "paper_plot"])
def test_a_tutorial_takes_ten_minutes_and_has_a_picture(name: str) -> None:
    page = DOCS / "tutorials" / f"{name}.md"
    assert words(page) <= MOST_OF_A_TUTORIAL
    assert "](../figures/tutorial_" in page.read_text(encoding="utf-8")
