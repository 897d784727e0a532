"""A small team as one agent: matrices side by side, all outputs, and the differences that pairs compare.

A pair is then a proposition like any other: a box for some outputs of the one agent. Its cells are products of the
cells of all agents, so that teams with more than a few states have no grid.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from ...envs.agents import LinearAgent, PairRegion, Proposition, with_matrices
from ...envs.problem import Problem, Specification
from ..cells import FloatArray, RelationRefused, refuse_shared_noise

TEAM = "team"
"""Name of the joint agent."""


def joint_problem(problem: Problem) -> Problem:
    """Return the problem whose one agent is the team; its automaton is the same, its states in agent order.

    Raises
    ------
    RelationRefused
        If an agent is not linear, its noise is not Gaussian, a pair is a distance in the plane or in space, or rounding
        moves the start across a face of a region.
    """
    refuse_shared_noise(problem)
    if any(pair.is_round for pair in problem.labeling.pairs):
        raise RelationRefused("a joint agent has boxes of differences, got a distance of several outputs")
    if not all(agent.is_linear_gaussian for agent in problem.agents):
        raise RelationRefused("a joint agent is made of linear agents with Gaussian noise, got others")
    agents = [with_matrices(agent) for agent in problem.agents]
    rows = [block_diag(*(agent.output_matrix for agent in agents))]
    for pair in problem.labeling.pairs:
        rows.append(_difference(problem, pair))
    matrix = np.concatenate(rows)
    boxes = [(agent.initial.low, agent.initial.high) for agent in agents]
    team = LinearAgent(
        name=TEAM,
        A=block_diag(*(agent.A for agent in agents)),
        B=block_diag(*(agent.B for agent in agents)),
        noise_covariance=block_diag(*(agent.noise_covariance for agent in agents)),
        state_low=np.concatenate([agent.state_low for agent in agents]),
        state_high=np.concatenate([agent.state_high for agent in agents]),
        input_low=np.concatenate([agent.input_low for agent in agents]),
        input_high=np.concatenate([agent.input_high for agent in agents]),
        initial_low=np.concatenate([low for low, _ in boxes]),
        initial_high=np.concatenate([high for _, high in boxes]),
        output_matrix=matrix,
        offset=np.concatenate([agent.offset for agent in agents]),
    )
    joint = Problem(
        name=f"{problem.name[:180]} as one agent",
        horizon=problem.horizon,
        agents=[team],
        propositions=_regions(problem, team),
        specification=Specification(automaton=problem.automaton),
    )
    if team.initial.is_point and joint.initial_q != problem.initial_q:
        raise RelationRefused(
            "the start is on a face of a region, and the outputs of the joint agent are rounded to its other side; "
            "move the start or the region a little"
        )
    return joint


def _difference(problem: Problem, pair: PairRegion) -> FloatArray:
    """Return the rows (p, D) that take a joint state to the differences that a pair compares."""
    rows = np.zeros((len(pair.low), problem.n_states))
    for i, outputs, sign in ((pair.first, pair.outputs[0], 1.0), (pair.second, pair.outputs[1], -1.0)):
        agent = with_matrices(problem.agents[i])
        rows[:, problem.columns[i]] += sign * agent.output_matrix[list(outputs)]
    return rows


def _regions(problem: Problem, team: LinearAgent) -> dict[str, Proposition]:
    """Return the propositions on the outputs of the team; outputs that one is not about are left free."""
    low, high = (bound[0] for bound in team.output_range(team.state_low[None], team.state_high[None]))
    # Beyond everything that the output can be, so that nothing is asked of it.
    low, high = low - 1.0 - np.abs(low), high + 1.0 + np.abs(high)
    labeling, regions = problem.labeling, {}
    first = np.concatenate([[0], np.cumsum([agent.n_outputs for agent in problem.agents])])
    for i, own in enumerate(labeling.agent_propositions):
        for k, p in enumerate(own.tolist()):
            corners = low.copy(), high.copy()
            place = slice(first[i], first[i + 1])
            corners[0][place] = labeling.low[i][:, k]
            upper = labeling.high[i][:, k]  # infinite where a region is closed at the edge of the workspace
            corners[1][place] = np.where(np.isfinite(upper), upper, high[place])
            regions[labeling.names[p]] = Proposition(TEAM, *corners)
    at = int(first[-1])
    for name, pair in zip(labeling.names[labeling.first_pair :], labeling.pairs, strict=True):
        corners = low.copy(), high.copy()
        corners[0][at : at + len(pair.low)], corners[1][at : at + len(pair.low)] = pair.low, pair.high
        at += len(pair.low)
        regions[name] = Proposition(TEAM, *corners)
    return regions
