"""The rule of a shield: which inputs are let through, and what becomes of the budget.

A run carries a budget b, at most the certified value V of its state: the success probability that is still owed. The
team's inputs are let through if ``Q >= b``; otherwise the inputs move along the line to the certified ones, as far as
needed. With Q of the inputs that are applied, and the value V' of the next state under its true letter,

    rho = min(1, b / Q)   (0 if b = 0),        b' = rho V'.

Then ``E b' >= b`` and ``b' <= V'`` (docs/theory/shields.md, "The budget"). Everything fails closed: where Q is not
known, the certified inputs are taken, for which ``E V' >= V >= b`` was proved.

``joint``           the inputs of all agents are judged together.
``decentralised``   each agent judges its own input: the factor kappa_i by which it may lower Q is at least its share of
                    ``b / Q`` (of the certified inputs), so that all of them together keep ``Q >= b``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...relations.grids import FloatArray
from .q_values import ActionValues, pieces
from .vertex_action_values import VertexActionValues

Valued = ActionValues | VertexActionValues
"""What says what states and inputs are worth under a certificate."""

ROUNDS = 2
"""Points that are tried on the line to the certified input; each costs as much as judging the proposal."""

SHORT = 0.95
"""Share of the way to where a secant meets the boundary at which a point is tried: worth is rarely straight."""

WORTHWHILE = 1e-6
"""Relative surplus of the certified input below which nothing else is looked for on the line."""

MARGIN = 1e-11
"""Relative reserve on each agent's share, far above the rounding of ratios, roots and products."""


@dataclass(frozen=True, eq=False)
class Case:
    """Worlds at one time and in one automaton state, and what is proposed there.

    Parameters
    ----------
    time, q : int
    states : tuple of (d_i, M) arrays
    proposed, certified : tuples of (m_i, M) arrays
        Inputs inside their boxes; proposed ones may be no numbers.
    low, high : tuples of (m_i, 1) arrays
        Input boxes.
    budget : (M,) array
    """

    time: int
    q: int
    states: tuple[FloatArray, ...]
    proposed: tuple[FloatArray, ...]
    certified: tuple[FloatArray, ...]
    low: tuple[FloatArray, ...]
    high: tuple[FloatArray, ...]
    budget: FloatArray

    def selected(self, which: NDArray[Any]) -> Case:
        """Return the case of some of the worlds."""
        states, proposed, certified = (
            tuple(array[:, which] for array in arrays) for arrays in (self.states, self.proposed, self.certified)
        )
        return Case(self.time, self.q, states, proposed, certified, self.low, self.high, self.budget[which])

    def between(self, i: int, share: FloatArray) -> FloatArray:
        """Return inputs (m, M) of agent i on the line from the certified (share 0) to the proposed ones (share 1)."""
        line = self.certified[i] + share * (self.proposed[i] - self.certified[i])
        return np.minimum(np.maximum(line, self.low[i]), self.high[i])  # rounding may lead out of the box


@dataclass(frozen=True, eq=False)
class Choice:
    """What is applied.

    Parameters
    ----------
    inputs : tuple of (m_i, M) arrays
    ratio : (M,) array
        ``rho``: the budget of the next state is ``ratio`` times its value.
    overridden : (I, M) bool array
        Whose proposal was not let through.
    """

    inputs: tuple[FloatArray, ...]
    ratio: FloatArray
    overridden: NDArray[np.bool_]


def joint_choice(values: Valued, case: Case) -> Choice:
    """Return what is applied if the inputs of all agents are judged together."""
    q_values = values.of_inputs(case.time, case.q, case.states, case.proposed)
    # A comparison with what is no number is false: the proposal is refused.
    refused = np.flatnonzero(~(q_values >= case.budget))
    inputs = tuple(u.copy() for u in case.proposed)
    if len(refused):
        replaced, q_values[refused] = _towards_certified(values, case.selected(refused), q_values[refused])
        for u, new in zip(inputs, replaced, strict=True):
            u[:, refused] = new
    overridden = np.zeros((len(inputs), len(q_values)), dtype=bool)
    overridden[:, refused] = True
    return Choice(inputs, ratio_of(case.budget, q_values), overridden)


def _towards_certified(values: Valued, case: Case, q_values: FloatArray) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Return inputs on the line to the certified ones, and their Q; ``q_values`` (M,) is Q of the proposed ones.

    Every point that is taken was judged itself; Q need not fall along the line.
    """
    inputs = tuple(u.copy() for u in case.certified)
    found = values.of_inputs(case.time, case.q, case.states, case.certified)
    search = Line.between(found, q_values)
    for _ in range(ROUNDS):
        trying = np.flatnonzero(found > case.budget * (1.0 + WORTHWHILE))
        if not len(trying):
            break
        here, share = case.selected(trying), search.next_point(case.budget)[trying]
        tried = tuple(here.between(i, share) for i in range(len(inputs)))
        reached = values.of_inputs(here.time, here.q, here.states, tried)
        allowed = reached >= here.budget
        search.note(trying, share, reached, allowed)
        found[trying[allowed]] = reached[allowed]
        for u, new in zip(inputs, tried, strict=True):
            u[:, trying[allowed]] = new[:, allowed]
    return inputs, found


@dataclass(frozen=True, eq=False)
class Line:
    """What is known on lines from certified inputs (share 0) to proposed ones (share 1): the last point that was
    allowed, the first one that was not, and their worth, (M,) each."""

    near: FloatArray
    far: FloatArray
    near_worth: FloatArray
    far_worth: FloatArray

    @classmethod
    def between(cls, certified: FloatArray, proposed: FloatArray) -> Line:
        """Return the line whose ends have these worths; a worth that is no number counts as 0."""
        return cls(np.zeros(len(certified)), np.ones(len(certified)), certified.copy(), np.nan_to_num(proposed))

    def next_point(self, needed: FloatArray) -> FloatArray:
        """Return shares (M,) a little before the points at which secants meet what is needed (M,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            part = (self.near_worth - needed) / (self.near_worth - self.far_worth)
        return self.near + SHORT * np.clip(np.nan_to_num(part), 0.0, 1.0) * (self.far - self.near)

    def note(
        self, which: NDArray[np.int64], share: FloatArray, q_values: FloatArray, allowed: NDArray[np.bool_]
    ) -> None:
        """Note what was found at shares (m,) of the worlds ``which`` (m,)."""
        good, bad = which[allowed], which[~allowed]
        self.near[good], self.near_worth[good] = share[allowed], q_values[allowed]
        self.far[bad], self.far_worth[bad] = share[~allowed], np.nan_to_num(q_values[~allowed])


def decentralised_choice(values: Valued, case: Case) -> Choice:
    """Return what is applied if each agent judges its own input; budget and Q of the certified inputs are shared."""
    count = len(case.states)
    inputs = tuple(u.copy() for u in case.certified)
    q_values, overridden = np.empty(len(case.budget)), np.zeros((count, len(case.budget)), dtype=bool)
    for some in pieces(np.arange(len(q_values)), count * values.work(case.time, case.q)):
        here = case.selected(some)
        base = [values.expected(here.time, here.q, i, here.states, here.certified[i]) for i in range(count)]
        threshold = _share_of_each(np.prod(base, axis=0).sum(axis=0), here.budget, count)
        product: Any = 1.0
        for i in range(count):
            own, factors, let_through = _agents_choice(values, here, i, base[i], threshold)
            inputs[i][:, some], overridden[i, some] = own, ~let_through
            product = product * factors
        q_values[some] = product.sum(axis=0)
    return Choice(inputs, ratio_of(case.budget, q_values), overridden)


def _share_of_each(certified: FloatArray, budget: FloatArray, count: int) -> FloatArray:
    """Return the least kappa (M,) of each of ``count`` agents, given Q (M,) of the certified inputs.

    Where that is below the budget, by rounding, nobody may leave the certified input.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (budget / certified) ** (1.0 / count) * (1.0 + MARGIN)
    return np.where(budget == 0.0, 0.0, np.where(certified >= budget, share, np.inf))


def _agents_choice(
    values: Valued, case: Case, i: int, base: FloatArray, threshold: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return the input (m, M) of agent i, its factors (R, M) there, and whether its proposal was let through (M,)."""
    count = len(threshold)
    inputs, factors = case.certified[i].copy(), base.copy()

    def judge(tried: FloatArray, which: NDArray[np.int64]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Take the inputs that are allowed among those tried in the worlds ``which``; return kappa, and which are."""
        found = values.expected(case.time, case.q, i, tuple(x[:, which] for x in case.states), tried)
        ratio = kappa(found, base[:, which])
        # What is no number has no ratio where the certified factors are all 0: it is refused by itself.
        # Where the certified factors are worth less than is owed nobody may leave them: inf is no threshold to reach.
        allowed = (ratio >= threshold[which]) & np.isfinite(threshold[which]) & np.isfinite(tried).all(axis=0)
        taken = which[allowed]
        inputs[:, taken], factors[:, taken] = tried[:, allowed], found[:, allowed]
        return ratio, allowed

    ratio, let_through = judge(case.proposed[i], np.arange(count))
    refused = np.flatnonzero(~let_through & (threshold < 1.0 - WORTHWHILE))
    rest, search = case.selected(refused), Line.between(np.ones(len(refused)), ratio[refused])
    for _ in range(ROUNDS if len(refused) else 0):
        share = search.next_point(threshold[refused])
        ratio, allowed = judge(rest.between(i, share), refused)
        search.note(np.arange(len(refused)), share, ratio, allowed)
    return inputs, factors, let_through


def kappa(factors: FloatArray, base: FloatArray) -> FloatArray:
    """Return the least ratio (M,) of factors (R, M) to those of the certified input, over terms where these are > 0.

    Infinite where there is no such term: the agent cannot lower a sum to which nothing contributes.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(base > 0.0, factors / base, np.inf)
    return np.asarray(ratios.min(axis=0, initial=np.inf))


def ratio_of(budget: FloatArray, q_values: FloatArray) -> FloatArray:
    """Return ``min(1, b / Q)`` (M,): 0 where nothing is owed, 1 where Q is 0 or no number."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(q_values > budget, budget / q_values, 1.0)
    return np.where(budget == 0.0, 0.0, ratio)
