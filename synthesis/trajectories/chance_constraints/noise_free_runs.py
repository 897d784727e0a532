"""Runs without noise: whether one satisfies the task, and which demand one that does not misses most.

Nothing is proved here. What is said tells a task that cannot be done from models that are too coarse for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ....envs.tasks.problem import Problem
from ....envs.tasks.regions import inside
from ...relations.grids import FloatArray
from .path_limits import corners_along

Miss = tuple[float, str]
"""By how much of a range a demand is missed, and which one, in words."""


def satisfies(problem: Problem, states: Sequence[FloatArray]) -> bool:
    """Return whether a run satisfies the task; its states (S + 1, d) agent by agent, from the start on.

    Of a finite-trace task the run has to reach the horizon; of a co-safe one it ends where it may.
    """
    steps, automaton = len(states[0]) - 1, problem.automaton
    q = problem.initial_q
    if q is None or not (automaton.is_co_safe or steps == problem.horizon):
        return False
    for t in range(1, steps + 1):
        if automaton.is_co_safe and automaton.accepting[q]:
            return True
        now = [of_agent[t] for of_agent in states]
        if not all(inside(x, a.state_low, a.state_high) for a, x in zip(problem.agents, now, strict=True)):
            return False
        q = int(automaton.next_state(q, problem.labeling.at(t).letter(now)))
    return bool(automaton.accepting[q])


def most_missed(problem: Problem, letters: NDArray[np.int8], states: Sequence[FloatArray]) -> str:
    """Return which demand of a word (S + 1, P) a run misses most, as a share of a range, in words; "" for none."""
    misses = [miss for i, agent in enumerate(problem.agents) for miss in _outside(agent, states[i])]
    for q, name in enumerate(problem.automaton.propositions):
        misses += _unread(problem, name, letters[:, q], states)
    return max(misses, default=(0.0, ""))[1]


def _outside(agent: AnyAgent, states: FloatArray) -> Iterator[Miss]:
    """Yield by how much the states (S + 1, d) of an agent leave its workspace most."""
    beyond = np.maximum(agent.state_low - states, states - agent.state_high)
    beyond[0] = -np.inf
    share = beyond / (agent.state_high - agent.state_low)
    t, k = np.unravel_index(int(np.argmax(share)), share.shape)
    if share[t, k] > 0.0:
        yield float(share[t, k]), f"agent `{agent.name}` leaves its workspace at step {t} by {beyond[t, k]:.3g}"


def _unread(problem: Problem, name: str, wanted: NDArray[np.int8], states: Sequence[FloatArray]) -> Iterator[Miss]:
    """Yield by how much a proposition is not read as it is wanted (S + 1,), where that is most."""
    values, low, high, owner = _outputs_and_corners(problem, name, states)
    width = np.maximum(np.where(high > low, high - low, 1.0), 1e-12)
    short, deep = np.maximum(low - values, values - high), np.minimum(values - low, high - values)
    apart, within = short.max(axis=1), deep.min(axis=1)
    share = np.where(wanted > 0, (short / width).max(axis=1), np.where(wanted < 0, (deep / width).min(axis=1), -1.0))
    share[0] = -1.0
    t = int(np.argmax(share))
    if share[t] > 0.0 and wanted[t] > 0:
        yield float(share[t]), f"{owner} is {apart[t]:.3g} short of `{name}` at step {t}"
    elif share[t] > 0.0:
        yield float(share[t]), f"{owner} is {within[t]:.3g} deep in `{name}` at step {t}"


def _outputs_and_corners(
    problem: Problem, name: str, states: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray, str]:
    """Return what a region is about along a run, its corners, each (S + 1, p), and whose it is, in words."""
    labeling = problem.labeling
    q = labeling.names.index(name)
    owners = sorted(labeling.owners[q])
    outputs = [problem.agents[i].outputs(states[i].T).T for i in owners]
    whose = " and ".join(f"`{problem.agent_names[i]}`" for i in owners)
    if q < labeling.first_pair:
        low, high = corners_along(problem, name, len(states[0]))
        return outputs[0], low, high, f"agent {whose}"
    pair = labeling.pairs[q - labeling.first_pair]
    by_agent = dict(zip(owners, outputs, strict=True))
    values = np.asarray(pair.difference(by_agent[pair.first].T, by_agent[pair.second].T)).T
    boxes = [pair.at(t).inner_box for t in range(len(values))]
    low, high = (np.array([box[side] for box in boxes]) for side in (0, 1))
    return values, low, high, f"the difference of {whose}"
