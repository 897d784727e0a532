"""Synthesis of a problem that decomposes into independent tasks: one synthesis for each kind of task."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from ...envs.tasks.problem import Problem
from ..abstraction.models import Relations, check_names
from ..certificates.proofs import Synthesis, nameless, product_certificate, relations_tried
from ..certificates.value_functions import UNIT
from ..relations.grids import CellCounts

SynthesizeTask = Callable[[Problem, CellCounts, Relations], Synthesis]
"""Synthesis of one task, given its cells and relations."""


def synthesize_parts(
    problem: Problem, cells: CellCounts, relation: Relations, synthesize_task: SynthesizeTask
) -> Synthesis:
    """Synthesize every independent task, once where tasks differ only in names, and join the certificates."""
    check_names("cells", cells, problem)
    distinct: dict[tuple[str, str], Synthesis] = {}
    results = []
    for task in problem.tasks_apart:
        task_cells, kinds = _of_task(task, cells), _of_task(task, relation)
        # the key holds what was asked for agent by agent in order, so that names make no difference
        options = (task_cells, kinds)
        asked = [[o.get(name) for name in task.agent_names] if isinstance(o, Mapping) else o for o in options]
        key = (nameless(task), str(asked))
        if key not in distinct:
            distinct[key] = synthesize_task(task, task_cells, kinds)
        results.append(distinct[key])
    certificate = product_certificate(problem, tuple(result.certificate for result in results))
    each: list[dict[str, Any]] = [result.stats for result in distinct.values()]
    stats: dict[str, Any] = {
        "seconds": {name: sum(entry["seconds"][name] for entry in each) for name in each[0]["seconds"]},
        "sweeps": [value for entry in each for value in entry["sweeps"]],
        "rank": certificate.proof.rank,
        "dropped": sum(dict(result.stats)["dropped"] for result in results),
        "tasks": len(results),
        "distinct_tasks": len(distinct),
    }
    if compared := relations_tried(certificate):
        stats["tried"] = compared
    # no such bound for co-safe tasks: there the independent tasks together ask for more than the whole problem does
    if not problem.specification.is_co_safe:
        for name in ("abstract_upper_bound", "continuous_upper_bound"):
            bounds: list[Any] = [dict(result.stats)[name] for result in results]
            if None not in bounds:
                stats[name] = min(1.0, math.prod(bounds) * (1.0 + 4.0 * len(results) * UNIT))
    return Synthesis(certificate, certificate.controller, stats)


def _of_task(task: Problem, option: Any) -> Any:
    """Return what an option says about the agents of a task: entries of a mapping, or the option itself."""
    return {a: option[a] for a in task.agent_names if a in option} if isinstance(option, Mapping) else option
