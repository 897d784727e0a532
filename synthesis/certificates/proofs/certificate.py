"""Certificates: a lower bound, the policies it belongs to, and everything needed to check it again.

A certificate speaks of one problem (dynamics, regions, automaton, horizon, start: its fingerprint) and one set of
policies. Its *proof* holds these policies and the numbers from which ``check``, a short separate program, computes the
bound again. Proofs are of several kinds: on grids, along paths, by subtraction,
written out in time, and products of independent tasks. Whoever needs something that not every proof has
asks for it (``require``).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, TypeVar

from ....envs.systems.arguments import tree_text
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from .digits import EXACT_GAP
from .projection import RunProjection
from .proof import Capability, Proof
from .summaries import certificate_facts, certificate_html

P_co = TypeVar("P_co", bound=Proof, covariant=True)
"""A kind of proof: functions that need a certain one say so, ``Certificate[GridProof]``."""


@dataclass(frozen=True, eq=False, repr=False)
class Certificate(Generic[P_co]):
    """A certified lower bound on the probability that controllers satisfy the task of a problem.

    Parameters
    ----------
    problem : Problem
        What it is about: the continuous closed loop, with its start.
    proof : Proof
        How the bound is proved: ``GridProof``, ``PathProof``, ``UnionBoundProof``, ``TimedProof`` or
        ``ProductProof``. Certificates that it is put together of are its ``parts``.
    settings : dict
        Every setting of abstraction and search with which it was found; nothing depends on them.
    """

    problem: Problem
    proof: P_co
    settings: dict[str, Any]

    def __repr__(self) -> str:
        return tree_text(f"Certificate of {self.problem.name!r}", certificate_facts(self))

    def _repr_html_(self) -> str:
        return certificate_html(f"Certificate of {self.problem.name}", self)

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the problem."""
        return self.problem.fingerprint

    @property
    def lower_bound(self) -> float:
        """Certified lower bound on the satisfaction probability at the problem's start, or each of a set of starts."""
        bound: float = self.proof.lower_bound
        return bound

    @property
    def gap(self) -> float | None:
        """If not None, ``lower_bound + gap`` is an upper bound for these very controllers."""
        return self.proof.gap_of(self.problem)

    @property
    def upper_bound(self) -> float:
        """Upper bound on the satisfaction probability of these very controllers; 1 where nothing is known."""
        return 1.0 if self.gap is None else min(1.0, math.nextafter(self.lower_bound + self.gap, 2.0))

    @cached_property
    def controller(self) -> Any:
        """The controllers the bound belongs to."""
        return self.proof.controller(self.problem)

    @cached_property
    def claim(self) -> Any:
        """The claim about every start, with all reserves taken off: what ``at``, ``mean`` and ``min`` read.

        Raises
        ------
        ValueError
            If the certificate speaks of the problem's start alone.
        """
        require(self, Capability.OTHER_STARTS)
        return self.proof.claim(self)

    def at(self, states: Any) -> FloatArray:
        """Return lower bounds (M,) on the satisfaction probability from each of M joint initial states.

        They are bounds if ``check`` verifies the certificate, which is not asked.

        Parameters
        ----------
        states : array_like, shape (M, D) or (D,), or mapping from agent name to (d_i,) vector
            Joint states in agent order, ``D = sum d_i``, in state units. A single state gives an array of length 1.

        Raises
        ------
        ValueError
            If the shape does not fit, or the certificate speaks of the problem's start alone.
        """
        bounds: FloatArray = self.claim.at(states)
        return bounds

    def mean(self, low: Any, high: Any) -> float:
        """Return a lower bound on the satisfaction probability from a start drawn uniformly from ``[low, high)``.

        Parameters
        ----------
        low, high : array_like, shape (D,), or mappings from agent name to (d_i,) vector
            Corners in joint state space; equal ends are points. The box is averaged cell by cell, each cell with
            the letters that are certain in it.

        Raises
        ------
        ValueError
            If the shapes do not fit, or the certificate speaks of the problem's start alone.
        """
        return float(self.claim.mean(low, high))

    def min(self, low: Any, high: Any) -> float:
        """Return a lower bound on the satisfaction probability from every start in the box: the least of its cells.

        Raises
        ------
        ValueError
            If the box holds more than ``MAX_JOINT_CELLS`` joint cells, or the certificate speaks of the problem's start
            alone.
        """
        return float(self.claim.min(low, high))


def members_of(certificate: Certificate) -> tuple[Certificate, ...]:
    """Return the certificates that one is the product of: itself, but for independent tasks."""
    return certificate.proof.factors or (certificate,)


def member_agents(certificate: Certificate) -> tuple[tuple[int, ...], ...]:
    """Return the numbers of the agents that each member is about."""
    if certificate.proof.factors:
        return tuple(group.agents for group in certificate.problem.apart)
    return (tuple(range(certificate.problem.n_agents)),)


def alike_members(certificate: Certificate) -> tuple[tuple[int, ...], ...]:
    """Return the numbers of the members, those that differ in nothing but names together."""
    return alike_among(members_of(certificate))


def alike_among(parts: tuple[Certificate, ...]) -> tuple[tuple[int, ...], ...]:
    """Return the numbers of certificates, those that differ in nothing but names together."""
    if len(parts) == 1:
        return ((0,),)
    by_content: dict[object, list[int]] = {}
    for k, part in enumerate(parts):
        # Tasks that differ in names alone are synthesized once, and share their proof.
        by_content.setdefault((id(part.proof), nameless(part.problem)), []).append(k)
    return tuple(tuple(same) for same in by_content.values())


def on_cells(certificate: Certificate) -> Any:
    """Return the certificate on cells whose values are those of this one; None if there is none."""
    return certificate.proof.on_cells(certificate)


def path_under(certificate: Certificate) -> Any:
    """Return the certificate along a path that one is or rests on; None if there is none."""
    return certificate.proof.along(certificate)


def seen_by(certificate: Certificate) -> RunProjection:
    """Return how runs of a certificate's problem are seen by the one ``on_cells``."""
    return certificate.proof.seen(certificate.problem)


def start_of_claim(certificate: Certificate) -> str:
    """Return ``"point"`` if the bound holds from the initial state, ``"mean"``: on average over the initial boxes."""
    return "point" if all(agent.initial.is_point for agent in certificate.problem.agents) else "mean"


def is_exact(certificate: Certificate) -> bool:
    """Return whether the probability is known to ``EXACT_GAP``: rollouts then test the bound from both sides."""
    gap = certificate.gap
    return gap is not None and gap <= EXACT_GAP


def lasting_bound(certificate: Certificate) -> float | None:
    """Return a lower bound on satisfying a co-safe task at any time, without a deadline; None for other tasks.

    What is satisfied by the horizon stays satisfied. Afterwards controllers repeat their last choices; those of
    stationary policies are the same at all times.
    """
    return certificate.lower_bound if certificate.problem.automaton.is_co_safe else None


def relations_tried(certificate: Certificate) -> dict[str, float | str]:
    """Return the bound of each relation that was tried, or why there is none; of tasks that are alike, those of one."""
    if not certificate.proof.factors:
        return dict(certificate.settings.get("relations_tried", {}))
    tried: dict[str, float | str] = {}
    for part in _distinct(certificate):
        name = part.problem.agent_names[0]
        tried |= {f"{relation}, task of {name}": outcome for relation, outcome in relations_tried(part).items()}
    return tried


def why_nothing(certificate: Certificate) -> str:
    """Return why nothing was certified, as the search said; "" where something was, or that is not known."""
    if certificate.lower_bound > 0.0:
        return ""
    if not certificate.proof.factors:
        return str(certificate.settings.get("nothing", ""))
    told = {part.problem.agent_names[0]: why_nothing(part) for part in _distinct(certificate)}
    return "; ".join(f"task of {name}: {text}" for name, text in told.items() if text)


def _distinct(certificate: Certificate) -> list[Certificate]:
    """Return the members that differ in more than names."""
    return [members_of(certificate)[same[0]] for same in alike_members(certificate)]


def changed(certificate: Certificate[P_co], **entries: Any) -> Certificate[P_co]:
    """Return a certificate with other entries of its own, or of its proof."""
    outer = {name: entries.pop(name) for name in ("problem", "settings") if name in entries}
    proof: Any = certificate.proof
    return replace(certificate, proof=replace(proof, **entries), **outer)


def with_claims(certificate: Certificate, change: Callable[[Any], Any]) -> Certificate:
    """Return the same claim, with what a function makes of the certificates on cells that it is put together of."""
    return certificate.proof.with_claims(certificate, change)


def require(certificate: Certificate, *offers: Capability) -> None:
    """Raise ValueError, with what can be done instead, unless a certificate and its members offer all of this."""
    for offer in offers:
        for member in members_of(certificate):
            if offer in member.proof.unsupported:
                raise ValueError(f"`certificate`: expected {offer.value}, got {member.proof.unsupported[offer]}")


def nameless(problem: Problem) -> str:
    """Return everything that a certificate of the problem depends on, as text: names of agents are left out."""
    agents = [agent.to_dict() for agent in problem.agents]
    places = {agent.name: i for i, agent in enumerate(problem.agents)}
    for agent in agents:
        del agent["name"]
    regions = [{**region.to_dict(), "agent": places[region.agent]} for region in problem.propositions.values()]
    automaton = problem.automaton.to_dict()
    # Propositions are told by their place in the automaton, agents by their place in the problem.
    order = {name: k for k, name in enumerate(automaton["propositions"])}
    asked = [order[name] for name in problem.propositions]
    task = {key: value for key, value in automaton.items() if key != "propositions"}
    return json.dumps([problem.horizon, agents, regions, asked, task], sort_keys=True)
