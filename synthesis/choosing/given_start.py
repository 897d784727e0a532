"""Policies to begin with: those of a certificate for the same agents, read at another horizon.

Policies of horizon T are read at another horizon in two ways: *by the time left* (the last steps are the same, the
first one is repeated before them, or left out) and *by the time gone* (the first steps are the same, the last one is
repeated). For a co-safe task the second is worth at least as much at a longer horizon as it was, so that bounds rise
with the horizon, up to what is pruned.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...envs.agents import LinearAgent
from ...envs.problem import Problem
from ..certificates import Certificate, checked_certificate
from ..models import Abstraction, InputMenu, Policies


def policies_from(certificate: Certificate, problem: Problem, abstraction: Abstraction) -> dict[str, Policies]:
    """The policies of a certificate at the horizon of ``problem``, by what is kept of their times.

    Raises
    ------
    ValueError
        If it was made for other agents, another automaton, other cells or another relation.
    """
    agents = checked_certificate(certificate).agents
    fits: bool = (
        len(agents) == problem.n_agents and certificate.problem.automaton.n_states == problem.automaton.n_states
    )
    members = zip(certificate.problem.agents, problem.agents, strict=False)
    for part, model, (given, asked) in zip(agents, abstraction.models, members, strict=False):
        same = [*zip(part.grid.edges, model.grid.edges, strict=False), *zip(part.lattice, model.lattice, strict=False)]
        fits = fits and _moves(given) == _moves(asked)
        fits = fits and part.policy.shape[-1] == model.n_cells and all(np.array_equal(a, b) for a, b in same)
        if isinstance(model.choices, InputMenu):
            fits = fits and part.menu is not None and np.array_equal(part.menu, model.choices.leads_to)
        else:
            fits = fits and part.menu is None
    if not fits:
        raise ValueError(
            "`start`: expected a certificate of the same agents, task, cells and relation, got one of "
            f"{certificate.problem.name!r} with other ones; leave it out"
        )
    times = np.arange(problem.horizon)
    kept = {}
    for name, shift in (("time left", certificate.problem.horizon - problem.horizon), ("time gone", 0)):
        policies = [part.policy[np.clip(times + shift, 0, len(part.policy) - 1)] for part in agents]
        kept[f"given start by {name}"] = tuple(_admissible(policy, m.choices.resting_choice) for policy, m in
                                               zip(policies, abstraction.models, strict=True))  # fmt: skip
    return kept if certificate.problem.horizon != problem.horizon else dict([kept.popitem()])


def _moves(agent: LinearAgent) -> dict[str, Any]:
    """All of an agent but its name and its start: what its choices are admissible for."""
    return {key: value for key, value in agent.to_dict().items() if key != "name" and not key.startswith("initial")}


def _admissible(policy: Any, resting: Any) -> Any:
    """The policy, with a choice wherever there is one."""
    return np.where((policy < 0) & (resting >= 0), resting, policy).astype(np.int32)
