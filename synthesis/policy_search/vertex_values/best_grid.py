"""The best proof on finer and finer grids, and when no finer one is tried."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

from ....envs.tasks.problem import Problem
from ...certificates.proofs import Certificate, Synthesis, VertexProof, VertexTeamProof
from ...checker import Refused
from ...relations.grids import RelationRefused
from ...trajectories.planning import CountedWork
from .counted_backups import BrokenOff
from .sampled_runs import MANY, RUNS

AIMS, LOWERED = (0.005, 0.02), 0.3
"""Failure that the first grid aims at, unless no more is hoped for: laws that lose little beside it are not made anew.
Later ones aim at a share of what the grid before failed by, and at this share of what it aimed at at least: with many
more laws work would grow in a way that the grid before does not tell."""

ENOUGH = 1e-5
"""Failure from which no finer grid is tried."""

GAINS = 0.02
"""Share of the failure that the last grid has to have taken off for a finer one to be tried, once there is a bound."""

LEFT, SEEN = (0.3, 1e-3), 30
"""No finer grid is tried where so little of the failure is charged, as a share and in all, that the rest is what the
controller itself fails by, as far as its runs say: where it fails in so many of them.
"""

CLAIMED = 1.0 + 1e-5
"""Factor on the failure that is claimed: other machines add in another order, in single precision where values bend."""

Proof = TypeVar("Proof", VertexProof, VertexTeamProof)


class BestGrid(Generic[Proof]):
    """The best proof so far, the bound of each level, and the failure that the next one aims at."""

    def __init__(self, work: CountedWork) -> None:
        self.work, self.began = work, time.perf_counter()
        self.proof: Proof | None = None
        self.levels, self.aim, self.is_slow = dict[str, float](), AIMS[0], False

    def tried(self, sizes: str, failure: float) -> bool:
        """Keep the bound of a level, and return whether its proof is the best so far."""
        self.levels[sizes] = 1.0 - failure
        self.aim = min(self.aim, max(AIMS[1] * failure, LOWERED * self.aim))
        before = None if self.proof is None else self.proof.failure
        self.is_slow = before is not None and before < 1.0 and failure > (1.0 - GAINS) * before
        return before is None or failure < before

    def keep(self, proof: Proof, failure: float) -> None:
        """Keep a proof, whose bound is told."""
        self.proof = proof
        self.work.tell(failure)

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Let Ctrl-C, seconds that are over, and a grid that is refused leave what was found; RelationRefused else."""
        try:
            yield
        except KeyboardInterrupt:
            if self.proof is None or self.proof.failure >= 1.0:
                raise
            self.work.is_interrupted = True
        except BrokenOff:
            pass
        except Refused as reason:
            if self.proof is None:
                raise RelationRefused(str(reason)) from reason
        if self.proof is None or self.proof.failure >= 1.0:
            raise RelationRefused(
                f"nothing is proved on grids of {', '.join(self.levels) or 'few'} cells; ask for more `effort`"
            )

    def synthesis(self, problem: Problem) -> Synthesis:
        """Return the certificate of the best proof."""
        assert self.proof is not None
        certificate = Certificate(problem, self.proof, {"relation": "vertex grid", "levels": self.levels})
        seconds = {"abstract": 0.0, "synthesize": time.perf_counter() - self.began}
        stats: dict[str, Any] = {
            "seconds": seconds,
            "rank": self.proof.rank,
            "sweeps": [],
            "starts": {},
            "dropped": 0.0,
        }
        stats |= dict.fromkeys(("abstract_upper_bound", "continuous_upper_bound", "unilateral_gain"))
        return Synthesis(certificate, certificate.controller, stats)


def left_over(failure: float) -> float | None:
    """Return what runs have to fail by for a failure to be the controller's own; None where runs could not tell."""
    return failure - min(LEFT[0] * failure, LEFT[1]) if failure > SEEN / (MANY * RUNS) else None
