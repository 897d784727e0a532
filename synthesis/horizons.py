"""One problem at several horizons, each search beginning with what the last one found, and without any deadline.

For co-safe tasks the value of T steps is a lower bound of the value without a deadline, and rises with T.
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
"""What a doubled horizon may add before ``without_deadline`` stops."""

LONGEST = 1000
"""Longest horizon that ``without_deadline`` tries."""


def synthesize_horizons(
    problem: Any, horizons: Iterable[int], cells: CellCounts = None, **settings: Any
) -> list[Synthesis]:
    """Synthesize at every horizon, in increasing order, each from the policies of the one before.

    Parameters
    ----------
    problem : Problem, id or path
        Its own horizon does not matter.
    horizons : iterable of int
        Control steps.
    cells, **settings
        As for ``synthesize``.

    Returns
    -------
    list of Synthesis
        In the order of ``horizons``.
    """
    asked = list(horizons)
    found = {one.certificate.problem.horizon: one for one in each_horizon(problem, asked, cells, **settings)}
    return [found[horizon] for horizon in asked]


def each_horizon(
    problem: Any, horizons: Iterable[int], cells: CellCounts = None, **settings: Any
) -> Iterator[Synthesis]:  # fmt: skip
    """``synthesize_horizons`` one by one, in increasing order."""
    problem = as_problem(problem)
    last: Synthesis | None = None
    for horizon in sorted(set(horizons)):
        last = _from(last, problem.replace(horizon=horizon), cells, settings)
        yield last


def _from(last: Synthesis | None, problem: Problem, cells: CellCounts, settings: dict[str, Any]) -> Synthesis:
    """Synthesis that begins with the last one, unless cells or relation are to be chosen anew."""
    chosen_anew = {"memory", "accuracy"} & {*settings} or settings.get("relation") == "best"
    if last is None or problem.groups or chosen_anew:
        return synthesize(problem, cells, **settings)
    # A shorter horizon may have needed fewer states of the automaton: its policies know nothing of the others.
    if last.certificate.problem.automaton.n_states != problem.automaton.n_states:
        return synthesize(problem, cells, **settings)
    return synthesize(problem, cells, start=last.certificate, **settings)


def without_deadline(
    problem: Any, cells: CellCounts = None, *, tolerance: float = TOLERANCE, longest: int = LONGEST, **settings: Any
) -> Synthesis:
    """Stationary policies for a co-safe task, and a lower bound on satisfying it at any time.

    The horizon is doubled, from the problem's own, until the bound gains less than ``tolerance``.

    Parameters
    ----------
    problem : Problem, id or path
    cells, **settings
        As for ``synthesize``.
    tolerance : float
        Gain at which to stop: an observation, no bound on what still longer horizons would add.
    longest : int
        Longest horizon.

    Returns
    -------
    Synthesis
        With the largest bound of all horizons tried; its certificate is about that horizon (``certificate.problem``)
        and, by ``certificate.unbounded``, about all longer ones.

    Raises
    ------
    ValueError
        If the task is not co-safe: then more time may do harm.
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
        found = _from(best, problem.replace(horizon=2 * best.certificate.problem.horizon), cells, settings)
        if found.certificate.lower_bound <= best.certificate.lower_bound + tolerance:
            return max(best, found, key=lambda one: one.certificate.lower_bound)
        best = found
    return best
