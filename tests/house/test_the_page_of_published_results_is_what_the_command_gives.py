"""Every number of the page about published results is what ``certigym reproduce`` was recorded to give, and is checked.

The record itself is compared with the command: here where that takes seconds, by ``certigym reproduce all`` as a whole.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from certigym.cli.main import main
from certigym.validation.presentation.paper import RECORDED, TARGETS, arch
from certigym.validation.presentation.paper.judged_lines import Bound, Claim, Digits, judged_lines, lines_text
from certigym.validation.presentation.paper.reproduce import fig3
from certigym.validation.presentation.paper.reproduction import PieceResult, Reproduction
from certigym.validation.presentation.paper.targets import lines_of, target_of

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "published_results.md").read_text(encoding="utf-8")
RECORD: dict[str, dict[str, Any]] = json.loads(RECORDED.read_text(encoding="utf-8"))


def rows(heading: str) -> list[list[str]]:
    """The rows of the table under a heading."""
    section = PAGE.split(f"## {heading}")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if re.match(r"\| \d", line)]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def assert_shown(text: str, number: float) -> None:
    """A number of the page is the recorded one, rounded down or to the nearest."""
    if text.startswith("> "):
        assert number > float(text[2:]) - 1e-6, (text, number)
        return
    mantissa, _, exponent = text.partition("e")
    unit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    assert abs(float(text) - number) <= unit * (1 + 1e-9), (text, number)


def test_fig_3() -> None:
    record = RECORD["fig3"]
    names = ("robust tree, variance as deviation", "robust tree, stated noise", "robust tree, certified",
             "a-posteriori, certified", "exact relation, certified")  # fmt: skip
    table = rows("Fig. 3")
    assert [int(row[0]) for row in table] == [1, 2, 3, 4, 5, 6, 7, 16]
    for row in table:
        assert row[1] == row[2]  # the published digits come out
        for text, name in zip(row[2:], names, strict=True):
            assert_shown(text, record[f"T = {row[0]}: {name}"][0])


def test_fig_4() -> None:
    record = RECORD["fig4"]
    for t, four, twenty, exact in rows("Fig. 4"):
        assert_shown(four, record[f"T = {t}, setting A, 4 agents: robust tree"][0])
        assert_shown(twenty, record[f"T = {t}, setting A, 20 agents: robust tree"][0])
        for n in (4, 20):
            assert_shown(exact, record[f"T = {t}, setting A, {n} agents: exact relation"][0])
    for n, text in re.findall(r"(\.\d+) for 4 and (\.\d+) for 20", PAGE):
        assert_shown(n, record["T = 7, setting B, 4 agents: exact relation"][0])
        assert_shown(text, record["T = 7, setting B, 20 agents: exact relation"][0])


def test_table_2() -> None:
    record, episodes = RECORD["table2"], re.findall(r"\| (\S+) rollouts \|", PAGE)
    assert episodes == ["400,000"]
    for point, _, method, exact, rollouts in rows("Table 2"):
        for text, name in ((method, "the paper's method"), (exact, "exact relation"), (rollouts, "rollouts")):
            assert_shown(text, record[f"point {point}: {name}"][0])
        assert record[f"point {point}: upper limit of rollouts"][1] == "published claim refuted"
    (eased,) = re.findall(r"certificates are (\.\d+), (\.\d+) and (\.\d+) from the three points", PAGE)
    for k, text in enumerate(eased):
        assert_shown(text, record[f"point {k + 1}, eased: exact relation"][0])


def test_the_record_of_the_fields_benchmarks_is_that_of_their_page() -> None:
    stored = {row["row"]: row for row in json.loads((ROOT / "docs" / "arch.json").read_text(encoding="utf-8"))}
    record = RECORD["arch"]
    assert set(record) == set(stored)
    for name, row in stored.items():
        assert record[name][0] == pytest.approx(row["certified"], rel=2e-4), name


@pytest.mark.pages
def test_figure_4_is_as_recorded(tmp_path: Path) -> None:
    """The command compares Table 1 with its record in ``test_published_results``."""
    lines = lines_of("fig4", target_of("fig4").rows(tmp_path))
    assert [line for line in lines if line["wrong"]] == []


@pytest.mark.pages
def test_figure_3_is_as_recorded(tmp_path: Path) -> None:
    """A short horizon, one in the middle and the longest: here numbers were lost once without anybody's seeing it."""
    names = {"robust_tree_certified": "robust tree, certified", "a_posteriori": "a-posteriori, certified",
             "exact": "exact relation, certified"}  # fmt: skip
    for row in fig3((2, 7, 16)).rows(tmp_path):
        for column, name in names.items():
            recorded, _ = RECORD["fig3"][f"T = {row['T']}: {name}"]
            assert recorded <= float(str(row[column])) < recorded + 1e-5, (row["T"], name)


@pytest.mark.pages
def test_the_refutation_is_as_recorded(tmp_path: Path) -> None:
    assert main(["reproduce", "refutation", "--out", str(tmp_path), "--json", str(tmp_path / "r.json")]) == 0
    assert set(json.loads((tmp_path / "r.json").read_text())) == {"result", "lines"}


def test_a_number_that_falls_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = [Bound("bound", 0.5, 0.6), Digits("digits", 0.5, 0.5), Claim("claim", 0.9, 0.7)]
    record = tmp_path / "recorded.json"
    told = {"bound": [0.6, "higher"], "digits": [0.5, "agrees"], "claim": [0.7, "published claim refuted"]}
    record.write_text(json.dumps({"own": told}))
    assert [line["wrong"] for line in judged_lines("own", lines, record)] == [None] * 3
    for k, value, word in ((0, 0.5999, "below"), (1, 0.501, "recorded as agrees"), (2, 0.95, "recorded as")):
        changed = [replace(line, ours=value) if i == k else line for i, line in enumerate(lines)]
        wrong = [line["wrong"] for line in judged_lines("own", changed, record)]
        assert word in str(wrong[k]) and wrong.count(None) == 2
    missing = judged_lines("own", lines[:2], record)
    assert missing[-1]["wrong"] == "not computed"
    assert "higher" in lines_text(judged_lines("own", lines, record))
    # A row whose check fails certifies nothing, and the command says so by its status.
    failed = {"check": "NOT valid", "certified": 1.0, "published": None, "starts": None, "row": "bas-7"}
    refused = Reproduction({"bas-7": lambda: PieceResult(failed, "nothing")}, lambda found, _: found)
    monkeypatch.setattr("certigym.validation.presentation.paper.targets.arch", lambda _: refused)
    assert main(["reproduce", "arch", "--row", "bas-7", "--out", str(tmp_path / "out")]) == 1


def test_everything_that_can_be_reproduced_is_recorded() -> None:
    assert set(RECORD) == set(TARGETS)
    assert (arch.FOLDER / "rows.json").is_file()
