"""One problem at several horizons, and without a deadline; each search begins with the policies of the one before.

For co-safe tasks the value of T steps is a lower bound on the value without a deadline, and rises with T.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from ...envs.tasks.problem import Problem
from ..certificates.proofs import Certificate, Synthesis
from ..extended_check.claims import SHORTEST, is_safety, safety_rate

TOLERANCE = 1e-6
"""Gain of a doubled horizon at which ``without_deadline`` stops: a smaller gain is not worth twice the time.

It is an observation, not a bound on what longer horizons would add.
"""

LONGEST = 1000
"""Longest horizon that ``without_deadline`` tries: seven doublings of the horizon 7."""

Once = Callable[[Problem, Certificate | None], Synthesis]
"""Synthesizes a problem, from the policies of a certificate if there is one."""


def horizons_of(horizon: Any) -> list[int]:
    """Return the horizons (N,) that are asked for; raise ValueError if they are none."""
    try:
        asked = [*horizon]
    except TypeError:
        asked = []
    if not asked or isinstance(horizon, str):
        raise ValueError(
            f"`horizon`: expected control steps, a list of them, or None for no deadline, got {horizon!r}; leave it "
            "out for that of the problem"
        )
    return asked


def each_horizon(problem: Problem, horizons: Iterable[int], once: Once) -> Iterator[Synthesis]:
    """Yield what is found at each horizon, in increasing order, each search from the policies of the one before."""
    last: Synthesis | None = None
    for horizon in sorted(set(horizons)):
        task = problem.replace(horizon=horizon)
        last = once(task, _begun_with(last, task))
        yield last


def _begun_with(last: Synthesis | None, problem: Problem) -> Certificate | None:
    """Return the certificate of the last horizon, if its policies are of use for a problem."""
    # What names the time is another problem for every horizon.
    if last is None or problem.groups or problem.labeling.pairs or problem.names_time:
        return None
    if not last.certificate.proof.has_cells:
        return None
    # A shorter horizon may have needed fewer states of the automaton: its policies know nothing of the others.
    same = last.certificate.problem.automaton.n_states == problem.automaton.n_states
    return last.certificate if same else None


def without_deadline(problem: Problem, once: Once) -> Synthesis:
    """Compute policies for a task without a deadline, and what is certified about them.

    For a co-safe task that is a lower bound on the probability of ever satisfying it: the horizon of the problem is
    doubled until the bound gains less than ``TOLERANCE``. For a safety task nothing lasts for ever under unbounded
    noise; ``safety_rate`` of the result bounds the probability of being safe for every number of steps at once, and the
    horizon is doubled until its rate gains less than ``TOLERANCE``.

    Parameters
    ----------
    problem : Problem
        One co-safe or safety task; the search begins with its horizon.
    once : callable
        Synthesizes stationary policies.

    Returns
    -------
    Synthesis
        The best synthesis among all horizons tried. Its certificate is about that horizon (``certificate.problem``)
        and, by ``safety_rate``, about all longer ones.

    Raises
    ------
    ValueError
        If the task is neither, because then more time can lower the probability; or if it decomposes.
    """
    if problem.names_time:
        raise ValueError(
            "`problem`: expected one that is the same at every step, got one that names the time `t`: policies without "
            "a deadline do not look at it; give the problem a horizon"
        )
    automaton = problem.automaton
    if not automaton.is_co_safe and not is_safety(automaton):
        raise ValueError(
            "`problem`: expected a co-safe task, which is satisfied at some time, or a safety task, which is satisfied "
            "until it fails; give other tasks a horizon"
        )
    if problem.groups:
        raise ValueError("`problem`: expected one task, got independent ones; take the problems of `problem.tasks`")
    problem = problem if automaton.is_co_safe else problem.replace(horizon=max(problem.horizon, SHORTEST))
    best = once(problem, None)
    while (doubled := 2 * best.certificate.problem.horizon) <= LONGEST:
        task = problem.replace(horizon=doubled)
        longer = once(task, _begun_with(best, task))
        if _worth(longer) <= _worth(best) + TOLERANCE:
            return max(best, longer, key=_worth)
        best = longer
    return best


def _worth(result: Synthesis) -> float:
    """Return what is certified without a deadline: the bound of a co-safe task, the rate of a safety task."""
    certificate = result.certificate
    if certificate.problem.automaton.is_co_safe:
        return certificate.lower_bound
    try:
        return safety_rate(certificate).rate
    except ValueError:  # a value that falls to 0 somewhere bounds nothing; a longer horizon may do better
        return 0.0
