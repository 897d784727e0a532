"""Certificates of small teams as one joint agent, for tasks about pairs of agents.

The problem is written with one agent whose state is the joint state, and whose outputs are those of all agents and the
differences that pairs compare. Its certificate is one of those for single agents; its controller sees all states.

Reference: docs/theory/pairs.md, "Joint agents".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import tree_text
from ...envs.problem import Problem, problem_from_dict
from ..cells import FloatArray
from ..controllers import TeamController
from .archive import Pool
from .certificate import Certificate
from .digits import shown_bound
from .part import AgentPart
from .path_certificate import PathCertificate
from .seen import Seen, SeenJointly
from .two_ended import Offer, TwoEnded

ALL_TOGETHER = (
    "that of a joint agent, whose cells are those of all states together; give its `.base`, which is about the joint "
    "agent"
)
"""What certificates of joint agents answer to whoever asks for cells of single agents."""


@dataclass(frozen=True, eq=False, repr=False)
class TeamCertificate(TwoEnded):
    """A certified lower bound for a team whose agents see one another: that of their joint agent.

    Parameters
    ----------
    problem : Problem
        The whole problem, with its agents.
    base : Certificate or PathCertificate
        Of the problem of the joint agent.
    """

    problem: Problem
    base: Certificate | PathCertificate

    @property
    def lacks(self) -> Mapping[Offer, str]:  # type: ignore[override]
        """What it does not offer: cells of single agents, and whatever its base does not offer."""
        return {Offer.OWN_STATES: ALL_TOGETHER, **self.base.lacks}

    @property
    def on_cells(self) -> Any:
        """The certificate of the joint agent, if that is on cells."""
        return self.base.on_cells

    @property
    def seen(self) -> Seen:
        """Runs of the team, as those of the joint agent."""
        return SeenJointly(self.problem)

    def __repr__(self) -> str:
        rows = [
            ("horizon", f"{self.problem.horizon} control steps"),
            ("bound", shown_bound(self.lower_bound, self.gap)),
            ("method", self.method),
            ("sees", "each agent sees the states of all"),
        ]
        return tree_text(f"TeamCertificate of {self.problem.name!r}", rows)

    @property
    def about_pairs(self) -> dict[str, str]:
        """What reports say of the agents."""
        return {"information": "every agent sees the states of all"}

    @property
    def along(self) -> Any:
        """The certificate of the joint agent, if that is along a path."""
        return self.base.along

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        return {"team": pool.put_file(self.base)}

    @property
    def lower_bound(self) -> float:
        """Certified lower bound at the problem's start."""
        return self.base.lower_bound

    @property
    def gap(self) -> float | None:
        """If not None, ``lower_bound + gap`` is an upper bound on the satisfaction probability of this controller."""
        return self.base.gap

    @property
    def exact(self) -> bool:
        """Whether the probability is known to ``EXACT_GAP``."""
        return self.base.exact

    def with_claims(self, change: Callable[[Any], Any]) -> Self:
        """Return the same claim, with what a function makes of its base."""
        return replace(self, base=self.base.with_claims(change))

    @property
    def start(self) -> str:
        """``"point"`` or ``"mean"``."""
        return self.base.start

    @property
    def bound(self) -> str:
        """Name of the bound of the joint agent."""
        return f"joint agent, {self.base.bound}"

    @property
    def has_cells(self) -> bool:
        """Whether its base is about cells."""
        return self.base.has_cells

    @property
    def method(self) -> str:
        """How the bound was found, in words."""
        return f"joint agent that sees all states: {self.base.method}"

    @property
    def rank(self) -> int:
        """Largest number of terms of the value function."""
        return self.base.rank

    @property
    def agents(self) -> tuple[AgentPart, ...]:
        """What is stored of the joint agent: one part, whose grid coordinates are those of all agents in order."""
        if self.base.on_cells is None:
            raise ValueError("`certificate`: expected one on grids, got one along a path, which has no cells")
        parts: tuple[AgentPart, ...] = self.base.on_cells.agents
        return parts

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the synthesis of the joint agent."""
        return self.base.settings

    @cached_property
    def controller(self) -> TeamController:
        """The controllers the bound belongs to: each agent sees the states of all."""
        return TeamController(self.problem, self.base.controller)

    def at(self, states: Any) -> FloatArray:
        """Return lower bounds (M,) from joint initial states (M, D); ValueError for certificates along a path."""
        if self.base.on_cells is None:
            raise ValueError("`certificate`: expected one on grids, got one along a path, which holds from its start")
        return self.base.at(states)


def team_in(
    header: dict[str, Any], arrays: dict[str, NDArray[Any]], read: Callable[[bytes], Certificate | PathCertificate]
) -> TeamCertificate:
    """Return the certificate of a joint agent that a header and its arrays describe; raise ValueError otherwise."""
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    base = read(arrays[str(int(header["team"]))].astype(np.uint8).tobytes())
    if base.problem.n_agents != 1 or base.problem.n_states != problem.n_states:
        raise ValueError("its base does not fit the problem")
    return TeamCertificate(problem, base)
