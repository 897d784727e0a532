"""Command line: ``certigym COMMAND ...``.

Exit status: 0 when the verdict is confirmed or consistent (or the command has none), 1 when a certificate is refuted or
does not check, 2 for bad input (one line on standard error), 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Sequence
from importlib import import_module

from .parser import MODULES, build_parser

NUMBER = re.compile(r"-(\d|\.\d)")
"""How a negative number begins."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    # argparse takes "-10,-3" for an option; a leading blank marks it as a value
    options = build_parser().parse_args([f" {a}" if NUMBER.match(a) else a for a in given])
    from .given import check_places

    try:
        check_places(getattr(options, "json", None), _file_of(options), getattr(options, "plot", None))
        module = import_module(f".{MODULES[options.command]}", __package__)
        return int(getattr(module, options.command.replace("-", "_"))(options))
    except (ValueError, OSError) as error:
        first = str(error).strip().replace("\n", " | ") or type(error).__name__
        print(f"certigym: {first}", file=sys.stderr)
        return 2
    except MemoryError:
        print("certigym: not enough memory for this problem; ask for fewer --cells", file=sys.stderr)
        return 2
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 2
    except KeyboardInterrupt:
        print("certigym: interrupted", file=sys.stderr)
        return 130


def _file_of(options: argparse.Namespace) -> str | None:
    """The file that `--out` names; two commands take a folder, which they make."""
    return None if options.command in ("reproduce", "train") else getattr(options, "out", None)
