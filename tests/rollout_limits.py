"""What rollouts allow a bound to be: an exact limit of the success probability, with a false alarm of 1e-6."""

from __future__ import annotations

from scipy.stats import beta

import certigym as cg

ROLLOUTS, ALARM = 20_000, 1e-6


def most_by_rollouts(certificate: cg.Certificate, seed: int) -> float:
    """Return the upper Clopper-Pearson limit of the success probability of a certificate's controllers."""
    successes = cg.rollout(certificate.problem, certificate.controller, episodes=ROLLOUTS, seed=seed).successes
    return 1.0 if successes == ROLLOUTS else float(beta.ppf(1.0 - ALARM, successes + 1, ROLLOUTS - successes))
