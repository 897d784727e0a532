"""Every command writes its result as JSON: numbers as they are, keys that are explained, and nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.cli.given import plain
from certigym.cli.main import main
from certigym.cli.parser import MODULES, build_parser
from certigym.validation.policies import Probe
from certigym.validation.presentation.studio import Studio
from sample_problems import HOP

PAGE = Path(__file__).parents[2] / "docs" / "command_line.md"

TASK = ["task.toml", "--cells", "20"]
FEW = ["--episodes", "300"]
COMMANDS: dict[str, list[list[str]]] = {
    "describe": [[], ["task.toml"]],
    "run": [
        [*TASK, *FEW, "--out", "made.npz"],
        [*TASK, *FEW, "--horizon", "2", "3"],
    ],
    "synthesize": [
        [*TASK, "--out", "made.npz"],
        [*TASK, "--stationary", "--restarts", "1", "--out", "made.npz"],
    ],
    "check": [["c.npz"]],
    "canonical": [["task.toml"]],
    "validate": [["c.npz", *FEW]],
    "validate-field": [["c.npz", "--random", "3", *FEW]],
    "audit": [["c.npz", *FEW]],
    "stress": [["c.npz", *FEW]],
    "sweep": [[*TASK, *FEW, "--over", "noise=1,2"]],
    "report": [["c.npz", "--out", "r.html", *FEW]],
    "plot": [["automaton", "task.toml", "--out", "a.svg"]],
    "record": [["task.toml", *FEW, "--policy", "random", "--out", "d.npz"]],
    "save-policy": [["task.toml", "--cells", "20", "--policy", "certified", "--out", "p.h"]],
    "compare": [[*TASK, *FEW, "--policies", "certified,random"]],
    "certify": [[*TASK, *FEW, "--policy", "mine.py:policy"]],
    "leaderboard": [["task.toml", *FEW, "--policies", "certified,random", "--out", "board.md"]],
    "reproduce": [["arch", "--row", "bas-7", "--out", "rows"]],
    "studio": [["task.toml", "--port", "0"]],
}
LEARNING: dict[str, list[list[str]]] = {"train": [["task.toml", "--steps", "256", "--worlds", "8", "--out", "t"]]}
"""Commands that train: these need a library and some seconds."""

ELSEWHERE = {"probe": "takes a minute; it is run with --json where probes are tested"}
"""Commands that are not run here, and why."""

MINE = """
def policy(*seen):
    print("a library that talks")
    return [0.0]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("json")
    (place / "task.toml").write_text(HOP)
    (place / "mine.py").write_text(MINE)
    problem = cg.load(place / "task.toml")
    cg.save(cg.synthesize(problem, 20), place / "c.npz")
    cg.save(cg.synthesize(problem, relation="path"), place / "path.npz")
    return place


def documented() -> set[str]:
    """Keys that the page explains."""
    section = PAGE.read_text(encoding="utf-8").split("## JSON\n", 1)[1].split("\n## ", 1)[0]
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    return {key for row in rows for key in re.findall(r"`([\w]+)`", row.split("|")[1])}


def spoken(
    command: str, words: list[str], folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Any:
    """What a command writes to standard output with ``--json -``: one JSON document, and nothing else."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(Studio, "wait", lambda self: None)
    assert main([command, *words, "--json", "-"]) in (0, 1)
    said = capsys.readouterr().out
    assert said.startswith(("{", "[")) and said.endswith(("}\n", "]\n"))
    return json.loads(said, parse_constant=pytest.fail)


def test_every_command_is_tried() -> None:
    assert {*COMMANDS, *LEARNING, *ELSEWHERE} == set(MODULES)
    parsers = build_parser()._subparsers
    assert parsers is not None
    for name, parser in parsers._group_actions[0].choices.items():  # type: ignore[union-attr]
        assert any("--json" in action.option_strings for action in parser._actions), name


def check_keys(found: Any) -> None:
    """Every key of a result, or of the first of its rows, is explained."""
    row = found[0] if isinstance(found, list) else found
    assert set(row) <= documented(), " ".join(sorted(set(row) - documented()))


@pytest.mark.parametrize(("command", "words"), [(name, words) for name, all in COMMANDS.items() for words in all])
def test_results_are_json_with_keys_that_are_explained(
    command: str, words: list[str], folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    check_keys(spoken(command, words, folder, capsys, monkeypatch))


@pytest.mark.thorough
@pytest.mark.parametrize(("command", "words"), [(name, words) for name, all in LEARNING.items() for words in all])
def test_results_of_learning_are_json_with_keys_that_are_explained(
    command: str, words: list[str], folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")
    check_keys(spoken(command, words, folder, capsys, monkeypatch))


def test_the_keys_of_probes_are_explained() -> None:
    check_keys(dict.fromkeys({*Probe.__dataclass_fields__, "verdict"} - {"actor"}))


def test_numbers_are_not_rounded(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    certificate = cg.load(folder / "c.npz")
    said: Callable[..., Any] = lambda *words: spoken(words[0], [*words[1:]], folder, capsys, monkeypatch)  # noqa: E731
    assert said("check", "c.npz")["lower_bound"] == certificate.lower_bound
    assert said("validate", "c.npz", *FEW)["lower_bound"] == certificate.lower_bound
    made = said("run", *TASK, *FEW, "--out", "made.npz")
    assert made["lower_bound"] == cg.load(folder / made["certificate"]).lower_bound
    # The same in a file.
    main(["check", "c.npz", "--json", "check.json"])
    assert json.loads((folder / "check.json").read_text())["lower_bound"] == certificate.lower_bound


def test_what_json_cannot_hold_is_said_in_words() -> None:
    """A result is written whatever numbers it holds: NaN as null, as nothing is known; infinity by its name."""
    told = plain({"a": np.array([np.nan, np.inf]), 3: (np.float64(0.1), -np.inf), "b": np.bool_(True)})
    assert json.loads(json.dumps(told, allow_nan=False)) == {"a": [None, "inf"], "3": [0.1, "-inf"], "b": True}
