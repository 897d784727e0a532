"""The episodes that the player of a page shows, as values that its script reads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...envs.dynamics import Dynamics, letters, split_joint
from ...envs.pictures import Panel
from ...envs.problem import Problem
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
        curves.append(
            [
                {
                    "role": f"agent{curve.number % 6}",
                    "paths": [[[round(x, 1), round(y, 1)] for x, y in path] for path in paths],
                }
                for curve, paths in zip(panel.curves, drawn)
            ]
        )
    followed = None if problem.groups else task_states(problem, states)
    return {
        "episodes": [f"episode {m}{'' if content.success[m] else ' (failed)'}" for m in picked.tolist()],
        "lengths": lengths.tolist(),
        "success": content.success[picked].tolist(),
        "panels": curves,
        "states": None if followed is None else [followed[:n, m].tolist() for m, n in enumerate(lengths)],
        "names": [] if followed is None else list(problem.automaton.state_names),
    }


def task_states(problem: Problem, states: NDArray[Any]) -> NDArray[np.int64]:
    """Return the automaton state (T + 1, M) after each state of paths (T + 1, M, D); 0 after the decision.

    An agent outside its workspace ends the task; the automaton state is then the one before.
    """
    dynamics = Dynamics.of(problem)
    q = np.full(states.shape[1], problem.automaton.initial)
    result = np.zeros(states.shape[:2], dtype=np.int64)
    low = np.concatenate([agent.state_low for agent in problem.agents])
    high = np.concatenate([agent.state_high for agent in problem.agents])
    for time, here in enumerate(states):
        inside = np.flatnonzero(((here >= low) & (here <= high)).all(axis=1))
        if len(inside):
            q[inside] = problem.automaton.next_state(q[inside], letters(dynamics, split_joint(dynamics, here[inside])))
        result[time] = q
    return result
