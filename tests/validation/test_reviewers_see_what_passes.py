"""Whoever reproduces the numbers sees for each what is expected, what was found, and whether it passes."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pytest

from certigym.validation.presentation.paper import Reproduction, computed, lines_text
from certigym.validation.presentation.paper.judged_lines import Bound, Line, judged_lines
from certigym.validation.presentation.paper.reproduction import PieceResult
from certigym.validation.statistical_tests import processes


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


@pytest.mark.thorough
@pytest.mark.parametrize("workers", [1, 2])
def test_every_piece_is_told_of_and_comes_back_in_its_place(workers: int) -> None:
    """With one process or two; a target comes as soon as its own pieces are there."""
    whole = {
        name: Reproduction(
            {f"row {k}": partial(PieceResult, (name, k), f"{k}") for k in range(3)}, lambda found, _: found
        )
        for name in ("one", "two")
    }
    heard = _Heard()
    assert list(computed(whole, heard, workers)) == [(name, [(name, k) for k in range(3)]) for name in whole]
    pieces = [(f"{name}, row {k}", str(k)) for name in whole for k in range(3)]
    assert sorted(heard.told) == sorted(pieces) and set(heard.names) == {name for name, _ in pieces}


def _broken() -> PieceResult:
    raise ValueError("a piece that fails")


@pytest.mark.thorough
def test_a_piece_that_fails_is_not_passed_over() -> None:
    whole = {"one": Reproduction({"good": partial(PieceResult, 1, ""), "bad": _broken}, lambda found, _: found)}
    with pytest.raises(ValueError, match="a piece that fails"):
        list(computed(whole, _Heard(), 1))


@pytest.mark.thorough
def test_processes_side_by_side_have_one_thread_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two libraries of linear algebra with a thread for every core take twice the time; what the user says stays."""
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    with processes(2) as pool:
        assert pool.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
        assert pool.submit(os.getenv, "OPENBLAS_NUM_THREADS").result() == "3"
    assert "OMP_NUM_THREADS" not in os.environ
