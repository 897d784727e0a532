"""The sub-command ``plot``: one figure of a problem or certificate, as PNG, SVG or PDF."""

from __future__ import annotations

from argparse import Namespace
from typing import Any


def plot(options: Namespace) -> int:
    """Draw one figure."""
    from ..validation.figures import check_format, save_figure
    from .given import show

    check_format(options.out, "--out")
    save_figure(_figure(options), options.out)
    show(options, f"{options.kind} of {options.problem}, written to {options.out}",
         {"kind": options.kind, "problem": options.problem, "seed": options.seed, "figure": options.out})  # fmt: skip
    return 0


def _figure(options: Namespace) -> Any:
    from ..validation.figures import certificate_figures as figures
    from ..validation.figures import figure_scenes as scenes
    from ..validation.verdicts import sweep_horizons
    from .given import cells_of, problem_of, relation_of

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
    from ..synthesis.certificates import load_certificate
    from ..synthesis.synthesize import synthesize
    from .given import cells_of, problem_of, relation_of

    if not _is_file(options):
        return synthesize(problem_of(options), cells_of(options), **relation_of(options)).certificate
    if options.horizon is not None or options.initial_state is not None or options.cells is not None:
        raise ValueError("`--horizon`, `--initial-state`, `--cells`: a certificate has its own; leave them out")
    return load_certificate(options.problem)
