"""Networks of problems that are written in another way: the same functions of what agents see there.

Written out in time, a network is told of the automaton state of the problem, and a clock is no input of its
(docs/theory/networks.md, "Problems written in another way").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...envs.tasks.problem import Problem, states_in_time
from ..relations.kinds import NetworkPolicy


def told_in_time(problem: Problem, base: Problem, policies: Sequence[NetworkPolicy]) -> list[NetworkPolicy]:
    """Return networks of a problem that names the time as those of the problem written out."""
    table = states_in_time(problem, base)
    told = np.full(base.automaton.n_states, -1)
    for q in range(problem.automaton.n_states):
        told[table[table[:, q] >= 0, q]] = q
    told[base.automaton.absorbing] = -1
    return [
        replace(policy, view=replace(policy.view, told=tuple(told.tolist())), has_clock=agent.has_clock)
        for policy, agent in zip(policies, base.agents, strict=True)
    ]
