"""What networks of a certificate are said to see and to do: what their problem shows them, each mode at its time."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....envs.systems.agents import AnyAgent
from ...certificates.proofs import OnGrid
from ...relations.kinds import ON_CELLS


def _has_known_form(agent: AnyAgent, network: dict[str, Any]) -> bool:
    """Whether states are seen as shares or in units, and outputs are actions, or inputs of a box that is not flat."""
    box = agent.chosen_box
    if network.get("outputs", "unit") == "box" and (network["squashed"] or np.any(box.low >= box.high)):
        return False
    return network.get("scale", "unit") in ("unit", "raw") and network.get("outputs", "unit") in ("unit", "box")


def wrong_networks(certificate: OnGrid) -> list[str]:
    """What networks of a certificate see or do otherwise than its problem and its policies say."""
    problem, failures = certificate.problem, []
    width = max(agent.n_states for agent in problem.agents)
    # Of an opposite task networks are told all states but the last, in which nothing is left to decide.
    n_q, horizon = problem.automaton.n_states - problem.automaton.reads_exits, problem.horizon
    expected: dict[str, Any] = {"agents": problem.n_agents, "width": width, "horizon": horizon}

    def alone(network: dict[str, Any]) -> dict[str, Any]:
        # A single agent need not be told which one it is.
        return {"agents": 0} if problem.n_agents == 1 and network["agents"] == 0 else {}

    for i, (agent, part) in enumerate(zip(problem.agents, certificate.proof.agents, strict=True)):
        network = part.relation.get("network")
        if network is None:
            continue
        asked = expected | {"agent": i} | alone(network)
        if part.relation["kind"] != "linear" or not agent.is_affine:
            failures.append(f"the network of agent `{agent.name}` is for another relation or other dynamics")
        elif network["activation"] not in ON_CELLS:
            failures.append(f"the network of agent `{agent.name}` has an activation that is not known on cells")
        elif not _has_known_form(agent, network):
            failures.append(f"the network of agent `{agent.name}` sees states, or answers, in a form that is not known")
        elif len(network["weights"][-1]) < agent.chosen_box.dimension:
            failures.append(f"the network of agent `{agent.name}` has fewer outputs than its agent has inputs")
        elif network["states"] != n_q or any(network[name] != value for name, value in asked.items()):
            failures.append(f"the network of agent `{agent.name}` sees another problem, or another agent")
        elif len(part.policy) != horizon:
            failures.append(f"the policy of agent `{agent.name}` does not say what its network does at each time")
        else:
            # In every cell a mode may be chosen only at its own time and in its own automaton state.
            mode = np.arange(horizon)[:, None, None] * n_q + np.arange(n_q)[None, :, None]
            modes = (part.policy >= 0) & (part.policy < horizon * network["states"])
            if np.any(modes[:, n_q:]) or np.any(modes[:, :n_q] & (part.policy[:, :n_q] != mode)):
                failures.append(f"the network of agent `{agent.name}` is used at another time or automaton state")
    return failures
