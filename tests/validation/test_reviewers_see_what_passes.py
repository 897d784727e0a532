"""Whoever reproduces the numbers sees for each what is expected, what was found, and whether it passes."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pytest

from certigym.cli.main import main
from certigym.validation.paper import RECORDED, Reproduction, computed, lines_text, summary_text
from certigym.validation.paper.judged_lines import Bound, Line, judged_lines
from certigym.validation.paper.reproduce import WORDS, words_of
from certigym.validation.paper.reproduction import Found
from certigym.validation.simulation import processes

PAGE = Path(__file__).parents[2] / "docs" / "artifact.md"


@pytest.fixture
def record(tmp_path: Path) -> Path:
    path = tmp_path / "recorded.json"
    path.write_text(json.dumps({"own": {"a": [0.5, "higher"], "b": [2.0, "ours alone"], "gone": [1.0, "agrees"]}}))
    return path


def test_a_line_says_what_is_expected_and_found_and_whether_it_passes(record: Path) -> None:
    lines = [Bound("a", 0.25, 0.75), Line("b", None, 3.0), Line("new", None, 1.0)]
    judged = judged_lines("own", lines, record)
    rows = {row.split()[0]: row for row in lines_text(judged).splitlines()}
    assert rows["a"].split() == ["a", "0.25", "0.5", "0.75", "higher", "pass"]
    assert rows["b"].endswith("FAIL: far from the recorded 2") and rows["new"].endswith("FAIL: not recorded")
    assert rows["gone"].endswith("FAIL: not computed") and " 1 " in rows["gone"]
    # A bound that fell fails, by however little.
    (fallen,) = judged_lines("own", [Bound("a", 0.25, 0.5 - 1e-12)], record, only="a")
    assert lines_text([fallen]).splitlines()[1].endswith("FAIL: below the recorded 0.5")


def test_the_summary_counts_every_line_once(record: Path) -> None:
    lines = [Bound("a", 0.25, 0.75), Line("b", None, 3.0)]
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


class _Heard:
    """Keeps what a reproduction tells of."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.told: list[tuple[str, str]] = []

    def now(self, names: Sequence[str]) -> None:
        self.names += names

    def found(self, name: str, words: str, seconds: float) -> None:
        assert seconds >= 0.0
        self.told.append((name, words))


@pytest.mark.parametrize("workers", [1, 2])
def test_every_piece_is_told_of_and_comes_back_in_its_place(workers: int) -> None:
    """With one process or two; a target comes as soon as its own pieces are there."""
    whole = {
        name: Reproduction({f"row {k}": partial(Found, (name, k), f"{k}") for k in range(3)}, lambda found, _: found)
        for name in ("one", "two")
    }
    heard = _Heard()
    assert list(computed(whole, heard, workers)) == [(name, [(name, k) for k in range(3)]) for name in whole]
    pieces = [(f"{name}, row {k}", str(k)) for name in whole for k in range(3)]
    assert sorted(heard.told) == sorted(pieces) and set(heard.names) == {name for name, _ in pieces}


def _broken() -> Found:
    raise ValueError("a piece that fails")


def test_a_piece_that_fails_is_not_passed_over() -> None:
    whole = {"one": Reproduction({"good": partial(Found, 1, ""), "bad": _broken}, lambda found, _: found)}
    with pytest.raises(ValueError, match="a piece that fails"):
        list(computed(whole, _Heard(), 1))


def test_processes_side_by_side_have_one_thread_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two libraries of linear algebra with a thread for every core take twice the time; what the user says stays."""
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    with processes(2) as pool:
        assert pool.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
        assert pool.submit(os.getenv, "OPENBLAS_NUM_THREADS").result() == "3"
    assert "OMP_NUM_THREADS" not in os.environ


def test_the_command_says_on_standard_error_what_it_computes_and_finds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    row = {"check": "valid", "certified": 0.25, "published": None, "starts": None, "row": "own"}
    whole = Reproduction({"own": partial(Found, row, "0.25")}, lambda found, _: found)
    monkeypatch.setattr("certigym.validation.paper.targets.arch", lambda _: whole)
    monkeypatch.setattr("certigym.cli.reproduce_command.TARGETS", ("arch",))
    # Nothing like it was recorded, and what was is missing: it fails, and what fails comes last.
    assert main(["reproduce", "all", "--out", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    assert "computing arch, own" in err and "[1/1] arch, own: 0.25" in err
    assert "\nfailed\n" in out and "FAIL: not recorded" in out.rsplit("\nfailed\n")[-1]
    assert out.splitlines()[-1].startswith("FAIL: ")
    assert main(["reproduce", "arch", "--workers", "0", "--out", str(tmp_path)]) == 2


def test_the_keys_of_lines_are_explained(record: Path) -> None:
    (line,) = judged_lines("own", [Bound("a", 0.25, 0.5)], record, only="a")
    page = (PAGE.parent / "command_line.md").read_text(encoding="utf-8")
    (row,) = [row for row in page.splitlines() if row.startswith("| each of `lines` |")]
    assert all(f"`{key}`" in row for key in line)
