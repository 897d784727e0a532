"""The command ``plot``: a figure of a problem or certificate, or an episode as a moving picture."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from typing import Any

from ..envs.systems.arguments import counted
from ..synthesis.certificates.proofs import load_certificate
from ..synthesis.verbs.synthesize import synthesize
from ..validation.presentation import figures
from ..validation.presentation.figures import Player, check_film, check_format, render_episode
from ..validation.statistical_tests import TrialPlan, each_report
from .given import cells_of, problem_of, relation_of, show
from .policy_words import policy_of_word


def plot(options: Namespace) -> int:
    """Draw one figure or one episode."""
    if options.kind == "episode":
        return _episode(options)
    # A wrong file name is refused before anything is computed.
    check_format(options.out, "--out")
    figures.save_figure(FIGURES[options.kind](options), options.out)
    text = f"{options.kind} of {options.problem}, written to {options.out}"
    drawn = {"kind": options.kind, "problem": options.problem, "seed": options.seed, "figure": options.out}
    show(options, text, drawn)
    return 0


def _episode(options: Namespace) -> int:
    """Draw one episode, with other policies beside the certified controllers if they are named."""
    check_film(options.out, options.seed, options.fps)  # before anything is computed
    certificate = _certificate(options)
    problem = certificate.problem
    players = [Player.of("certified", certificate)]
    players += [Player.of(name, policy_of_word(problem, name, options)) for name in options.beside or []]
    facts = render_episode(problem, players, options.out, options.seed, options.fps)
    told = [
        f"{one['policy']}: {counted(one['steps'], 'step')}, {'satisfied' if one['satisfied'] else 'not satisfied'}"
        for one in facts["shown"]
    ]
    show(options, f"{problem.name}: {'; '.join(told)}; written to {options.out}", facts)
    return 0


def _horizon_figure(options: Namespace) -> Any:
    """Return bounds and rollouts over horizons."""
    problem = _problem(options)
    horizons = options.horizons or range(1, problem.horizon + 1)
    settings = {"cells": cells_of(options), **relation_of(options)}
    plan = TrialPlan(options.episodes or 2000, options.seed)
    return figures.horizon_figure([*each_report(problem, horizons, plan, settings)])


def _rollouts_figure(options: Namespace) -> Any:
    """Return rollouts, 40 of them if no number is given."""
    episodes = 40 if options.episodes is None else options.episodes
    return figures.rollouts_figure(_certificate(options), episodes, options.seed)


def _problem(options: Namespace) -> Any:
    """Return the problem that is named, or the problem of the certificate that is named."""
    return _certificate(options).problem if options.problem.endswith(".npz") else problem_of(options)


def _certificate(options: Namespace) -> Any:
    """Return the certificate that is named, or synthesize one of the problem that is named."""
    if not options.problem.endswith(".npz"):
        return synthesize(problem_of(options), cells_of(options), **relation_of(options)).certificate
    if options.horizon is not None or options.initial_state is not None or options.cells is not None:
        raise ValueError("`--horizon`, `--initial-state`, `--cells`: a certificate fixes all of them; leave them out")
    return load_certificate(options.problem)


FIGURES: dict[str, Callable[[Namespace], Any]] = {
    "automaton": lambda options: figures.automaton_figure(_problem(options)),
    "horizon": _horizon_figure,
    "rank": lambda options: figures.rank_figure(_certificate(options)),
    "rollouts": _rollouts_figure,
    "tree": lambda options: figures.tree_figure(_certificate(options)),
    "value": lambda options: figures.value_figure(_certificate(options), options.axes),
}
"""How each kind of figure is drawn."""
