"""Certificates by subtraction: a task in which agents must keep apart, or stay near each other.

The same task with every proposition about pairs taken as usual (false, or true where the task wants it) has a
certificate by itself, on grids, with the relation ``exact`` for every agent. What its policies do is known as a
distribution. The probability that a pair is ever otherwise while it matters is bounded from above, pair by pair and
step by step, and subtracted:

    P(task)  >=  P(task without pairs)  -  sum over steps and pairs of P(undecided before, not as usual now) .

Reference: docs/theory/pairs.md, "Subtraction".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import tree_text
from ...envs.problem import Problem, problem_from_dict
from ..controllers import Controller
from ..values import UNIT
from .archive import Pool
from .certificate import Certificate
from .digits import EXACT_GAP, significant_up
from .part import AgentPart
from .summaries import certificate_facts, certificate_html
from .two_ended import Offer, TwoEnded

SPOILED = (
    "one by subtraction: what pairs of agents may spoil is bounded for the whole run from the start of its problem, "
    "and for no other state or time; it can be checked, validated, stressed, simulated, compared and reported"
)
"""What certificates by subtraction answer to whoever asks for values."""


@dataclass(frozen=True, eq=False, repr=False)
class PairsCertificate(TwoEnded):
    """A certified lower bound for a task with propositions about pairs: that without them, less what pairs may spoil.

    Parameters
    ----------
    problem : Problem
        The whole problem.
    base : Certificate
        Of the same task with every proposition about a pair taken as usual.
    usual : tuple of bool
        What each proposition about a pair is taken to be.
    near : float
        Upper bound on the probability that a pair is ever otherwise while the task is open and its automaton asks.
    settings : dict
        How it was found.
    """

    problem: Problem
    base: Certificate
    usual: tuple[bool, ...]
    near: float
    settings: dict[str, Any]

    lacks = MappingProxyType({Offer.VALUES: SPOILED})
    start = "point"
    bound = "subtraction"

    def __repr__(self) -> str:
        near = f"not as they should be with probability {self.near:.3g} at most"
        facts = [*certificate_facts(self), ("pairs", f"{len(self.problem.labeling.pairs)}, {near}")]
        return tree_text(f"PairsCertificate of {self.problem.name!r}", facts)

    def _repr_html_(self) -> str:
        return certificate_html(f"Certificate of {self.problem.name}", self)

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
            "without_pairs": pool.put_file(self.base),
        }

    @property
    def lower_bound(self) -> float:
        """Certified lower bound on the probability that the task is satisfied, rounded down."""
        return max(0.0, math.nextafter(self.base.lower_bound - self.near, -1.0))

    @property
    def gap(self) -> float | None:
        """If not None, ``lower_bound + gap`` is an upper bound on the satisfaction probability of this controller.

        It is that of the base, and what pairs may spoil once more: where they do, the task may be satisfied as well.
        """
        if self.base.gap is None:
            return None
        most = (self.base.lower_bound + self.base.gap + self.near) * (1.0 + 8.0 * UNIT)
        return min(1.0, most) - self.lower_bound

    def with_claims(self, change: Callable[[Any], Any]) -> Self:
        """Return the same claim, with what a function makes of its base; itself where its base bounds nothing above."""
        # Where pairs that are not as usual may save what is lost without them, an end of the base is none of the task.
        if not np.array_equal(self.base.problem.automaton.dead, self.problem.automaton.dead):
            return self
        return replace(self, base=self.base.with_claims(change))

    @property
    def exact(self) -> bool:
        """Whether the probability is known to ``EXACT_GAP``."""
        return self.gap is not None and self.gap <= EXACT_GAP

    @property
    def has_cells(self) -> bool:
        """Whether its base is about cells."""
        return self.base.has_cells

    @property
    def method(self) -> str:
        """Relation, policy search and bound, in words."""
        return f"{self.base.method}, less what pairs may spoil"

    @property
    def rank(self) -> int:
        """Largest number of terms of the value function without pairs."""
        return self.base.rank

    @property
    def agents(self) -> tuple[AgentPart, ...]:
        """What is stored of each agent."""
        return self.base.agents

    def at(self, states: Any) -> NoReturn:
        """Refuse: the certificate speaks of the problem's start alone (ValueError)."""
        raise ValueError(
            "`certificate`: expected one on grids, got one about pairs of agents, which says nothing of other starts; "
            "synthesize the problem with another `initial_state`"
        )

    @cached_property
    def controller(self) -> Controller:
        """The controllers the bound belongs to: every agent sees its own state, the automaton state and the time."""
        return Controller(self.problem, self.base.controller.agents)


def pairs_in(
    header: dict[str, Any], arrays: dict[str, NDArray[Any]], read: Callable[[bytes], Certificate]
) -> PairsCertificate:
    """Return the certificate that a header and its arrays describe; ``read`` reads the file of its base.

    Raises
    ------
    ValueError
        If they describe none.
    """
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    near = header["near"]
    if isinstance(near, bool) or not isinstance(near, int | float) or not 0.0 <= near <= 1.0:
        raise ValueError("its probability of being near is none")
    usual = header["usual"]
    if not isinstance(usual, list) or len(usual) != len(problem.labeling.pairs) or not {*usual} <= {True, False}:
        raise ValueError("what it takes its pairs to be does not fit the problem")
    base = read(arrays[str(int(header["without_pairs"]))].astype(np.uint8).tobytes())
    if not isinstance(header["settings"], dict) or not isinstance(base, Certificate):
        raise ValueError("its settings or its base are none")
    if len(base.agents) != problem.n_agents or base.problem.automaton.n_states != problem.automaton.n_states:
        raise ValueError("its base does not fit the problem")
    return PairsCertificate(problem, base, tuple(bool(value) for value in usual), float(near), header["settings"])
