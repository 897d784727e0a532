"""Options that several commands share."""

from __future__ import annotations

import argparse

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


def add_relation(parser: argparse.ArgumentParser, meaning: str) -> None:
    """Options ``--relation`` and ``--delta``."""
    parser.add_argument("--relation", nargs="+", metavar="NAME", default=["auto"],
                        help=f"{meaning}; AGENT=NAME for single agents")  # fmt: skip
    parser.add_argument("--delta", type=float, metavar="P",
                        help="failure probability per step and agent of `ellipsoid` or `paper`")  # fmt: skip


def add_problem_options(parser: argparse.ArgumentParser) -> None:
    """The problem, its horizon and its start."""
    parser.add_argument("problem", metavar="ID|FILE", help="suite id or TOML problem file")
    parser.add_argument("--horizon", type=int, metavar="T", help="control steps (default: the problem's)")
    add_start_options(parser)
    parser.add_argument("--split", action="store_true", help="make agents of independent axes agents of their own")


def add_start_options(parser: argparse.ArgumentParser) -> None:
    """The initial state."""
    parser.add_argument("--initial-state", nargs="+", metavar="X", help="joint initial state, agent after agent")


def add_synthesis_options(parser: argparse.ArgumentParser) -> None:
    """How policies are synthesized."""
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


def add_validation_options(parser: argparse.ArgumentParser) -> None:
    """How many rollouts, and how sure their limits are."""
    parser.add_argument("--episodes", type=int, default=100_000, metavar="M", help="rollouts (default: 100000)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the rollouts (default: 0)")
    parser.add_argument("--confidence", type=float, default=0.999, metavar="C", help="of the limits (default: 0.999)")


def add_json_options(parser: argparse.ArgumentParser) -> None:
    """Where the result is written as JSON."""
    parser.add_argument("--json", metavar="PATH", help="write the result as JSON (- for standard output)")
