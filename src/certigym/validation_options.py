"""Options and sub-commands about validation; built without numpy, so that ``--help`` is quick."""

from __future__ import annotations

import argparse
from typing import Any

MISMATCH = "noise_scale=1.2, noise_family=laplace, actuator_bias=0.1, delay=1 or dropout=0.05; several may be given"


def add_rollout_options(parser: argparse.ArgumentParser, episodes: int = 100_000, per: str = "") -> None:
    """Number, seed and place of rollouts."""
    parser.add_argument("--episodes", type=int, default=episodes, metavar="M", help=f"rollouts{per} ({episodes})")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the rollouts (default: 0)")
    parser.add_argument("--confidence", type=float, default=0.999, metavar="C", help="of limits and verdict (0.999)")
    add_executor_options(parser)


def add_executor_options(parser: argparse.ArgumentParser) -> None:
    """Where the work is done."""
    parser.add_argument("--workers", type=int, metavar="N", help="worker processes of this machine (default: none)")
    parser.add_argument("--dask", metavar="ADDRESS|local", help="Dask scheduler, or workers of this machine under Dask")


def add_validate_options(parser: argparse.ArgumentParser) -> None:
    """What ``run`` and ``validate`` have beyond ``add_rollout_options``."""
    parser.add_argument("--sequential", action="store_true", help="stop when confirmed or refuted (e-processes)")
    parser.add_argument("--mismatch", nargs="+", metavar="NAME=VALUE", help=f"simulate another system: {MISMATCH}")
    add_executor_options(parser)


def add_validation_commands(commands: Any) -> None:
    """The sub-commands ``field``, ``audit``, ``stress``, ``sweep`` and ``report``."""
    field = commands.add_parser("field", help="test a saved certificate at many initial states at once")
    _certificate(field)
    field.add_argument("--axes", nargs="+", type=int, metavar="K", help="joint coordinates of a slice (one or two)")
    field.add_argument("--points", nargs="+", type=int, metavar="N", help="points per axis of the slice (20)")
    field.add_argument("--low", nargs="+", metavar="X", help="lower corner of the box of starts (the workspaces)")
    field.add_argument("--high", nargs="+", metavar="X", help="upper corner of the box of starts")
    field.add_argument("--random", type=int, default=200, metavar="N", help="random starts, without --axes (200)")
    field.add_argument("--search", action="store_true", help="search for the weakest start; --episodes in all")
    add_rollout_options(field, 1000, " per start")
    audit = commands.add_parser("audit", help="test a saved certificate step by step along rollouts")
    _certificate(audit)
    add_rollout_options(audit, 20_000)
    stress = commands.add_parser("stress", help="how far a bound survives noise, actuator and observation faults")
    _certificate(stress)
    add_rollout_options(stress, 20_000, " per mismatch")
    sweep = commands.add_parser("sweep", help="synthesize and validate a problem at several horizons")
    sweep.add_argument("problem", metavar="ID|FILE", help="suite id or TOML problem file")
    sweep.add_argument("--horizons", nargs="+", type=int, required=True, metavar="T", help="control steps")
    sweep.add_argument("--cells", nargs="+", type=int, metavar="N", help="cells per axis (default: by dimension)")
    add_rollout_options(sweep, 20_000, " per horizon")
    report = commands.add_parser("report", help="write one self-contained HTML page about a saved certificate")
    _certificate(report)
    report.add_argument("--out", metavar="HTML", required=True, help="page to write (.html)")
    report.add_argument("--axes", nargs="+", type=int, metavar="K", help="joint coordinates of the map (one or two)")
    add_rollout_options(report)
    for parser in (field, audit, stress, sweep, report):
        parser.add_argument("--json", metavar="PATH", help="write the result as JSON (- for standard output)")


def _certificate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("certificate", metavar="CERT", help="certificate file (.npz)")
