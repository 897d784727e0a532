"""What simulation says about a certificate: exact binomial limits and a verdict.

A certificate claims ``P >= lower`` (and, when it is exact, ``P <= lower + gap``). With k successes in M independent
episodes and Clopper-Pearson limits that each miss P with probability at most (1 - confidence) / 2, it is

``confirmed``   if the lower limit reaches the claim: a rejection of ``P < lower``;
``refuted``     if the upper limit is below the claim, or, for an exact one, the lower limit above ``lower + gap``;
``consistent``  otherwise.

A true certificate is refuted with probability at most ``1 - confidence``, a false one confirmed with at most half.
"""

from __future__ import annotations

from scipy.special import betaincinv

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
    if not 0 < confidence < 1:
        raise ValueError(f"`confidence`: expected a number strictly between 0 and 1, got {confidence!r}")
    if not 0 <= successes <= episodes or episodes < 1:
        raise ValueError(f"`successes`: expected 0 <= successes <= episodes, got {successes} of {episodes}")
    tail = 0.5 * (1.0 - confidence)
    low = 0.0 if successes == 0 else float(betaincinv(successes, episodes - successes + 1, tail))
    high = 1.0 if successes == episodes else float(betaincinv(successes + 1, episodes - successes, 1.0 - tail))
    return low, high


def verdict(lower: float, gap: float | None, ci_low: float, ci_high: float) -> str:
    """Verdict on ``lower <= P`` (and ``P <= lower + gap`` unless ``gap`` is None) from limits on P."""
    if ci_high < lower or (gap is not None and ci_low > lower + gap):
        return REFUTED
    return CONFIRMED if ci_low >= lower else CONSISTENT
