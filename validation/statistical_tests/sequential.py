"""Anytime-valid evidence: test a bound after every episode and stop as soon as it is confirmed or refuted.

An *e-process* against a hypothesis starts at 1. If the hypothesis is true, the process ever reaches ``1 / alpha`` with
probability at most alpha (Ville's inequality), so one may look at it after every episode. Against ``P >= l`` we use the
likelihood ratio of a Beta mixture over ``p <= l`` to ``l``,

    E_n = integral_0^l (p/l)^k ((1-p)/(1-l))^(n-k) dBeta(p | p <= l).

It is a supermartingale for every P >= l *because the mixture stops at l*: a mixture that is not truncated would reject
true hypotheses (docs/theory/evidence.md, "Stopping early"). Against ``P <= l`` the mixture covers ``[l, 1]``. Episodes
enter in the order of their index.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, betaln, xlog1py, xlogy

from .binomial import CONFIRMED, CONSISTENT, REFUTED, VACUOUS, check_confidence, says_nothing

PRIOR = (0.5, 0.5)
"""Beta prior of the mixtures: Jeffreys' prior, which favours no region of P and has power near 0 and 1, too."""

BISECTIONS = 80
"""Steps of a bisection of an interval of length at most 1: more than a float64 can tell apart."""


def log_e_at_least(successes: Any, episodes: Any, bound: float, prior: tuple[float, float] = PRIOR) -> NDArray[Any]:
    """Return the logarithm of the e-process against ``P >= bound`` after so many episodes and successes.

    Parameters
    ----------
    successes, episodes : array_like
        Broadcast against each other.
    bound : float
    prior : tuple of float
        Both parameters of the Beta mixture before it is truncated.

    Examples
    --------
    With a uniform prior and no success in one episode, ``2 integral_0^(1/2) 2 (1 - p) dp = 3/2``:

    >>> round(float(np.exp(log_e_at_least(0, 1, 0.5, (1.0, 1.0)))), 9)
    1.5
    """
    k, n = np.asarray(successes, dtype=float), np.asarray(episodes, dtype=float)
    if bound <= 0.0:
        return np.zeros(np.broadcast(k, n).shape)  # P >= 0 is never wrong
    a, b = prior
    # The integral of the mixture is an incomplete beta function; the truncated prior is divided by its mass.
    with np.errstate(divide="ignore", invalid="ignore"):
        mixture = betaln(a + k, b + n - k) + np.log(betainc(a + k, b + n - k, min(bound, 1.0)))
        truncation = betaln(a, b) + np.log(betainc(a, b, min(bound, 1.0)))
        result = mixture - truncation - xlogy(k, bound) - xlog1py(n - k, -bound)
    # An incomplete beta function that underflows leaves -inf or inf - inf: no evidence against the hypothesis.
    return np.asarray(np.where(np.isnan(result), -np.inf, result))


def log_e_at_most(successes: Any, episodes: Any, bound: float, prior: tuple[float, float] = PRIOR) -> NDArray[Any]:
    """Return the logarithm of the e-process against ``P <= bound``; see ``log_e_at_least``."""
    # P <= l says that failures have probability at least 1 - l.
    n = np.asarray(episodes, dtype=float)
    return log_e_at_least(n - np.asarray(successes, dtype=float), n, 1.0 - bound, prior[::-1])


def confidence_sequence(
    successes: int, episodes: int, confidence: float, prior: tuple[float, float] = PRIOR
) -> tuple[float, float]:
    """Return limits on P that hold at all times together with probability at least ``confidence``.

    They consist of all p that Robbins' untruncated mixture has not rejected by now.

    Examples
    --------
    >>> low, high = confidence_sequence(50, 100, 0.95)
    >>> round(low, 3), round(high, 3)
    (0.338, 0.662)
    """
    check_confidence(confidence)
    k, n, (a, b) = successes, episodes, prior
    mixture = float(betaln(a + k, b + n - k) - betaln(a, b))

    def excluded(p: float) -> bool:
        return mixture - float(xlogy(k, p) + xlog1py(n - k, -p)) >= -np.log1p(-confidence)

    return _edge(excluded, k / n, 0.0), _edge(excluded, k / n, 1.0)


def _edge(excluded: Any, inner: float, outer: float) -> float:
    """Return the edge between ``inner``, not excluded, and ``outer``, on the excluded side; ``outer`` if there is none.

    Bisection keeps ``inner`` inside and ``outer`` excluded, so that rounding widens the limits.
    """
    if not excluded(outer):
        return outer
    for _ in range(BISECTIONS):
        middle = 0.5 * (inner + outer)
        if excluded(middle):
            outer = middle
        else:
            inner = middle
    return outer


@dataclass(frozen=True)
class SequentialState:
    """The evidence of the episodes so far; ``advance`` returns the next state.

    Parameters
    ----------
    lower, gap, confidence
        The claim ``P >= lower`` (and ``P <= lower + gap`` unless ``gap`` is None). Whenever one stops, a wrong answer
        has probability at most ``(1 - confidence) / 2`` per side.
    successes, episodes : int
        Counts of the episodes that have entered.
    log_refuted, log_confirmed : float
        Largest logarithmic e-values so far against the claim and against its opposite.
    verdict : str
        Starts as ``consistent`` and changes at most once, to the final answer; a claim of 0 is ``vacuous``.
    """

    lower: float
    gap: float | None
    confidence: float
    successes: int = 0
    episodes: int = 0
    log_refuted: float = 0.0
    log_confirmed: float = 0.0
    verdict: str = CONSISTENT

    @property
    def threshold(self) -> float:
        """Logarithmic e-value at which a hypothesis is rejected."""
        return float(-np.log(0.5 * (1.0 - self.confidence)))

    def add(self, success: NDArray[np.bool_]) -> SequentialState:
        """Return the state with more episodes counted but nothing tested: for a number of episodes fixed beforehand."""
        return replace(self, successes=self.successes + int(success.sum()), episodes=self.episodes + len(success))

    def advance(self, success: NDArray[np.bool_]) -> SequentialState:
        """Return the state after these episodes, taken in order up to the one that decides; later ones are ignored."""
        if self.verdict != CONSISTENT or len(success) == 0:
            return self
        # Evidence after each single episode: against the claim (from both ends, if it has two) and for it.
        k = self.successes + np.cumsum(success)
        n = self.episodes + np.arange(1, len(success) + 1)
        against = log_e_at_least(k, n, self.lower)
        if self.gap is not None and self.lower + self.gap < 1.0:
            against = np.maximum(against, log_e_at_most(k, n, self.lower + self.gap))
        # Nothing speaks for a claim of 0; where it has no upper end either, one episode is as good as many.
        for_it = np.zeros(len(k)) if self.lower <= 0.0 else log_e_at_most(k, n, self.lower)
        # The first episode at which either process crosses its threshold decides.
        refuted, confirmed = against >= self.threshold, for_it >= self.threshold
        empty = says_nothing(self.lower, self.gap)
        decided = np.flatnonzero(refuted | confirmed | empty)
        last = int(decided[0]) if len(decided) else len(k) - 1
        verdict = CONSISTENT if not len(decided) else REFUTED if refuted[last] else VACUOUS if empty else CONFIRMED
        return replace(
            self,
            successes=int(k[last]),
            episodes=int(n[last]),
            log_refuted=max(self.log_refuted, float(against[: last + 1].max())),
            log_confirmed=max(self.log_confirmed, float(for_it[: last + 1].max())),
            verdict=verdict,
        )
