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
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.suite import as_problem
from ...envs.systems.agents import AnyAgent
from ...envs.systems.backends import on_one_thread
from ...envs.tasks.problem import Problem, policy_in_file, states_in_time, unrolled_in_time
from ..abstraction.models import (
    Abstraction,
    AgentModel,
    JointModel,
    Policies,
    Relations,
    Settings,
    abstraction_of,
    check_names,
    join,
    relations_of,
    shifted,
    start_of,
)
from ..certificates.controllers import Decentralised, Policy, decentralised
from ..certificates.proofs import Synthesis, timed_certificate
from ..composition import CollisionProbability, less_proximity, proximity, relevant_pairs, usual_values, without_pairs
from ..interop import SymbolicPolicies, certifiable
from ..policy_search.ascent import FINAL, Sweep, sweep
from ..policy_search.cell_certificates import certificate_of, judged
from ..relations.grids import CellCounts, FloatArray
from .raw_networks import certified_as_it_is
from .search_options import OF_RELATIONS, SearchOptions, options_of
from .upper_bounds import synthesis_above

OF_NETWORKS = ("auto", "quick", "path", "linear")
"""Relations under which networks are certified as they are."""

WORTHWHILE = 1e-7
"""Relative gain below which ``improve`` stops: far above rounding, and too little for the cost of another sweep."""


@on_one_thread
@judged
def certify(
    problem: Any,
    policy: Any = None,
    cells: CellCounts = None,
    *,
    relation: Relations = "auto",
    wrap: bool = False,
    above: bool = False,
    search: SearchOptions | None = None,
    **old: Any,
) -> Synthesis:
    """Compute a certified lower bound on the satisfaction probability of ``policy``: of networks as they are.

    Networks are certified along the run that they take without noise, in any dimension, or on cells; the better bound
    is kept. Other policies, and networks with ``wrap``, are put on cells first ("wrapped").

    Parameters
    ----------
    problem : Problem, id or path
        Agents with positive definite noise, to whom the relation applies.
    policy : Policy, model or path, optional
        Decentralised policies, in any form that ``synthesis.decentralised`` or ``as_policy`` takes; or expressions,
        ``{"u": ["clip(-1.2*x - 0.8*v, -1, 1)"]}``. Default: those in the table ``[policy]`` of a problem file.
    cells : int, sequence of int or mapping from agent name, optional
        Cells per axis: then cells alone are tried. With more cells a wrapped policy is closer to the raw one.
    relation : str, or mapping from agent name to str
        Of networks as they are ``path`` or ``linear`` (by default what is best). Any other wraps the policy,
        as for ``abstract``; ``exact`` for tasks about pairs; relations are not compared.
    wrap : bool
        Whether to certify what a network becomes on cells.
    above : bool
        Whether to bound it from above, too (``upper_bound`` of the certificate).
    search : SearchOptions, optional
        Its options of relations, as for ``abstract``; others are refused.
    **old
        The same options as keywords, as until 0.3: they work until 0.5, with a DeprecationWarning.

    Returns
    -------
    Synthesis
        ``certificate`` and ``controller`` belong to the networks as they are, or to the wrapped policy; simulate the
        raw one with ``rollout(problem, as_controller(problem, policy), ...)``.
        ``checked`` is what ``check`` says of the certificate.

    Raises
    ------
    ValueError
        If the policy has an unknown form or returns inputs that are not finite, or the relation does not apply.
    """
    keywords = ("problem", "policy", "cells", "relation", "wrap", "above", "search")
    settings = options_of(search, old, "certify", keywords, OF_RELATIONS).of_relations
    if policy is None:
        policy = policy_in_file(problem) if isinstance(problem, str | Path) else None
        if policy is None:
            raise ValueError("`policy`: expected one, or a problem file with a table [policy], got none")
    found = _found(problem, policy, cells, relation, wrap, settings)
    return synthesis_above(found) if above else found


def is_certified_as_given(policy: Any, cells: CellCounts) -> bool:
    """Return whether the claim about a policy is about itself, by default, and not about what it becomes on cells.

    Networks are certified as they are along their run and on cells, expressions along their run alone.
    """
    reason: str = getattr(policy, "why_not_as_it_is", "")
    is_known = hasattr(policy, "agent_policy") and not reason
    return is_known and (cells is None or not isinstance(policy, SymbolicPolicies))


def _found(
    problem: Any, policy: Any, cells: CellCounts, relation: Relations, wrap: bool, settings: dict[str, Any]
) -> Synthesis:
    """Certify a policy from below, as it is or wrapped on cells."""
    problem = as_problem(problem)
    policy = certifiable(problem, policy, along=cells is None and not wrap and relation in ("auto", "quick", "path"))
    if is_certified_as_given(policy, cells) and not wrap and isinstance(relation, str) and relation in OF_NETWORKS:
        return certified_as_it_is(problem, policy, cells, "auto" if relation == "quick" else relation, settings)
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
    base = unrolled_in_time(problem)
    clocks = tuple(bool(agent.has_clock) for agent in base.agents)
    raw = _WrittenOut(decentralised(problem, policy), states_in_time(problem, base), clocks)
    found, _ = _of_task(base, raw, cells, relation, settings)
    certificate = timed_certificate(problem, found.certificate)
    return Synthesis(certificate, certificate.controller, found.stats)


def _about_pairs(
    problem: Problem, policy: Policy, cells: CellCounts, relation: Relations, settings: dict[str, Any]
) -> Synthesis:
    """Certify a policy for a task about pairs, by subtraction."""
    if relation not in ("auto", "exact"):
        raise ValueError(f"`relation`: expected auto or exact for a task about pairs, got {relation!r}")
    return _by_subtraction(problem, decentralised(problem, policy), cells, settings)


def _by_subtraction(problem: Problem, policy: Decentralised, cells: CellCounts, settings: dict[str, Any]) -> Synthesis:
    """Certify a policy without the pairs, and subtract what they may spoil."""
    usual = usual_values(problem)
    base = without_pairs(problem, usual)
    found, wrapped = _of_task(base, policy, cells, "exact", settings)
    model = replace(wrapped.joint, finds_alike=True)
    near = proximity(CollisionProbability(problem, base, model, relevant_pairs(problem), usual), wrapped.policies)
    certificate = less_proximity(problem, found.certificate, usual, near, dict(found.certificate.settings))
    return Synthesis(certificate, certificate.controller, {**found.stats, "near": certificate.proof.near})


@on_one_thread
@judged
def improve(
    problem: Any,
    policy: Any,
    cells: CellCounts = None,
    *,
    relation: Relations = "auto",
    progress: Callable[[str, float], None] | None = None,
    search: SearchOptions | None = None,
    **old: Any,
) -> Synthesis:
    """Improve ``policy`` by coordinate ascent; return the best policies and a certified lower bound for them.

    The bound is at least that of ``certify`` with the same cells and settings: the wrapped policy is one of the
    candidates, and all candidates are evaluated in the same way.

    Parameters
    ----------
    problem, policy, cells, relation, **old
        As for ``certify``.
    progress : callable, optional
        Called with a short text and the best value so far after each sweep.
    search : SearchOptions, optional
        ``max_sweeps``, ``limits``, and the options of relations; others are refused.
    """
    keywords = ("problem", "policy", "cells", "relation", "progress", "search")
    options = options_of(search, old, "improve", keywords, ("max_sweeps", "limits", *OF_RELATIONS))
    settings, max_sweeps = options.of_relations, options.max_sweeps
    clock, problem = _Clock(), as_problem(problem)
    ascent = options.search(progress=progress)
    wrapped = _wrapped(problem, certifiable(problem, policy), cells, relation, settings)
    joint, start = wrapped.joint, start_of(problem, wrapped.joint)
    clock.abstracted()
    best = sweep(joint, wrapped.policies, start, FINAL, improve=False)
    values, last, top = [best.value], best, best
    # every sweep improves the policies of the one before, until the value stops rising
    for _ in range(max_sweeps):
        before, last = last.value, sweep(joint, last.policies, start, ascent.limits, improve=True)
        values.append(last.value)
        top = max(top, last, key=lambda candidate: candidate.value)
        ascent.tell("from the given policy", max(values))
        if last.value <= before * (1 + WORTHWHILE):
            break
    # pruning may have favoured a sweep: evaluate its policies again, unchanged and pruned as little as possible
    frozen = sweep(joint, top.policies, start, FINAL, improve=False)
    best = max(best, frozen, key=lambda candidate: candidate.value)
    name = "coordinate ascent from a given policy"
    return _synthesis(problem, wrapped, best, values, name, clock, {"max_sweeps": max_sweeps})


def wrap(problem: Problem, abstraction: Abstraction, policy: Decentralised) -> Policies:
    """Return policy tables (T, Q, S), one per agent: the admissible choice with the mean nearest to the policy's.

    Choices are compared at the centre of each cell, by Euclidean distance divided by the cell
    widths; -1 where no choice is admissible. Under the relation ``linear`` the corners decide between gains.
    """
    n_q, tables = problem.automaton.n_states, []
    for i, (agent, model) in enumerate(zip(problem.agents, abstraction.models, strict=True)):
        table = np.empty((problem.horizon, n_q, model.grid.n_cells), dtype=np.int32)
        for t in range(problem.horizon):
            choices, first = model.offered(t)
            for q in range(n_q):
                means_at = partial(_means_at, agent, model, partial(_inputs, policy, i, q, t))
                table[t, q] = shifted(choices.nearest(means_at), first)
        tables.append(table)
    return tuple(tables)


def _inputs(policy: Decentralised, i: int, q: int, t: int, states: FloatArray) -> FloatArray:
    """Return the inputs (m, S) of agent i at states (d, S)."""
    return policy.inputs(i, states, np.full(states.shape[1], q), t)


def _means_at(
    agent: AnyAgent, model: AgentModel, inputs: Callable[[FloatArray], FloatArray], points: FloatArray
) -> FloatArray:
    """Return the means (d, S) of the next states, from points (S, d) of the grid.

    Inputs are saturated.
    """
    states, box = np.ascontiguousarray(points.T), agent.input_box
    saturated = np.clip(inputs(states), box.low[:, None], box.high[:, None])
    return np.asarray(agent.mean(states, saturated))


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
    raw = decentralised(problem, policy)
    _check_answers_alike(problem, raw)
    check_names("cells", cells, problem)
    abstraction = abstraction_of(problem, cells, relations_of(problem, relation), Settings(**settings))
    return _Wrapped(abstraction, join(problem, abstraction), wrap(problem, abstraction, raw))


ASKED = 4
"""States of each agent at which a policy is asked twice."""


def _check_answers_alike(problem: Problem, policy: Decentralised) -> None:
    """Raise ValueError if a policy, asked again about the same states, answers otherwise than before."""
    rng = np.random.default_rng(0)
    for i, agent in enumerate(problem.agents):
        low, high = agent.state_low[:, None], agent.state_high[:, None]
        states, others = (low + (high - low) * rng.random((agent.n_states, ASKED)) for _ in range(2))
        first, _, again = (_inputs(policy, i, problem.automaton.initial, 0, each) for each in (states, others, states))
        if not np.allclose(first, again, rtol=1e-5, atol=1e-5 * float(np.max(agent.input_box.half_width))):
            raise ValueError(
                f"`policy`: expected a function of the present state, automaton state and time, got one that answers "
                f"otherwise when it is asked again about agent `{agent.name}`: it remembers, or draws numbers; measure "
                "it by rollouts (`compare`, `rollout`)"
            )


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
    stats = {"seconds": clock.seconds(), "sweeps": values, "rank": certificate.proof.rank, "dropped": best.dropped}
    return Synthesis(certificate, certificate.controller, stats)
