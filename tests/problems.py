"""Small problems and exact models for the tests."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from certigym import LinearAgent, Problem, Proposition, Specification
from certigym.envs.systems.agents import AnyAgent
from certigym.synthesis.abstraction.kernels.kernel import AxisTable, Kernel
from certigym.synthesis.abstraction.models.finite_models import AgentModel
from certigym.synthesis.abstraction.models.target_windows import TargetWindows
from certigym.synthesis.relations.grids.grid import Grid
from certigym.synthesis.relations.grids.labels import CellLabels
from certigym.synthesis.relations.kinds.exact import exact_relation


def linear(agent: AnyAgent) -> LinearAgent:
    """An agent of a problem that is known to have matrices."""
    assert isinstance(agent, LinearAgent)
    return agent


def scalar_agent(name: str, **changes: Any) -> LinearAgent:
    """A stable scalar agent on [-4, 4]."""
    values: dict[str, Any] = {
        "name": name,
        "A": [[0.9]],
        "B": [[0.5]],
        "noise_covariance": [[0.25]],
        "state_low": [-4.0],
        "state_high": [4.0],
        "input_low": [-2.0],
        "input_high": [2.0],
        "initial_state": [0.3],
    }
    return LinearAgent(**{**values, **changes})


def cart(**changes: Any) -> LinearAgent:
    """A position-velocity agent with one input."""
    values: dict[str, Any] = {
        "name": "cart",
        "A": [[1.0, 0.5], [0.0, 1.0]],
        "B": [[0.0], [0.5]],
        "noise_covariance": [[0.04, 0.0], [0.0, 0.04]],
        "state_low": [-6.0, -3.0],
        "state_high": [6.0, 3.0],
        "input_low": [-2.0],
        "input_high": [2.0],
        "initial_state": [-3.0, 0.0],
    }
    return LinearAgent(**{**values, **changes})


def cart_reach(agent: LinearAgent, horizon: int = 8) -> Problem:
    """The cart is to come to a position in [1, 5]."""
    return Problem(
        name="cart",
        horizon=horizon,
        agents=[agent],
        propositions={"goal": Proposition("cart", [1.0, -3.0], [5.0, 3.0])},
        specification=Specification("F goal", "co-safe"),
    )


def two_agents(formula: str = "(!b | !c) U a", semantics: str = "co-safe", horizon: int = 4, **changes: Any) -> Problem:
    """Two scalar agents; regions a = [1, 3), b = [-2, 0), both = [-4, 4] of the first, c = [-3, -1) of the second."""
    return Problem(
        name="two",
        horizon=horizon,
        agents=[scalar_agent("one", **changes), scalar_agent("two", **changes)],
        propositions={
            "a": Proposition("one", [1.0], [3.0]),
            "b": Proposition("one", [-2.0], [0.0]),
            "c": Proposition("two", [-3.0], [-1.0]),
            "d": Proposition("two", [0.0], [4.0]),
        },
        specification=Specification(formula, semantics),
    )


def exact_model(problem: Problem, agent: int, tables: Any, labels: Sequence[int], label_sets: Any) -> AgentModel:
    """A model with tables of ``Fraction`` (Z, S) and free choice of targets, for exact comparisons."""
    table = np.array(tables, dtype=object)
    n_lattice, n_cells = table.shape
    model = problem.agents[agent]
    edges = np.linspace(model.state_low[0], model.state_high[0], n_cells + 1)
    grid, lattice, relation = (
        Grid((edges,)),
        (np.linspace(-1.0, 1.0, n_lattice),),
        exact_relation(linear(model)),
    )
    low, high = np.zeros((n_cells, 1), dtype=np.int32), np.full((n_cells, 1), n_lattice, dtype=np.int32)
    windows = TargetWindows(grid, lattice, relation, low, high)
    known = CellLabels(np.array(labels, dtype=np.int32), np.array(label_sets, dtype=bool))
    return AgentModel(grid, lattice, relation, Kernel((AxisTable.dense(table),)), windows, known, known)


def fractions(weights: Sequence[Sequence[int]], total: int) -> list[list[Fraction]]:
    """Rows of nonnegative integers as exact sub-probabilities with denominator ``total``."""
    return [[Fraction(w, total) for w in row] for row in weights]
