"""What simulation says about a certificate: exact binomial limits, p-values and a verdict.

A certificate claims ``P >= lower`` (and, when nothing is lost on the way, ``P <= lower + gap``). With k successes in M
independent episodes and Clopper-Pearson limits that each miss P with probability at most (1 - confidence) / 2, it is

``confirmed``   if the lower limit reaches the claim: a rejection of ``P < lower``;
``refuted``     if the upper limit is below the claim, or the lower limit above ``lower + gap``, where it says so;
``consistent``  otherwise.

A true certificate is refuted with probability at most ``1 - confidence``, a false one confirmed with at most half.
Many claims at once go through ``holm``, the claims and their opposites as two separate families.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, betaincinv

CONFIRMED, CONSISTENT, REFUTED = "confirmed", "consistent", "refuted"


def clopper_pearson(successes: int, episodes: int, confidence: float) -> tuple[float, float]:
    """Exact two-sided limits on a success probability, each missed with probability at most (1 - confidence) / 2.

    Raises
    ------
    ValueError
        If the counts do not fit or the confidence is not strictly between 0 and 1.

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
    low = 0.0 if successes == 0 else float(betaincinv(successes, episodes - successes + 1, tail))
    high = 1.0 if successes == episodes else float(betaincinv(successes + 1, episodes - successes, 1.0 - tail))
    return low, high


def check_confidence(confidence: float) -> None:
    """Raise ValueError unless ``0 < confidence < 1``."""
    if not 0 < confidence < 1:
        raise ValueError(f"`confidence`: expected a number strictly between 0 and 1, got {confidence!r}")


def verdict(lower: float, gap: float | None, ci_low: float, ci_high: float) -> str:
    """Verdict on ``lower <= P`` (and ``P <= lower + gap`` unless ``gap`` is None) from limits on P."""
    if ci_high < lower or (gap is not None and ci_low > lower + gap):
        return REFUTED
    return CONFIRMED if ci_low >= lower else CONSISTENT


def p_at_least(successes: Any, episodes: Any, bound: Any) -> NDArray[Any]:
    """Exact p-values against ``P >= bound``: the probability of so few successes or fewer at ``P = bound``.

    Examples
    --------
    >>> round(float(p_at_least(1, 3, 0.5)), 9)
    0.5
    """
    k, n, bound = np.broadcast_arrays(np.asarray(successes, dtype=float), episodes, np.asarray(bound, dtype=float))
    # P(Bin(n, l) <= k) = I_{1-l}(n - k, k + 1)
    tail = betainc(np.maximum(n - k, 1e-300), k + 1.0, 1.0 - bound)
    return np.where(k >= n, 1.0, tail)


def p_at_most(successes: Any, episodes: Any, bound: Any) -> NDArray[Any]:
    """Exact p-values against ``P <= bound``: the probability of so many successes or more at ``P = bound``.

    Examples
    --------
    >>> round(float(p_at_most(2, 3, 0.5)), 9)
    0.5
    """
    k, n, bound = np.broadcast_arrays(np.asarray(successes, dtype=float), episodes, np.asarray(bound, dtype=float))
    tail = betainc(np.maximum(k, 1e-300), n - k + 1.0, bound)
    return np.where(k <= 0, 1.0, tail)


def holm(p_values: Any) -> NDArray[Any]:
    """Adjusted p-values: rejecting those up to alpha rejects any true hypothesis with probability at most alpha.

    Holm's step-down method; nothing is assumed about dependence.

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03]).round(3).tolist()
    [0.03, 0.06, 0.06]
    """
    p = np.asarray(p_values, dtype=float)
    order = np.argsort(p, kind="stable")
    stepped = np.maximum.accumulate((len(p) - np.arange(len(p))) * p[order])
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted
