"""The command line does the main job, reports it as JSON, and answers bad input with one line and status 2."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.cli.parser import EXAMPLES, GROUPS, build_parser
from certigym.synthesis.certificates.proofs import changed
from sample_problems import HOP

KEYS = {
    "problem",
    "horizon",
    "method",
    "lower_bound",
    "exact",
    "episodes",
    "successes",
    "estimate",
    "ci_low",
    "ci_high",
    "confidence",
    "verdict",
    "rank",
    "seconds",
}


@pytest.fixture
def task(tmp_path: Path) -> str:
    path = tmp_path / "task.toml"
    path.write_text(HOP)
    return str(path)


def test_run_synthesizes_validates_and_reports(task: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "r.json"
    assert main(["run", task, "-v", "--cells", "80", "--episodes", "5000", "--seed", "3", "--json", str(out)]) == 0
    printed = capsys.readouterr().out
    report = json.loads(out.read_text())
    assert set(report) >= KEYS
    assert set(report["seconds"]) == {"abstract", "synthesize", "check", "validate"}
    assert report["problem"] == "hop" and report["horizon"] == 3 and report["episodes"] == 5000
    assert report["verdict"] in ("confirmed", "consistent") and report["verdict"] in printed
    assert report["estimate"] == report["successes"] / 5000
    assert report["ci_low"] <= report["estimate"] <= report["ci_high"]


def test_synthesize_check_and_validate_hand_a_certificate_over(
    task: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cert, out = str(tmp_path / "c.npz"), str(tmp_path / "v.json")
    assert main(["synthesize", task, "--cells", "40", "--horizon", "5", "--initial-state", "-2", "--out", cert]) == 0
    assert main(["check", cert]) == 0
    assert main(["check", cert, "--problem", task]) == 1  # another horizon and start
    assert "NOT valid" in capsys.readouterr().out
    assert main(["validate", cert, "--episodes", "2000", "--json", out]) == 0
    report = json.loads(Path(out).read_text())
    assert set(report) >= KEYS
    assert report["horizon"] == 5 and report["seconds"]["synthesize"] is None
    assert main(["validate", cert, "--episodes", "2000", "--initial-state", "-3.5", "--json", out]) == 0
    assert json.loads(Path(out).read_text())["lower_bound"] < report["lower_bound"]


def test_a_refuted_certificate_gives_status_1(task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cert = str(tmp_path / "c.npz")
    assert main(["synthesize", task, "--cells", "40", "--out", cert]) == 0
    import certigym.cli.validation_commands as commands
    from certigym.synthesis.certificates.proofs.certificate_file import load_certificate

    def boastful(path: str, max_bytes: int) -> object:
        return changed(load_certificate(path, max_bytes), lower_bound=0.9999)

    monkeypatch.setattr(commands, "load_certificate", boastful)
    assert main(["validate", cert, "--episodes", "2000"]) == 1


def test_describe_lists_ids_first(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["describe"]) == 0
    ids = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert {"reach-avoid-v0", "invariance-4-v0", "invariance-20-v0", "package-delivery-v0"} <= set(ids)


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "nowhere"],
        ["run", "reach-avoid-v0", "--horizon", "0"],
        ["run", "reach-avoid-v0", "--cells", "10", "10", "10"],
        ["describe", "reach-avoid-v0", "--initial-state", "one", "two"],
        ["run", "reach-avoid-v0", "--cells", "20", "--episodes", "10", "--json", "/nowhere/at/all.json"],
        ["check", "pyproject.toml"],
        ["synthesize", "reach-avoid-v0", "--cells", "20", "--out", "/nowhere/at/all.npz"],
    ],
)
def test_bad_input_is_one_line_and_status_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    captured = capsys.readouterr()
    lines = [line for line in captured.err.splitlines() if line.strip() and "it/s" not in line and line[0] != "["]
    assert len(lines) == 1 and lines[0].startswith("certigym: "), captured.err
    assert "Traceback" not in captured.err


def test_help_imports_no_numpy_and_unknown_options_exit_with_2() -> None:
    code = "import sys; from certigym.cli.parser import build_parser as b; b(); print('scipy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
    done = subprocess.run([sys.executable, "-m", "certigym", "run"], capture_output=True, text=True, check=False)
    assert done.returncode == 2


def test_help_lists_every_command_once_by_what_it_is_for_with_an_example() -> None:
    parser = build_parser()
    commands = parser.groups.choices
    listed = [name for names in GROUPS.values() for name in names]
    assert sorted(listed) == sorted(commands) == sorted(EXAMPLES)
    for name, example in EXAMPLES.items():
        assert parser.parse_args(example.split()).command == name
        assert f"certigym {example}" in " ".join(commands[name].format_help().split())
    text = parser.format_help()
    assert all(text.count(f"\n  {name} ") == 1 for name in commands)


def test_initial_states_may_be_negative_and_separated_by_commas(tmp_path: Path) -> None:
    out, settings = str(tmp_path / "c.npz"), ["--cells", "50", "--horizon", "5"]
    bounds = []
    for state in (["--initial-state", "-10,-3"], ["--initial-state=-10,-3"], ["--initial-state", "-10", "-3"]):
        assert main(["synthesize", "reach-avoid-v0", *settings, *state, "--out", out]) == 0
        bounds.append(cg.load(out).lower_bound)
    assert bounds[0] == bounds[1] == bounds[2] > 0.5


@pytest.mark.thorough
def test_terminals_without_umlauts_show_numbers_and_json_is_written(tmp_path: Path) -> None:
    file, out = tmp_path / "task.toml", tmp_path / "out.json"
    file.write_text(HOP.replace('"hop"', '"Türme"'), encoding="utf-8")
    words = ["run", str(file), "--cells", "20", "--relation", "exact", "--episodes", "100", "--json", str(out)]
    ran = subprocess.run(
        [sys.executable, "-m", "certigym", *words],
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    assert rb"T\xfcrme" in ran.stdout
    assert json.loads(out.read_text(encoding="utf-8"))["problem"] == "Türme"


@pytest.mark.thorough
def test_readers_that_stop_reading_are_no_news() -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "certigym", "describe"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as describing:
        assert describing.stdout is not None and describing.stderr is not None
        describing.stdout.close()
        assert describing.stderr.read() == b""
