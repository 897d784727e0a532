"""One problem at several horizons, and without a deadline; each search begins with the policies of the one before.

For co-safe tasks the value of T steps is a lower bound on the value without a deadline, and rises with T.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from ..envs.problem import Problem
from ..envs.suite import as_problem
from .cells import CellCounts
from .certificates import Synthesis
from .synthesize import synthesize

TOLERANCE = 1e-6
"""Gain of a doubled horizon at which ``without_deadline`` stops: a smaller gain is not worth twice the time."""

LONGEST = 1000
"""Longest horizon that ``without_deadline`` tries: seven doublings of the horizon 7."""


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
    """Synthesize from the policies of the last horizon, unless cells or relation are to be chosen anew."""
    chosen_anew = {"memory", "accuracy"} & {*settings} or settings.get("relation") == "best"
    if last is None or problem.groups or problem.labeling.pairs or chosen_anew:
        return synthesize(problem, cells, **settings)
    # A shorter horizon may have needed fewer states of the automaton: its policies know nothing of the others.
    if last.certificate.problem.automaton.n_states != problem.automaton.n_states:
        return synthesize(problem, cells, **settings)
    return synthesize(problem, cells, start=last.certificate, **settings)


def without_deadline(
    problem: Any, cells: CellCounts = None, *, tolerance: float = TOLERANCE, longest: int = LONGEST, **settings: Any
) -> Synthesis:
    """Compute stationary policies for a co-safe task, and a lower bound on the probability of ever satisfying it.

    The horizon of the problem is doubled until the bound gains less than ``tolerance``.

    Parameters
    ----------
    problem : Problem, id or path
        One co-safe task; the search begins with its horizon.
    cells, **settings
        As for ``synthesize``.
    tolerance : float
        Gain at which to stop. It is an observation, not a bound on what longer horizons would add.
    longest : int
        Longest horizon, in control steps.

    Returns
    -------
    Synthesis
        The synthesis with the largest bound among all horizons tried. Its certificate is about that horizon
        (``certificate.problem``) and, by ``certificate.unbounded``, about all longer ones.

    Raises
    ------
    ValueError
        If the task is not co-safe, because then more time can lower the probability; or if it decomposes.
    """
    problem = as_problem(problem)
    if not problem.specification.is_co_safe:
        raise ValueError(
            '`problem`: expected a task of semantics "co-safe", which is satisfied at some time, got '
            f"{problem.specification.semantics!r}; give it a horizon"
        )
    if problem.groups:
        raise ValueError("`problem`: expected one task, got independent ones; take the problems of `problem.tasks`")
    settings = {**settings, "stationary": True}
    best = _from(None, problem, cells, settings)
    while 2 * best.certificate.problem.horizon <= longest:
        longer = _from(best, problem.replace(horizon=2 * best.certificate.problem.horizon), cells, settings)
        if longer.certificate.lower_bound <= best.certificate.lower_bound + tolerance:
            return max(best, longer, key=lambda result: result.certificate.lower_bound)
        best = longer
    return best
