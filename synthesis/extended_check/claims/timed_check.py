"""Checks of certificates of problems that name the time: what they are about is the problem, written out.

Nothing of how the problem was written out is trusted. Both automata are followed through all letters of each time;
places of regions are enclosed at their times by the check's own intervals; agents are compared entry by entry; and
policies set every clock to the time, at every step and in every cell in which they choose anything.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ....envs.systems.agents import TIME, AnyAgent
from ....envs.tasks.problem import Places, states_in_time, unrolled_in_time
from ....envs.tasks.regions import Proposition
from ...certificates.cell_probabilities import AgentRecord
from ...certificates.proofs import Certificate, TimedProof, on_cells
from ..steps import RegionSpan

if TYPE_CHECKING:
    from ....envs.tasks.problem import Problem

WIDE = 1e-9
"""Width, as a share of a number and one, from which an interval says nothing of where a corner is."""


def wrong_in_time(certificate: Certificate[TimedProof]) -> list[str]:
    """Return what is wrong with a certificate of a problem that names the time, apart from that of its base."""
    problem, base = certificate.problem, certificate.proof.base.problem
    if on_cells(certificate.proof.base) is not certificate.proof.base:
        return ["its base is not on grids"]
    if not problem.names_time or problem.labeling.pairs or base.names_time or base.labeling.pairs:
        return ["it is not about single agents and the time"]
    if base.horizon != problem.horizon or base.n_agents != problem.n_agents:
        return ["its base has another horizon or other agents"]
    try:
        if unrolled_in_time(problem).fingerprint != base.fingerprint:
            return ["its base is not the problem written out"]
        states_in_time(problem, base)  # raises where both automata differ
    except ValueError as error:
        return [f"its base is not the problem written out: {error}"]
    # Writing out is not taken for granted: where regions are, and what agents do, is looked at again.
    failures = _wrong_agents(problem, base) + _wrong_places(problem, base)
    if failures:
        return failures
    for agent, part in zip(base.agents, certificate.proof.base.proof.agents, strict=True):
        wrong = _wrong_clock(agent, part, problem.horizon) if agent.has_clock else ""
        if wrong:
            failures.append(f"agent `{agent.name}`: {wrong}")
    return failures


def _wrong_agents(problem: Problem, base: Problem) -> list[str]:
    """Agents are those of the problem; where they name the time it is their last input."""
    failures = []
    for agent, other in zip(problem.agents, base.agents, strict=True):
        wanted = agent.to_dict()
        if agent.names_time:
            wanted["inputs"] = [*wanted["inputs"], TIME]
            wanted["input_low"] = [*wanted["input_low"], 0.0]
            wanted["input_high"] = [*wanted["input_high"], float(problem.horizon - 1)]
        if other.to_dict() != wanted or other.has_clock != agent.names_time:
            failures.append(f"agent `{agent.name}` of its base is not that of the problem")
    return failures


def _wrong_places(problem: Problem, base: Problem) -> list[str]:
    """Regions of the base are where those of the problem are at each time, by intervals of the check's own."""
    places = Places(problem)
    for name in problem.labeling.moving:
        region = problem.propositions[name]
        assert isinstance(region, Proposition)
        for time in range(problem.horizon + 1):
            own, place = RegionSpan.of(region, time), places.name_of(name, time)
            if place is None:
                continue  # it is nowhere in the workspace: `states_in_time` takes it from the problem
            low, high = base.propositions[place].low, base.propositions[place].high
            if not (_within(low, own.low) and _within(high, own.high)):
                return [f"`{place}` is not where `{name}` is at time {time}"]
    return []


def _within(numbers: np.ndarray, ends: np.ndarray) -> bool:
    """Return whether numbers are between ends that are next to each other: within wide ones they may be anything."""
    is_known = ends[1] - ends[0] <= WIDE * (1.0 + np.abs(numbers))
    return bool(np.all((ends[0] <= numbers) & (numbers <= ends[1]) & is_known))


def _wrong_clock(agent: AnyAgent, part: AgentRecord, horizon: int) -> str:
    """Return what is wrong with how the policies of an agent set its clock; nothing if they set it to the time."""
    if part.relation["kind"] not in ("boxes", "linear"):
        return "its clock is set by choices of another kind than inputs that are the same in a whole cell, and networks"
    input_set = np.array(part.relation["menu"], dtype=float)
    if input_set.ndim != 2 or np.any(part.policy >= len(input_set)):
        return "its clock is set by choices that are not of its menu"
    if len(part.policy) != horizon:
        return "its policies do not look at the time, which its dynamics name"
    for time, choices in enumerate(part.policy):
        chosen = np.unique(choices[choices >= 0])
        if np.any(input_set[chosen, -1] != float(time)):
            return f"its clock is not the time at step {time}"
    return ""
