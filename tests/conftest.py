"""What several tests use and what is expensive to make: made once in a session (on each worker)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import certigym as cg


@pytest.fixture(scope="session")
def synthesized() -> Callable[..., cg.Synthesis]:
    """``synthesized(problem, cells, **options)``, of an id or a Problem: the same result every time."""
    known: dict[tuple[Any, ...], cg.Synthesis] = {}

    def of(problem: str | cg.Problem, cells: Any = None, **options: Any) -> cg.Synthesis:
        problem = cg.make_problem(problem) if isinstance(problem, str) else problem
        key = (problem.fingerprint, repr(cells), *sorted((name, repr(value)) for name, value in options.items()))
        if key not in known:
            known[key] = cg.synthesize(problem, cells, **options)
        return known[key]

    return of
