"""What infos or observations tell a certified controller: the true state, the automaton state and the time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ....envs.tasks.problem import Problem

READING = "reading"
"""Key of infos that only environments with noisy sensors have; a test compares it with theirs."""


def told(infos: Mapping[str, Any] | None, name: str) -> Any:
    """Return the info of an agent if it tells the state, else None.

    Raises
    ------
    ValueError
        If the environment has noisy sensors: the info holds the true state, but the agent does not know it.
    """
    info = infos.get(name) if infos is not None else None
    if info is None:
        return None
    if READING in info:
        raise ValueError(
            f"`infos`: expected those of an environment with exact sensors, got noisy readings for {name!r}; the "
            "certificate is about controllers that see the true states, and says nothing about noisy ones: leave out "
            "`sensor_noise`, or use a learned policy"
        )
    return info if "state" in info else None


def told_of_all(
    problem: Problem, observations: Mapping[str, Any], infos: Mapping[str, Any] | None, n_q: int
) -> dict[str, tuple[Any, int, int]]:
    """Return state (d,), automaton state and time of every agent observed, from infos where these tell them.

    Parameters
    ----------
    problem : Problem
    observations, infos : mapping by name
    n_q : int
        Automaton states: an observation holds the state, one number for each of these, and the share of time left.

    Raises
    ------
    ValueError
        If an agent is not of the problem, or an observation has another number of entries.
    """
    sizes = {agent.name: agent.n_states for agent in problem.agents}
    found = {}
    for name, observation in observations.items():
        if name not in sizes:
            raise ValueError(
                f"`observations`: expected agents of problem {problem.name!r}, got {name!r}; act in its own environment"
            )
        info = told(infos, name)
        if info is not None:
            found[name] = info["state"], int(info["automaton_state"]), int(info["time"])
            continue
        seen, d = np.asarray(observation, dtype=float), sizes[name]
        if seen.shape != (d + n_q + 1,):
            raise ValueError(
                f"`observations`: expected {d + n_q + 1} numbers for agent `{name}` (state, automaton state, time "
                f"left), got shape {seen.shape}"
            )
        time = round((1.0 - float(seen[-1])) * problem.horizon)
        found[name] = seen[:d], int(np.argmax(seen[d : d + n_q])), time
    return found
