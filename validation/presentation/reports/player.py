"""The episodes that the player of a page shows, as values that its script reads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ....envs.interfaces import AGENTS, Panel
from ...statistical_tests import task_tracks
from .inline_pictures import panel_axes, tracks

if TYPE_CHECKING:
    from .content import ReportContent

MOST_EPISODES, MOST_FAILURES = 12, 6
"""Episodes of the player, and how many of them may be failures: these come first, as they tell the most."""


def episodes_of(content: ReportContent, shown: Sequence[Panel]) -> dict[str, Any]:
    """Return names, lengths, success, paths and automaton states of the episodes that can be played.

    Returns
    -------
    dict
        ``episodes``: a name for each; ``lengths``: numbers of states; ``success``; ``panels``: for each panel and curve
        the role and the picture points; ``states``: the automaton state at every step, or None for independent tasks;
        ``names`` of automaton states.
    """
    problem = content.certificate.problem
    lost, good = np.flatnonzero(~content.success)[:MOST_FAILURES], np.flatnonzero(content.success)
    picked = np.concatenate([lost, good[: MOST_EPISODES - len(lost)]])
    states = content.states[:, picked]
    lengths = (~np.isnan(states).any(axis=2)).sum(axis=0)
    curves = []
    for panel in shown:
        drawn = tracks(panel, panel_axes(panel, problem.horizon), states)
        # Where agents have a heading, it is told in degrees, clockwise as pictures turn.
        turns = [
            [np.round(-np.degrees(states[:n, m, c.heading])).astype(int).tolist() for m, n in enumerate(lengths)]
            if c.heading is not None
            else None
            for c in panel.curves
        ]
        curves.append(
            [
                {
                    "role": f"agent{curve.number % len(AGENTS)}",
                    "paths": [[[round(x, 1), round(y, 1)] for x, y in path] for path in paths],
                    "turns": turned,
                }
                for curve, paths, turned in zip(panel.curves, drawn, turns)
            ]
        )
    followed = None if problem.groups else task_tracks(problem, states)[0]
    return {
        "episodes": [f"episode {m}{'' if content.success[m] else ' (failed)'}" for m in picked.tolist()],
        "lengths": lengths.tolist(),
        "success": content.success[picked].tolist(),
        "panels": curves,
        "states": None if followed is None else [followed[:n, m].tolist() for m, n in enumerate(lengths)],
        "names": [] if followed is None else list(problem.automaton.state_names),
    }
