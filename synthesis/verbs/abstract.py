"""From a problem to finite models of its agents."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...envs.suite import as_problem
from ...envs.systems.backends import on_one_thread
from ...envs.tasks.problem import Problem
from ..abstraction.models import Abstraction, Relations, Settings, abstraction_of, check_names, relations_of
from ..relations.grids import CellCounts
from .search_options import OF_RELATIONS, SearchOptions, options_of


@on_one_thread
def abstract(
    problem: Problem | str | Path,
    cells: CellCounts = None,
    *,
    relation: Relations = "auto",
    search: SearchOptions | None = None,
    **old: Any,
) -> Abstraction:
    """Return finite models of the agents of ``problem``.

    Parameters
    ----------
    problem : Problem, id or path
    cells : int, sequence of int, or mapping from agent name to one of these, optional
        Cells per axis. Default: 500 for scalar agents, 80 per axis for two, 24 for three dimensions.
    relation : str, or mapping from agent name to str
        ``"exact"``: inputs reach every mean (B of full row rank, or expressions like it), delta = 0. ``"linear"``: any
        agent, delta = 0, losses of second order. ``"boxes"``: any agent, delta = 0, nothing but boxes around means is
        used. ``"paper"``: scalar agents, delta >= 0 in closed form. ``"quick"``: for each agent ``exact`` where it
        applies and the inputs are strong enough for the cells, else ``linear`` (``boxes`` for expressions); agents that
        a mapping leaves out get this, too. ``"auto"`` is the same here: only a synthesis can tell which relation
        certifies most (see ``synthesize``).
    search : SearchOptions, optional
        Its options of relations: ``targets_per_cell``, ``epsilon``, ``feedback``, ``inputs`` and ``delta``;
        others are refused.
    **old
        The same options as keywords, as until 0.3: they work until 0.5, with a DeprecationWarning.

    Raises
    ------
    ValueError
        If the relation does not apply to an agent, or a number is out of range.
    """
    keywords = ("problem", "cells", "relation", "search")
    options = options_of(search, old, "abstract", keywords, OF_RELATIONS)
    problem = as_problem(problem)
    check_names("cells", cells, problem)
    return abstraction_of(problem, cells, relations_of(problem, relation), Settings(**options.of_relations))
