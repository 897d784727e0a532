"""What several tests use and what is expensive to make: made once in a session (on each worker).

Searches are smaller here than users have them (``smaller_searches``): what is claimed is as true, and proved by the same
code. Tests of how much is found say so: ``pytestmark = pytest.mark.thorough``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

import certigym as cg
from certigym.synthesis.choosing import effort
from certigym.synthesis.models import ellipsoid_search
from certigym.synthesis.nominal_paths import nonlinear_search, nonlinear_team, polish
from certigym.synthesis.permissions import permitting
from certigym.validation.policies import imitation, probing
from network_problems import RNG

# A suite that draws anew fails by luck; `pytest --hypothesis-profile=anew` explores.
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("anew", deadline=None)
settings.load_profile("same")

SMALLER: tuple[tuple[Any, str, Any], ...] = (
    # Ways to certify are tried as long as effort is left, which is about a minute for users.
    (effort, "EFFORT", 4.0),
    # A sixth of the semidefinite programs, of which each ellipsoid takes hundreds.
    (ellipsoid_search, "LABEL_SHARES", (2.0, 1.0, 0.8, 0.6, 0.45, 0.3, 0.2, 0.1)),
    (ellipsoid_search, "FIRST_MULTIPLIERS", (0.2, 0.5, 0.8, 0.95)),
    (ellipsoid_search, "LAST_STEP", 2e-2),
    # Paths are planned with more times, refined and moved a little a hundred times: the first few gain the most.
    (nonlinear_search, "GENERATIONS", 2),
    (nonlinear_team, "MOST_MOVES", 2),
    (nonlinear_team, "REFINED", 1),
    (nonlinear_team, "TOUCHED_UP", 1),
    (polish, "GENERATIONS", 6),
    # Menus: the tolerance is found to a hundredth, not to 1e-4.
    (permitting, "HALVINGS", 6),
    # Clones of controllers: a sixth of the regression, and of the episodes that choose among attempts.
    (imitation, "ROUNDS", 600),
    (probing, "CHOOSING", 1000),
)
"""Modules, constants, and values with which searches end earlier."""


@pytest.fixture(scope="session", autouse=True)
def smaller_searches() -> Iterator[None]:
    """Searches whose results the tests do not judge take a share of the time, also in fixtures of modules."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name, value in SMALLER:
            patch.setattr(module, name, value)
        yield


USUAL = [getattr(module, name) for module, name, _ in SMALLER]


@pytest.fixture(autouse=True)
def usual_searches(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches as users have them, for tests marked ``thorough``."""
    if request.node.get_closest_marker("thorough") is not None:
        for (module, name, _), value in zip(SMALLER, USUAL, strict=True):
            monkeypatch.setattr(module, name, value)


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
