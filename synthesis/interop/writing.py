"""Policies as files that other programs run: networks as ONNX, certified tables as a C header."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...envs.systems.arguments import write_bytes, write_text
from ..certificates.controllers import Controller
from ..relations.kinds import Network, NetworkPolicy
from .c_header import header_of
from .onnx_files import written

FORMAT = "certigym policy 1"
"""Name and version of what is said in the metadata of a file of ONNX."""


def is_written_policy(path: str | Path) -> bool:
    """Whether a path is that of a policy for other programs, by its ending."""
    return Path(path).suffix in (".onnx", ".h")


def save_policy(policy: Any, path: str | Path, agent: str | None = None) -> Path:
    """Write a policy as a file that runs elsewhere; return its path.

    Parameters
    ----------
    policy : object
        A synthesis, a certificate or its controller; a training, an actor, or what ``as_policy`` returns.
    path : str or Path
        ``.onnx``: networks, as a graph from rows (N, n) to actions (N, m), float32 (the extra ``onnx``). Its metadata
        say what a row is, and ``as_policy`` reads it back. ``.h``: tables of certified controllers of the relations
        ``exact`` and ``linear`` as C, with the same inputs to the last bit.
    agent : str, optional
        Whose policy; needed for ONNX if agents have networks of their own, and by default all agents for C.

    Raises
    ------
    ValueError
        If the policy is no network (``.onnx``) or no such table (``.h``), or if onnx is not installed.
    """
    path = Path(path)
    if not is_written_policy(path):
        raise ValueError(f"`path`: expected a file name that ends in .onnx or .h, got {str(path)!r}")
    for attribute in ("controller", "actor"):
        policy = getattr(policy, attribute, policy)
    names = policy.problem.agent_names if hasattr(policy, "problem") else ()
    if agent is not None and agent not in names:
        raise ValueError(f"`agent`: expected an agent of the problem ({', '.join(names)}), got {agent!r}")
    if path.suffix == ".h":
        if not isinstance(policy, Controller):
            raise ValueError(f"`policy`: expected the controllers of a certificate, got {type(policy).__name__}")
        write_text(path, header_of(policy, path.stem, () if agent is None else (agent,)))
        return path
    network, row = _network_and_row(policy, agent)
    problem = policy.problem
    facts = {"format": FORMAT, "env": row, "problem": problem.name, "fingerprint": problem.fingerprint, "agent": agent}
    write_bytes(path, written(network, facts))
    return path


def _network_and_row(policy: Any, agent: str | None) -> tuple[Network, str]:
    """Return the network to write, and how the environment is made whose rows it sees."""
    if getattr(policy, "view", None) == "central":
        return policy.network, "central_vec_env"
    policies = _network_policies(policy)
    names = policy.problem.agent_names
    chosen = policies[0 if agent is None else names.index(agent)]
    same = all(np.array_equal(a, b) for each in policies
               for a, b in zip(_numbers(each), _numbers(chosen), strict=False))  # fmt: skip
    if agent is None and not same:
        raise ValueError("`agent`: expected the name of an agent, since each has a network of its own, got none")
    actions = "unit" if chosen.network.outputs == "unit" else "input"
    return chosen.network, f"rows(scale={chosen.view.scale}, actions={actions})"


def _network_policies(policy: Any) -> list[NetworkPolicy]:
    """Return the networks of all agents."""
    if isinstance(policy, Controller):
        found = [getattr(getattr(agent.relation, "means", None), "policy", None) for agent in policy.agents]
        if all(isinstance(each, NetworkPolicy) for each in found):
            return [each for each in found if each is not None]
    elif hasattr(policy, "agent_policy"):
        return [policy.agent_policy(i) for i in range(policy.problem.n_agents)]
    raise ValueError(
        f"`policy`: expected networks of agents that see their own state, got {type(policy).__name__}; certified "
        "tables are written as a C header (.h)"
    )


def _numbers(policy: NetworkPolicy) -> list[Any]:
    return [*policy.network.weights, *policy.network.biases]
