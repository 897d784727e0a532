"""Certificates of networks as they are deployed.

From every point of a cell the network leads to a mean near a known affine map of the state
(``relations.network_bounds``, ``relations.network_maps``), and the value tree takes the least value over what remains
unknown. What is certified is the deployed network itself (docs/theory/networks.md).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...envs.suite import as_problem
from ...envs.tasks.problem import Problem
from ..abstraction.models import Abstraction, Policies, join, network_abstraction, network_tables, start_of
from ..certificates.proofs import Certificate, OnGrid, Synthesis
from ..interop import SymbolicPolicies, certifiable
from ..policy_search.ascent import FINAL, sweep
from ..policy_search.cell_certificates import certificate_of
from ..relations.grids import CellCounts, NoRunFound, RelationRefused
from ..relations.kinds import NetworkPolicy, network_policy
from ..trajectories.planning import networks_from


def certify_network(
    problem: Any,
    actor: Any,
    cells: CellCounts = None,
    *,
    targets_per_cell: int | None = None,
) -> Synthesis:
    """Compute a certified lower bound on the satisfaction probability of networks as they are deployed, on cells.

    Parameters
    ----------
    problem : Problem, id or path
        Without pairs of agents, and with linear dynamics.
    actor : SharedActor, TeamActor, or what ``as_policy`` takes
        Networks that see the agent's own state, the automaton state and the time.
    cells : int, sequence of int or mapping from agent name to one of these, optional
        Cells per axis; the bound rises with their number.
    targets_per_cell : int, optional
        Lattice points per cell and axis at which values are read.

    Returns
    -------
    Synthesis
        ``certificate`` is about the networks, and ``controller`` evaluates them.

    Raises
    ------
    ValueError
        If a network sees more than its agent's own state, or linear cells do not apply.
    """
    given = as_problem(problem)
    networks = _policies(given, actor)
    if given.names_time:
        raise RelationRefused(
            "`problem`: expected one that does not name the time `t` for networks on cells, got one that does; without "
            "`cells` a network is certified along its trajectory"
        )
    if given.labeling.pairs:
        raise RelationRefused(
            "`problem`: expected no pairs of agents for networks on cells, got some; without `cells` a network is "
            "certified along its trajectory"
        )
    began = time.perf_counter()
    abstraction = network_abstraction(given, networks, cells, targets_per_cell)
    middle, tables = time.perf_counter(), network_tables(given, abstraction)
    return _certified(given, abstraction, tables, (began, middle))


PLENTY, FEW_STATES = 1e-3, 2
"""Probability of failing from which no cells are tried beside a trajectory, and most states of an agent for which they
are, unless they are asked for."""


def certified_as_it_is(
    problem: Problem, actor: Any, cells: CellCounts, relation: str, settings: dict[str, Any]
) -> Synthesis:
    """Return the best certificate of networks as they are: along their run without noise, or on cells.

    Raises
    ------
    ValueError
        If nothing is certified; the message says why along the run, and what would help.
    """
    is_written, per_cell = isinstance(actor, SymbolicPolicies), points_of_networks(settings)
    if (cells is not None or relation == "linear") and not is_written:
        return certify_network(problem, actor, cells, targets_per_cell=per_cell)
    policies = actor.policies if is_written else _policies(problem, actor, along=True)
    began, tried, found = time.perf_counter(), dict[str, Any](), None
    kind: type[RelationRefused] = RelationRefused
    try:
        certificate = networks_from(problem, policies)
        seconds = {"abstract": 0.0, "synthesize": time.perf_counter() - began}
        found = Synthesis(certificate, certificate.controller, {"seconds": seconds})
        tried["path"] = certificate.lower_bound
    except ValueError as refused:
        tried["path"], kind = str(refused), NoRunFound if isinstance(refused, NoRunFound) else RelationRefused
        if relation == "path" or is_written:
            raise
    own = relation != "path" and not is_written and not any(policy.sees_all for policy in policies)
    is_small = own and all(agent.n_states <= FEW_STATES for agent in problem.agents)
    if is_small and (found is None or 1.0 - found.certificate.lower_bound > PLENTY):
        try:
            on_cells = certify_network(problem, actor, cells, targets_per_cell=per_cell)
            tried["cells"] = on_cells.certificate.lower_bound
            if found is None or tried["cells"] > found.certificate.lower_bound:
                found = on_cells
        except ValueError as refused:
            tried["cells"] = str(refused)
    if found is None:
        raise kind(f"`policy`: nothing is certified of it as it is: {tried['path']}")
    return replace(found, stats={**found.stats, "tried": tried})


def points_of_networks(settings: Mapping[str, Any]) -> int | None:
    """Return the points per cell of settings of relations; raise ValueError at any other, which no network has."""
    for name in settings:
        if name != "targets_per_cell":
            raise ValueError(
                f"`{name}`: expected none for networks as they are, which have `targets_per_cell` only, got "
                f"{settings[name]!r}; leave it out, or put the network on cells with `wrap=True`"
            )
    return settings.get("targets_per_cell")


def _policies(problem: Problem, actor: Any, along: bool = False) -> list[Any]:
    """Return the networks of all agents, or raise ValueError if they see more than is certified."""
    actor = certifiable(problem, actor, along)
    if not hasattr(actor, "agent_policy"):
        raise ValueError(
            f"`policy`: expected networks that see their agent's own state, the automaton state and the time, got "
            f"{type(actor).__name__}; train `ppo`, `ippo` or `mappo`, or wrap it on cells (`wrap=True`)"
        )
    if actor.problem.fingerprint != problem.fingerprint:
        actor = replace(actor, problem=problem)
    policies = [actor.agent_policy(i) for i in range(problem.n_agents)]
    if not along and any(policy.sees_all for policy in policies):
        raise ValueError(
            "`policy`: expected networks that see their agent's own state, the automaton state and the time, got "
            "one that sees the states of all agents, which is certified along its run alone; leave `cells` out, or "
            "train `ppo`, `ippo` or `mappo`"
        )
    for policy in policies:
        if any(layer.dtype != np.float32 for layer in (*policy.network.weights, *policy.network.biases)):
            raise ValueError("`policy`: expected networks with weights of single precision (float32), got others")
        if not policy.sees_all and policy.network.weights[0].shape[1] != policy.view.size:
            raise ValueError("`policy`: expected networks for the agents of this problem, got others")
    return policies


def _certified(problem: Problem, abstraction: Abstraction, tables: Policies, began: tuple[float, float]) -> Synthesis:
    """Return certificate and statistics of policy tables."""
    joint = join(problem, abstraction)
    # Unions from below lose hardly anything with linear cells.
    best = sweep(joint, tables, start_of(problem, joint), FINAL, improve=False)
    settings = {**abstraction.settings, "final_limits": vars(FINAL)}
    certificate = certificate_of(problem, abstraction, joint, best, settings, "networks as they are")
    seconds = {"abstract": began[1] - began[0], "synthesize": time.perf_counter() - began[1]}
    stats = {"seconds": seconds, "rank": certificate.proof.rank, "dropped": best.dropped}
    return Synthesis(certificate, certificate.controller, stats)


def network_abstraction_of(certificate: OnGrid) -> Abstraction:
    """Return the finite models that a certificate of networks was made with."""
    problem, parts = certificate.problem, certificate.proof.agents
    policies = [
        network_policy(part.relation["network"], agent) for agent, part in zip(problem.agents, parts, strict=True)
    ]
    cells = dict(zip(problem.agent_names, (part.grid.shape for part in parts), strict=True))
    return network_abstraction(problem, policies, cells, certificate.settings.get("targets_per_cell"))


def differences(certificate: Certificate, actor: Any) -> list[str]:
    """Return in which ways the networks of a certificate are not those of an actor; empty if it is about this actor.

    ``check`` verifies a certificate for the networks stored in it; this compares them with those that are deployed.
    """
    problem, found = certificate.problem, list[str]()
    policies: Sequence[NetworkPolicy] = _policies(problem, actor)
    for name, part, policy in zip(problem.agent_names, certificate.proof.agents, policies, strict=True):
        stored, given = part.relation.get("network"), policy.description
        if stored is None:
            found.append(f"agent `{name}` is not moved by a network")
            continue
        keys = dict.fromkeys((*given, *stored))
        found += [f"agent `{name}`: its network has other {key}" for key in keys if stored.get(key) != given.get(key)]
        if np.any(part.policy != policy.modes_in(problem.automaton.n_states)[..., None]):
            found.append(f"agent `{name}`: its network was replaced in some cells")
    return found
