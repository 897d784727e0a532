"""Safety without a deadline: a bound that holds for every number of steps at once.

In a bounded workspace with unbounded noise nothing stays safe for ever. What can be proved is how slowly the
probability of being safe falls: under a stationary policy, for a function 0 <= v <= 1 that is 0 where the task has
failed, let lambda be the least quotient of (P v) / v where v > 0. Then

    P(not failed within k steps) >= v(x) lambda^k    for every k

by induction, because one step of the recursion is monotone, and turns c v into at least c P v for 0 <= c <= 1. Here v
is the certificate's own value with some steps to go, and P v the one with a step more, both grown by the check
(docs/theory/bounds.md, "Safety without a deadline").
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ....envs.systems.arguments import checked_count, tree_text
from ....envs.systems.backends import on_one_thread
from ....envs.tasks.automata import Automaton
from ...certificates.proofs import (
    Capability,
    Certificate,
    OnGrid,
    certificate_on_grids,
    members_of,
    on_cells,
    require,
    rounded_down,
    start_of_claim,
)
from ...certificates.value_functions import Terms
from ...relations.grids import FloatArray
from .checked_first import standing
from .regrown_tree import regrow

SHORTEST = 4
"""Least horizon of a certificate: values with one and two steps less are read from its inside."""


@dataclass(frozen=True, eq=False, repr=False)
class SafetyRate:
    """A lower bound on the probability of staying safe, for every number of steps.

    Parameters
    ----------
    share : float
        v at the start of the problem, or its mean over the start box; a lower bound.
    rate : float
        Factor per step, a lower bound.
    loss : float
        What carrying out the policy in floating point may cost per step; an upper bound.
    certificate : Certificate
        With the stationary controllers that the bound is about.
    """

    share: float
    rate: float
    loss: float
    certificate: Certificate

    def __repr__(self) -> str:
        name = self.certificate.problem.name
        rows = [("for all k", f"P(safe for k steps) >= {self}"), ("half-life", f"{self.half_life:.6g} steps at least")]
        return tree_text(f"Safety without a deadline of {name!r}", rows)

    def __str__(self) -> str:
        less = f" - {self.loss:.2g} k" if self.loss > 0 else ""
        return f"{rounded_down(self.share)} x {rounded_down(self.rate, 12)}^k{less}"

    @property
    def half_life(self) -> float:
        """Steps after which the rate alone has halved the bound."""
        return float("inf") if self.rate >= 1 else float(np.log(0.5) / np.log(self.rate)) if self.rate > 0 else 0.0

    def at(self, steps: Any) -> FloatArray:
        """Return lower bounds on the probability of not failing within ``steps`` steps (whole numbers, any shape)."""
        k = np.asarray(steps)
        if not np.issubdtype(k.dtype, np.integer) or np.any(k < 0):
            raise ValueError(f"`steps`: expected whole numbers of at least 0, got {steps!r}")
        # Powers round by an ulp or so for each factor; take them off.
        power = self.rate ** k.astype(float) * (1.0 - 4e-16 * (k + 4.0))
        return np.clip(self.share * power - self.loss * k, 0.0, 1.0)


@on_one_thread
def safety_rate(certificate: Any) -> SafetyRate:
    """Return a bound on staying safe that holds for every number of steps at once.

    The certificate is checked first, once: relations, guards and lattices are verified before values are grown from
    them by the code of the check. For independent tasks the bounds of all tasks are multiplied.

    Parameters
    ----------
    certificate : Synthesis, certificate or path
        Of one task, or of independent ones: a safety task (semantics "finite-trace",
        satisfied as long as it has not failed), with stationary policies (``SearchOptions(stationary=True)``) and a
        horizon of at least 4. A longer horizon gives a better v.

    Returns
    -------
    SafetyRate
        A lower bound.

    Raises
    ------
    ValueError
        If the certificate is about something else, if ``check`` refuses it, or if its value function has no such
        quotient.
    """
    claim = certificate_on_grids(certificate)
    require(claim, Capability.SAME_STEPS)
    parts = [on_cells(member) for member in members_of(claim)]
    for part in parts:
        _refuse_other_kinds(part)
    standing(claim)
    rates = [_rate(part) for part in parts]
    share, rate = (float(np.prod([getattr(one, name) for one in rates])) for name in ("share", "rate"))
    reserve = 1.0 - 4e-16 * len(rates)
    return SafetyRate(share * reserve, rate * reserve, sum(one.loss for one in rates), claim)


def _rate(certificate: OnGrid) -> SafetyRate:
    """Return the bound of one task, whose certificate was checked."""
    times: dict[int, Terms] = {}

    def note(time: int, terms: Terms) -> None:
        if time in (1, 2):
            times[time] = terms

    regrow(certificate, note)
    later, now = times[2], times[1]
    live = np.flatnonzero(~certificate.problem.automaton.dead)
    claim = certificate.claim
    quotient = min((_quotient(now, later, int(q)) for q in live), default=0.0)
    rate = min(1.0, quotient * (1.0 - 2.0 * claim.relative_rounding))
    # v may be scaled until its largest value is 1, which it has where the task has not failed and no step is left.
    largest = max((_largest(later, int(q)) for q in live), default=0.0)
    if not rate > 0 or not largest > 0:
        raise ValueError("`certificate`: its value falls to 0 somewhere, which bounds nothing; try finer cells")
    read = replace(claim, value=later, correction=0.0)
    problem = certificate.problem
    starts = np.concatenate([agent.initial.low for agent in problem.agents])
    ends = np.concatenate([agent.initial.high for agent in problem.agents])
    value = float(read.at(starts)[0]) if start_of_claim(certificate) == "point" else read.mean(starts, ends)
    share = min(1.0, value / largest * (1.0 - 1e-15))
    return SafetyRate(share, rate, claim.correction / problem.horizon, certificate)


def _refuse_other_kinds(certificate: OnGrid) -> None:
    """Raise ValueError if a certificate is not of the kind that has a rate."""
    if not is_safety(certificate.problem.automaton):
        raise ValueError("`certificate`: expected a safety task, which is satisfied until it fails, such as `G safe`")
    if not certificate.proof.stationary:
        raise ValueError(
            "`certificate`: expected stationary policies; synthesize them with `search=SearchOptions(stationary=True)`"
        )
    if certificate.proof.terms is None:
        raise ValueError(
            "`certificate`: expected one with a value tree, got tensor trains, whose factors have both signs: the "
            'least quotient is not the product of the least quotients; synthesize with `value="tree"`'
        )
    if certificate.proof.bound != "nominal":
        raise ValueError("`certificate`: expected delta = 0, got relations that may be lost")
    checked_count(certificate.problem.horizon, "horizon", SHORTEST)


def is_safety(automaton: Automaton) -> bool:
    """Return whether a task is satisfied at its end if and only if it has not failed by then."""
    return not automaton.is_co_safe and np.array_equal(automaton.accepting, ~automaton.dead)


def _quotient(now: Terms, later: Terms, q: int) -> float:
    """Return a lower bound on now / later in state q, over all joint cells where the later value is positive.

    For one agent the sums are compared cell by cell. For several, term by term: ``sum a_r >= (min a_r / b_r) sum b_r``
    for whatever terms are compared, and a quotient of products is at least the product of the least quotients.
    """
    if not len(later.index[q]):
        return np.inf
    if len(later.factors) == 1:
        above, below = (terms.factors[0][terms.index[q][:, 0]].sum(axis=0) for terms in (now, later))
        return _least(above, below)
    if len(now.index[q]) != len(later.index[q]):
        return 0.0
    quotients = []
    for rows, rows_later in zip(now.index[q], later.index[q], strict=True):
        pairs = zip(now.factors, rows, later.factors, rows_later, strict=True)
        quotients.append(float(np.prod([_least(a[i], b[j]) for a, i, b, j in pairs])))
    return min(quotients)


def _least(above: FloatArray, below: FloatArray) -> float:
    """Return the least quotient where the denominator is positive."""
    positive = below > 0
    return float(np.min(above[positive] / below[positive], initial=np.inf))


def _largest(terms: Terms, q: int) -> float:
    """Return an upper bound on the value in state q."""
    return float(sum(np.prod([f[i].max() for f, i in zip(terms.factors, row)]) for row in terms.index[q]))
