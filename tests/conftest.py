"""What several tests use and what is expensive to make: made once in a session (on each worker).

Searches are smaller here than users have them (``smaller_searches``): what is claimed is as true, and proved by the
same code. Tests of how much is found say so: ``pytest.mark.full_search``.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

import certigym as cg
from certigym.synthesis.abstraction.models import box_model
from certigym.synthesis.policy_search.cell_certificates import agreement
from certigym.synthesis.policy_search.portfolio import effort
from certigym.synthesis.trajectories.planning import nonlinear_search, nonlinear_team
from certigym.validation.policies import imitation, probing
from certigym.validation.presentation.reports import explorer
from network_problems import RNG

# A suite that draws anew fails by luck; `pytest --hypothesis-profile=anew` explores.
settings.register_profile("same", derandomize=True, deadline=None, max_examples=80)
settings.register_profile("anew", deadline=None, max_examples=400)
settings.load_profile("same")

SMALLER: tuple[tuple[Any, str, Any], ...] = (
    # Ways to certify are tried as long as effort is left, which is about a minute for users.
    (effort, "EFFORT", 2.0),
    # Quick upper ends, which users have by default: an evaluation more of each certificate, in file and check, too.
    (effort, "SHARE_ABOVE", 0.0),
    # Menus of inputs: less than half of them in each dimension.
    (box_model, "INPUT_LEVELS", {1: 7, 2: 5, 3: 3}),
    # Paths are planned with more times, refined and moved a little a hundred times: the first few gain the most.
    (nonlinear_search, "GENERATIONS", 3),
    (nonlinear_search, "MORE_REPLANS", 0),
    (nonlinear_team, "MOST_MOVES", 2),
    (nonlinear_team, "REFINED", 1),
    (nonlinear_team, "POLISHED", ((1, 6),)),
    # Clones of controllers: a sixth of the regression, and of the episodes that choose among attempts.
    (imitation, "ROUNDS", 600),
    (probing, "CHOOSING", 1000),
    # Reports ask the check about a tenth of the starts around that of a path.
    (explorer.bounds_of_starts, "__defaults__", (400,)),
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
    """Searches as users have them, for tests marked ``full_search``: all, or the modules that the mark names."""
    mark = request.node.get_closest_marker("full_search")
    if mark is not None:
        assert {*mark.args} <= {module for module, _, _ in SMALLER}, mark.args
        for (module, name, _), value in zip(SMALLER, USUAL, strict=True):
            if not mark.args or module in mark.args:
                monkeypatch.setattr(module, name, value)


# What is collected stays until the end: there is no garbage to look for in it.
gc.disable()


def pytest_collection_finish() -> None:
    """Look for garbage from now on, among what tests make."""
    gc.freeze()
    gc.enable()


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


@pytest.fixture
def search_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Claims along paths as the search makes them, for sabotage of the search: the checker is not asked beforehand."""
    monkeypatch.setattr(agreement, "agreed_path", lambda certificate: certificate)
