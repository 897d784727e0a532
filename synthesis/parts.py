"""Synthesis of a task that decomposes into independent tasks: each on its own, equal ones once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from ..envs.problem import Problem
from .cells import CellCounts
from .certificates import Synthesis, nameless, product_certificate, relations_tried
from .models import Relations, check_names
from .values import UNIT

SynthesizeTask = Callable[[Problem, CellCounts, Relations], Synthesis]
"""Synthesis of one task, given its cells and relations."""


def synthesize_parts(
    problem: Problem, cells: CellCounts, relation: Relations, synthesize_task: SynthesizeTask
) -> Synthesis:
    """Synthesize every independent task, those that differ in names alone once, and put the certificates together."""
    check_names("cells", cells, problem)
    found: dict[tuple[str, str], Synthesis] = {}
    parts = []
    for task in problem.tasks:
        own, kinds = _of_task(task, cells), _of_task(task, relation)
        asked = [[o.get(a) for a in task.agent_names] if isinstance(o, Mapping) else o for o in (own, kinds)]
        key = (nameless(task), str(asked))
        if key not in found:
            found[key] = synthesize_task(task, own, kinds)
        parts.append(found[key])
    certificate = product_certificate(problem, tuple(part.certificate for part in parts))
    each: list[dict[str, Any]] = [part.stats for part in found.values()]
    stats: dict[str, Any] = {
        "seconds": {name: sum(own["seconds"][name] for own in each) for name in each[0]["seconds"]},
        "sweeps": [value for own in each for value in own["sweeps"]],
        "rank": certificate.rank,
        "dropped": sum(dict(part.stats)["dropped"] for part in parts),
        "tasks": len(parts),
        "distinct_tasks": len(found),
    }
    if compared := relations_tried(certificate):
        stats["tried"] = compared
    if not problem.specification.is_co_safe:  # of these the parts ask for more than the whole does
        for name in ("abstract_upper_bound", "continuous_upper_bound"):
            bounds: list[Any] = [dict(part.stats)[name] for part in parts]
            if None not in bounds:
                stats[name] = min(1.0, math.prod(bounds) * (1.0 + 4.0 * len(parts) * UNIT))
    return Synthesis(certificate, certificate.controller, stats)  # type: ignore[arg-type]


def _of_task(task: Problem, given: Any) -> Any:
    """What is given for the agents of a task: the entries of a mapping, or the whole."""
    return {a: given[a] for a in task.agent_names if a in given} if isinstance(given, Mapping) else given
