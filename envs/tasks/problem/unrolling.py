"""Problems with angles, unrolled: every angle is a number of several turns, and regions of it come once a turn.

Where angles are numbers, plans are made as for all other states. A run of the unrolled problem, less whole turns, is
one of the problem as it is written; only its workspace ends somewhere. Searches along paths plan in it, and say their
certificates of the problem itself, whose check reads angles as angles (docs/theory/angles.md, "Along paths").
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ...systems.agents import TURN, AnyAgent
from ..regions import Proposition
from .families import AnyProposition
from .record import Problem
from .specification import Specification

TURNS = 1
"""Turns to either side of the workspace of an angle in which paths are planned."""


@dataclass(frozen=True, eq=False)
class Unrolled:
    """A problem whose angles are numbers.

    Attributes
    ----------
    problem : Problem
    copies : mapping from str to tuple of str
        Of regions that are limited along an angle: names of their copies, one for each turn, from below.
    """

    problem: Problem
    copies: Mapping[str, tuple[str, ...]]


def unrolled(problem: Problem) -> Unrolled:
    """Return a problem with its angles unrolled."""
    agents = {agent.name: agent for agent in problem.agents}
    propositions: dict[str, AnyProposition] = {}
    copies: dict[str, tuple[str, ...]] = {}
    for name, region in problem.propositions.items():
        places = _limited(agents[region.agent], region) if isinstance(region, Proposition) else ()
        if not places:
            propositions[name] = region
            continue
        assert isinstance(region, Proposition)
        low, high = (region.low.tolist(), region.high.tolist()) if region.corners is None else region.corners
        names = []
        for turn in range(-TURNS, TURNS + 1):
            moved = [[x + TURN * turn if k in places else x for k, x in enumerate(ends)] for ends in (low, high)]
            names.append(_fresh(f"{name}_turn{turn + TURNS}", problem))
            propositions[names[-1]] = Proposition(region.agent, *moved)
        propositions[name] = Proposition(region.agent, union=names)
        copies[name] = tuple(names)
    members = [_unrolled(*both) for both in zip(problem.agents, problem.written_agents, strict=True)]
    found = Problem(
        name=problem.name, horizon=problem.horizon, agents=members, propositions=propositions,
        specification=Specification(automaton=problem.automaton), joint_noise=dict(problem.joint_noise) or None,
    )  # fmt: skip
    return Unrolled(found, copies)


def _unrolled(agent: AnyAgent, written: AnyAgent) -> AnyAgent:
    """Return an agent of a problem with its angles unrolled, and with its own noise alone."""
    agent = agent.replace(**written.noise_data())
    return agent.unrolled_by(TURNS) if agent.angles else agent


def _limited(agent: AnyAgent, region: Proposition) -> tuple[int, ...]:
    """Return the outputs that are angles along which a region is less than a turn."""
    corners = (region.low, region.high) if region.corners is None else region.corners
    found = []
    for k in agent.angle_outputs:
        axis = agent.output_axis(k)
        assert axis is not None
        if corners[0][k] > agent.state_low[axis[0]] or corners[1][k] < agent.state_high[axis[0]]:
            found.append(k)
    return tuple(found)


def _fresh(name: str, problem: Problem) -> str:
    while name in problem.propositions or name in problem.families:
        name += "_"
    return name
