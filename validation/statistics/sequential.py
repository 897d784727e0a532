"""Anytime-valid evidence: test a bound after every episode and stop as soon as it is confirmed or refuted.

An *e-process* against a hypothesis starts at 1 and, while the hypothesis is true, ever reaches ``1 / alpha`` with
probability at most alpha (Ville's inequality): it may be looked at after every episode. Against ``P >= l`` ours is the
likelihood ratio of a Beta mixture over ``p <= l`` to ``l``,

    E_n = integral_0^l (p/l)^k ((1-p)/(1-l))^(n-k) dBeta(p | p <= l),

whose factors are supermartingales for every P >= l *because the mixture stops at l*: an untruncated one would reject
true hypotheses (THEORY section 10). Against ``P <= l`` the mixture lives on ``[l, 1]``. Episodes enter in index order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, betaln, xlog1py, xlogy

from .binomial import CONFIRMED, CONSISTENT, REFUTED, check_confidence

PRIOR = (0.5, 0.5)
"""Beta prior of the mixtures (Jeffreys)."""


def log_e_at_least(successes: Any, episodes: Any, bound: float, prior: tuple[float, float] = PRIOR) -> NDArray[Any]:
    """Logarithm of the e-process against ``P >= bound`` after ``episodes`` with ``successes``.

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
    with np.errstate(divide="ignore", invalid="ignore"):
        mixture = betaln(a + k, b + n - k) + np.log(betainc(a + k, b + n - k, min(bound, 1.0)))
        truncation = betaln(a, b) + np.log(betainc(a, b, min(bound, 1.0)))
        result = mixture - truncation - xlogy(k, bound) - xlog1py(n - k, -bound)
    return np.asarray(np.where(np.isnan(result), -np.inf, result))


def log_e_at_most(successes: Any, episodes: Any, bound: float, prior: tuple[float, float] = PRIOR) -> NDArray[Any]:
    """Logarithm of the e-process against ``P <= bound``."""
    n = np.asarray(episodes, dtype=float)
    return log_e_at_least(n - np.asarray(successes, dtype=float), n, 1.0 - bound, prior[::-1])


def confidence_sequence(
    successes: int, episodes: int, confidence: float, prior: tuple[float, float] = PRIOR
) -> tuple[float, float]:
    """Limits on P that hold at all times together with probability at least ``confidence`` (Robbins' mixture).

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
    """Edge between ``inner``, which is in, and ``outer``, by bisection, on the outer side; ``outer`` if it is in."""
    if not excluded(outer):
        return outer
    for _ in range(80):
        middle = 0.5 * (inner + outer)
        if excluded(middle):
            outer = middle
        else:
            inner = middle
    return outer


@dataclass(frozen=True)
class SequentialState:
    """Evidence so far; ``advance`` makes the next one.

    Parameters
    ----------
    lower, gap, confidence
        The claim ``P >= lower`` (and ``P <= lower + gap`` unless ``gap`` is None); each wrong answer has probability at
        most ``(1 - confidence) / 2`` per side, at whatever time it is given.
    successes, episodes : int
        What has entered.
    log_refuted, log_confirmed : float
        Largest logarithmic e-values so far against the claim and against its opposite.
    verdict : str
        Changes once at most, from ``consistent`` to the final answer.
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
        """Count episodes without testing anything: for a number of episodes fixed beforehand."""
        return replace(self, successes=self.successes + int(success.sum()), episodes=self.episodes + len(success))

    def advance(self, success: NDArray[np.bool_]) -> SequentialState:
        """Enter episodes in order, as far as they are needed; the rest is not looked at."""
        if self.verdict != CONSISTENT or len(success) == 0:
            return self
        k = self.successes + np.cumsum(success)
        n = self.episodes + np.arange(1, len(success) + 1)
        against = log_e_at_least(k, n, self.lower)
        if self.gap is not None and self.lower + self.gap < 1.0:
            against = np.maximum(against, log_e_at_most(k, n, self.lower + self.gap))
        for_it = np.full(len(k), np.inf) if self.lower <= 0.0 else log_e_at_most(k, n, self.lower)
        refuted, confirmed = against >= self.threshold, for_it >= self.threshold
        decided = np.flatnonzero(refuted | confirmed)
        last = int(decided[0]) if len(decided) else len(k) - 1
        verdict = CONSISTENT if not len(decided) else REFUTED if refuted[last] else CONFIRMED
        return SequentialState(
            self.lower, self.gap, self.confidence, int(k[last]), int(n[last]),
            max(self.log_refuted, float(against[: last + 1].max())),
            max(self.log_confirmed, float(for_it[: last + 1].max())), verdict,
        )  # fmt: skip
