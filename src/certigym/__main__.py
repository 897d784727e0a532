"""Command line: ``certigym COMMAND ...``.

Exit status: 0 when the verdict is confirmed or consistent (or the command has none), 1 when a certificate is refuted or
does not check, 2 for bad input (one line on standard error). The parser is built without numpy, so that ``--help`` is
quick.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Sequence

from . import __version__
from .learning_options import add_learning_commands, add_relation
from .plot_command import add_plot_command
from .validation_options import add_validate_options, add_validation_commands

NUMBER = re.compile(r"-(\d|\.\d)")


def build_parser() -> argparse.ArgumentParser:
    """The parser of all sub-commands."""
    parser = argparse.ArgumentParser(
        prog="certigym", description="Multi-agent environments with temporal-logic tasks and certified controllers."
    )
    parser.add_argument("--version", action="version", version=f"certigym {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    problems = commands.add_parser("problems", help="list the problems of the suite, one id a line")
    _json(problems)
    describe = commands.add_parser("describe", help="show agents, regions, automaton and start of a problem")
    _problem(describe)
    _json(describe)
    run = commands.add_parser("run", help="synthesize controllers, validate the bound by rollouts, report")
    _problem(run)
    _synthesis(run)
    _validation(run)
    add_validate_options(run)
    run.add_argument("--out", metavar="CERT", help="also save the certificate (.npz)")
    _json(run)
    synthesize = commands.add_parser("synthesize", help="synthesize controllers and save the certificate")
    _problem(synthesize)
    _synthesis(synthesize)
    synthesize.add_argument("--out", metavar="CERT", required=True, help="certificate file to write (.npz)")
    _json(synthesize)
    validate = commands.add_parser("validate", help="test a saved certificate by rollouts")
    validate.add_argument("certificate", metavar="CERT")
    _start(validate)
    _validation(validate)
    add_validate_options(validate)
    _json(validate)
    reproduce = commands.add_parser(
        "reproduce", help="recompute the paper's figures and tables, published values beside"
    )
    reproduce.add_argument("what", choices=["fig3", "fig4", "table1", "table2", "refutation"])
    reproduce.add_argument("--out", metavar="DIR", help="folder for numbers and figures (default: reproduced)")
    _json(reproduce)
    check = commands.add_parser("check", help="verify a saved certificate by separate code, without simulation")
    check.add_argument("certificate", metavar="CERT")
    check.add_argument("--problem", metavar="ID|FILE", help="the certificate must be about this problem")
    check.add_argument("--horizon", type=int, metavar="T", help="horizon of --problem")
    _json(check)
    render = commands.add_parser("render", help="show an episode under certified controllers as a GIF or MP4")
    render.add_argument("problem", metavar="ID|FILE|CERT", help="suite id, TOML problem file or certificate (.npz)")
    render.add_argument("--horizon", type=int, metavar="T", help="control steps (default: the problem's)")
    _start(render)
    _synthesis(render)
    render.add_argument("--out", metavar="PICTURE", required=True, help="file to write (.gif, .mp4 or .png)")
    render.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the episode (default: 0)")
    render.add_argument("--fps", type=int, default=4, metavar="F", help="control steps per second (default: 4)")
    _json(render)
    add_plot_command(commands)
    add_validation_commands(commands)
    add_learning_commands(commands)
    return parser


def _problem(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("problem", metavar="ID|FILE", help="suite id or TOML problem file")
    parser.add_argument("--horizon", type=int, metavar="T", help="control steps (default: the problem's)")
    _start(parser)
    parser.add_argument("--split", action="store_true", help="make agents of independent axes agents of their own")


def _start(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--initial-state", nargs="+", metavar="X", help="joint initial state, agent after agent")


def _synthesis(parser: argparse.ArgumentParser) -> None:
    add_relation(parser, "auto (default: what certifies most), quick (no comparison), best (no shortcut), exact, tube, "
                         "ellipsoid or paper")  # fmt: skip
    parser.add_argument("--cells", nargs="+", type=int, metavar="N", help="cells per axis (default: by dimension)")
    parser.add_argument("--memory", metavar="BYTES",
                        help="instead of --cells: as fine as fits (bytes, or with K, M, G)")  # fmt: skip
    parser.add_argument("--accuracy", type=float, metavar="P",
                        help="instead of --cells: finer until the bound changes by less")  # fmt: skip
    parser.add_argument("--restarts", type=int, default=0, metavar="N",
                        help="further starts of the search from perturbed plans (default: 0)")  # fmt: skip
    parser.add_argument("--stationary", action="store_true", help="policies that do not look at the time")
    parser.add_argument("--device", default="numpy", metavar="NAME",
                        help="where sweeps compute: numpy (default), torch:cuda, torch:cpu, cupy:0")  # fmt: skip


def _validation(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--episodes", type=int, default=100_000, metavar="M", help="rollouts (default: 100000)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the rollouts (default: 0)")
    parser.add_argument("--confidence", type=float, default=0.999, metavar="C", help="of the limits (default: 0.999)")


def _json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", metavar="PATH", help="write the result as JSON (- for standard output)")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    # argparse takes "-10,-3" for an option; a leading blank marks it as a value
    options = build_parser().parse_args([f" {a}" if NUMBER.match(a) else a for a in given])
    from . import commands
    from .arguments import check_places

    try:
        check_places(getattr(options, "json", None), _file_of(options), getattr(options, "plot", None))
        return int(getattr(commands, options.command)(options))
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
    """File that `--out` names; two commands take a folder, which they make."""
    return None if options.command in ("reproduce", "train") else getattr(options, "out", None)


if __name__ == "__main__":
    sys.exit(main())
