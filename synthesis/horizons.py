"""One problem at several horizons, and without a deadline; each search begins with the policies of the one before.

For co-safe tasks the value of T steps is a lower bound on the value without a deadline, and rises with T.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from ..envs.arrays import on_one_thread
from ..envs.problem import Problem
from ..envs.suite import as_problem
from .cells import CellCounts
from .certificates import Synthesis
from .checking import SHORTEST, is_safety, safety_rate
from .synthesize import synthesize

TOLERANCE = 1e-6
"""Gain of a doubled horizon at which ``without_deadline`` stops: a smaller gain is not worth twice the time."""

LONGEST = 1000
"""Longest horizon that ``without_deadline`` tries: seven doublings of the horizon 7."""


@on_one_thread
def synthesize_horizons(
    problem: Any, horizons: Iterable[int], cells: CellCounts = None, **settings: Any
) -> list[Synthesis]:
    """Synthesize at every horizon, in increasing order, each from the policies of the one before.

    Parameters
    ----------
    problem : Problem, id or path
        The horizon of this problem does not matter.
    horizons : iterable of int
        Numbers of control steps.
    cells, **settings
        As for ``synthesize``.

    Returns
    -------
    list of Synthesis
        In the order of ``horizons``.
    """
    asked = list(horizons)
    results = each_horizon(problem, asked, cells, **settings)
    of_horizon = {result.certificate.problem.horizon: result for result in results}
    return [of_horizon[horizon] for horizon in asked]


def each_horizon(
    problem: Any, horizons: Iterable[int], cells: CellCounts = None, **settings: Any
) -> Iterator[Synthesis]:
    """Yield the results of ``synthesize_horizons`` one by one, in increasing order of the horizon."""
    problem = as_problem(problem)
    last: Synthesis | None = None
    for horizon in sorted(set(horizons)):
        last = _from(last, problem.replace(horizon=horizon), cells, settings)
        yield last


def _from(last: Synthesis | None, problem: Problem, cells: CellCounts, settings: dict[str, Any]) -> Synthesis:
    """Synthesize from the policies of the last horizon, unless there are none, or cells and relation are open."""
    chosen_anew = {"memory", "accuracy"} & {*settings} or settings.get("relation") == "best"
    # What names the time is another problem for every horizon.
    anew = problem.groups or problem.labeling.pairs or problem.names_time or chosen_anew
    if last is None or anew or not last.certificate.proof.has_cells:
        return synthesize(problem, cells, **settings)
    # A shorter horizon may have needed fewer states of the automaton: its policies know nothing of the others.
    if last.certificate.problem.automaton.n_states != problem.automaton.n_states:
        return synthesize(problem, cells, **settings)
    return synthesize(problem, cells, start=last.certificate, **settings)


@on_one_thread
def without_deadline(
    problem: Any, cells: CellCounts = None, *, tolerance: float = TOLERANCE, longest: int = LONGEST, **settings: Any
) -> Synthesis:
    """Compute stationary policies for a task without a deadline, and what is certified about them.

    For a co-safe task that is a lower bound on the probability of ever satisfying it: the horizon of the problem is
    doubled until the bound gains less than ``tolerance``. For a safety task nothing lasts for ever under unbounded
    noise; ``safety_rate`` of the result bounds the probability of being safe for every number of steps at once, and the
    horizon is doubled until its rate gains less than ``tolerance``.

    Parameters
    ----------
    problem : Problem, id or path
        One co-safe or safety task; the search begins with its horizon.
    cells, **settings
        As for ``synthesize``.
    tolerance : float
        Gain at which to stop. It is an observation, not a bound on what longer horizons would add.
    longest : int
        Longest horizon, in control steps.

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
    problem = as_problem(problem)
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
    settings = {**settings, "stationary": True}
    problem = problem if automaton.is_co_safe else problem.replace(horizon=max(problem.horizon, SHORTEST))
    best = _from(None, problem, cells, settings)
    while 2 * best.certificate.problem.horizon <= longest:
        longer = _from(best, problem.replace(horizon=2 * best.certificate.problem.horizon), cells, settings)
        if _worth(longer) <= _worth(best) + tolerance:
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
