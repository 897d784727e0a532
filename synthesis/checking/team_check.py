"""Checks of certificates of joint agents: the one agent is the team, and its propositions are those of the problem.

The joint agent is made anew, entry by entry, and compared; whatever is claimed of it is checked like any other
certificate (docs/theory/pairs.md, "What the check does").
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...envs.agents import LinearAgent, Proposition, with_matrices
from ..cells import FloatArray

if TYPE_CHECKING:
    from ...envs.problem import Problem


def wrong_team(problem: Problem, base: Problem) -> list[str]:
    """Return in what a problem of one agent differs from a problem of several, taken together."""
    if base.n_agents != 1 or base.horizon != problem.horizon or base.labeling.pairs:
        return ["its base is not the problem of one agent with the same horizon"]
    if base.automaton.to_dict() != problem.automaton.to_dict():
        return ["the automaton of its base is not that of the problem"]
    team = base.agents[0]
    if not team.is_linear_gaussian:
        return ["its one agent is not linear with Gaussian noise"]
    for agent in problem.agents:
        if not agent.is_linear_gaussian:
            return [f"agent `{agent.name}` is not linear with Gaussian noise"]
    if any(pair.is_round for pair in problem.labeling.pairs):
        return ["a distance of several outputs is no box of its one agent"]
    team = with_matrices(team)
    failures = _wrong_matrices(problem, team)
    return failures or _wrong_regions(problem, base, team) or _wrong_first_letter(problem, base)


def _wrong_matrices(problem: Problem, team: LinearAgent) -> list[str]:
    """Everything between two agents is zero, and everything within an agent is its own."""
    members = [with_matrices(agent) for agent in problem.agents]
    failures = []
    if team.n_states != problem.n_states or team.n_inputs != problem.n_inputs:
        return ["its one agent has other states or inputs than the team"]
    for name in ("A", "B", "noise_covariance"):
        matrix = np.array(getattr(team, name))
        for i, agent in enumerate(members):
            own = (problem.columns[i], problem.input_columns[i] if name == "B" else problem.columns[i])
            if not np.array_equal(matrix[own], getattr(agent, name)):
                failures.append(f"`{name}` of its one agent is not that of agent `{agent.name}`")
            matrix[own] = 0.0
        if np.any(matrix != 0.0):
            failures.append(f"`{name}` of its one agent ties agents to one another")
    for name in ("state_low", "state_high", "input_low", "input_high", "offset"):
        if not np.array_equal(getattr(team, name), np.concatenate([getattr(agent, name) for agent in members])):
            failures.append(f"`{name}` of its one agent is not that of the team")
    for name in ("low", "high"):
        own_start = np.concatenate([getattr(agent.initial, name) for agent in members])
        if not np.array_equal(getattr(team.initial, name), own_start):
            failures.append("the start of its one agent is not that of the team")
    return failures


def _wrong_regions(problem: Problem, base: Problem, team: LinearAgent) -> list[str]:
    """Every proposition asks for the same of the same outputs, and for nothing of the others."""
    labeling = problem.labeling
    if base.labeling.names != labeling.names:
        return ["the propositions of its base are not those of the problem"]
    low, high = (bound[0] for bound in team.output_range(team.state_low[None], team.state_high[None]))
    failures = []
    for p, name in enumerate(labeling.names):
        region = base.propositions[name]
        assert isinstance(region, Proposition)
        rows, corners = _asked(problem, p)
        # Every output asked about is restricted to its interval; two pairs may compare the same outputs.
        free = np.ones(team.n_outputs, dtype=bool)
        for row, bottom, top in zip(rows, *corners, strict=True):
            same_row = np.all(team.output_matrix == row, axis=1)
            upper = (region.high == top) | (np.isinf(top) & (region.high > high))
            places = np.flatnonzero(same_row & (region.low == bottom) & upper & free)
            if not len(places):
                failures.append(f"{name!r} is another box than in the problem")
                break
            free[places[0]] = False
        else:
            if np.any(region.low[free] >= low[free]) or np.any(region.high[free] <= high[free]):
                failures.append(f"{name!r} asks for something of outputs that it is not about")
    return failures


def _wrong_first_letter(problem: Problem, base: Problem) -> list[str]:
    """From a point the first letter leads to one state, whoever computes the outputs: rounding may part them."""
    if not base.agents[0].initial.is_point or base.initial_q == problem.initial_q:
        return []
    return [
        "the first letter of its one agent leads elsewhere than that of the team: the start is on a face of a region"
    ]


def _asked(problem: Problem, p: int) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Return the rows (k, D) of the outputs that a proposition is about, and the corners of its box."""
    labeling, rows = problem.labeling, []
    if p >= labeling.first_pair:
        pair = labeling.pairs[p - labeling.first_pair]
        for a, b in zip(*pair.outputs, strict=True):
            row = np.zeros(problem.n_states)
            row[problem.columns[pair.first]] = _matrix(problem, pair.first)[a]
            row[problem.columns[pair.second]] = -_matrix(problem, pair.second)[b]
            rows.append(row)
        return np.array(rows), (pair.low, pair.high)
    i = next(i for i, own in enumerate(labeling.agent_propositions) if p in own)
    k = labeling.agent_propositions[i].tolist().index(p)
    for own_row in _matrix(problem, i):
        row = np.zeros(problem.n_states)
        row[problem.columns[i]] = own_row
        rows.append(row)
    return np.array(rows), (labeling.low[i][:, k], labeling.high[i][:, k])


def _matrix(problem: Problem, i: int) -> FloatArray:
    return with_matrices(problem.agents[i]).output_matrix  # others were refused
