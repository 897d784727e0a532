"""Proofs on grids: policies on cells, and the value tree or tensor trains that they belong to.

A proof holds the value tree's skeleton (which vertices were kept), so that the bound can be computed again from the
policies by a short separate program (``check``). It also holds the value function at time 0, so that other starts can
be asked for: at every state the value there is a lower bound, too (docs/theory/bounds.md, "Other starts").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...relations.kinds import Relation, joint_delta
from ..cell_probabilities import AgentRecord, BrokenTrainError, regrow_trains
from ..controllers import AgentController, Controller
from ..value_functions import Guards, MergeLog, Rounding, Terms, Trains
from .archive import Pool, Stored
from .certificate import Certificate
from .claim import Claim, with_early_acceptance
from .grid_reader import CLAIM_FIELDS, GridReader
from .proof import Proof
from .written_values import put_agent, put_rounding, put_skeleton, put_terms

CORRECTION_INFLATION = 1 + 1e-9
"""Factor on what lost relations may cost, far above its rounding."""


@dataclass(frozen=True, eq=False, repr=False)
class GridProof(Proof):
    """A bound computed on cells of the agents' workspaces, for all states at once.

    Parameters
    ----------
    method : str
        Relation, bound and policy search, in words.
    bound : str
        Name of the bound that gives ``lower_bound``: ``nominal``, ``a-posteriori`` or ``robust tree`` (see ``bounds``).
    bounds : dict
        All bounds that were computed, by name.
    lower_bound : float
        Certified lower bound at the problem's start.
    gap : float or None
        If not None, ``lower_bound + gap`` is an upper bound on the satisfaction probability of this very controller.
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
    rounding : Rounding or None
        How tensor trains were rounded; None for a value tree.
    opposite : Certificate or None
        Of the same controllers and the opposite task, if ``gap`` rests on one (see ``upper_bounds``).
    """

    method: str
    bound: str
    bounds: dict[str, float]
    lower_bound: float
    gap: float | None
    relative_rounding: float
    agents: tuple[AgentRecord, ...]
    guard_source: NDArray[np.int32]
    guard_target: NDArray[np.int32]
    guard_mask: NDArray[np.int32]
    start_target: NDArray[np.int32]
    start_mask: NDArray[np.int32]
    merge_log: tuple[MergeLog, ...]
    terms: Terms | None
    rank: int
    rounding: Rounding | None = None
    complement: Certificate[GridProof] | None = None

    kind = "grid"
    inside = frozenset({"grid"})
    has_cells = True

    @property
    def parts(self) -> tuple[OnGrid, ...]:
        """The certificate of the opposite task, if there is one."""
        return () if self.complement is None else (self.complement,)

    @property
    def stationary(self) -> bool:
        """Whether no agent looks at the time."""
        return all(len(part.policy) == 1 for part in self.agents)

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

    def agents_of(self, problem: Problem) -> tuple[AgentRecord, ...]:
        """Return what is stored of each agent."""
        return self.agents

    def on_cells(self, certificate: Certificate) -> Certificate:
        """Return the certificate itself."""
        return certificate

    def with_claims(self, certificate: Certificate, change: Callable[[Any], Any]) -> Certificate:
        """Return what a function makes of the certificate."""
        made: Certificate = change(certificate)
        return made

    def controller(self, problem: Problem) -> Controller:
        """Return controllers that carry out the policies, their relations computed anew."""
        controllers, known = [], dict[object, Relation]()
        for agent, part in zip(problem.agents, self.agents, strict=True):
            # Agents with equal dynamics and cells share the relation of the first of them.
            key = (*part.sharing_key(agent), id(part.grid))
            relation = known[key] = known.get(key) or part.relation_of(agent)
            controllers.append(
                AgentController(agent.name, part.grid, part.lattice, relation, part.policy, part.input_set)
            )
        return Controller(problem, tuple(controllers))

    def claim(self, certificate: Certificate) -> Claim:
        """Return the value function at time 0, read with all reserves taken off."""
        return _claim(certificate)

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        guards = self.guard_source, self.guard_target, self.guard_mask
        entries = {
            **{name: getattr(self, name) for name in CLAIM_FIELDS},
            "agents": [put_agent(pool, part) for part in self.agents],
            "guards": [pool.put(array) for array in guards],
            "start_guards": [pool.put(self.start_target), pool.put(self.start_mask)],
            "skeleton": [put_skeleton(pool, step) for step in self.merge_log],
            "terms": None if self.terms is None else put_terms(pool, self.terms),
            "rounding": None if self.rounding is None else put_rounding(pool, self.rounding),
        }
        return entries if self.complement is None else {**entries, "opposite": pool.put_file(self.complement)}

    @classmethod
    def read(cls, problem: Problem, stored: Stored) -> Self:
        """Return the proof in a file; raise ValueError (KeyError, TypeError, .. if the header has another form)."""
        complement = stored.certificate(stored.entry["opposite"]) if "opposite" in stored.entry else None
        return cls(**GridReader(problem, stored).fields(), complement=complement)


OnGrid = Certificate[GridProof]
"""A certificate on a grid."""


def delta_of(certificate: OnGrid) -> float:
    """Return an upper bound on the probability, per step, that any relation is lost."""
    return joint_delta([relation.delta for relation in _relations(certificate)])


def _relations(certificate: OnGrid) -> tuple[Relation, ...]:
    """Return the relation of each agent: those of the controllers, so that they are computed once."""
    return tuple(agent.relation for agent in certificate.controller.agents)


def value_of(certificate: OnGrid) -> Terms | Trains:
    """Return the value function at time 0: the stored terms, or the tensor trains grown from the policies."""
    proof = certificate.proof
    if proof.terms is not None:
        return proof.terms
    if proof.rounding is None:
        raise BrokenTrainError("it has a value tree and no tensor trains")
    return regrow_trains(certificate.problem, proof.agents, proof.guards, proof.rounding)


def _claim(certificate: OnGrid) -> Claim:
    """Return the claim of a certificate about every start."""
    problem, proof, value = certificate.problem, certificate.proof, value_of(certificate)
    # Under the a-posteriori bound a run that is undecided to the end may lose its relation at every step.
    delta = delta_of(certificate) if proof.bound == "a-posteriori" else 0.0
    correction = delta * problem.horizon * CORRECTION_INFLATION
    if correction > 0.0 and isinstance(value, Terms):
        value = with_early_acceptance(value, proof.merge_log, proof.guards, problem.automaton, problem.horizon, delta)
    # The controllers carry out their policies up to rounding, which moves the means a little at every step.
    relations = _relations(certificate)
    triples = zip(problem.agents, relations, proof.agents, strict=True)
    per_step = sum(relation.rounding_loss(agent, part.grid.edges) for agent, relation, part in triples)
    correction += per_step * problem.horizon * CORRECTION_INFLATION
    start = proof.start_target, proof.start_mask
    return Claim(problem, proof.agents, relations, *start, value, proof.relative_rounding, correction)
