"""What the task makes of paths: the letters of their states, and the automaton states that have read them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Dynamics, letters, split_joint
from ...envs.tasks.problem import Problem


def task_tracks(problem: Problem, states: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return automaton states (T + 1, M) and letters (T + 1, P, M) of paths (T + 1, M, D); exact.

    The automaton state at a time has read the letter of that time. Outside the workspace no proposition holds and the
    automaton stands still, as the task has ended; so it does where states are NaN, after the decision.
    """
    dynamics = Dynamics.of(problem)
    low = np.concatenate([agent.state_low for agent in problem.agents])
    high = np.concatenate([agent.state_high for agent in problem.agents])
    horizon, count = states.shape[:2]
    q = np.full(count, problem.automaton.initial)
    read = np.zeros((horizon, count), dtype=np.int64)
    hold = np.zeros((horizon, len(problem.automaton.propositions), count), dtype=bool)
    for time, here in enumerate(states):
        inside = np.flatnonzero(((here >= low) & (here <= high)).all(axis=1))
        if len(inside):
            letter = np.asarray(letters(dynamics, split_joint(dynamics, here[inside]), time))
            q[inside] = problem.automaton.next_state(q[inside], letter)
            hold[time][:, inside] = letter
        read[time] = q
    return read, hold
