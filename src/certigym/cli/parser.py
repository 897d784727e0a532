"""The parser of all commands. Of certigym it imports version and options alone, so that ``--help`` is quick."""

from __future__ import annotations

import argparse
import re
import shutil
from collections.abc import Collection, Sequence
from difflib import get_close_matches
from textwrap import TextWrapper
from typing import Any, NoReturn

from .. import __version__
from .options import (
    USUAL,
    add_above,
    add_cells,
    add_certificate,
    add_effort,
    add_horizon,
    add_json,
    add_models,
    add_picture,
    add_problem,
    add_rollouts,
    add_search,
    add_source,
    add_start,
    add_task,
    add_test,
    add_trials,
    add_trust,
)

MODULES = {
    "describe": "synthesis_commands",
    "run": "synthesis_commands",
    "synthesize": "synthesis_commands",
    "certify": "learning_commands",
    "check": "canonical_commands",
    "canonical": "canonical_commands",
    "validate": "validation_commands",
    "validate-field": "validation_commands",
    "audit": "validation_commands",
    "stress": "validation_commands",
    "sweep": "validation_commands",
    "report": "validation_commands",
    "train": "learning_commands",
    "probe": "learning_commands",
    "leaderboard": "learning_commands",
    "record": "learning_commands",
    "compare": "learning_commands",
    "save-policy": "learning_commands",
    "plot": "picture_commands",
    "studio": "studio_commands",
    "reproduce": "reproduce_command",
}
"""The file of each command; the function in it has the command's name."""

KINDS = {
    "value": "certified bound over a slice of starts (--axes: one coordinate or two)",
    "horizon": "certified bound and rollouts against the horizon (--horizons)",
    "rollouts": "rollouts over the regions",
    "episode": "one episode as a moving picture (.gif or .mp4; .png: its last frame)",
    "automaton": "the task automaton",
    "rank": "terms of the value function against the steps left",
    "tree": "the value tree (short horizons)",
}
"""The figures that ``plot`` draws."""

POLICIES = (
    "certified, ppo, ippo, mappo, central-ppo, sac, random, idle, a file (.npz, .onnx; with --trust .zip, .pt; @ENV "
    "behind it says where it was trained), or FILE.py:NAME, which is run"
)
"""The words for policies on the command line."""


GROUPS = {
    "certify": ("run", "synthesize", "certify"),
    "check": ("check", "canonical", "validate", "validate-field", "audit", "stress", "sweep"),
    "learn": ("train", "compare", "leaderboard", "probe", "record", "save-policy"),
    "see": ("describe", "report", "plot", "studio"),
    "reproduce": ("reproduce",),
}
"""Commands by what one wants, the one that is shown as an example first: the order of ``certigym --help``."""

EXAMPLES = {
    "run": "run reach-avoid-v0",
    "synthesize": "synthesize my-task.toml --out my-task.npz",
    "certify": "certify quadrotor-v0 --policy model.zip --trust",
    "check": "check my-task.npz",
    "canonical": "canonical old.npz --out new.npz",
    "validate": "validate my-task.npz --episodes 1000000",
    "validate-field": "validate-field my-task.npz --axes 0 1 --points 9",
    "audit": "audit my-task.npz",
    "stress": "stress my-task.npz",
    "sweep": "sweep my-task.toml --over noise=0.5,1,2 horizon=10,20",
    "train": "train reach-avoid-v0 --steps 100000 --out ppo",
    "compare": "compare reach-avoid-v0 --policies certified,ppo,random",
    "leaderboard": "leaderboard reach-avoid-v0 --out board.html",
    "probe": "probe reach-avoid-v0 --seconds 60",
    "record": "record reach-avoid-v0 --policy certified --out data.npz",
    "save-policy": "save-policy reach-avoid-v0 --policy certified --out policy.onnx",
    "describe": "describe my-task.toml",
    "report": "report my-task.npz --out my-task.html",
    "plot": "plot episode my-task.npz --out episode.gif",
    "studio": "studio my-task.toml --open",
    "reproduce": "reproduce table1",
}
"""An example of every command, shown at the end of its help."""


class Parser(argparse.ArgumentParser):
    """A parser of arguments that names the command or option that was probably meant."""

    def error(self, message: str) -> NoReturn:
        """Print what is wrong in one line, without all that would have been right, and leave with status 2."""
        if found := re.fullmatch(r"argument COMMAND: invalid choice: '(.*)' \(choose from (.*)\)", message):
            word, known = found[1], re.findall(r"[\w-]+", found[2])
            self.exit(2, f"{self.prog}: error: no command `{word}`; {nearest(word, known)}\n")
        if found := re.fullmatch(r"argument (.*): invalid choice: '(.*)' \(choose from (.*)\)", message):
            close = get_close_matches(found[2], re.findall(r"[\w-]+", found[3]), n=1)
            message += f"; did you mean `{close[0]}`?" if close else ""
        super().error(message)


class Commands(Parser):
    """The parser of the program itself, whose help lists commands by what they are for."""

    groups: Any = None
    """The action that holds its commands."""

    def format_help(self) -> str:
        """Return the help: groups of commands, an example in the line of each."""
        about = {action.dest: action.help or "" for action in self.groups._choices_actions}
        wide = 2 + max(map(len, about))
        fill = TextWrapper(shutil.get_terminal_size().columns - 2, subsequent_indent=" " * (wide + 2))
        lines = [self.format_usage(), f"{self.description}", ""]
        for title, names in GROUPS.items():
            lines.append(f"{title}: for example `certigym {EXAMPLES[names[0]]}`")
            lines += [fill.fill(f"  {name:{wide}}{about[name]}") for name in names]
            lines.append("")
        return "\n".join(
            [*lines, "`certigym COMMAND --help` says more; `certigym --version` which version this is.", ""]
        )


def nearest(word: str, known: Collection[str]) -> str:
    """Return the known word that a mistyped one resembles, as a question, or where all are listed."""
    close = get_close_matches(word, known, n=1)
    return f"did you mean `{close[0]}`?" if close else "`certigym --help` lists all"


def build_parser() -> Commands:
    """Return the parser of all commands."""
    parser = Commands(
        prog="certigym", description="Multi-agent environments with temporal-logic tasks and certified controllers."
    )
    parser.add_argument("--version", action="version", version=f"certigym {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)
    parser.groups = commands
    _add_synthesis(commands)
    _add_validation(commands)
    _add_learning(commands)
    _add_leaderboard(commands)
    _add_comparing(commands)
    _add_pictures(commands)
    for name, command in commands.choices.items():
        add_json(command)
        command.epilog = " ".join(filter(None, (f"Example: certigym {EXAMPLES[name]}.", command.epilog)))
    return parser


def elsewhere(parser: argparse.ArgumentParser, command: str, unknown: Sequence[str]) -> str:
    """Return what an unknown option should have been, or where it is, in words; nothing if it is nowhere."""
    names = [word.partition("=")[0] for word in unknown if word.startswith("--")]
    if not names:
        return ""
    from ..envs.systems.arguments import OTHER_NAMES  # only where something is wrong: `--help` is quick

    commands = next(action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    known = [name.lstrip("-") for name in commands.choices[command]._option_string_actions]
    meant = [one for one in OTHER_NAMES.get(names[0].lstrip("-").replace("-", "_"), ()) if one in known]
    if close := meant or get_close_matches(names[0].lstrip("-"), known, n=1, cutoff=0.75):
        return f"; did you mean `--{close[0]}`?"
    if command == "run" and names[0].lstrip("-").replace("-", "_") in USUAL:
        return "; `certigym synthesize` and `certigym validate` have all options, `run` has the ten that matter most"
    return ""


def _add_synthesis(commands: Any) -> None:
    """Add the commands that describe a problem, certify it, and check a certificate."""
    describe = commands.add_parser("describe", help="list the suite, or show agents, regions and task of a problem")
    describe.add_argument("problem", metavar="ID|FILE", nargs="?", help="suite id or TOML problem file (default: all)")
    add_horizon(describe)
    add_start(describe)
    describe.add_argument(
        "--tier",
        choices=("solved", "open", "hard", "unrated"),
        help="list problems of one tier: what is left to learn there",
    )

    run = commands.add_parser("run", help="synthesize controllers, test their bound by rollouts, print a report")
    add_task(run)
    add_cells(run)
    add_effort(run)
    add_rollouts(run, 100_000)
    run.add_argument("--out", metavar="CERT", help="also save the certificate (.npz)")
    run.add_argument(
        "-v", "--verbose", action="store_true", help="also say what was tried, what limits the bound, and the verdict"
    )
    run.set_defaults(**USUAL)

    synthesize = commands.add_parser("synthesize", help="synthesize controllers and save the certificate")
    add_task(synthesize)
    add_start(synthesize)
    add_models(synthesize)
    add_search(synthesize)
    synthesize.add_argument("--out", metavar="CERT", help="certificate file to write (.npz; default: NAME.npz here)")

    check = commands.add_parser("check", help="verify a saved certificate by separate code, without simulation")
    add_certificate(check)
    check.add_argument("--problem", metavar="ID|FILE", help="the certificate must be about this problem")
    check.add_argument("--horizon", type=int, metavar="T", help="horizon of --problem")

    canonical = commands.add_parser(
        "canonical", help="print a problem as the checker reads it, or bring a certificate into that form"
    )
    canonical.add_argument("source", metavar="ID|FILE|CERT", help="suite id, problem file or certificate")
    canonical.add_argument("--out", metavar="CERT", help="certificate file to write: that of CERT in canonical form")
    canonical.add_argument(
        "--claim",
        choices=("same", "proved"),
        default="same",
        help="proved: where CERT claims more than the checker proves, claim that, and do not refuse it",
    )


def _add_validation(commands: Any) -> None:
    """Add the commands that test a certificate by rollouts."""
    validate = commands.add_parser("validate", help="test a saved certificate by rollouts")
    add_certificate(validate)
    add_start(validate)
    add_trials(validate, 100_000)
    add_test(validate)

    field = commands.add_parser("validate-field", help="test a saved certificate at many initial states at once")
    add_certificate(field)
    field.add_argument("--axes", nargs="+", type=int, metavar="K", help="joint coordinates of a slice (one or two)")
    field.add_argument("--points", nargs="+", type=int, metavar="N", help="points per axis of the slice (20)")
    field.add_argument("--low", nargs="+", metavar="X", help="lower corner of the box of starts (the workspaces)")
    field.add_argument("--high", nargs="+", metavar="X", help="upper corner of the box of starts")
    field.add_argument("--random", type=int, default=200, metavar="N", help="random starts, without --axes (200)")
    field.add_argument("--search", action="store_true", help="search for the weakest start, with --episodes in all")
    add_trials(field, 1000, " per start")

    audit = commands.add_parser("audit", help="test a saved certificate step by step along rollouts")
    add_certificate(audit)
    add_trials(audit, 20_000)

    stress = commands.add_parser("stress", help="test how far a bound survives noise, actuator and observation faults")
    add_certificate(stress)
    add_trials(stress, 20_000, " per mismatch")

    sweep = commands.add_parser("sweep", help="certify and test a problem for every combination of some changes")
    add_problem(sweep)
    sweep.add_argument(
        "--over",
        nargs="+",
        required=True,
        metavar="NAME=VALUES",
        help="what is changed, such as noise=0.5,1,2 horizon=10,20: noise (a factor on its standard deviations), "
        "horizon, effort, cells",
    )
    add_cells(sweep)
    add_effort(sweep)
    add_trials(sweep, 10_000, " per row")
    sweep.set_defaults(**{name: USUAL[name] for name in ("delta", "targets", "restarts", "stationary")})

    report = commands.add_parser("report", help="write one self-contained HTML page about a saved certificate")
    add_certificate(report)
    report.add_argument("--out", metavar="HTML", required=True, help="page to write (.html)")
    report.add_argument("--axes", nargs="+", type=int, metavar="K", help="joint coordinates of the map (one or two)")
    add_trials(report, 100_000)

    reproduce = commands.add_parser(
        "reproduce",
        help="recompute the paper's figures and tables, and the field's benchmarks, beside the published values",
    )
    reproduce.add_argument("what", choices=["all", "fig3", "fig4", "table1", "table2", "refutation", "arch", "lograsm"])
    reproduce.add_argument("--weights", metavar="DIR", help="of lograsm: folder with its networks, which are not ours")
    reproduce.add_argument("--row", metavar="NAME", help="one row of arch alone")
    reproduce.add_argument("--out", metavar="DIR", help="folder for numbers and figures (default: reproduced)")
    reproduce.add_argument("--workers", type=int, default=2, metavar="N", help="processes side by side (default: 2)")


def _add_learning(commands: Any) -> None:
    """Add the commands that train learners."""
    train = commands.add_parser("train", help="train a baseline of Stable-Baselines3 and save it")
    add_problem(train)
    train.add_argument(
        "--algo",
        choices=["ppo", "ippo", "mappo", "central-ppo", "sac"],
        default="ppo",
        help="decentralised: ppo (default: one network for all agents), ippo (one for each), mappo (a central critic); "
        "central-ppo and sac see the states of all agents",
    )
    train.add_argument("--steps", type=int, metavar="N", help="world steps (default: by algorithm)")
    train.add_argument("--seed", type=int, default=0, metavar="S", help="seed of everything random (default: 0)")
    train.add_argument(
        "--seeds", nargs="+", type=int, metavar="S", help="several trainings, compared at the end; folders DIR/seed-S"
    )
    train.add_argument("--resume", metavar="DIR", help="go on with the learner that is saved in this folder")
    train.add_argument("--worlds", type=int, metavar="M", help="worlds side by side (default: by algorithm)")
    train.add_argument(
        "--reward",
        choices=["sparse", "shaped", "progress"],
        help="one reward for all of the training (default: progress first, then sparse)",
    )
    train.add_argument(
        "--warm-start",
        metavar="certificate|CERT",
        help="clone certified controllers first: those of the file CERT, or of the certificate made with the defaults",
    )
    train.add_argument(
        "--shield",
        metavar="certificate|CERT",
        help="train behind the shield of the certificate CERT, or of one made with the defaults (with --probability)",
    )
    train.add_argument(
        "--probability", type=float, metavar="P", help="success probability that the shield keeps while training"
    )
    train.add_argument("--out", metavar="DIR", required=True, help="folder for actor, record, curve and learner")
    train.add_argument("--certify", action="store_true", help="certify the actor as it is, or a smoother one like it")
    add_picture(train, "the training curve")
    train.add_argument(
        "--bound", metavar="certificate|CERT", help="certificate whose bound --plot draws (default: of --warm-start)"
    )

    probe = commands.add_parser(
        "probe", help="let a learner that starts from the certified controllers try to beat them"
    )
    add_problem(probe)
    probe.add_argument(
        "--certificate", metavar="CERT", default="certificate", help="certificate file (default: one is made)"
    )
    probe.add_argument("--seconds", type=float, default=120.0, metavar="S", help="budget of the learner (default: 120)")
    probe.add_argument("--steps", type=int, metavar="N", help="world steps per attempt, instead of --seconds")
    probe.add_argument("--out", metavar="ACTOR", help="also save the best actor (.npz)")
    add_trials(probe, 20_000, " that judge")


def _add_leaderboard(commands: Any) -> None:
    """Add the command that fills the leaderboard."""
    board = commands.add_parser("leaderboard", help="judge every policy on every problem, and write page and JSON")
    board.add_argument("ids", metavar="ID", nargs="*", help="suite ids or TOML files (default: the suite)")
    board.add_argument(
        "--out", metavar="PAGE", default="leaderboard.md", help="page to write or to go on with; beside it the JSON"
    )
    board.add_argument(
        "--policies",
        default="certified,ppo,ippo,mappo,sac,random",
        metavar="LIST",
        help="columns to fill, separated by commas; also central-ppo (default: %(default)s)",
    )
    board.add_argument(
        "--steps", type=int, metavar="N", help="world steps of each learner that is trained (default: settings.toml)"
    )
    board.add_argument("--train-seeds", nargs="+", type=int, default=[0], metavar="S", help="of learners (0)")
    board.add_argument("--certificates", metavar="DIR", help="folder with ID.npz: read if there, else written")
    board.add_argument("--learners", metavar="DIR", help="folder with ID/LEARNER/seed-S.npz, as DIR of certificates")
    board.add_argument(
        "--replay",
        action="store_true",
        help="train nothing: judge the actors in --learners again (docs/actors), and compare with the record",
    )
    board.add_argument(
        "--add",
        metavar="NAME=POLICY",
        help="judge an own policy: a file (.npz, .onnx; with --trust .zip, .pt; [@ENV]) or FILE.py:NAME",
    )
    add_trust(board)
    add_trials(board, 20_000, " per policy")


def _add_comparing(commands: Any) -> None:
    """Add the commands that record, compare and certify policies."""
    record = commands.add_parser("record", help="write episodes of a policy as arrays, or as a Minari dataset")
    add_problem(record)
    record.add_argument("--policy", required=True, metavar="POLICY", help=POLICIES)
    add_trust(record)
    record.add_argument("--episodes", type=int, default=1000, metavar="M", help="episodes (default: 1000)")
    record.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the rollouts (default: 0)")
    record.add_argument("--steps", type=int, metavar="N", help="world steps of a learner (default: by algorithm)")
    record.add_argument("--train-seeds", nargs="+", type=int, default=[0], metavar="S", help="of learners (0)")
    add_models(record)
    record.add_argument("--tiers", action="store_true", help="write random, medium and expert (POLICY) into a folder")
    record.add_argument("--out", metavar="DATA", required=True, help="file to write (.npz), or folder for --tiers")
    minari = "also write Minari dataset NAME, or NAME/TIER-v0 (needs certigym[data])"
    record.add_argument("--minari", metavar="NAME", help=minari)

    save = commands.add_parser("save-policy", help="write a policy for other programs: networks as ONNX, tables as C")
    add_problem(save)
    save.add_argument("--policy", required=True, metavar="POLICY", help=POLICIES)
    add_trust(save)
    save.add_argument("--agent", metavar="NAME", help="whose policy (default: that of all agents)")
    save.add_argument("--steps", type=int, metavar="N", help="world steps of a learner (default: by algorithm)")
    save.add_argument("--train-seeds", nargs="+", type=int, default=[0], metavar="S", help="of a learner (0)")
    add_models(save)
    save.add_argument("--out", metavar="FILE", required=True, help="file to write: .onnx or .h")

    compare = commands.add_parser("compare", help="compare policies on common random numbers")
    add_problem(compare)
    compare.add_argument(
        "--policies",
        default="certified,ppo,random",
        metavar="LIST",
        help=f"separated by commas: {POLICIES} (default: certified,ppo,random)",
    )
    add_trust(compare)
    compare.add_argument("--steps", type=int, metavar="N", help="world steps of learners (default: by algorithm)")
    compare.add_argument("--train-seeds", nargs="+", type=int, default=[0], metavar="S", help="of learners (0)")
    add_models(compare)
    add_picture(compare, "the comparison")
    add_trials(compare, 10_000, " per policy", 0.99)

    certify = commands.add_parser("certify", help="certify a policy: networks as they are, others wrapped on cells")
    add_problem(certify)
    certify.add_argument(
        "--policy",
        metavar="POLICY",
        help="actor (.npz, .onnx; with --trust .zip, .pt; [@ENV]) or FILE.py:NAME (default: the actor in place of the "
        "problem)",
    )
    add_trust(certify)
    certify.add_argument("--wrap", action="store_true", help="certify what a network becomes on cells, not as it is")
    add_above(certify)
    add_models(certify, "the same as quick")
    certify.add_argument("--improve", action="store_true", help="also improve it by coordinate ascent")
    certify.add_argument("--out", metavar="CERT", help="save the certificate, with --improve the improved one (.npz)")
    add_trials(certify, 10_000, " per policy", 0.99)


def _add_pictures(commands: Any) -> None:
    """Add the commands for figures, moving pictures, and the page on which tasks are drawn."""
    kinds = "; ".join(f"{name}: {text}" for name, text in KINDS.items())
    plot = commands.add_parser("plot", help="draw a figure or an episode", epilog=f"KIND is one of: {kinds}.")
    plot.add_argument("kind", metavar="KIND", choices=sorted(KINDS), help=", ".join(KINDS))
    add_source(plot)
    plot.add_argument("--out", metavar="FIGURE", required=True, help="file to write (.png, .svg, .pdf; .gif, .mp4)")
    plot.add_argument("--horizons", nargs="+", type=int, metavar="T", help="of `horizon` (default: 1 to the problem's)")
    add_models(plot)
    plot.add_argument("--axes", nargs="+", type=int, metavar="K", help="joint coordinates of `value`")
    plot.add_argument("--episodes", type=int, metavar="M", help="rollouts (default: 40, or 2000 per horizon)")
    plot.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the rollouts (default: 0)")
    plot.add_argument(
        "--beside",
        nargs="+",
        metavar="POLICY",
        help=f"of `episode`: policies side by side, on the same noise: {POLICIES}",
    )
    add_trust(plot)
    plot.add_argument("--steps", type=int, metavar="N", help="world steps of learners that --beside trains")
    plot.set_defaults(train_seeds=[0])
    plot.add_argument("--fps", type=int, default=4, metavar="F", help="control steps per second of `episode` (4)")

    studio = commands.add_parser("studio", help="open a page on which a task is drawn, written and certified")
    studio.add_argument(
        "file", metavar="FILE", nargs="?", help="TOML problem file, which need not exist (default: a new one)"
    )
    studio.add_argument("--port", type=int, metavar="N", help="of this machine (default: 8642, or any that is free)")
    studio.add_argument("--open", action="store_true", help="also open the page in the browser of this machine")
