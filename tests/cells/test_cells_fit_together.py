"""Numbers of cells that fit regions."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.policy_search.portfolio.cell_numbers import MOST_COMBINATIONS, cells_at
from certigym.synthesis.verbs.abstract import abstract
from problems import two_agents

pytestmark = pytest.mark.thorough


def test_equal_agents_get_equal_cells_and_share_their_kernel() -> None:
    """Their regions differ; the numbers fit the regions of both."""
    problem = two_agents()
    cells = cells_at(problem, 3.0)
    assert cells["one"] == cells["two"]
    models = abstract(problem, cells).models
    assert models[0].kernel is models[1].kernel


def test_many_axes_are_not_compared_in_all_combinations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twelve axes with three numbers each would make half a million combinations."""
    compared = list[tuple[int, ...]]()

    def counted(*options: Any) -> Iterator[Any]:
        for choice in product(*options):
            compared.append(tuple(number for number, _ in choice))
            yield choice

    monkeypatch.setattr("certigym.synthesis.policy_search.portfolio.cell_numbers.product", counted)
    chain = cg.LinearAgent(
        name="chain", A=np.eye(12), B=np.eye(12)[:, :1], noise_covariance=0.01 * np.eye(12), state_low=[-5] * 12,
        state_high=[5] * 12, input_low=[-1], input_high=[1], initial_state=[0] * 12,
    )  # fmt: skip
    problem = cg.Problem(
        name="chain", horizon=3, agents=[chain], propositions={"rest": cg.Proposition("chain", [-1], [1], of=[0])},
        specification=cg.Specification("F rest", "co-safe"),
    )  # fmt: skip
    cells = cells_at(problem, 0.2)["chain"]
    assert cells in compared
    assert len(compared) <= MOST_COMBINATIONS
