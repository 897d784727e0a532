"""Certificates: a lower bound, the policies it belongs to, and everything needed to check it again.

A certificate speaks of one problem (dynamics, regions, automaton, horizon, start: its fingerprint) and one set of
policies. It holds the value tree's skeleton (which vertices were kept), so that the bound can be computed again from
the policies by a short separate program (``check``). It also holds the value function at time 0, so that other starts
can be asked for: at every state the value there is a lower bound, too (docs/theory/bounds.md, "Other starts").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import tree_text
from ...envs.problem import Problem
from ..cells import FloatArray
from ..controllers import AgentController, Controller
from ..relations import Relation, joint_delta
from ..values import Guards, Rounding, Skeleton, Terms, Trains
from .archive import Pool
from .claim import Claim, with_early_acceptance
from .part import AgentPart
from .regrown_trains import BrokenTrainError, regrow_trains
from .summaries import certificate_facts, certificate_html
from .two_ended import TwoEnded
from .written_values import put_agent, put_rounding, put_skeleton, put_terms

CLAIM_FIELDS = ("method", "bound", "bounds", "start", "lower_bound", "gap", "exact", "relative_rounding", "rank")
"""Fields of a certificate about its claim, which files hold under the same names."""

CORRECTION_INFLATION = 1 + 1e-9
"""Factor on what lost relations may cost, far above its rounding."""


def checked_certificate(value: Any, argument: str = "certificate") -> Certificate:
    """Return a certificate of one task, given as ``argument``, or raise ValueError with what to do."""
    if isinstance(value, Certificate):
        return value
    inside = isinstance(getattr(value, "certificate", None), Certificate)
    if hasattr(value, "parts"):
        raise ValueError(f"`{argument}`: expected that of one task, got {len(value.parts)}; give one of its `.parts`")
    remedy = "give its `.certificate`" if inside else "make one with `synthesize`, `certify` or `load_certificate`"
    raise ValueError(f"`{argument}`: expected a Certificate, got {type(value).__name__}; {remedy}")


@dataclass(frozen=True, eq=False, repr=False)
class Certificate(TwoEnded):
    """A certified lower bound on the satisfaction probability of the continuous closed loop.

    Parameters
    ----------
    problem : Problem
        What it is about.
    method : str
        Relation, bound and policy search, in words.
    bound : str
        Name of the bound that gives ``lower_bound``: ``nominal``, ``a-posteriori`` or ``robust tree`` (see ``bounds``).
    bounds : dict
        All bounds that were computed, by name.
    start : str
        ``"point"``: the bound holds from the problem's initial state; ``"mean"``: on average over a start drawn
        uniformly from the initial boxes.
    lower_bound : float
        Certified lower bound at the problem's start.
    gap : float or None
        If not None, ``lower_bound + gap`` is an upper bound on the satisfaction probability of this very controller.
    exact : bool
        Whether the probability is known to ``EXACT_GAP``: the bound is then tested by rollouts from both sides.
    relative_rounding : float
        Relative reserve for floating point, also taken off in ``at``, ``mean`` and ``min``.
    agents : tuple of AgentPart
    guard_source, guard_target : (G,) int32 arrays
        Automaton states that each guard connects.
    guard_mask : (G, I) int32 array
        Factor of each agent in each guard, an index into ``agents[i].masks``.
    start_target : (G0,) int32 array
        Automaton state after the letter of time 0.
    start_mask : (G0, I) int32 array
        The same for reading that letter, an index into ``agents[i].start_masks``.
    skeleton : tuple of Skeleton
        Vertices of the value tree, by time; empty if the value function is held as tensor trains.
    terms : Terms or None
        Value function at time 0; None for tensor trains, which are grown again from the policies when asked for.
    rank : int
        Largest number of terms of one automaton state, or of columns of a bond.
    settings : dict
        Every setting of abstraction and policy search.
    rounding : Rounding or None
        How tensor trains were rounded; None for a value tree.
    opposite : Certificate or None
        Of the same controllers and the opposite task, if ``gap`` rests on one (see ``bound_above``).
    """

    problem: Problem
    method: str
    bound: str
    bounds: dict[str, float]
    start: str
    lower_bound: float
    gap: float | None
    exact: bool
    relative_rounding: float
    agents: tuple[AgentPart, ...]
    guard_source: NDArray[np.int32]
    guard_target: NDArray[np.int32]
    guard_mask: NDArray[np.int32]
    start_target: NDArray[np.int32]
    start_mask: NDArray[np.int32]
    skeleton: tuple[Skeleton, ...]
    terms: Terms | None
    rank: int
    settings: dict[str, Any]
    rounding: Rounding | None = None
    opposite: Certificate | None = None

    def __repr__(self) -> str:
        return tree_text(f"Certificate of {self.problem.name!r}", certificate_facts(self))

    def _repr_html_(self) -> str:
        return certificate_html(f"Certificate of {self.problem.name}", self)

    @property
    def on_cells(self) -> Any:
        """Itself."""
        return self

    @property
    def has_cells(self) -> bool:
        """Whether it is about cells of workspaces."""
        return True

    def with_claims(self, change: Callable[[Any], Any]) -> Self:
        """Return what a function makes of it."""
        made: Self = change(self)
        return made

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        guards = self.guard_source, self.guard_target, self.guard_mask
        entries = {
            **{name: getattr(self, name) for name in CLAIM_FIELDS},
            "settings": self.settings,
            "agents": [put_agent(pool, part) for part in self.agents],
            "guards": [pool.put(array) for array in guards],
            "start_guards": [pool.put(self.start_target), pool.put(self.start_mask)],
            "skeleton": [put_skeleton(pool, step) for step in self.skeleton],
            "terms": None if self.terms is None else put_terms(pool, self.terms),
            "rounding": None if self.rounding is None else put_rounding(pool, self.rounding),
        }
        return entries if self.opposite is None else {**entries, "opposite": pool.put_file(self.opposite)}

    @property
    def stationary(self) -> bool:
        """Whether no agent looks at the time."""
        return all(len(part.policy) == 1 for part in self.agents)

    @property
    def unbounded(self) -> float | None:
        """Lower bound on satisfying a co-safe task at any time, without a deadline; None for other tasks.

        What is satisfied by the horizon stays satisfied. Afterwards controllers repeat their last choices; those of
        stationary policies are the same at all times.
        """
        return self.lower_bound if self.problem.automaton.is_co_safe else None

    @property
    def delta(self) -> float:
        """Upper bound on the probability, per step, that any relation is lost."""
        return joint_delta([relation.delta for relation in _relations(self)])

    @property
    def guards(self) -> Guards:
        """The guards over the cells of each agent."""
        masks = tuple(part.masks for part in self.agents)
        return Guards(masks, self.guard_source, self.guard_target, self.guard_mask)

    @property
    def tree(self) -> Terms:
        """Value function at time 0 as the terms of the value tree.

        Raises
        ------
        ValueError
            If the value function is held as tensor trains, which have no terms.
        """
        if self.terms is None:
            raise ValueError(
                "`certificate`: expected one with a value tree, got tensor trains, which have no terms; synthesize "
                'with `value="tree"` where the tree has few of them'
            )
        return self.terms

    @cached_property
    def value(self) -> Terms | Trains:
        """Value function at time 0: the stored terms, or the tensor trains grown from the policies on first use."""
        return _value(self)

    @cached_property
    def controller(self) -> Controller:
        """The controllers the bound belongs to."""
        return _controller(self)

    @cached_property
    def claim(self) -> Claim:
        """The value function of the certificate, read with all reserves taken off."""
        return _claim(self)

    def at(self, states: Any) -> FloatArray:
        """Return lower bounds (M,) on the satisfaction probability from each of M joint initial states.

        They are read from the stored value function: bounds if ``check`` verifies the certificate, which is not asked.

        Parameters
        ----------
        states : array_like, shape (M, D) or (D,), or mapping from agent name to (d_i,) vector
            Joint states in agent order, ``D = sum d_i``, in state units. A single state gives an array of length 1.

        Raises
        ------
        ValueError
            If the shape does not fit.
        """
        return self.claim.at(states)

    def mean(self, low: Any, high: Any) -> float:
        """Return a lower bound on the satisfaction probability from a start drawn uniformly from ``[low, high)``.

        Parameters
        ----------
        low, high : array_like, shape (D,), or mappings from agent name to (d_i,) vector
            Corners in joint state space; equal coordinates are points. The box is averaged cell by cell, each cell with
            the letters that are certain in it.
        """
        return self.claim.mean(low, high)

    def min(self, low: Any, high: Any) -> float:
        """Return a lower bound on the satisfaction probability from every start in the box: the least of its cells.

        Raises
        ------
        ValueError
            If the box holds more than ``MAX_JOINT_CELLS`` joint cells.
        """
        return self.claim.min(low, high)


def _controller(certificate: Certificate) -> Controller:
    """Return controllers that carry out the policies of a certificate, their relations computed anew."""
    controllers, known = [], dict[object, Relation]()
    for agent, part in zip(certificate.problem.agents, certificate.agents, strict=True):
        # Agents with equal dynamics and cells share the relation of the first of them.
        key = (*part.sharing_key(agent), id(part.grid), part.coordinates.tobytes())
        relation = known[key] = known.get(key) or part.relation_of(agent)
        controllers.append(AgentController(agent.name, part.grid, part.lattice, relation, part.policy, part.menu))
    return Controller(certificate.problem, tuple(controllers))


def _relations(certificate: Certificate) -> tuple[Relation, ...]:
    """Return the relation of each agent: those of the controllers, so that they are computed once."""
    return tuple(agent.relation for agent in certificate.controller.agents)


def _value(certificate: Certificate) -> Terms | Trains:
    """Return the value function at time 0, tensor trains grown from the policies."""
    if certificate.terms is not None:
        return certificate.terms
    if certificate.rounding is None:
        raise BrokenTrainError("it has a value tree and no tensor trains")
    return regrow_trains(certificate.problem, certificate.agents, certificate.guards, certificate.rounding)


def _claim(certificate: Certificate) -> Claim:
    """Return the claim of a certificate about every start."""
    problem, value, correction = certificate.problem, certificate.value, 0.0
    # Under the a-posteriori bound a run that is undecided to the end may lose its relation at every step.
    if certificate.bound == "a-posteriori":
        correction = certificate.delta * problem.horizon * CORRECTION_INFLATION
    if correction > 0.0 and isinstance(value, Terms):
        skeleton, guards, automaton = certificate.skeleton, certificate.guards, problem.automaton
        value = with_early_acceptance(value, skeleton, guards, automaton, problem.horizon, certificate.delta)
    # The controllers carry out their policies up to rounding, which moves the means a little at every step.
    relations = _relations(certificate)
    triples = zip(problem.agents, relations, certificate.agents, strict=True)
    per_step = sum(relation.execution_loss(agent, part.grid.edges) for agent, relation, part in triples)
    correction += per_step * problem.horizon * CORRECTION_INFLATION
    start = certificate.start_target, certificate.start_mask
    return Claim(problem, certificate.agents, relations, *start, value, certificate.relative_rounding, correction)
