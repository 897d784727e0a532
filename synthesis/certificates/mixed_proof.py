"""Proofs for mixed teams: some agents on grids, the others along paths, and pairs between them.

Agents along paths keep, with a certified probability, the letters of their path, and are in a tube around it. Agents on
grids have a task of their own: that of the team with these letters, and with pairs of both kinds of agents taken as
usual. What such pairs may spoil is subtracted. The position of an agent along a path is a normal number up to its
drift, by which the box of a pair is made wider:

    P(task)  >=  P(paths kept) P(task on grids)  -  sum over steps and pairs of P(undecided, near a wider box) .

Reference: docs/theory/pairs.md, "Mixed teams".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from ...envs.problem import Problem
from ..controllers import MixedController
from ..values import UNIT
from .archive import Pool, Stored
from .certificate import Certificate
from .digits import shown_bound
from .mixed_states import known_letters, reached_states
from .path_proof import AlongPath, probability
from .proof import Offer, Proof
from .subtraction_proof import SPOILED, spoiled_at_most, usual_in

OTHER_STARTS = (
    "one of a mixed team, which says nothing of other starts; synthesize the problem with another `initial_state`"
)
"""What certificates of mixed teams answer to whoever asks for other starts."""


@dataclass(frozen=True, eq=False, repr=False)
class MixedProof(Proof):
    """A bound for a team of which some agents are on grids and the others along paths.

    Parameters
    ----------
    grids : Certificate
        Of the agents on grids, by a grid or by subtraction: their task while the others keep their letters.
    paths : Certificate
        Of the others, along paths: that they keep the letters of their paths.
    usual : tuple of bool
        What each proposition about a pair of the whole problem is taken to be, if it is about agents of both kinds.
    near : float
        Upper bound on the probability that such a pair is ever otherwise while the task is open and asks for it.
    """

    grids: Certificate
    paths: AlongPath
    usual: tuple[bool, ...]
    near: float

    kind = "mixed"
    inside = frozenset({"grid", "path", "subtraction"})
    lacks = MappingProxyType({Offer.VALUES: SPOILED, Offer.OTHER_STARTS: OTHER_STARTS})
    bound = "mixed"
    gap = None

    @property
    def parts(self) -> tuple[Certificate, ...]:
        """Those of the agents on grids, and of the others."""
        return self.grids, self.paths

    @property
    def about(self) -> dict[str, str]:  # type: ignore[override]
        """What reports say of both kinds of agents, and of pairs of them."""
        told = zip(("on grids", "along paths"), self.parts, strict=True)
        agents = {name: f"{', '.join(p.problem.agent_names)}: {shown_bound(p.lower_bound, None)}" for name, p in told}
        return agents | spoiled_at_most(self.near)

    @property
    def lower_bound(self) -> float:
        """Certified lower bound on the probability that the task is satisfied, rounded down."""
        both = self.grids.lower_bound * self.paths.lower_bound * (1.0 - 4.0 * UNIT)
        return max(0.0, math.nextafter(both - self.near, -1.0))

    @property
    def method(self) -> str:
        """How the bound was found, in words."""
        methods = f"{self.grids.proof.method}; {self.paths.proof.method}"
        return f"mixed team: {methods}; less what pairs between them may spoil"

    @property
    def rank(self) -> int:
        """Largest number of terms of the value function on grids."""
        rank: int = self.grids.proof.rank
        return rank

    def agents_of(self, problem: Problem) -> NoReturn:
        """Refuse: not all agents have cells (ValueError)."""
        raise ValueError("`certificate`: expected one on grids, got one of a mixed team; take its `.proof.grids`")

    def states_on_grids(self, problem: Problem) -> NDArray[np.int64]:
        """Return automaton states (S + 1, Q) of the task on grids that go with those of the whole one; -1 for none."""
        usual = np.array(self.usual, dtype=bool)
        known = known_letters(problem, self.paths, usual)
        table = np.full((len(known), problem.automaton.n_states), -1, dtype=np.int64)
        for t, together in enumerate(reached_states(problem, self.grids.problem, known)):
            for q, b in sorted(together):
                if self.grids.problem.automaton.absorbing[b]:
                    continue  # nothing is left to decide, so that nobody asks any more
                if table[t, q] not in (-1, b):
                    raise ValueError("a state of the task goes with two states of the task on grids")
                table[t, q] = b
        return table

    def controller(self, problem: Problem) -> MixedController:
        """Return the controllers: every agent sees its own state, the automaton state and the time."""
        return MixedController(problem, self.grids.controller, self.paths.controller, self.states_on_grids(problem))

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        parts = [pool.put_file(part) for part in self.parts]
        return {"near": float(self.near), "usual": list(self.usual), "parts": parts}

    @classmethod
    def read(cls, problem: Problem, stored: Stored) -> Self:
        """Return the proof in a file; raise ValueError if there is none."""
        near, usual = probability(stored.entry["near"]), usual_in(problem, stored)
        grids, paths = (stored.certificate(number) for number in stored.entry["parts"])
        if not grids.proof.has_cells or paths.proof.along(paths) is None:
            raise ValueError("its parts are not one on grids and one along paths")
        return cls(grids, paths, usual, near)
