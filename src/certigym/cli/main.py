"""Command line: ``certigym COMMAND ...``.

Exit status: 0 if the verdict is confirmed, consistent or vacuous, or if the command has no verdict; 1 if a certificate
is refuted or fails the check; 2 for bad input, with one line on standard error; 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import io
import os
import re
import sys
from collections.abc import Sequence
from contextlib import nullcontext, redirect_stdout
from importlib import import_module
from pathlib import Path

from .parser import MODULES, build_parser, elsewhere

NUMBER = re.compile(r"-(\d|\.\d)")
"""How a negative number begins, which must not be taken for an option."""


_WELCOME = """certigym: environments with proofs

  certigym run reach-avoid-v0                      synthesize controllers, certify a bound, test it by rollouts
  certigym describe                                list the problems of the suite
  certigym plot episode meeting-v0 --out m.gif     watch an episode under certified controllers

A TOML file can stand for an id. `certigym --help` lists all commands, `certigym COMMAND --help` their options."""


def check_places(*paths: str | None) -> None:
    """Raise ValueError for files in folders that do not exist, before anything is computed."""
    for path in paths:
        if path is not None and path != "-" and not Path(path).absolute().parent.is_dir():
            raise ValueError(f"`{path}`: expected a file name in a folder that exists; make the folder first")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # What a terminal has no letters for is written as numbers, as on standard error.
        sys.stdout.reconfigure(errors="backslashreplace")
    # argparse takes "-10,-3" for an option; a leading blank marks it as a value.
    if not words:
        print(_WELCOME)
        return 0
    parser = build_parser()
    options, unknown = parser.parse_known_args([f" {word}" if NUMBER.match(word) else word for word in words])
    if unknown:
        parser.error(f"unrecognized arguments: {' '.join(unknown)}{elsewhere(parser, options.command, unknown)}")
    # The command's file, and with it the rest of the package, is loaded only now, so that --help is quick.
    try:
        check_places(getattr(options, "json", None), _file_of(options), getattr(options, "plot", None))
        module = import_module(f".{MODULES[options.command]}", __package__)
        options.results = sys.stdout
        # With `--json -` standard output holds JSON alone; what is printed besides, by libraries, too, goes elsewhere.
        with redirect_stdout(sys.stderr) if options.json == "-" else nullcontext():
            return int(getattr(module, options.command.replace("-", "_"))(options))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python complains when it exits
        return 2
    except (ValueError, OSError) as error:
        said = str(error).strip()
        # An expression with a caret under the mistake keeps its lines.
        first = said if said.endswith("^") else said.replace("\n", " | ") or type(error).__name__
        print(f"certigym: {first}", file=sys.stderr)
        return 2
    except MemoryError:
        remedy = "; ask for fewer --cells" if hasattr(options, "cells") else ""
        print(f"certigym: not enough memory for this problem{remedy}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("certigym: interrupted", file=sys.stderr)
        return 130


def _file_of(options: argparse.Namespace) -> str | None:
    """Return the file that `--out` names; two commands take a folder there, which they make."""
    return None if options.command in ("reproduce", "train") else getattr(options, "out", None)
