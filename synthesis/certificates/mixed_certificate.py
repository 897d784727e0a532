"""Certificates of mixed teams: some agents on grids, the others along paths, and pairs between them.

Agents along paths keep, with a certified probability, the letters of their path, and are in a tube around it. Agents on
grids have a task of their own: that of the team with these letters, and with pairs of both kinds of agents taken as
usual. What such pairs may spoil is subtracted. The position of an agent along a path is a normal number up to its
drift, by which the box of a pair is made wider:

    P(task)  >=  P(paths kept) P(task on grids)  -  sum over steps and pairs of P(undecided, near a wider box) .

Reference: docs/theory/pairs.md, "Mixed teams".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import tree_text
from ...envs.problem import Problem, problem_from_dict
from ..controllers import MixedController
from ..values import UNIT
from .archive import Pool
from .certificate import Certificate
from .digits import shown_bound, significant_up
from .mixed_states import known_letters, reached_states
from .pairs_certificate import SPOILED, PairsCertificate
from .part import AgentPart
from .path_certificate import PathCertificate
from .two_ended import Offer, TwoEnded


@dataclass(frozen=True, eq=False, repr=False)
class MixedCertificate(TwoEnded):
    """A certified lower bound for a team of which some agents are on grids and the others along paths.

    Parameters
    ----------
    problem : Problem
        The whole problem.
    grids : Certificate or PairsCertificate
        Of the agents on grids: their task while the others keep their letters.
    paths : PathCertificate
        Of the others: that they keep the letters of their paths.
    usual : tuple of bool
        What each proposition about a pair of the whole problem is taken to be, if it is about agents of both kinds.
    near : float
        Upper bound on the probability that such a pair is ever otherwise while the task is open and asks for it.
    settings : dict
        How it was found.
    """

    problem: Problem
    grids: Certificate | PairsCertificate
    paths: PathCertificate
    usual: tuple[bool, ...]
    near: float
    settings: dict[str, Any]

    lacks = MappingProxyType({Offer.VALUES: SPOILED})
    bound = "mixed"
    gap = None
    exact = False
    has_cells = False

    def __repr__(self) -> str:
        rows = [
            ("horizon", f"{self.problem.horizon} control steps"),
            ("bound", shown_bound(self.lower_bound, None)),
            ("on grids", f"{', '.join(self.grids.problem.agent_names)}: {shown_bound(self.grids.lower_bound, None)}"),
            ("along paths", f"{', '.join(self.paths.problem.agent_names)}: fail at most with {self.paths.failure:.3g}"),
            ("pairs", f"not as they should be with probability {self.near:.3g} at most"),
        ]
        return tree_text(f"MixedCertificate of {self.problem.name!r}", rows)

    @property
    def about_pairs(self) -> dict[str, str]:
        """What reports say of pairs of agents."""
        return {"pairs": f"not as they should be with probability {significant_up(self.near, 3)} at most"}

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        return {
            "settings": self.settings,
            "near": float(self.near),
            "usual": list(self.usual),
            "mixed": [pool.put_file(part) for part in (self.grids, self.paths)],
        }

    @property
    def lower_bound(self) -> float:
        """Certified lower bound on the probability that the task is satisfied, rounded down."""
        both = self.grids.lower_bound * self.paths.lower_bound * (1.0 - 4.0 * UNIT)
        return max(0.0, math.nextafter(both - self.near, -1.0))

    @property
    def start(self) -> str:
        """``"mean"`` where a start is drawn from a box, else ``"point"``."""
        return "mean" if "mean" in (self.grids.start, self.paths.start) else "point"

    @property
    def method(self) -> str:
        """How the bound was found, in words."""
        return f"mixed team: {self.grids.method}; {self.paths.method}; less what pairs between them may spoil"

    @property
    def rank(self) -> int:
        """Largest number of terms of the value function on grids."""
        return self.grids.rank

    @property
    def agents(self) -> tuple[AgentPart, ...]:
        """Refuse: not all agents have cells (ValueError)."""
        raise ValueError("`certificate`: expected one on grids, got one of a mixed team; take its `.grids`")

    @cached_property
    def states(self) -> NDArray[np.int64]:
        """Automaton states (S + 1, Q) of the task on grids that go with those of the whole one; -1 for none."""
        usual = np.array(self.usual, dtype=bool)
        known = known_letters(self.problem, self.paths, usual)
        table = np.full((len(known), self.problem.automaton.n_states), -1, dtype=np.int64)
        for t, together in enumerate(reached_states(self.problem, self.grids.problem, known)):
            for q, b in sorted(together):
                if self.grids.problem.automaton.absorbing[b]:
                    continue  # nothing is left to decide, so that nobody asks any more
                if table[t, q] not in (-1, b):
                    raise ValueError("a state of the task goes with two states of the task on grids")
                table[t, q] = b
        return table

    @cached_property
    def controller(self) -> MixedController:
        """The controllers the bound belongs to: every agent sees its own state, the automaton state and the time."""
        return MixedController(self.problem, self.grids.controller, self.paths.controller, self.states)

    def at(self, states: Any) -> NoReturn:
        """Refuse: the certificate speaks of the problem's start alone (ValueError)."""
        raise ValueError(
            "`certificate`: expected one on grids, got one of a mixed team, which says nothing of other starts; "
            "synthesize the problem with another `initial_state`"
        )


def mixed_in(
    header: dict[str, Any],
    arrays: dict[str, NDArray[Any]],
    read: Callable[[bytes], Certificate | PathCertificate | PairsCertificate],
) -> MixedCertificate:
    """Return the certificate of a mixed team that a header and its arrays describe; raise ValueError otherwise."""
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    near, usual = header["near"], header["usual"]
    if isinstance(near, bool) or not isinstance(near, int | float) or not 0.0 <= near <= 1.0:
        raise ValueError("its probability of being near is none")
    if not isinstance(usual, list) or len(usual) != len(problem.labeling.pairs) or not {*usual} <= {True, False}:
        raise ValueError("what it takes its pairs to be does not fit the problem")
    grids, paths = (read(arrays[str(int(number))].astype(np.uint8).tobytes()) for number in header["mixed"])
    if not isinstance(paths, PathCertificate) or isinstance(grids, PathCertificate):
        raise ValueError("its parts are not one on grids and one along paths")
    if not isinstance(header["settings"], dict):
        raise ValueError("its settings are none")
    values = tuple(bool(value) for value in usual)
    return MixedCertificate(problem, grids, paths, values, float(near), header["settings"])
