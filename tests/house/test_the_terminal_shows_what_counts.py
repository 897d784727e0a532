"""What the command line shows first: a welcome without arguments, and colours on terminals."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import struct
import subprocess
import sys
import termios

import pytest

from certigym.cli.colors import colored
from certigym.cli.main import main
from certigym.cli.parser import build_parser
from certigym.synthesis.policy_search.portfolio import BEGINS, Status, Way
from kinds import mostly_thorough

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


def way(name: str, spent: float = 20.0, turn: tuple[int, int] = (2, 4)) -> Way:
    told = Way(f"{BEGINS}{name}, effort {spent:.0f} of 80")
    told.turn, told.spent, told.taken, told.limit = turn, spent, spent, 80.0
    return told


@pytest.mark.parametrize("width", [60, 80, 120])
def test_the_line_of_a_search_fits_and_shows_strategy_and_bound_first(width: int) -> None:
    status = Status()
    status.take(way("linear, 160 cells, at most 0.9141"), 0.9046089)
    line = status.line(width)
    assert "2/4 linear: P >= 0.9046" in line and len(line) < width
    assert ("s left" in line, "Ctrl-C keeps it" in line) == (True, width >= 80)
    assert "\N{FULL BLOCK}" in line and status.line(width, is_ascii=True).isascii()
    status.take(way("linear"), 1.0 - 3.05e-3)
    assert "fails <= 0.0031" in status.line(width)


def test_a_search_that_found_nothing_shows_nothing_below_0_and_that_ctrl_c_stops_it() -> None:
    status = Status()
    status.take(way("linear"), 0.0)
    status.take("descent", -1e-9)
    assert "linear: nothing proved yet" in status.line(90) and "Ctrl-C stops" in status.line(90)
    status.take("descent", 0.25)
    assert "in search 0.2500" in status.line(90)


def pages_of(environment: dict[str, str]) -> str:
    """Return what a search writes to a terminal of 80 columns."""
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": os.pathsep.join(sys.path), **environment}
    leader, follower = os.openpty()
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    command = [sys.executable, "-m", "certigym", "run", "reach-avoid-v0", "--cells", "10", "--episodes", "10"]
    with subprocess.Popen(command, stdout=follower, stderr=follower, env=environment) as running:
        os.close(follower)
        written = b""
        with contextlib.suppress(OSError):  # what Linux says when the other end is closed
            while piece := os.read(leader, 65536):
                written += piece
    os.close(leader)
    assert running.returncode == 0
    return written.decode()


@mostly_thorough(
    ("environment", "moves"),
    [
        ({"TERM": "xterm", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "NO_COLOR": "1"}, True),
        ({"TERM": "dumb", "PYTHONUTF8": "1"}, False),
    ],
)
def test_terminals_show_one_line_that_is_written_over(environment: dict[str, str], moves: bool) -> None:
    written = pages_of(environment)
    lines = [line for line in re.split(r"[\r\n]+", written) if "Ctrl-C" in line]
    assert bool(lines) == moves and all(len(line) <= 80 for line in lines)
    assert "\033[1m" not in written and all(line.isascii() for line in lines)
