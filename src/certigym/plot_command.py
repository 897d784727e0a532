"""The sub-command ``plot``: one figure of a problem or certificate, as PNG, SVG or PDF."""

from __future__ import annotations

import argparse
from argparse import Namespace
from typing import Any

from .learning_options import add_relation

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


def plot(options: argparse.Namespace) -> int:
    """Draw one figure."""
    from .arguments import show
    from .validation.figure_style import check_format, save_figure

    check_format(options.out, "--out")
    save_figure(_figure(options), options.out)
    show(options, f"{options.kind} of {options.problem}, written to {options.out}",
         {"kind": options.kind, "problem": options.problem, "seed": options.seed, "figure": options.out})  # fmt: skip
    return 0


def _figure(options: Namespace) -> Any:
    from .arguments import cells_of, problem_of, relation_of
    from .validation import figure_scenes as scenes
    from .validation import figures
    from .validation.sweeps import sweep_horizons

    if options.kind == "automaton":
        return scenes.automaton_figure(_loaded(options).problem if _is_file(options) else problem_of(options))
    if options.kind == "horizon":
        problem = _loaded(options).problem if _is_file(options) else problem_of(options)
        horizons = options.horizons or range(1, problem.horizon + 1)
        settings = {"cells": cells_of(options), **relation_of(options)}
        return figures.horizon_figure(
            sweep_horizons(problem, horizons, options.episodes or 2000, options.seed, **settings)
        )
    certificate = _loaded(options)
    if options.kind == "value":
        return figures.value_figure(certificate, options.axes)
    if options.kind == "rollouts":
        return scenes.rollouts_figure(certificate, 40 if options.episodes is None else options.episodes, options.seed)
    if options.kind == "relation":
        return figures.relation_figure(certificate, options.agent, seed=options.seed)
    return figures.rank_figure(certificate) if options.kind == "rank" else scenes.tree_figure(certificate)


def _is_file(options: Namespace) -> bool:
    return bool(options.problem.endswith(".npz"))


def _loaded(options: Namespace) -> Any:
    """The certificate that is named, or one of the problem that is named."""
    from .arguments import cells_of, problem_of, relation_of
    from .synthesis.certificate_file import load_certificate
    from .synthesis.synthesize import synthesize

    if not _is_file(options):
        return synthesize(problem_of(options), cells_of(options), **relation_of(options)).certificate
    if options.horizon is not None or options.initial_state is not None or options.cells is not None:
        raise ValueError("`--horizon`, `--initial-state`, `--cells`: a certificate has its own; leave them out")
    return load_certificate(options.problem)
