"""The step of an agent and the order of decisions, written once for numbers and for arrays."""

from __future__ import annotations

from typing import Any

from ..systems.agents import row_times


def moved(A: Any, B: Any, offset: Any, noise_factor: Any, x: Any, u: Any, z: Any) -> list[Any]:
    """Return the components of `A x + B u + c + L z`, as numbers or arrays: the one place where linear agents move.

    The order of the sums is fixed, so numbers and arrays give the same bits.
    """
    components = []
    for a, b, c, factor in zip(A, B, offset, noise_factor):
        total = row_times(a, x)  # a fresh array, so the next terms may be added in place
        total += row_times(b, u)
        total += c
        total += row_times(factor, z)
        components.append(total)
    return components


def noisy(means: Any, noise_rows: Any, z: Any) -> list[Any]:
    """Return the components of `mean + L z`, in the order of `moved`: where agents move whose means are expressions.

    A row of `L` is its entries that are not 0, and their positions. Means must be fresh arrays or numbers: the noise is
    added in place, so the rows of an array of numpy hold the result as well.
    """
    components = []
    for total, (factor, positions) in zip(means, noise_rows):
        total += row_times(factor, [z[at] for at in positions])
        components.append(total)
    return components


def decided(accepting: Any, q: Any, following: Any, failed: Any, accepted: Any, outside: Any) -> tuple[Any, Any, Any]:
    """Return automaton state, failed and accepted after a step: the one place that fixes the order of decisions.

    Parameters
    ----------
    accepting : sequence of bool
        `Dynamics.accepting`.
    q, following : int or array of int
        Automaton states before and after the letter is read.
    failed, accepted, outside : bool or array of bool
        Failed and accepted before the step, and whether an agent is outside its workspace after it.
    """
    failed = failed | (outside > accepted)  # outside and not accepted
    q = q + (following - q) * (failed == 0)  # a failed world reads no letter
    return q, failed, accepting[q] > failed  # accepting states are absorbing
