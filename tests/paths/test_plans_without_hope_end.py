"""Plans of linear paths that all fail end the search after a share of its work, and it goes on with soft limits."""

from __future__ import annotations

from typing import Any

import pytest

import certigym as cg
from certigym.synthesis.trajectories.planning import CountedWork, path_search


class SoftLimits(Exception):
    """The search goes on with soft limits."""


@pytest.mark.parametrize("limit", [1.0, 8.0])
def test_plans_that_fail_take_a_share_of_the_work(limit: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each takes a 128th of a core second; of two states a sixteenth of the work is for them."""
    tried = 0

    def failing(finder: Any, plan: Any) -> None:
        nonlocal tried
        tried += 1
        finder.work.spent += 1.0 / 128.0

    def soft(*args: Any) -> None:
        raise SoftLimits

    monkeypatch.setattr(path_search._Finder, "of_plan", failing)
    monkeypatch.setattr(path_search, "nonlinear_certificate", soft)
    monkeypatch.setattr(path_search, "SOURCES", [lambda problem: iter(range(30)) for _ in range(4)])
    problem = cg.make_problem("courier-v0")
    assert max(agent.n_states for agent in problem.agents) == 2
    with pytest.raises(SoftLimits):
        path_search.path_certificate(problem, CountedWork(limit))
    assert tried == {1.0: 9, 8.0: 65}[limit]
