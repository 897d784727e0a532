"""What several tests use and what is expensive to make: made once in a session (on each worker)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import certigym as cg
from network_problems import RNG


@pytest.fixture(autouse=True)
def same_draws() -> None:
    """Networks and points are drawn anew for every test, the same whatever other tests ran before."""
    RNG.bit_generator.state = np.random.default_rng(0).bit_generator.state


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
