"""What the command line shows first: a welcome without arguments, colours on terminals, advice for loose bounds."""

from __future__ import annotations

import io
import re
import sys
import time
from argparse import Namespace
from typing import Any

import pytest
from tqdm import tqdm

import certigym as cg
from certigym.cli import work
from certigym.cli.colors import colored, wants_colors
from certigym.cli.main import main
from certigym.cli.parser import build_parser
from certigym.synthesis.search import BAR, shown_on
from problems import scalar_agent

CODES = re.compile(r"\033\[\d+m")


def test_without_arguments_the_program_shows_three_commands_that_exist(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    commands = re.findall(r"^  certigym (.*?)   ", capsys.readouterr().out, re.M)
    assert len(commands) == 3
    for command in commands:
        build_parser().parse_args(command.split())


def test_colours_change_no_word_and_mark_the_verdict() -> None:
    lines = ["problem       p, horizon 3", "certified     P >= 0.5", "verdict       refuted: so it is", "no label here"]
    shown = colored("\n".join(lines))
    assert CODES.sub("", shown) == "\n".join(lines)
    assert "\033[31mrefuted\033[0m:" in shown and "\033[1mP >= 0.5\033[0m" in shown
    assert shown.splitlines()[-1] == "no label here"
    assert "\033[32mvalid\033[0m" in colored("p, horizon 3: valid: lower bound 0.5")


@pytest.mark.parametrize(("terminal", "setting", "wanted"), [(True, "", True), (True, "1", False), (False, "", False)])
def test_colours_are_for_terminals(monkeypatch: pytest.MonkeyPatch, terminal: bool, setting: str, wanted: bool) -> None:
    monkeypatch.setenv("NO_COLOR", setting)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    assert wants_colors() == wanted


@pytest.mark.slow
@pytest.mark.parametrize("width", [60, 132])
def test_no_line_is_wider_than_the_terminal_and_no_word_is_lost(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    wanted = ["meeting-v0", "door-formation-v0", "patrol-recharge-v0", "quadrotor-v0", "fleet-v0"]
    for words in ([], *([name] for name in wanted)):
        assert main(["describe", *words]) == 0
        plain = capsys.readouterr().out
        with monkeypatch.context() as terminal:
            terminal.setattr(sys.stdout, "isatty", lambda: True)
            terminal.setenv("COLUMNS", str(width))
            terminal.delenv("NO_COLOR", raising=False)
            terminal.setenv("TERM", "xterm")
            assert main(["describe", *words]) == 0
        shown = CODES.sub("", capsys.readouterr().out)
        assert max(map(len, shown.splitlines())) <= width
        # Words alone are broken, and only where they do not fit into a line of their own.
        assert "".join(shown.split()) == "".join(plain.split())
    assert any(len(line) > width for line in plain.splitlines())


def test_reports_fit_eighty_columns(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("NO_COLOR", "1")
    assert main(["run", "reach-avoid-v0", "--horizon", "2", "--cells", "20", "--episodes", "300"]) == 0
    report = capsys.readouterr().out
    # What goes on stands below what it belongs to.
    assert re.search(r"^method        linear relation.*\n {14}\S", report, re.M)
    words = ["--policies", "certified,random", "--episodes", "300"]
    assert main(["compare", "reach-avoid-v0", "--horizon", "2", "--cells", "20", *words]) == 0
    assert max(map(len, (report + capsys.readouterr().out).splitlines())) <= 80


def test_the_bar_shows_the_bound_before_what_a_narrow_terminal_cuts_off() -> None:
    text = io.StringIO()
    with tqdm(bar_format=BAR, file=text, ncols=60, mininterval=0.0) as bar:
        told = shown_on(bar)
        told("way: linear, 160 cells, at most 0.9141, effort 0 of 80", 0.9046089)
        bar.refresh()
    last = [line for line in text.getvalue().split("\r") if "linear" in line][-1]
    assert "] P >= 0.904608 so far; linear, 160 cells" in last and len(last.rstrip()) <= 60


@pytest.mark.slow
def test_eighty_columns_show_bound_level_upper_end_and_what_is_left() -> None:
    """As a task of the suite tells them over few steps, whatever the clock says."""
    text, told = io.StringIO(), list[str]()
    with tqdm(bar_format=BAR, file=text, ncols=80, mininterval=0.0) as bar:
        show = shown_on(bar)

        def tell(what: str, value: float) -> None:
            show(what, value)
            bar.refresh()
            told.append(what)

        cg.synthesize(cg.make_problem("reach-avoid-v0").replace(horizon=2), effort=0.6, progress=tell)
    lines = [line.rstrip() for line in text.getvalue().split("\r")]
    whole = re.compile(r"\[\d\d:\d\d\] P >= 0\.\d{6} so far; linear, \d+ cells, at most 0\.\d{4}, effort \d+ of 1")
    assert any(whole.match(line) for line in lines), told


def test_the_clock_goes_on_while_nothing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "TICK", 0.01)
    text = io.StringIO()
    with tqdm(bar_format=BAR, file=text, ncols=80) as bar, work.ticking(bar):
        shown_on(bar)("way: linear", 0.0)
        until = time.monotonic() + 10.0
        while text.getvalue().count("linear") < 3 and time.monotonic() < until:
            time.sleep(0.01)
    assert text.getvalue().count("linear") >= 3


def test_a_check_that_takes_long_says_what_it_checks(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(work, "TICK", 0.01)
    monkeypatch.setattr(work, "PATIENCE", 0.02)
    certificate = cg.synthesize(cg.make_problem("reach-avoid-v0").replace(horizon=3), 30).certificate
    honest = work.checked_once

    def slow(given: Any) -> Any:
        time.sleep(0.5)
        return honest(given)

    monkeypatch.setattr(work, "checked_once", slow)
    assert work.checked_again(certificate)
    assert re.match(r"\[0 s\] P >= 0\.\d+; separate code computes it again\n", capsys.readouterr().err)


def test_where_there_is_no_terminal_what_takes_long_is_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(work, "TICK", 0.01)
    monkeypatch.setattr(work, "PATIENCE", 0.02)
    with tqdm(bar_format=BAR, disable=True) as bar, work.ticking(bar):
        shown_on(bar)("way: linear", 0.25)
        time.sleep(0.5)
    assert re.fullmatch(r"\[0 s\] P >= 0\.250000 so far; linear\n", capsys.readouterr().err)


def test_without_a_terminal_nothing_is_silent_for_long(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A search that takes long says how far it is, again and again; rollouts say how many there are."""
    monkeypatch.setattr(work, "TICK", 0.01)
    monkeypatch.setattr(work, "PATIENCE", 0.02)
    monkeypatch.setattr(work, "REMIND", 0.1)
    with tqdm(bar_format=BAR, disable=True) as bar, work.ticking(bar):
        told = shown_on(bar)
        told("way: path", 0.0)
        told("path", 0.25)
        time.sleep(0.6)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) >= 3
    assert all(re.fullmatch(r"\[\d+ s\] nothing certified yet; path; this search: 0.250000", line) for line in lines)
    options = Namespace(dask=None, workers=1, episodes=3000, seed=0, confidence=0.99)
    with work.trials(options) as plan:
        assert callable(plan.progress)
        plan.progress(2000)
        time.sleep(0.3)
    assert "s] rollouts; 2000 episodes" in capsys.readouterr().err


def test_a_search_that_found_nothing_shows_nothing_below_0() -> None:
    text = io.StringIO()
    with tqdm(bar_format=BAR, file=text, ncols=90, mininterval=0.0) as bar:
        told = shown_on(bar)
        told("way: linear", 0.0)
        told("descent", -1e-9)
        bar.refresh()
    assert "this search: 0.000000" in text.getvalue() and "-0" not in text.getvalue()


def test_a_bound_far_below_the_rollouts_comes_with_advice() -> None:
    problem = cg.Problem(
        name="far",
        horizon=6,
        agents=[scalar_agent("only", initial_state=[-3.0])],
        propositions={"g": cg.Proposition("only", [1.0], [2.0])},
        specification=cg.Specification("F g", "co-safe"),
    )
    coarse = cg.validate(cg.synthesize(problem, 12, relation="boxes"), episodes=20_000, seed=0)
    assert coarse.ci_low - coarse.lower_bound > 0.02
    assert "advice        rollouts lie at least" in str(coarse) and "--effort" in str(coarse)
    exact = cg.validate(cg.synthesize(problem, 40, relation="exact"), episodes=2000, seed=0)
    assert "advice" not in str(exact)
