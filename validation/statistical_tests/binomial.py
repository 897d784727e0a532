"""What simulation says about a certificate: exact binomial limits, p-values and a verdict.

A certificate claims ``P >= lower`` and, where it knows its upper end, also ``P <= lower + gap``. Take k successes in M
independent episodes, and Clopper-Pearson limits that each miss P with probability at most (1 - confidence) / 2. The
certificate is

``confirmed``   if the lower limit reaches the claim: the rollouts reject ``P < lower``;
``refuted``     if the upper limit is below the claim, or if the lower limit is above a claimed ``lower + gap``;
``vacuous``     else if it claims ``P >= 0``, which is true of everything: no rollouts speak for it;
``consistent``  otherwise.

A claim of 0 is never confirmed; if it has an upper end below 1, that end may still be refuted.

A true certificate is refuted with probability at most ``1 - confidence``; a false one is confirmed with probability at
most half of that. Many claims at once go through ``holm``: the claims form one family, their opposites another
(docs/theory/evidence.md, "One claim" and "Many claims").
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, betaincinv, stdtrit

CONFIRMED, CONSISTENT, REFUTED, VACUOUS = "confirmed", "consistent", "refuted", "vacuous"

NEARLY_ZERO = 1e-300
"""Replaces a parameter 0 of the incomplete beta function, which must be positive; those entries are overwritten."""


def clopper_pearson(successes: int, episodes: int, confidence: float) -> tuple[float, float]:
    """Return exact two-sided limits on P: each is on the wrong side with probability at most (1 - confidence) / 2.

    Parameters
    ----------
    successes, episodes : int
    confidence : float
        Of both limits together, strictly between 0 and 1.

    Raises
    ------
    ValueError
        If there are more successes than episodes, no episode, or the confidence is out of range.

    Examples
    --------
    >>> low, high = clopper_pearson(0, 10, 0.95)
    >>> low, round(high, 4)
    (0.0, 0.3085)
    """
    check_confidence(confidence)
    if not 0 <= successes <= episodes or episodes < 1:
        raise ValueError(f"`successes`: expected 0 <= successes <= episodes, got {successes} of {episodes}")
    tail = 0.5 * (1.0 - confidence)
    # The limits are quantiles of beta distributions; at k = 0 and k = n one of them degenerates to the end point.
    low = 0.0 if successes == 0 else float(betaincinv(successes, episodes - successes + 1, tail))
    high = 1.0 if successes == episodes else float(betaincinv(successes + 1, episodes - successes, 1.0 - tail))
    return low, high


def paired_difference(only_first: int, only_second: int, episodes: int, confidence: float) -> tuple[float, float]:
    """Return exact two-sided limits on P1 - P2, the difference of two success probabilities in paired episodes.

    P1 - P2 is the probability that only the first succeeds less the probability that only the second does. Each of the
    four limits on these two is Clopper-Pearson's at a quarter of the error, so both limits of the difference hold
    together with the confidence, no matter how the outcomes of a pair depend on each other. They are wider than
    approximate ones.

    Parameters
    ----------
    only_first, only_second : int
        Episodes in which exactly this one succeeds.
    episodes : int
        All episodes.
    confidence : float
        Of both limits together, strictly between 0 and 1.

    Examples
    --------
    >>> low, high = paired_difference(30, 10, 1000, 0.99)
    >>> round(low, 4), round(high, 4)
    (-0.0055, 0.0451)
    """
    if only_first + only_second > episodes:
        raise ValueError(f"`episodes`: expected at least {only_first + only_second}, got {episodes}")
    halved = 0.5 * (1.0 + confidence)  # half of the error for each of the two probabilities
    first, second = (clopper_pearson(count, episodes, halved) for count in (only_first, only_second))
    return first[0] - second[1], first[1] - second[0]


def mean_limits(rates: Sequence[float], confidence: float) -> tuple[float, float]:
    """Return approximate two-sided limits of a mean, for success rates of several trainings: Student's, within [0, 1].

    They hold exactly only for normal numbers. With few trainings that fail or succeed altogether, they may miss the
    mean more often than said. Limits that hold for all distributions say nothing with a handful of numbers.

    Parameters
    ----------
    rates : sequence of float
        At least two, between 0 and 1.
    confidence : float
        Strictly between 0 and 1.

    Examples
    --------
    The quantile of Student's distribution with two degrees of freedom is 4.303 at 97.5 %.

    >>> low, high = mean_limits([0.4, 0.5, 0.6], 0.95)
    >>> round(low, 3), round(high, 3)
    (0.252, 0.748)
    """
    check_confidence(confidence)
    if len(rates) < 2:
        raise ValueError(f"`rates`: expected at least two, got {len(rates)}")
    reach = float(stdtrit(len(rates) - 1, 0.5 * (1.0 + confidence))) * np.std(rates, ddof=1) / np.sqrt(len(rates))
    mean = float(np.mean(rates))
    return max(0.0, mean - float(reach)), min(1.0, mean + float(reach))


def check_confidence(confidence: float) -> None:
    """Raise ValueError unless ``0 < confidence < 1``."""
    if not 0 < confidence < 1:
        raise ValueError(f"`confidence`: expected a number strictly between 0 and 1, got {confidence!r}")


def verdict(lower: float, gap: float | None, ci_low: float, ci_high: float) -> str:
    """Return the verdict on ``lower <= P`` (and on ``P <= lower + gap`` unless ``gap`` is None) from limits on P."""
    if ci_high < lower or (gap is not None and ci_low > lower + gap):
        return REFUTED
    if lower <= 0.0:
        return VACUOUS
    return CONFIRMED if ci_low >= lower else CONSISTENT


def says_nothing(lower: float, gap: float | None) -> bool:
    """Return whether a claim holds for every system: ``P >= 0``, and no upper end below 1."""
    return lower <= 0.0 and (gap is None or lower + gap >= 1.0)


def p_at_least(successes: Any, episodes: Any, bound: Any) -> NDArray[Any]:
    """Return exact p-values against ``P >= bound``: the probability of at most so many successes at ``P = bound``.

    Parameters
    ----------
    successes, episodes, bound : array_like
        Broadcast against each other.

    Examples
    --------
    >>> round(float(p_at_least(1, 3, 0.5)), 9)
    0.5
    """
    k, n, bound = np.broadcast_arrays(np.asarray(successes, dtype=float), episodes, np.asarray(bound, dtype=float))
    # P(Bin(n, l) <= k) = I_{1-l}(n - k, k + 1), the regularised incomplete beta function; it is 1 for k = n.
    tail = betainc(np.maximum(n - k, NEARLY_ZERO), k + 1.0, 1.0 - bound)
    return np.where(k >= n, 1.0, tail)


def p_at_most(successes: Any, episodes: Any, bound: Any) -> NDArray[Any]:
    """Return exact p-values against ``P <= bound``: the probability of at least so many successes at ``P = bound``.

    Parameters
    ----------
    successes, episodes, bound : array_like
        Broadcast against each other.

    Examples
    --------
    >>> round(float(p_at_most(2, 3, 0.5)), 9)
    0.5
    """
    k, n, bound = np.broadcast_arrays(np.asarray(successes, dtype=float), episodes, np.asarray(bound, dtype=float))
    # P(Bin(n, l) >= k) = I_l(k, n - k + 1); it is 1 for k = 0.
    tail = betainc(np.maximum(k, NEARLY_ZERO), n - k + 1.0, bound)
    return np.where(k <= 0, 1.0, tail)


def holm(p_values: Any) -> NDArray[Any]:
    """Return p-values adjusted by Holm's method, which assumes nothing about how the tests depend on each other.

    Whoever rejects the hypotheses whose adjusted p-values are at most alpha rejects some true hypothesis with
    probability at most alpha (docs/theory/evidence.md, "Many claims").

    Parameters
    ----------
    p_values : array_like, shape (n,)

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03]).round(3).tolist()
    [0.03, 0.06, 0.06]
    """
    p = np.asarray(p_values, dtype=float)
    # The k-th smallest of n values is multiplied by n - k + 1; running maxima keep the order.
    order = np.argsort(p, kind="stable")
    stepped = np.maximum.accumulate((len(p) - np.arange(len(p))) * p[order])
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted
