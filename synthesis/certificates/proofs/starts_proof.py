"""Proofs from a box of starts that is cut into cells, each of which has a path of its own for the same policies.

From a start that is drawn uniformly the task fails with at most the mean of what fails from the cells, and from every
start with at most the largest of it (docs/theory/paths.md, "Networks").
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Self

from ....envs.tasks.problem import Problem
from .archive import Pool, Stored
from .certificate import Certificate
from .digits import significant_up
from .path_proof import ONE_RUN, OTHER_STARTS, GivenPolicy, PathProof, networks_in, probability
from .proof import Capability, FailureProof


@dataclass(frozen=True, eq=False)
class Cut:
    """A box of starts that is cut in two: the parts below and above a value of a state of an agent.

    A part is a path from all of it, cut again, or None, where nothing is claimed.
    """

    agent: int
    state: int
    at: float
    below: Cut | PathProof | None
    above: Cut | PathProof | None


Part = Cut | PathProof | None


@dataclass(frozen=True, eq=False, repr=False)
class StartsProof(FailureProof):
    """A bound from a box of starts, which is cut into cells.

    Parameters
    ----------
    cut : Cut
        How the box is cut, and the paths.
    networks : tuple of policies
        Those of all agents, which act from every start.
    failure, worst : float
        Upper bounds on the probability that the task fails, from a start that is drawn uniformly and from every one.
    """

    cut: Cut
    networks: tuple[GivenPolicy, ...]
    failure: float
    worst: float

    kind = "starts"
    unsupported = MappingProxyType({Capability.VALUES: ONE_RUN, Capability.OTHER_STARTS: OTHER_STARTS})
    bound = "path"

    @property
    def about(self) -> dict[str, str]:  # type: ignore[override]
        """What summaries say of it besides."""
        return super().about | {"every start": f"a failure of at most {significant_up(self.worst, 3)}"}

    @property
    def least_bound(self) -> float:
        """Certified lower bound from every start in the box, rounded down."""
        return max(0.0, math.nextafter(1.0 - self.worst, 0.0))

    @property
    def method(self) -> str:
        """How the bound was found, in words."""
        return f"policies as they are, along a run from each of {len([*self.paths])} cells of starts"

    @property
    def paths(self) -> Iterator[PathProof]:
        """The paths from all cells."""
        waiting: list[Part] = [self.cut]
        while waiting:
            part = waiting.pop()
            if isinstance(part, Cut):
                waiting += [part.below, part.above]
            elif part is not None:
                yield part

    def controller(self, problem: Problem) -> Any:
        """Return the policies, which do not ask where a run began."""
        return next(self.paths).controller(problem)

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        return {
            "failure": float(self.failure),
            "worst": float(self.worst),
            "networks": [own.description for own in self.networks],
            "cut": _written(self.cut, pool),
        }

    @classmethod
    def read(cls, problem: Problem, stored: Stored) -> Self:
        """Return the proof in a file; raise ValueError if there is none."""
        failure, worst = probability(stored.entry["failure"]), probability(stored.entry["worst"])
        networks = networks_in(problem, stored.entry["networks"])
        cut = _read(problem, stored, stored.entry["cut"], networks)
        if not isinstance(cut, Cut):
            raise ValueError("its box of starts is not cut")
        proof = cls(cut, networks, failure, worst)
        if next(proof.paths, None) is None:
            raise ValueError("nothing is claimed of any of its cells")
        return proof


OfStarts = Certificate[StartsProof]
"""A certificate from a box of starts that is cut into cells."""


def _written(part: Part, pool: Pool) -> Any:
    if isinstance(part, Cut):
        sides = {"below": _written(part.below, pool), "above": _written(part.above, pool)}
        return {"agent": part.agent, "state": part.state, "at": float(part.at), **sides}
    return None if part is None else {k: v for k, v in part.written(pool).items() if k != "networks"}


def _read(problem: Problem, stored: Stored, entry: Any, networks: tuple[GivenPolicy, ...]) -> Part:
    if entry is None:
        return None
    if "at" not in entry:
        proof = PathProof.read(problem, replace(stored, entry=entry))
        return replace(proof, networks=networks, radii=tuple(float(radius) for radius in entry["radii"]))
    i, k, at = entry["agent"], entry["state"], entry["at"]
    if type(i) is not int or type(k) is not int or type(at) is not float:
        raise ValueError("a cut of its box of starts is none")
    if not 0 <= i < problem.n_agents or not 0 <= k < problem.agents[i].n_states:
        raise ValueError("a cut of its box of starts is along no state")
    below, above = (_read(problem, stored, entry[side], networks) for side in ("below", "above"))
    return Cut(i, k, at, below, above)
