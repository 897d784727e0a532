"""Certificates on grids of problems that name the time: those of the same problems written out without it.

Regions that move are a region for each place, the automaton counts steps, and dynamics that name the time have it as an
input, the clock, which policies have to set to the time at every step. Then runs, letters and verdicts of both problems
are the same (docs/theory/time.md, "Written out").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import tree_text
from ...envs.problem import Problem, problem_from_dict, states_in_time, written_out
from ..cells import FloatArray
from ..controllers import TimedController
from .archive import Pool
from .certificate import Certificate
from .digits import shown_bound
from .part import AgentPart
from .seen import Seen, SeenInTime
from .two_ended import Offer, TwoEnded

IN_TIME = (
    "one of a problem that names the time `t`, of whose steps nothing is said beyond its horizon; its `.base` is about "
    "the problem written out without the time"
)
"""What certificates of problems that name the time answer to whoever asks what happens later."""


@dataclass(frozen=True, eq=False, repr=False)
class TimedCertificate(TwoEnded):
    """A certified lower bound for a problem that names the time: that of the problem written out.

    Parameters
    ----------
    problem : Problem
        The problem that names the time.
    base : Certificate
        Of the problem written out, whatever problem it says that it is about.

    Raises
    ------
    ValueError
        If the problem cannot be written out.
    """

    problem: Problem
    base: Certificate

    lacks = MappingProxyType({Offer.SAME_STEPS: IN_TIME})

    def __post_init__(self) -> None:
        object.__setattr__(self, "base", replace(self.base, problem=written_out(self.problem)))

    @property
    def on_cells(self) -> Any:
        """The certificate of the problem written out."""
        return self.base

    @cached_property
    def seen(self) -> Seen:
        """Runs of the problem, as those of the problem written out."""
        clocks = tuple(bool(agent.has_clock) for agent in self.base.problem.agents)
        return SeenInTime(self.problem, self.states_in_time, clocks)

    def __repr__(self) -> str:
        rows = [
            ("horizon", f"{self.problem.horizon} control steps"),
            ("bound", shown_bound(self.lower_bound, self.gap)),
            ("method", self.method),
        ]
        return tree_text(f"TimedCertificate of {self.problem.name!r}", rows)

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        return {"written_out": pool.put_file(self.base)}

    @property
    def lower_bound(self) -> float:
        """Certified lower bound at the problem's start."""
        return self.base.lower_bound

    @property
    def gap(self) -> float | None:
        """If not None, ``lower_bound + gap`` is an upper bound on the satisfaction probability of this controller."""
        return self.base.gap

    def with_claims(self, change: Callable[[Any], Any]) -> Self:
        """Return the same claim, with what a function makes of its base."""
        return replace(self, base=self.base.with_claims(change))

    @property
    def exact(self) -> bool:
        """Whether the probability is known to ``EXACT_GAP``."""
        return self.base.exact

    @property
    def start(self) -> str:
        """``"point"`` or ``"mean"``."""
        return self.base.start

    @property
    def bound(self) -> str:
        """Name of the bound of the problem written out."""
        return self.base.bound

    @property
    def has_cells(self) -> bool:
        """Whether it is about cells: it is."""
        return True

    @property
    def method(self) -> str:
        """How the bound was found, in words."""
        return f"written out in time: {self.base.method}"

    @property
    def rank(self) -> int:
        """Largest number of terms of the value function."""
        return self.base.rank

    @property
    def agents(self) -> tuple[AgentPart, ...]:
        """What is stored of each agent."""
        return self.base.agents

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the synthesis of the problem written out."""
        return self.base.settings

    @cached_property
    def states_in_time(self) -> NDArray[np.int64]:
        """Automaton states (T + 1, Q) of the problem written out that go with those of the problem; -1 for none."""
        return states_in_time(self.problem, self.base.problem)

    @cached_property
    def controller(self) -> TimedController:
        """The controllers the bound belongs to."""
        return TimedController(self.problem, self.base.controller, self.states_in_time)

    def at(self, states: Any) -> FloatArray:
        """Return lower bounds (M,) from joint initial states (M, D), in any form that ``Certificate.at`` takes."""
        return self.base.at(states)


def timed_in(
    header: dict[str, Any], arrays: dict[str, NDArray[Any]], read: Callable[[bytes], Certificate]
) -> TimedCertificate:
    """Return the certificate of a problem that names the time, from a header and arrays; raise ValueError otherwise."""
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    base = read(arrays[str(int(header["written_out"]))].astype(np.uint8).tobytes())
    certificate = TimedCertificate(problem, base)
    if certificate.base.fingerprint != base.fingerprint:
        raise ValueError("its base is not its problem written out")
    return certificate
