"""The parser of all sub-commands, built without numpy, so that ``--help`` is quick."""

from __future__ import annotations

import argparse
from typing import Any

from .. import __version__
from .options import (
    add_json_options,
    add_problem_options,
    add_relation,
    add_rollout_options,
    add_start_options,
    add_synthesis_options,
    add_validate_options,
    add_validation_options,
)


def build_parser() -> argparse.ArgumentParser:
    """The parser of all sub-commands."""
    parser = argparse.ArgumentParser(
        prog="certigym", description="Multi-agent environments with temporal-logic tasks and certified controllers."
    )
    parser.add_argument("--version", action="version", version=f"certigym {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    problems = commands.add_parser("problems", help="list the problems of the suite, one id a line")
    add_json_options(problems)
    describe = commands.add_parser("describe", help="show agents, regions, automaton and start of a problem")
    add_problem_options(describe)
    add_json_options(describe)
    run = commands.add_parser("run", help="synthesize controllers, validate the bound by rollouts, report")
    add_problem_options(run)
    add_synthesis_options(run)
    add_validation_options(run)
    add_validate_options(run)
    run.add_argument("--out", metavar="CERT", help="also save the certificate (.npz)")
    add_json_options(run)
    synthesize = commands.add_parser("synthesize", help="synthesize controllers and save the certificate")
    add_problem_options(synthesize)
    add_synthesis_options(synthesize)
    synthesize.add_argument("--out", metavar="CERT", required=True, help="certificate file to write (.npz)")
    add_json_options(synthesize)
    validate = commands.add_parser("validate", help="test a saved certificate by rollouts")
    validate.add_argument("certificate", metavar="CERT")
    add_start_options(validate)
    add_validation_options(validate)
    add_validate_options(validate)
    add_json_options(validate)
    reproduce = commands.add_parser(
        "reproduce", help="recompute the paper's figures and tables, published values beside"
    )
    reproduce.add_argument("what", choices=["fig3", "fig4", "table1", "table2", "refutation"])
    reproduce.add_argument("--out", metavar="DIR", help="folder for numbers and figures (default: reproduced)")
    add_json_options(reproduce)
    check = commands.add_parser("check", help="verify a saved certificate by separate code, without simulation")
    check.add_argument("certificate", metavar="CERT")
    check.add_argument("--problem", metavar="ID|FILE", help="the certificate must be about this problem")
    check.add_argument("--horizon", type=int, metavar="T", help="horizon of --problem")
    add_json_options(check)
    render = commands.add_parser("render", help="show an episode under certified controllers as a GIF or MP4")
    render.add_argument("problem", metavar="ID|FILE|CERT", help="suite id, TOML problem file or certificate (.npz)")
    render.add_argument("--horizon", type=int, metavar="T", help="control steps (default: the problem's)")
    add_start_options(render)
    add_synthesis_options(render)
    render.add_argument("--out", metavar="PICTURE", required=True, help="file to write (.gif, .mp4 or .png)")
    render.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the episode (default: 0)")
    render.add_argument("--fps", type=int, default=4, metavar="F", help="control steps per second (default: 4)")
    add_json_options(render)
    add_plot_command(commands)
    add_validation_commands(commands)
    add_learning_commands(commands)
    return parser


KINDS = {
    "value": "certified bound over a slice of starts (--axes: one coordinate or two)",
    "horizon": "certified bound and rollouts against the horizon (--horizons)",
    "rollouts": "rollouts over the regions",
    "automaton": "the task automaton",
    "rank": "terms of the value function against the steps left",
    "relation": "one agent, its finite model, and the set that the relation keeps it in (--agent)",
    "tree": "the value tree (short horizons)",
}


def add_plot_command(commands: Any) -> None:
    """Add the sub-command; built without numpy, so that ``--help`` is quick."""
    kinds = "; ".join(f"{name}: {text}" for name, text in KINDS.items())
    plot = commands.add_parser("plot", help="draw a figure (PNG, SVG, PDF)", epilog=f"KIND is one of: {kinds}.")
    plot.add_argument("kind", metavar="KIND", choices=sorted(KINDS), help=", ".join(KINDS))
    plot.add_argument("problem", metavar="ID|FILE|CERT", help="suite id, TOML problem file or certificate (.npz)")
    plot.add_argument("--out", metavar="FIGURE", required=True, help="file to write (.png, .svg or .pdf)")
    plot.add_argument("--horizon", type=int, metavar="T", help="control steps (default: the problem's)")
    plot.add_argument(
        "--horizons", nargs="+", type=int, metavar="T", help="for `horizon` (default: 1 to the problem's)"
    )
    plot.add_argument("--initial-state", nargs="+", metavar="X", help="joint initial state, agent after agent")
    add_relation(plot, "as for `synthesize` (default: auto)")
    plot.add_argument("--cells", nargs="+", type=int, metavar="N", help="cells per axis (default: by dimension)")
    plot.add_argument("--axes", nargs="+", type=int, metavar="K", help="joint coordinates of `value`")
    plot.add_argument("--agent", type=int, default=0, metavar="I", help="number of the agent of `relation`")
    plot.add_argument("--episodes", type=int, metavar="M", help="rollouts (default: 40, or 2000 per horizon)")
    plot.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the rollouts (default: 0)")
    plot.add_argument("--json", metavar="PATH", help="write what was drawn as JSON (- for standard output)")


POLICIES = "certified, ppo, central-ppo, sac, random, idle, an actor or certificate (.npz), or FILE.py:NAME"


def add_learning_commands(commands: Any) -> None:
    """The sub-commands ``train``, ``compare`` and ``certify``."""
    train = commands.add_parser("train", help="train a baseline of Stable-Baselines3 and save it")
    _learning_problem(train)
    train.add_argument("--algo", choices=["ppo", "central-ppo", "sac"], default="ppo",
                       help="ppo: decentralised, one network for all agents (default); the others see all")  # fmt: skip
    train.add_argument("--steps", type=int, metavar="N", help="world steps (default: by algorithm)")
    train.add_argument("--seed", type=int, default=0, metavar="S", help="decides everything (default: 0)")
    train.add_argument("--worlds", type=int, metavar="M", help="worlds side by side (default: by algorithm)")
    train.add_argument("--reward", choices=["shaped", "sparse"], default="shaped", help="default: shaped")
    train.add_argument("--out", metavar="DIR", required=True, help="folder for actor.npz, training.json, model.zip")
    train.add_argument("--plot", metavar="PICTURE", help="also draw the training curve (.png, .svg, .pdf)")

    compare = commands.add_parser("compare", help="compare policies on common random numbers")
    _learning_problem(compare)
    compare.add_argument("--policies", default="certified,ppo,random", metavar="LIST",
                         help=f"separated by commas: {POLICIES} (default: certified,ppo,random)")  # fmt: skip
    compare.add_argument("--steps", type=int, metavar="N", help="world steps of learners (default: by algorithm)")
    compare.add_argument("--train-seeds", nargs="+", type=int, default=[0], metavar="S", help="of learners (0)")
    compare.add_argument("--cells", nargs="+", type=int, metavar="N", help="cells per axis of `certified`")
    compare.add_argument("--plot", metavar="PICTURE", help="also draw the comparison (.png, .svg, .pdf)")
    _learning_rollouts(compare)

    certify = commands.add_parser("certify", help="certify a decentralised policy, wrapped on a grid")
    _learning_problem(certify)
    certify.add_argument("--policy", required=True, metavar="POLICY", help="actor (.npz) or FILE.py:NAME")
    certify.add_argument("--cells", nargs="+", type=int, metavar="N", help="cells per axis (default: by dimension)")
    add_relation(certify, "how agents follow their finite models: quick (default), exact, tube, ellipsoid or paper")
    certify.add_argument("--improve", action="store_true", help="also improve it by coordinate ascent")
    certify.add_argument("--out", metavar="CERT", help="save the certificate, of the improved policy if any (.npz)")
    _learning_rollouts(certify)
    for parser in (train, compare, certify):
        parser.add_argument("--json", metavar="PATH", help="write the result as JSON (- for standard output)")


def _learning_problem(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("problem", metavar="ID|FILE", help="suite id or TOML problem file")
    parser.add_argument("--horizon", type=int, metavar="T", help="control steps (default: the problem's)")
    parser.add_argument("--initial-state", nargs="+", metavar="X", help="joint initial state, agent after agent")


def _learning_rollouts(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--episodes", type=int, default=10_000, metavar="M", help="rollouts per policy (10000)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the rollouts (default: 0)")
    parser.add_argument("--confidence", type=float, default=0.99, metavar="C", help="of each interval (0.99)")


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
