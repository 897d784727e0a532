"""Options that several commands share: each is declared once, with one default and one meaning."""

from __future__ import annotations

import argparse
from typing import Any

MISMATCH = "noise_scale=1.2, noise_family=laplace, actuator_bias=0.1, delay=1 or dropout=0.05; several are allowed"
"""Examples for the help of ``--mismatch``."""


USUAL: dict[str, Any] = {
    "initial_state": None,
    "delta": None,
    "targets": None,
    "restarts": 0,
    "stationary": False,
    "above": None,
    "confidence": 0.999,
    "workers": None,
    "dask": None,
    "sequential": False,
    "mismatch": None,
    "disturbance": None,
}
"""What ``synthesize`` and ``validate`` ask for and ``run`` takes as usual."""


def add_task(parser: argparse.ArgumentParser) -> None:
    """Add the problem and its horizon, several, or none."""
    parser.add_argument("problem", metavar="ID|FILE", help="suite id or TOML problem file")
    parser.add_argument(
        "--horizon",
        nargs="+",
        type=_horizon,
        metavar="T",
        help="control steps (default: the problem's); several: a row for each; none: no deadline, policies that do not "
        "look at the time, and a horizon that is doubled until the bound gains less than 1e-6",
    )


def _horizon(word: str) -> int | None:
    """Return a number of control steps, or None for the word `none`."""
    return None if word == "none" else int(word)


def add_problem(parser: argparse.ArgumentParser) -> None:
    """Add the problem, its horizon and its start."""
    parser.add_argument("problem", metavar="ID|FILE", help="suite id or TOML problem file")
    add_horizon(parser)
    add_start(parser)


def add_source(parser: argparse.ArgumentParser) -> None:
    """Add a problem or a certificate."""
    parser.add_argument("problem", metavar="ID|FILE|CERT", help="suite id, TOML problem file or certificate (.npz)")
    add_horizon(parser)
    add_start(parser)


def add_certificate(parser: argparse.ArgumentParser) -> None:
    """Add a certificate file."""
    parser.add_argument("certificate", metavar="CERT", help="certificate file (.npz)")
    parser.add_argument(
        "--max-bytes", default="1G", metavar="BYTES", help="largest unpacked size of CERT that is read (default: 1G)"
    )


def add_horizon(parser: argparse.ArgumentParser) -> None:
    """Add the horizon."""
    parser.add_argument("--horizon", type=int, metavar="T", help="control steps (default: the problem's)")


def add_start(parser: argparse.ArgumentParser) -> None:
    """Add the initial state."""
    parser.add_argument("--initial-state", nargs="+", metavar="X", help="joint initial state, agent after agent")


def add_cells(parser: argparse.ArgumentParser, automatic: str = "what certifies most") -> None:
    """Add relation and cells of the finite models; ``automatic`` says what ``auto`` means."""
    parser.add_argument(
        "--relation",
        nargs="+",
        metavar="NAME",
        default=["auto"],
        help=f"auto (default: {automatic}), best (no shortcut), exact, linear, boxes, paper, path (no grid) or "
        "vertices (one agent, few states); AGENT=NAME for single agents",
    )
    parser.add_argument("--cells", nargs="+", type=int, metavar="N", help="cells per axis (default: by dimension)")


def add_models(parser: argparse.ArgumentParser, automatic: str = "what certifies most") -> None:
    """Add relation and cells of the finite models, and what some relations are told besides."""
    add_cells(parser, automatic)
    parser.add_argument("--delta", type=float, metavar="P", help="failure probability per step and agent of `paper`")
    parser.add_argument(
        "--targets", type=int, metavar="N", help="target means per cell and axis (default: by relation and dimension)"
    )


def add_effort(parser: argparse.ArgumentParser) -> None:
    """Add how much is spent on the search, and which bound is enough."""
    parser.add_argument(
        "--effort",
        type=float,
        metavar="W",
        help="core seconds for ways to certify the task: work that is counted, not measured (default: 80)",
    )
    parser.add_argument(
        "--seconds", type=float, metavar="S", help="the best certificate that the clock leaves time for (no default)"
    )
    parser.add_argument(
        "--until", type=float, metavar="P", help="end with the first certificate whose lower bound is P (no default)"
    )


def add_search(parser: argparse.ArgumentParser) -> None:
    """Add how cells and policies are searched for."""
    add_effort(parser)
    add_above(parser)
    parser.add_argument(
        "--restarts", type=int, default=0, metavar="N", help="further searches from perturbed plans (default: 0)"
    )
    parser.add_argument("--stationary", action="store_true", help="policies that do not look at the time")


def add_above(parser: argparse.ArgumentParser) -> None:
    """Add whether a claim is to have an upper end."""
    parser.add_argument(
        "--above",
        action="store_true",
        default=None,
        help="bound the same controllers from above, too, however long that takes (default: where it is quick)",
    )


def add_rollouts(parser: argparse.ArgumentParser, episodes: int, per: str = "") -> None:
    """Add how many rollouts are made, and from which seed."""
    parser.add_argument(
        "--episodes", type=int, default=episodes, metavar="M", help=f"rollouts{per} (default: {episodes})"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the rollouts (default: 0)")


def add_trials(parser: argparse.ArgumentParser, episodes: int, per: str = "", confidence: float = 0.999) -> None:
    """Add how many rollouts are made, from which seed, how sure their limits are, and where they are computed."""
    add_rollouts(parser, episodes, per)
    parser.add_argument(
        "--confidence", type=float, default=confidence, metavar="C", help=f"of limits (default: {confidence})"
    )
    parser.add_argument("--workers", type=int, metavar="N", help="worker processes of this machine (default: none)")
    parser.add_argument("--dask", metavar="ADDRESS|local", help="Dask scheduler, or workers of this machine under Dask")


def add_test(parser: argparse.ArgumentParser) -> None:
    """Add how a bound is tested."""
    parser.add_argument("--sequential", action="store_true", help="stop as soon as the bound is confirmed or refuted")
    parser.add_argument(
        "--disturbance",
        choices=["zero", "random", "periodic", "greedy"],
        help="behaviour of bounded disturbances (default: all of them, and the worst is reported)",
    )
    parser.add_argument("--mismatch", nargs="+", metavar="NAME=VALUE", help=f"simulate another system: {MISMATCH}")


def add_picture(parser: argparse.ArgumentParser, what: str) -> None:
    """Add a picture of the result."""
    parser.add_argument("--plot", metavar="PICTURE", help=f"also draw {what} (.png, .svg, .pdf)")


def add_trust(parser: argparse.ArgumentParser) -> None:
    """Add whether files of policies may run code."""
    parser.add_argument(
        "--trust",
        action="store_true",
        help="read policies in .zip, .pt and checkpoints, which run code that is in them (pickle); refused without it",
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add where the result is written as JSON."""
    parser.add_argument("--json", metavar="PATH", help="write the result as JSON (- for standard output)")
