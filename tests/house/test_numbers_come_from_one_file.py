"""Numbers about ids of the suite on pages are those of `docs/defaults.json`, written as `numbers_of_pages` does."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import certigym as cg
import numbers_of_pages as numbers
from certigym.synthesis.certificates.proofs import rounded_down

ROOT = Path(__file__).parents[2]
KEPT = numbers.table("defaults")
BOARD = numbers.Leaderboard.load(ROOT / "docs" / "leaderboard.json")
BOUND = re.compile(r"(?:P >= |failure <= |proved with |certified )(\d?\.\d{2,}|\d+(?:\.\d+)?e-\d+)")
"""A certified number in words."""

WITHOUT_ID = ("api", "theory", "reference", "figures", "_build", "_certificates")
"""Folders of pages whose examples have problems of their own."""

OTHER_SETTINGS = {
    "concepts.md",
    "changelog.md",
    "published_results.md",
    "arch.md",
    "own_models.md",
    "field_audit.md",
    "probes.md",
    "adversary.md",
}
"""Pages of numbers that have a file, a command and a test of their own, and are not those of the defaults."""


def without_times(text: str) -> str:
    return numbers.CHANGING.sub("", text)


@pytest.fixture(scope="module")
def written() -> dict[Path, str]:
    return numbers.pages()


def test_pages_show_what_was_measured(written: dict[Path, str]) -> None:
    assert {"README.md", "defaults.md", "leaderboard.md", "leaderboard.csv"} <= {path.name for path in written}
    for path, text in written.items():
        page = path.read_text(encoding="utf-8")
        remedy = f"{path.name} has drifted; run `python docs/numbers_of_pages.py`"
        assert without_times(page) == without_times(text), remedy


def known(bound: str, id: str) -> bool:
    """Whether a page may show this number about an id: its bound as written, of a longer search, or of a learner."""
    entry = KEPT[id]
    longer = [rounded_down(one["certified"], 4) for one in entry.get("longer", [])]
    learned = [numbers.as_it_is(row) for row in BOARD.rows if row.problem == id]
    shown = [numbers.proved(entry), numbers.measured(entry), numbers.at_most(entry), *learned]
    words = [*" ".join(shown).split(), *longer]
    return bound in words


def stray_bounds(text: str) -> list[str]:
    """Lines of a page that name one id, and a bound that is not the one of this id."""
    stray = []
    for line in text.splitlines():
        ids = [id for id in cg.problem_ids() if re.search(rf"(?<![\w-]){id}(?![\w-])", line)]
        if len(ids) == 1:
            stray += [line for bound in BOUND.findall(line) if not known(bound, ids[0])]
    return stray


def test_no_line_about_an_id_has_another_bound() -> None:
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))):
        parts = path.relative_to(ROOT).parts
        if not {*parts} & {*WITHOUT_ID} and path.name not in OTHER_SETTINGS:
            text = numbers.PARTS.sub("", path.read_text(encoding="utf-8"))
            assert stray_bounds(text) == [], path


def test_a_wrong_number_is_seen() -> None:
    assert stray_bounds("| `meeting-v0` | failure <= 1.0e-9 |") and stray_bounds("meeting-v0: P >= 0.98935")
    assert not stray_bounds(f"| `meeting-v0` | {numbers.proved(KEPT['meeting-v0'])} |")
    page = numbers.defaults_page()
    (row,) = (line for line in page.splitlines() if "| [van-der-pol-v0]" in line)
    assert stray_bounds(row) == [] and stray_bounds(row.replace("P >= 0.7", "P >= 0.8"))


def test_a_rate_below_its_bound_says_that_it_is_within_noise() -> None:
    for id, entry in KEPT.items():
        below = entry["rollouts"]["successes"] / entry["rollouts"]["episodes"] < entry["certified"]
        assert numbers.measured(entry).endswith("within noise") == below, id
        assert re.search(r"\[[\d.e-]+, [\d.e-]+\]", numbers.measured(entry)), id


@pytest.mark.parametrize(
    ("certified", "failure", "words"),
    [
        (0.98999, 0.01001, "P >= 0.9899"),
        (0.9902, 0.00981, "failure <= 9.9e-3"),
        (0.9969844, 0.0030156, "failure <= 3.1e-3"),
        (0.0014239, 0.9985761, "P >= 0.0014"),
        (1.0, 1.2504e-10, "failure <= 1.3e-10"),
    ],
)
def test_bounds_are_rounded_to_the_safe_side(certified: float, failure: float, words: str) -> None:
    entry: dict[str, Any] = {"certified": certified, "failure": failure}
    assert numbers.proved(entry) == words
