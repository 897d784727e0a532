"""Certificates of networks as they are deployed, and repairs of networks where they are poor.

From every point of a cell the network leads to a mean within a known box, or near a known affine map of the state
(``relations.network_bounds``, ``relations.network_maps``), and the value tree takes the least value over what remains
unknown. What is certified is the deployed network itself (docs/theory/networks.md).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...envs.suite import as_problem
from ...envs.systems.arguments import counted, tree_text
from ...envs.tasks.problem import Problem, unrolled_in_time
from ..abstraction.models import Abstraction, JointModel, Policies, join, network_abstraction, network_tables, start_of
from ..certificates.proofs import Certificate, OnGrid, Synthesis, timed_certificate
from ..certificates.value_functions import to_host
from ..composition import CollisionProbability, less_proximity, proximity, relevant_pairs, usual_values, without_pairs
from ..interop import SymbolicPolicies, certifiable
from ..policy_search.ascent import FINAL, Limits, Stage, sweep
from ..policy_search.cell_certificates import certificate_of
from ..relations.grids import CellCounts, FloatArray, NoRunFound, RelationRefused
from ..relations.kinds import NetworkPolicy, network_policy
from ..trajectories.planning import networks_from
from .time_unrolled_networks import told_in_time

RELATIONS = ("linear", "boxes")
"""How the means under networks are enclosed, in the order in which they are tried."""

FEW_BOXES = 300_000
"""Cells, automaton states and times up to which boxes are compared with maps: some seconds."""

COVERED = 0.99
"""Share of all that a network loses that repairs make up for, by default: the rest is spread over many cells."""


LEAST_LOSS = 1e-8
"""Loss of a place from which on it is replaced: smaller ones are of the order of what boxes are rounded by."""

PASSES = 3
"""Passes of the ascent: a poor network does not come to where it should act better, a repaired one does."""


@dataclass(frozen=True, eq=False, repr=False)
class WeakPlaces:
    """Where networks lose most against the inputs that a certificate could choose (estimates).

    Parameters
    ----------
    problem : Problem
    losses : tuple of (T, Q, S) arrays
        For every agent: about what the value at the start would gain if the agent did better in this cell at this time
        in this automaton state; 0 where the network is as good as any input on offer.
    edges : tuple of tuples of arrays
        Edges of the cells of every agent, by axis, in grid coordinates.
    """

    problem: Problem
    losses: tuple[FloatArray, ...]
    edges: tuple[tuple[FloatArray, ...], ...]

    def __repr__(self) -> str:
        rows = [(name, f"{loss.sum():.2g} in {counted(int(np.count_nonzero(loss)), 'place')}") for name, loss in
                zip(self.problem.agent_names, self.losses, strict=True)]  # fmt: skip
        return tree_text(f"WeakPlaces of {self.problem.name!r}", rows)

    def worst(self, count: int = 10) -> list[dict[str, Any]]:
        """Return the places that lose most: agent, time, automaton state, corners of the cell, and loss."""
        places: list[dict[str, Any]] = []
        for i, loss in enumerate(self.losses):
            # Only the largest of each agent can be among the largest of all.
            for flat in np.argsort(loss, axis=None)[::-1][:count]:
                t, q, cell = (int(k) for k in np.unravel_index(flat, loss.shape))
                index = np.unravel_index(cell, [len(edges) - 1 for edges in self.edges[i]])
                low, high = ([float(e[k + side]) for e, k in zip(self.edges[i], index, strict=True)] for side in (0, 1))
                names = {"agent": self.problem.agent_names[i], "time": t, "q": self.problem.automaton.state_names[q]}
                places.append({**names, "low": low, "high": high, "loss": float(loss[t, q, cell])})
        worst = sorted(places, key=lambda place: -place["loss"])
        return [place for place in worst[:count] if place["loss"] > 0.0]

    def least_of(self, share: float) -> float:
        """Return the least loss among the fewest places that make up for this share of all losses."""
        losses = np.sort(np.concatenate([loss[loss > 0.0] for loss in self.losses]))[::-1]
        if not len(losses):
            return np.inf
        total = np.cumsum(losses)
        return float(losses[min(int(np.searchsorted(total, share * total[-1])), len(losses) - 1)])


def certify_network(
    problem: Any,
    actor: Any,
    cells: CellCounts = None,
    *,
    relation: str = "auto",
    targets_per_cell: int | None = None,
) -> Synthesis:
    """Compute a certified lower bound on the satisfaction probability of networks as they are deployed.

    Parameters
    ----------
    problem : Problem, id or path
        It may name the time, or be about pairs of agents, whose noise then is normal along states.
    actor : SharedActor, TeamActor, or what ``as_policy`` takes
        Networks that see the agent's own state, the automaton state and the time.
    cells : int, sequence of int or mapping from agent name to one of these, optional
        Cells per axis; the bound rises with their number.
    relation : "auto", "linear" or "boxes"
        Affine maps around the network in every cell, or boxes around means. By default maps; boxes where maps do not
        apply, or where they are so few that they cost seconds, and certify more: in cells wide against the noise.
    targets_per_cell : int, optional
        Lattice points per cell and axis at which values are read.

    Returns
    -------
    Synthesis
        ``certificate`` is about the networks, and ``controller`` evaluates them.

    Raises
    ------
    ValueError
        If a network sees more than its agent's own state, or a relation that was asked for does not apply.
    """
    given = as_problem(problem)
    if relation not in (*RELATIONS, "auto"):
        raise ValueError(f"`relation`: expected `linear` or `boxes` for networks as they are, got {relation!r}")
    networks = _policies(given, actor)
    if given.labeling.pairs and given.names_time:
        raise ValueError(
            "`problem`: expected a task that is about pairs of agents or names the time `t`, got one that does both, "
            "of which only paths know; judge the network by rollouts, and `synthesize` with the relation `path`"
        )
    if given.labeling.pairs:
        return _less_nearness(given, networks, cells, relation, targets_per_cell)
    base, policies = _written(given, networks)
    return _of_given(given, _on_grids(base, policies, cells, relation, targets_per_cell)[0])


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
    if (cells is not None or relation in RELATIONS) and not is_written:
        return certify_network(problem, actor, cells, relation=relation, targets_per_cell=per_cell)
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


def _on_grids(
    problem: Problem,
    policies: Sequence[NetworkPolicy],
    cells: CellCounts,
    relation: str,
    targets_per_cell: int | None,
) -> tuple[Synthesis, Abstraction]:
    """Certify networks of a problem without pairs that does not name the time, and return the finite models as well."""
    found = list[tuple[Synthesis, Abstraction]]()
    for kind in RELATIONS if relation == "auto" else (relation,):
        if found and _boxes_of(found[0][0].certificate) > FEW_BOXES:
            break
        began = time.perf_counter()
        try:
            abstraction = network_abstraction(problem, policies, cells, targets_per_cell, kind)
        except RelationRefused:
            if kind == relation or (kind == RELATIONS[-1] and not found):
                raise
            continue
        middle, tables = time.perf_counter(), network_tables(problem, abstraction)
        certified = _certified(problem, abstraction, tables, "networks as they are", {}, (began, middle))
        found.append((certified, abstraction))
    return max(found, key=lambda one: one[0].certificate.lower_bound)


def _less_nearness(
    problem: Problem,
    policies: Sequence[NetworkPolicy],
    cells: CellCounts,
    relation: str,
    targets_per_cell: int | None,
) -> Synthesis:
    """Certify the task without pairs, and subtract what these may spoil under the networks."""
    usual = usual_values(problem)
    base = without_pairs(problem, usual)
    found, abstraction = _on_grids(base, policies, cells, relation, targets_per_cell)
    masses = CollisionProbability(problem, base, join(base, abstraction), relevant_pairs(problem), usual)
    near = proximity(masses, network_tables(base, abstraction))
    certificate = less_proximity(problem, found.certificate, usual, near, dict(found.certificate.settings))
    return Synthesis(certificate, certificate.controller, {**found.stats, "near": certificate.proof.near})


def _of_given(problem: Problem, found: Synthesis) -> Synthesis:
    """Return what was found for a problem that may be written out in time, said of the problem itself."""
    if found.certificate.problem is problem:
        return found
    certificate = timed_certificate(problem, found.certificate)
    return Synthesis(certificate, certificate.controller, found.stats)


def _written(problem: Problem, policies: Sequence[NetworkPolicy]) -> tuple[Problem, Sequence[NetworkPolicy]]:
    """Return the problem as grids know it, without the time, and what its networks are there."""
    if not problem.names_time:
        return problem, policies
    base = unrolled_in_time(problem)
    return base, told_in_time(problem, base, policies)


def repair_network(
    problem: Any,
    actor: Any,
    cells: CellCounts = None,
    *,
    share: float = COVERED,
    targets_per_cell: int | None = None,
) -> tuple[Synthesis, WeakPlaces]:
    """Replace networks where they lose most, and certify the mixture; return also where they lose.

    A few passes backward in time ask, agent by agent, in which cells an input of a menu is worth more than the network.
    What the network loses is counted where better policies lead: those places that lose most are replaced, and the
    network acts everywhere else.

    Parameters
    ----------
    problem, actor, cells, targets_per_cell
        As for ``certify_network``.
    share : float
        Share of all that is lost that the replaced places make up for, as few of them as can be: from 0 (nothing is
        replaced) to 1 (everything that gains).
    """
    given, began = as_problem(problem), time.perf_counter()
    if isinstance(share, bool) or not isinstance(share, int | float) or not 0.0 <= share <= 1.0:
        raise ValueError(f"`share`: expected a number from 0 to 1, got {share!r}")
    if given.labeling.pairs:
        raise ValueError(
            "`problem`: expected a task that is not about pairs, whose networks are repaired agent by agent, got one "
            "about pairs; certify its networks as they are"
        )
    problem, policies = _written(given, _policies(given, actor))
    abstraction = network_abstraction(problem, policies, cells, targets_per_cell, "boxes", with_menu=True)
    middle = time.perf_counter()
    joint, tables = join(problem, abstraction), network_tables(problem, abstraction)
    start, better = start_of(problem, joint), tables
    for _ in range(PASSES - 1):
        better = sweep(joint, better, start, Limits(), improve=True).policies
    noted = _Losses(joint, tables)
    sweep(joint, better, start, Limits(), improve=True, watch=noted.watch)
    places = WeakPlaces(problem, tuple(noted.losses), tuple(model.grid.edges for model in joint.models))
    mixed = noted.mixed(places.least_of(share) if share > 0.0 else np.inf)
    changed = sum(int(np.sum(a != b)) for a, b in zip(mixed, tables, strict=True))
    facts = {"share": float(share), "repaired": changed}
    name = "networks, repaired where they lose most"
    return _of_given(given, _certified(problem, abstraction, mixed, name, facts, (began, middle))), places


def _boxes_of(certificate: OnGrid) -> int:
    """Return the number of cells, automaton states and times of all agents: as many boxes there would be."""
    return sum(part.policy.size for part in certificate.proof.agents)


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


class _Losses:
    """What networks lose, noted while one sweep goes backward in time."""

    def __init__(self, joint: JointModel, tables: Policies) -> None:
        self.models, self.tables = joint.models, tables
        self.losses = [np.zeros(table.shape) for table in tables]
        self.others = [table.copy() for table in tables]

    def watch(self, stage: Stage) -> None:
        """Note what better inputs add at a time in an automaton state, weighted by where the networks come to."""
        t, q = stage.time, stage.q
        for i, (model, weights) in enumerate(zip(self.models, stage.weights(), strict=True)):
            self.others[i][t, q] = stage.policies[i]
            if stage.is_met and len(stage.rows):
                backed_up = to_host(stage.backed_up[i])
                better, own = (model.choices.read(backed_up, p) for p in (stage.policies[i], self.tables[i][t, q]))
                self.losses[i][t, q] = np.maximum(np.einsum("sn,ns->s", to_host(weights), better - own), 0.0)

    def mixed(self, least: float) -> Policies:
        """Return policy tables with better inputs where networks lose at least so much."""
        triples = zip(self.losses, self.others, self.tables, strict=True)
        return tuple(np.where(loss >= max(least, LEAST_LOSS), other, own) for loss, other, own in triples)


def _certified(
    problem: Problem,
    abstraction: Abstraction,
    tables: Policies,
    name: str,
    facts: dict[str, Any],
    began: tuple[float, float],
) -> Synthesis:
    """Return certificate and statistics of policy tables."""
    joint = join(problem, abstraction)
    start = start_of(problem, joint)
    # Whether unions from below pay is not known before; the policies are the same. With linear cells they hardly lose.
    climbs = (0.0,) if abstraction.settings["relation"] == "linear" else (0.0, None)
    tries = [sweep(joint, tables, start, FINAL, improve=False, climb=climb) for climb in climbs]
    best = max(tries, key=lambda found: found.value)
    settings = {**abstraction.settings, **facts, "final_limits": vars(FINAL)}
    certificate = certificate_of(problem, abstraction, joint, best, settings, name)
    seconds = {"abstract": began[1] - began[0], "synthesize": time.perf_counter() - began[1]}
    stats = {"seconds": seconds, "rank": certificate.proof.rank, "dropped": best.dropped, **facts}
    return Synthesis(certificate, certificate.controller, stats)


def network_abstraction_of(certificate: OnGrid) -> Abstraction:
    """Return the finite models that a certificate of networks was made with."""
    problem, parts = certificate.problem, certificate.proof.agents
    policies = [
        network_policy(part.relation["network"], agent) for agent, part in zip(problem.agents, parts, strict=True)
    ]
    cells = dict(zip(problem.agent_names, (part.grid.shape for part in parts), strict=True))
    kind, targets = parts[0].relation["kind"], certificate.settings.get("targets_per_cell")
    repaired = any(np.any(part.policy >= policy.n_modes) for part, policy in zip(parts, policies, strict=True))
    return network_abstraction(problem, policies, cells, targets, kind, with_menu=repaired)


def differences(certificate: Certificate, actor: Any) -> list[str]:
    """Return in which ways the networks of a certificate are not those of an actor; empty if it is about this actor.

    ``check`` verifies a certificate for the networks stored in it; this compares them with those that are deployed.
    """
    problem, found = certificate.problem, list[str]()
    base = getattr(certificate.proof, "base", certificate)  # of proofs about a problem written in another way
    policies: Sequence[NetworkPolicy] = _policies(problem, actor)
    if problem.names_time:
        policies = told_in_time(problem, base.problem, policies)
    for name, part, policy in zip(base.problem.agent_names, base.proof.agents, policies, strict=True):
        stored, given = part.relation.get("network"), policy.description
        if stored is None:
            found.append(f"agent `{name}` is not moved by a network")
            continue
        keys = dict.fromkeys((*given, *stored))
        found += [f"agent `{name}`: its network has other {key}" for key in keys if stored.get(key) != given.get(key)]
        if np.any(part.policy != policy.modes_in(base.problem.automaton.n_states)[..., None]):
            found.append(f"agent `{name}`: its network was replaced in some cells")
    return found
