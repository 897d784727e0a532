"""Where comparing all relations takes more than there is, exact targets of expressions are made finer all the same."""

from __future__ import annotations

from typing import Any

import pytest

import certigym as cg
from certigym.synthesis.abstraction.models import Settings
from certigym.synthesis.policy_search.ascent import Search
from certigym.synthesis.policy_search.cell_certificates.on_cells import Plan
from certigym.synthesis.policy_search.portfolio import Effort
from certigym.synthesis.verbs import task_strategies
from certigym.synthesis.verbs.synthesize import strategies_ahead
from certigym.synthesis.verbs.task_strategies import _finer


def ferry() -> cg.Problem:
    """Return a boat of uniform noise, of which boxes need lattices too fine for default cells."""
    noise = {"law": "uniform", "low": -0.1, "high": 0.1}
    boat = cg.Agent(
        name="boat",
        states=["x", "y"],
        inputs=["u", "v"],
        dynamics=["x + 0.4*u + 0.05*v", "y + 0.4*v - 0.05*u"],
        noise=[noise, noise],
        state_low=[0, 0],
        state_high=[4, 3],
        input_low=[-1, -1],
        input_high=[1, 1],
        initial_state=[0.6, 0.6],
    )
    return cg.Problem(
        name="ferry",
        horizon=50,
        agents=[boat],
        propositions={
            "rock": cg.Proposition("boat", disc={"centre": [1.8, 1.4], "radius": 0.5}),
            "port": cg.Proposition("boat", disc={"centre": [3.2, 2.3], "radius": 0.5}),
        },
        specification=cg.Specification("!rock U port", "co-safe"),
    )


@pytest.mark.thorough
@pytest.mark.full_search
def test_boxes_on_default_cells_are_counted() -> None:
    work = {strategy.name: strategy.work for _, strategies in strategies_ahead(ferry()) for strategy in strategies}
    assert work["others"] > 30.0  # 20 were counted, whatever they took


def test_finer_cells_begin_with_exact_targets_where_nothing_else_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = ferry()
    coarse = cg.synthesize(problem, 14, relation="exact")
    finer = _finer(problem, Plan(Settings(), Search(), Effort()))
    assert finer.why_not({"exact": coarse}) is None and finer.why_not({}) == ""
    begun = list[cg.Synthesis]()

    def levels(
        problem: cg.Problem, settings: Settings, first: cg.Synthesis, *rest: Any
    ) -> tuple[cg.Synthesis, list[Any]]:
        begun.append(first)
        return first, []

    monkeypatch.setattr(task_strategies, "finer_levels", levels)
    assert "exact, finer cells" in str(finer.run({"exact": coarse}).stats["tried"])
    assert begun == [coarse]
