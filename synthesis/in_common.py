"""Teams in which one input moves several agents: such inputs chosen in common, or unknown, whichever certifies more.

Chosen in common, such an input depends on the automaton state and the time alone, and all agents that name it know it.
As an unknown it may be anything in its box, and its owner may choose it by its own state.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from ..envs.agents import Agent
from ..envs.problem import Problem
from .cells import RelationRefused
from .certificates import Synthesis
from .choosing import SOLVED
from .on_cells import Plan, with_record

WAYS = {"in common": True, "unknown": False}
"""What inputs of others may be to the agents that name them."""


def names_inputs(problem: Problem) -> bool:
    """Return whether the expressions of an agent name an input of another one."""
    return any(isinstance(agent, Agent) and any(agent.neighbour_inputs) for agent in problem.agents)


def either_way(plan: Plan, run: Callable[[Plan], Synthesis]) -> Synthesis:
    """Return the better of two syntheses: with inputs that are chosen in common, and with unknown ones.

    Raises
    ------
    RelationRefused
        If neither is possible.
    """
    began, best, refusals = time.perf_counter(), None, list[RelationRefused]()
    tried: dict[str, float | str] = {}
    for way, common in WAYS.items():
        name = f"inputs of others {way}"
        if best is not None and best.certificate.lower_bound >= SOLVED:
            tried[name] = "not computed, as hardly anything is left to gain"
            continue
        try:
            result = run(replace(plan, settings=replace(plan.settings, common=common)))
        except RelationRefused as refusal:
            refusals.append(refusal)
            tried[name] = " ".join(str(refusal).split())
            continue
        tried[name] = float(result.certificate.lower_bound)
        before = result.stats.get("tried", {})
        assert isinstance(before, dict)
        tried |= {f"{relation}, {name}": outcome for relation, outcome in before.items()}
        if best is None or result.certificate.lower_bound > best.certificate.lower_bound:
            best = result
    if best is None:
        raise refusals[-1]  # what unknown inputs are refused for says most
    return with_record(best, {"relations_tried": tried}, began)
