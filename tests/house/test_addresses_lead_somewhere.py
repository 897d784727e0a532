"""Old addresses of the site lead to pages that exist, and so do the words that readers search for."""

from __future__ import annotations

from pathlib import Path

import pytest

import certigym as cg
import redirects

DOCS = Path(__file__).parents[2] / "docs"


def test_old_addresses_lead_to_pages() -> None:
    moved = redirects.moved()
    assert not [old for old in moved if (DOCS / f"{old}.md").exists()]
    assert not [new for new in moved.values() if not (DOCS / f"{new}.md").exists()]


def test_every_id_has_an_address() -> None:
    """The page of an id is there, or its address leads to the page on which the id is a row."""
    moved = redirects.moved()
    for id in cg.problem_ids():
        assert f"environments/{id}" in moved or (DOCS / "environments" / f"{id}.md").exists()


def test_searched_words_lead_to_one_page_each() -> None:
    pytest.importorskip("sphinx", reason="needs the extra `docs`")
    from searched_words import SEARCHED

    assert not [page for page in SEARCHED if not (DOCS / f"{page}.md").exists()]
    words = [word.lower() for found in SEARCHED.values() for word in found]
    assert len(words) == len({*words})
    assert {"timeout", "ltl", "safety filter", "my bound is 0", "neural network"} <= {*words}


def test_the_front_page_has_at_most_sixteen_entries() -> None:
    """What the list beside every page shows before anything is opened."""
    text = (DOCS / "index.md").read_text(encoding="utf-8")
    trees = [block.split("```")[0] for block in text.split("```{toctree}")[1:]]
    entries = [line for tree in trees for line in tree.splitlines() if line and not line.startswith(":")]
    assert len(entries) <= 16
    captions = [line.removeprefix(":caption: ") for line in text.splitlines() if line.startswith(":caption:")]
    assert captions == ["Start", "Tutorials", "Environments", "How-to", "Theory", "Reference", "Evidence"]
