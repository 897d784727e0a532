"""Whoever reproduces the numbers sees for each what is expected, what was found, and whether it passes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from certigym.validation.paper import RECORDED, lines_text, summary_text
from certigym.validation.paper.judged_lines import Line, judged_lines
from certigym.validation.paper.reproduce import WORDS, words_of

PAGE = Path(__file__).parents[1] / "docs" / "artifact.md"


@pytest.fixture
def record(tmp_path: Path) -> Path:
    path = tmp_path / "recorded.json"
    path.write_text(json.dumps({"own": {"a": [0.5, "higher"], "b": [2.0, "ours alone"], "gone": [1.0, "agrees"]}}))
    return path


def test_a_line_says_what_is_expected_and_found_and_whether_it_passes(record: Path) -> None:
    lines = [Line("a", 0.25, 0.75, "bound"), Line("b", None, 3.0, "measured"), Line("new", None, 1.0, "measured")]
    judged = judged_lines("own", lines, record)
    rows = {row.split()[0]: row for row in lines_text(judged).splitlines()}
    assert rows["a"].split() == ["a", "0.25", "0.5", "0.75", "higher", "pass"]
    assert rows["b"].endswith("FAIL: far from the recorded 2") and rows["new"].endswith("FAIL: not recorded")
    assert rows["gone"].endswith("FAIL: not computed") and " 1 " in rows["gone"]
    # A bound that fell fails, by however little.
    (fallen,) = judged_lines("own", [Line("a", 0.25, 0.5 - 1e-12, "bound")], record, only="a")
    assert lines_text([fallen]).splitlines()[1].endswith("FAIL: below the recorded 0.5")


def test_the_summary_counts_every_line_once(record: Path) -> None:
    lines = [Line("a", 0.25, 0.75, "bound"), Line("b", None, 3.0, "measured")]
    told = {"own": judged_lines("own", lines, record), "other": judged_lines("own", lines[:1], record, only="a")}
    rows = [row.split() for row in summary_text(told).splitlines()]
    assert rows[1:] == [["own", "3", "1", "2"], ["other", "1", "1", "0"], ["all", "4", "2", "2"]]


def test_the_page_for_reviewers_shows_expected_numbers() -> None:
    text, record = PAGE.read_text(encoding="utf-8"), json.loads(RECORDED.read_text(encoding="utf-8"))
    shown = [line for line in text.splitlines() if line.endswith("  pass")]
    assert len(shown) == len(record["table1"])
    for line in shown:
        name = next(name for name in record["table1"] if line.startswith(f"{name}  "))
        value, verdict = record["table1"][name]
        assert f"  {value:.6g}  " in line and line.split()[-2] == verdict
    assert all(f"`{target}`" in text for target in record)


def test_columns_of_figures_have_names_in_words() -> None:
    columns = [*WORDS, *(f"{kind}_{s}_{n}" for kind in ("robust_tree", "exact") for s in "AB" for n in (4, 20))]
    names = [words_of(column) for column in columns]
    assert len(set(names)) == len(names) and not any("_" in name for name in names)
