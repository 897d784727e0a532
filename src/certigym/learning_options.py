"""Options and sub-commands about learned and given policies; built without numpy, so that ``--help`` is quick."""

from __future__ import annotations

import argparse
from typing import Any

POLICIES = "certified, ppo, central-ppo, sac, random, idle, an actor or certificate (.npz), or FILE.py:NAME"


def add_learning_commands(commands: Any) -> None:
    """The sub-commands ``train``, ``compare`` and ``certify``."""
    train = commands.add_parser("train", help="train a baseline of Stable-Baselines3 and save it")
    _problem(train)
    train.add_argument("--algo", choices=["ppo", "central-ppo", "sac"], default="ppo",
                       help="ppo: decentralised, one network for all agents (default); the others see all")  # fmt: skip
    train.add_argument("--steps", type=int, metavar="N", help="world steps (default: by algorithm)")
    train.add_argument("--seed", type=int, default=0, metavar="S", help="decides everything (default: 0)")
    train.add_argument("--worlds", type=int, metavar="M", help="worlds side by side (default: by algorithm)")
    train.add_argument("--reward", choices=["shaped", "sparse"], default="shaped", help="default: shaped")
    train.add_argument("--out", metavar="DIR", required=True, help="folder for actor.npz, training.json, model.zip")
    train.add_argument("--plot", metavar="PICTURE", help="also draw the training curve (.png, .svg, .pdf)")

    compare = commands.add_parser("compare", help="compare policies on common random numbers")
    _problem(compare)
    compare.add_argument("--policies", default="certified,ppo,random", metavar="LIST",
                         help=f"separated by commas: {POLICIES} (default: certified,ppo,random)")  # fmt: skip
    compare.add_argument("--steps", type=int, metavar="N", help="world steps of learners (default: by algorithm)")
    compare.add_argument("--train-seeds", nargs="+", type=int, default=[0], metavar="S", help="of learners (0)")
    compare.add_argument("--cells", nargs="+", type=int, metavar="N", help="cells per axis of `certified`")
    compare.add_argument("--plot", metavar="PICTURE", help="also draw the comparison (.png, .svg, .pdf)")
    _rollouts(compare)

    certify = commands.add_parser("certify", help="certify a decentralised policy, wrapped on a grid")
    _problem(certify)
    certify.add_argument("--policy", required=True, metavar="POLICY", help="actor (.npz) or FILE.py:NAME")
    certify.add_argument("--cells", nargs="+", type=int, metavar="N", help="cells per axis (default: by dimension)")
    add_relation(certify, "how agents follow their finite models: quick (default), exact, tube, ellipsoid or paper")
    certify.add_argument("--improve", action="store_true", help="also improve it by coordinate ascent")
    certify.add_argument("--out", metavar="CERT", help="save the certificate, of the improved policy if any (.npz)")
    _rollouts(certify)
    for parser in (train, compare, certify):
        parser.add_argument("--json", metavar="PATH", help="write the result as JSON (- for standard output)")


def _problem(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("problem", metavar="ID|FILE", help="suite id or TOML problem file")
    parser.add_argument("--horizon", type=int, metavar="T", help="control steps (default: the problem's)")
    parser.add_argument("--initial-state", nargs="+", metavar="X", help="joint initial state, agent after agent")


def _rollouts(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--episodes", type=int, default=10_000, metavar="M", help="rollouts per policy (10000)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the rollouts (default: 0)")
    parser.add_argument("--confidence", type=float, default=0.99, metavar="C", help="of each interval (0.99)")


def add_relation(parser: argparse.ArgumentParser, meaning: str) -> None:
    """Options ``--relation`` and ``--delta``."""
    parser.add_argument("--relation", nargs="+", metavar="NAME", default=["auto"],
                        help=f"{meaning}; AGENT=NAME for single agents")  # fmt: skip
    parser.add_argument("--delta", type=float, metavar="P",
                        help="failure probability per step and agent of `ellipsoid` or `paper`")  # fmt: skip
