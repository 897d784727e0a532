"""Certificates for policies that come from elsewhere: learned, written by hand, or read from a table.

A decentralised policy is put on the cells of an abstraction ("wrapped"). Take a cell with the centre m, an automaton
state and a step. The policy's input u, saturated as actuators saturate, leads to the mean ``A m + B u + c``; the
wrapped policy aims at the nearest admissible target. The value tree then evaluates the wrapped policy. The certificate
belongs to the wrapped policy, not to the raw one, and so do the controllers, the rollouts and ``check``. ``improve``
goes on from there by coordinate ascent (``docs/theory/tree.md``, "Occupancy-weighted ascent").

The two policies differ in two ways. The raw one acts on the state, the wrapped one on the cell. And if some point of
the cell cannot reach a target within the input box, the wrapped policy takes the nearest target that all points can
reach. Finer cells make both differences smaller. Under the relation ``linear`` the wrapped policy moves with the state
inside the cell, as the choice does whose means are nearest to those of the raw one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..envs.agents import AnyAgent
from ..envs.problem import Problem, states_in_time, written_out
from ..envs.suite import as_problem
from .bridges import certifiable
from .cells import CellCounts, FloatArray, RelationRefused, corner_sides
from .certificates import Synthesis, TeamCertificate, TimedCertificate
from .certification import certificate_of
from .controllers import Decentralised, Policy, decentralised
from .keeping_apart import less_nearness, nearness
from .models import (
    Abstraction,
    AgentModel,
    BoxChoices,
    CornerChoices,
    InputMenu,
    JointModel,
    Policies,
    Relations,
    TargetWindows,
    abstract,
    join,
    start_of,
)
from .pairs import NearMass, joint_problem, relevant_pairs, usual_values, without_pairs
from .raw_networks import certify_network
from .search import FINAL, Limits, Search, Sweep, sweep
from .together import joint_cells
from .upper_ends import synthesis_above

WORTHWHILE = 1e-7
"""Relative gain below which ``improve`` stops: far above rounding, and too little for the cost of another sweep."""

INSIDE = 0.999
"""Share of the way from the centre of a cell to a corner at which a policy is asked: corners are of several cells."""


def certify(
    problem: Any,
    policy: Any,
    cells: CellCounts = None,
    *,
    relation: Relations = "auto",
    raw: bool = False,
    above: bool = False,
    **settings: Any,
) -> Synthesis:
    """Compute a certified lower bound on the satisfaction probability of ``policy`` as wrapped on a grid.

    With ``raw`` the bound is about networks as they are deployed (``certify_network``).

    Parameters
    ----------
    problem : Problem, id or path
        Agents with positive definite noise, to whom the relation applies.
    policy : Policy, model or path
        Decentralised policies, in any form that ``synthesis.decentralised`` or ``as_policy`` takes.
    cells : int, sequence of int or mapping from agent name, optional
        Cells per axis; with more cells the wrapped policy is closer to the raw one.
    relation : str, or mapping from agent name to str
        As for ``abstract``; ``exact`` or ``joint`` for tasks about pairs. Relations are not compared.
    raw : bool
        Whether to certify a trained actor as it is, not wrapped: the relation is ``linear`` or ``boxes`` then.
    above : bool
        Whether to bound it from above, too (``upper_bound`` of the certificate; see ``bound_above``).
    **settings
        Further settings of the relation, passed to ``abstract``.

    Returns
    -------
    Synthesis
        ``certificate`` and ``controller`` belong to the wrapped policy. Simulate the raw one with
        ``rollout(problem, as_controller(problem, policy), ...)``; no bound holds for it but with ``raw``.

    Raises
    ------
    ValueError
        If the policy has an unknown form or returns inputs that are not finite, or the relation does not apply.
    """
    if above:
        return synthesis_above(certify(problem, policy, cells, relation=relation, raw=raw, **settings))
    if raw:
        if not isinstance(relation, str):
            raise ValueError("`relation`: expected one for all agents with `raw`, got a mapping; leave it out")
        kind = "auto" if relation == "quick" else relation
        return certify_network(problem, policy, cells, relation=kind, **settings)
    problem = as_problem(problem)
    policy = certifiable(problem, policy)
    if problem.labeling.pairs:
        return _about_pairs(problem, policy, cells, relation, settings)
    if problem.names_time:
        return _in_time(problem, policy, cells, relation, settings)
    return _of_task(problem, policy, cells, relation, settings)[0]


def _of_task(
    problem: Problem, policy: Policy, cells: CellCounts, relation: Relations, settings: dict[str, Any]
) -> tuple[Synthesis, _Wrapped]:
    """Certify a policy for a task that does not speak of pairs."""
    clock = _Clock()
    wrapped = _wrapped(problem, policy, cells, relation, settings)
    clock.abstracted()
    best = sweep(wrapped.joint, wrapped.policies, start_of(problem, wrapped.joint), FINAL, improve=False)
    return _synthesis(problem, wrapped, best, [], "given policy on the cells", clock, {}), wrapped


@dataclass(frozen=True, eq=False)
class _OfJointAgent:
    """Policies of a team as one of its joint agent, whose states and inputs are those of all."""

    problem: Problem
    policy: Decentralised

    def inputs(self, agent: int, states: FloatArray, q: NDArray[Any], time: int) -> FloatArray:
        """Return inputs (m, N) for joint states (d, N) and automaton states (N,)."""
        own = [self.policy.inputs(i, states[columns], q, time) for i, columns in enumerate(self.problem.columns)]
        return np.concatenate(own)


@dataclass(frozen=True, eq=False)
class _WrittenOut:
    """Policies of a problem that names the time as those of the problem written out, whose automaton counts steps.

    ``counted`` (T + 1, Q) are the automaton states of the problem written out; ``clocks`` says which agents have the
    time as their last input there.
    """

    policy: Decentralised
    counted: NDArray[np.int64]
    clocks: tuple[bool, ...]

    def inputs(self, agent: int, states: FloatArray, q: NDArray[Any], time: int) -> FloatArray:
        """Return inputs (m, N) for states (d, N) and automaton states (N,) of the problem written out."""
        # States in which no run is at this time are anything; where several go with one they are worth the same.
        own = np.zeros(int(max(self.counted.max(), np.max(q))) + 1, dtype=np.int64)
        known = np.flatnonzero(self.counted[time] >= 0)
        own[self.counted[time, known]] = known
        inputs = self.policy.inputs(agent, states, own[q], time)
        return np.concatenate([inputs, np.full((1, inputs.shape[1]), float(time))]) if self.clocks[agent] else inputs


def _in_time(
    problem: Problem, policy: Policy, cells: CellCounts, relation: Relations, settings: dict[str, Any]
) -> Synthesis:
    """Certify a policy for a problem that names the time, as one of the problem written out."""
    base = written_out(problem)
    clocks = tuple(bool(agent.has_clock) for agent in base.agents)
    raw = _WrittenOut(decentralised(problem, policy), states_in_time(problem, base), clocks)
    found, _ = _of_task(base, raw, cells, relation, settings)
    held: Any = TimedCertificate(problem, found.certificate)
    return Synthesis(held, held.controller, found.stats)


def _about_pairs(
    problem: Problem, policy: Policy, cells: CellCounts, relation: Relations, settings: dict[str, Any]
) -> Synthesis:
    """Certify a policy for a task about pairs: by subtraction where all agents are ``exact``, or as a joint agent."""
    if relation not in ("auto", "exact", "joint"):
        raise ValueError(f"`relation`: expected auto, exact or joint for a task about pairs, got {relation!r}")
    raw = decentralised(problem, policy)
    if relation != "joint":
        try:
            return _by_subtraction(problem, raw, cells, settings)
        except RelationRefused:
            if relation == "exact":
                raise
    joint = joint_problem(problem)
    found, _ = _of_task(joint, _OfJointAgent(problem, raw), joint_cells(problem, cells), "auto", settings)
    held: Any = TeamCertificate(problem, found.certificate)
    return Synthesis(held, held.controller, found.stats)


def _by_subtraction(problem: Problem, policy: Decentralised, cells: CellCounts, settings: dict[str, Any]) -> Synthesis:
    """Certify a policy without the pairs, and subtract what they may spoil."""
    usual = usual_values(problem)
    base = without_pairs(problem, usual)
    found, wrapped = _of_task(base, policy, cells, "exact", settings)
    model = replace(wrapped.joint, finds_alike=True)
    near = nearness(NearMass(problem, base, model, relevant_pairs(problem), usual), wrapped.policies)
    held: Any = less_nearness(problem, found.certificate, usual, near, dict(found.certificate.settings))
    return Synthesis(held, held.controller, {**found.stats, "near": held.near})


def improve(
    problem: Any,
    policy: Any,
    cells: CellCounts = None,
    *,
    relation: Relations = "auto",
    max_sweeps: int = 8,
    limits: Limits | None = None,
    progress: Callable[[str, float], None] | None = None,
    **settings: Any,
) -> Synthesis:
    """Improve ``policy`` by coordinate ascent; return the best policies and a certified lower bound for them.

    The bound is at least that of ``certify`` with the same cells and settings: the wrapped policy is one of the
    candidates, and all candidates are evaluated in the same way.

    Parameters
    ----------
    problem, policy, cells, relation, **settings
        As for ``certify``.
    max_sweeps : int
        Largest number of sweeps; the search stops earlier when nothing improves.
    limits : Limits, optional
        How trees are pruned during the search.
    progress : callable, optional
        Called with a short text and the best value so far after each sweep.
    """
    clock, problem = _Clock(), as_problem(problem)
    search = Search(max_sweeps, Limits() if limits is None else limits, progress=progress)
    wrapped = _wrapped(problem, certifiable(problem, policy), cells, relation, settings)
    joint, start = wrapped.joint, start_of(problem, wrapped.joint)
    clock.abstracted()
    best = sweep(joint, wrapped.policies, start, FINAL, improve=False)
    values, last, top = [best.value], best, best
    # every sweep improves the policies of the one before, until the value stops rising
    for _ in range(max_sweeps):
        before, last = last.value, sweep(joint, last.policies, start, search.limits, improve=True)
        values.append(last.value)
        top = max(top, last, key=lambda candidate: candidate.value)
        search.tell("from the given policy", max(values))
        if last.value <= before * (1 + WORTHWHILE):
            break
    # pruning may have favoured a sweep: evaluate its policies again, unchanged and pruned as little as possible
    frozen = sweep(joint, top.policies, start, FINAL, improve=False)
    best = max(best, frozen, key=lambda candidate: candidate.value)
    name = "coordinate ascent from a given policy"
    return _synthesis(problem, wrapped, best, values, name, clock, {"max_sweeps": max_sweeps})


def wrap(problem: Problem, abstraction: Abstraction, policy: Decentralised) -> Policies:
    """Return policy tables (T, Q, S), one per agent: the admissible choice with the mean nearest to the policy's.

    Choices are compared at the centre of each cell, by Euclidean distance in grid coordinates divided by the cell
    widths; -1 where no choice is admissible. Under the relation ``linear`` the corners decide between gains.
    """
    n_q, tables = problem.automaton.n_states, []
    for i, (agent, model) in enumerate(zip(problem.agents, abstraction.models, strict=True)):
        table = np.empty((problem.horizon, n_q, model.grid.n_cells), dtype=np.int32)
        for t in range(problem.horizon):
            for q in range(n_q):
                centres = _means_at(agent, model, model.grid.centres, partial(_inputs, policy, i, q, t))
                if isinstance(model.choices, CornerChoices):
                    corners = [
                        _means_at(agent, model, points, partial(_inputs, policy, i, q, t)) for points in _corners(model)
                    ]
                    table[t, q] = _nearest_maps(model.choices, centres, corners, _cell_widths(model))
                else:
                    table[t, q] = nearest_choices(model, centres)
        tables.append(table)
    return tuple(tables)


def _inputs(policy: Decentralised, i: int, q: int, t: int, states: FloatArray) -> FloatArray:
    """Return the inputs (m, S) of agent i at states (d, S)."""
    return policy.inputs(i, states, np.full(states.shape[1], q), t)


def _cell_widths(model: AgentModel) -> FloatArray:
    """Return the mean width (d,) of cells along each axis."""
    return np.array([(axis[-1] - axis[0]) / (len(axis) - 1) for axis in model.grid.edges])


def _corners(model: AgentModel) -> list[FloatArray]:
    """Return points (S, d) in grid coordinates near each corner of all cells, a little inside of them."""
    sides = 2.0 * corner_sides(len(model.grid.edges)) - 1.0
    return [model.grid.centres + INSIDE * side * model.grid.half_widths for side in sides]


def nearest_choices(model: AgentModel, means: FloatArray) -> NDArray[np.int32]:
    """Return the admissible choice (S,) of each cell whose mean is nearest to ``means`` (d, S); -1 if there is none.

    Means are in grid coordinates.
    """
    scale, choices = _cell_widths(model), model.choices
    if isinstance(choices, BoxChoices):
        return _nearest_boxes(choices, means, scale)
    if isinstance(choices, TargetWindows):
        return _nearest_targets(choices, means, scale)
    assert isinstance(choices, InputMenu)
    points = np.stack(np.meshgrid(*model.lattice, indexing="ij"), axis=-1).reshape(-1, len(scale))
    offered = choices.leads_to
    # distances of all choices on offer, in cell widths; places of the menu that are empty are infinitely far
    gaps = (((points[np.maximum(offered, 0)] - means.T[:, None]) / scale) ** 2).sum(axis=-1)
    gaps = np.where(offered < 0, np.inf, gaps)
    return np.where((offered >= 0).any(axis=1), gaps.argmin(axis=1), -1).astype(np.int32)


def _nearest_boxes(choices: BoxChoices, means: FloatArray, scale: FloatArray) -> NDArray[np.int32]:
    """Return the admissible choice (S,) of each cell whose box has its middle nearest to means (d, S)."""
    nearest, best = np.full(choices.grid.n_cells, np.inf), np.full(choices.grid.n_cells, -1)
    for a in range(choices.size.shape[1]):
        gaps = (((choices.middles(a) - means.T) / scale) ** 2).sum(axis=1)
        closer = (choices.size[:, a] >= 0) & (gaps < nearest)
        nearest, best = np.where(closer, gaps, nearest), np.where(closer, a, best)
    return best.astype(np.int32)


def _nearest_maps(
    choices: CornerChoices, means: FloatArray, corners: Sequence[FloatArray], scale: FloatArray
) -> NDArray[np.int32]:
    """Return the choice (S,) of each cell whose means are nearest to those (d, S) at its centre and near its corners.

    The inputs and the target that are nearest at the centre; the corners decide between these.
    """
    cells, half = np.arange(choices.grid.n_cells), choices.grid.half_widths
    offered = [choices.centres(cells, np.full(len(cells), a)) for a in range(choices.n_inputs)]
    distances = np.stack([(((centres - means.T) / scale) ** 2).sum(axis=1) for centres in offered])
    inputs = np.argmin(distances, axis=0).astype(np.int32)
    if choices.windows is None:
        return inputs
    targets = _nearest_targets(choices.windows, means, scale)
    gains = choices.maps.gain[cells, inputs if choices.maps.gain.shape[1] > 1 else 0]
    aims = choices.centres(cells, np.maximum(targets, 0) + choices.n_inputs)
    moved, aimed = np.zeros(len(cells)), np.where(targets >= 0, 0.0, np.inf)
    for side, goal in zip(2.0 * corner_sides(len(scale)) - 1.0, corners, strict=True):
        here = choices.centres(cells, inputs) + INSIDE * np.einsum("sij,sj->si", gains, side * half)
        moved += (((here - goal.T) / scale) ** 2).sum(axis=1)
        aimed += (((aims - goal.T) / scale) ** 2).sum(axis=1)
    return np.where(aimed <= moved, targets + choices.n_inputs, inputs).astype(np.int32)


def _nearest_targets(windows: TargetWindows, means: FloatArray, scale: FloatArray) -> NDArray[np.int32]:
    """Take the nearest point of the window along each axis; where that is not admissible, search the whole window."""
    indices = []
    for k, axis in enumerate(windows.lattice):
        # the two lattice points around the mean, the nearer of them, and then the nearest one inside the window
        above = np.clip(np.searchsorted(axis, means[k]), 1, max(1, len(axis) - 1))
        below = above - 1
        above = np.minimum(above, len(axis) - 1)
        near = np.where(means[k] - axis[below] <= axis[above] - means[k], below, above)
        indices.append(np.clip(near, windows.low[:, k], np.maximum(windows.high[:, k] - 1, windows.low[:, k])))
    empty = np.any(windows.low >= windows.high, axis=1)
    targets = np.ravel_multi_index([np.where(empty, 0, index) for index in indices], windows.shape)
    targets = np.where(empty, -1, targets)
    # the admissible targets need not fill the window: it is a box around them
    refused = np.flatnonzero(~empty & ~windows.admissible(np.arange(len(targets)), np.maximum(targets, 0)))
    for s in refused:
        targets[s] = _search(windows, int(s), means[:, s], scale)
    return targets.astype(np.int32)


def _search(windows: TargetWindows, cell: int, mean: FloatArray, scale: FloatArray) -> int:
    """Return the nearest admissible target of one cell in its whole window, or -1."""
    ranges = [np.arange(a, b) for a, b in zip(windows.low[cell], windows.high[cell], strict=True)]
    mesh = [indices.ravel() for indices in np.meshgrid(*ranges, indexing="ij")]
    flat = np.ravel_multi_index(mesh, windows.shape)
    admissible = windows.admissible(np.full(len(flat), cell), flat)
    if not admissible.any():
        return -1
    gaps = np.zeros(len(flat))
    for axis, indices, goal, width in zip(windows.lattice, mesh, mean, scale, strict=True):
        gaps += ((axis[indices] - goal) / width) ** 2
    return int(flat[np.where(admissible, gaps, np.inf).argmin()])


def _means_at(
    agent: AnyAgent, model: AgentModel, points: FloatArray, inputs: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Return the means (d, S) of the next states in grid coordinates, from points (S, d) of the grid.

    Inputs are saturated.
    """
    states, box = np.ascontiguousarray(np.asarray(model.relation.coordinates) @ points.T), agent.input_box
    saturated = np.clip(inputs(states), box.low[:, None], box.high[:, None])
    return model.relation.to_grid(agent.mean(states, saturated))


@dataclass(frozen=True)
class _Wrapped:
    """A given policy on cells: the finite models, the joint model, and the policy tables of all agents."""

    abstraction: Abstraction
    joint: JointModel
    policies: Policies


def _wrapped(
    problem: Problem, policy: Policy, cells: CellCounts, relation: Relations, settings: dict[str, Any]
) -> _Wrapped:
    """Put a policy on the cells of finite models."""
    if settings.get("common"):
        raise ValueError(
            "`common`: expected none for given policies, whose inputs depend on states, got True; leave it out"
        )
    raw = decentralised(problem, policy)
    abstraction = abstract(problem, cells, relation=relation, **settings)
    return _Wrapped(abstraction, join(problem, abstraction), wrap(problem, abstraction, raw))


class _Clock:
    """Seconds that the finite models took, and seconds since then."""

    def __init__(self) -> None:
        self.began = self.middle = time.perf_counter()

    def abstracted(self) -> None:
        """Note that the finite models are finished."""
        self.middle = time.perf_counter()

    def seconds(self) -> dict[str, float]:
        """Return the seconds until the models were finished, and those since."""
        return {"abstract": self.middle - self.began, "synthesize": time.perf_counter() - self.middle}


def _synthesis(
    problem: Problem,
    wrapped: _Wrapped,
    best: Sweep,
    values: list[float],
    name: str,
    clock: _Clock,
    used: dict[str, Any],
) -> Synthesis:
    """Return certificate and statistics of the best policy."""
    settings = {**wrapped.abstraction.settings, **used, "final_limits": vars(FINAL)}
    certificate = certificate_of(problem, wrapped.abstraction, wrapped.joint, best, settings, name)
    stats = {"seconds": clock.seconds(), "sweeps": values, "rank": certificate.rank, "dropped": best.dropped}
    return Synthesis(certificate, certificate.controller, stats)
