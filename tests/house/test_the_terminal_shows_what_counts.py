"""What the command line shows first: a welcome without arguments, colours on terminals, advice for loose bounds."""

from __future__ import annotations

import io
import re
import sys

import pytest
from tqdm import tqdm

import certigym as cg
from certigym.cli.colors import colored, wants_colors
from certigym.cli.main import main
from certigym.cli.parser import build_parser
from certigym.synthesis.policy_search.ascent import BAR, shown_on
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


def test_the_bar_shows_the_bound_before_what_a_narrow_terminal_cuts_off() -> None:
    text = io.StringIO()
    with tqdm(bar_format=BAR, file=text, ncols=60, mininterval=0.0) as bar:
        told = shown_on(bar)
        told("way: linear, 160 cells, at most 0.9141, effort 0 of 80", 0.9046089)
        bar.refresh()
    last = [line for line in text.getvalue().split("\r") if "linear" in line][-1]
    assert "] P >= 0.904608 so far; linear, 160 cells" in last and len(last.rstrip()) <= 60


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
