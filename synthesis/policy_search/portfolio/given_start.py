"""Policies to begin with: those of a certificate for the same agents, read at another horizon.

Policies of horizon T are read at another horizon in two ways: *by the time left* (the last steps are the same; the
first one is repeated before them, or left out) and *by the time gone* (the first steps are the same; the last one is
repeated). For a co-safe task the second is worth at least as much at a longer horizon as it was, so that bounds rise
with the horizon, up to what is pruned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from ....envs.systems.agents import AnyAgent
from ....envs.tasks.problem import Problem
from ...abstraction.models import Abstraction, AgentModel, Policies, Settings
from ...certificates.cell_probabilities import AgentRecord
from ...certificates.proofs import OnGrid, checked_certificate

NUMBERS: dict[str, tuple[type, ...]] = {"epsilon": (int, float), "feedback": (int, float), "inputs": (int,)}
"""Settings whose types are not looked at where they are made."""


def policies_from(certificate: OnGrid, problem: Problem, abstraction: Abstraction) -> dict[str, Policies]:
    """Return the policies of a certificate at the horizon of ``problem``, by how their times are read.

    Raises
    ------
    ValueError
        If it was made for other agents, another automaton, other cells or another relation.
    """
    agents = checked_certificate(certificate).proof.agents
    fits: bool = (
        len(agents) == problem.n_agents and certificate.problem.automaton.n_states == problem.automaton.n_states
    )
    pairs = zip(certificate.problem.agents, problem.agents, strict=False)
    for part, model, (certified, asked) in zip(agents, abstraction.models, pairs, strict=False):
        fits = fits and _moves(certified) == _moves(asked) and _choices_fit(part, model)
    if not fits:
        raise ValueError(
            "`start`: expected a certificate of the same agents, task, cells and relation, got one of "
            f"{certificate.problem.name!r} with other ones; leave it out"
        )
    times = np.arange(problem.horizon)
    by_name = {}
    for name, shift in (("time left", certificate.problem.horizon - problem.horizon), ("time gone", 0)):
        policies = [part.policy[np.clip(times + shift, 0, len(part.policy) - 1)] for part in agents]
        resting = [model.choices.resting_choice for model in abstraction.models]
        by_name[f"given start by {name}"] = tuple(_admissible(*pair) for pair in zip(policies, resting, strict=True))
    # At the same horizon the two are one.
    return by_name if certificate.problem.horizon != problem.horizon else dict([by_name.popitem()])


def settings_of(certificate: OnGrid, kinds: Sequence[str]) -> dict[str, Any]:
    """Return the settings of relations that a certificate was made with, as far as these kinds have them.

    Agents get the same models again only with them. They come from a file: what they are not is refused.

    Raises
    ------
    ValueError
        If they are no settings.
    """
    names = [field.name for field in fields(Settings)]
    found = {name: certificate.settings[name] for name in names if certificate.settings.get(name) is not None}
    if "paper" not in kinds:
        found.pop("delta", None)
    try:
        for name, kinds_of_number in NUMBERS.items():
            if name in found and type(found[name]) not in kinds_of_number:
                raise ValueError(f"`{name}`: expected a number, got {found[name]!r}")
        Settings(**found)
    except ValueError as error:
        raise ValueError(f"`start`: expected a certificate with settings of its relations, got {error}") from None
    return found


def _moves(agent: AnyAgent) -> dict[str, Any]:
    """Return all of an agent but its name and its start: what its choices are admissible for."""
    return {key: value for key, value in agent.to_dict().items() if key != "name" and not key.startswith("initial")}


def _choices_fit(part: AgentRecord, model: AgentModel) -> bool:
    """Return whether the choices of a certificate's agent mean the same in a model: equal cells, lattice and menu."""
    axes = [*zip(part.grid.edges, model.grid.edges, strict=False), *zip(part.lattice, model.lattice, strict=False)]
    if part.policy.shape[-1] != model.grid.n_cells or not all(np.array_equal(a, b) for a, b in axes):
        return False
    return model.choices.same_as(part.relation, part.input_set)


def _admissible(policy: Any, resting: Any) -> Any:
    """Return the policy, with the resting choice where it has none and there is one."""
    return np.where((policy < 0) & (resting >= 0), resting, policy).astype(np.int32)
