"""Small problems whose agents are written as expressions."""

from __future__ import annotations

from typing import Any

from certigym import Agent, Problem, Proposition, Specification


def oscillator(**changes: Any) -> Agent:
    """Van der Pol's oscillator with a push."""
    values: dict[str, Any] = {
        "name": "vdp",
        "states": ["x", "y"],
        "inputs": ["u"],
        "parameters": {"step": 0.1},
        "dynamics": ["x + step*y", "y + step*(-x + (1 - x**2)*y) + u"],
        "noise_covariance": [[0.2, 0.0], [0.0, 0.2]],
        "state_low": [-3, -3],
        "state_high": [3, 3],
        "input_low": [-1],
        "input_high": [1],
        "initial_state": [-1, 1],
    }
    return Agent(**{**values, **changes})


def oscillator_reach(horizon: int = 20, **changes: Any) -> Problem:
    """The oscillator is to come to a small box."""
    return Problem(
        name="oscillator",
        horizon=horizon,
        agents=[oscillator(**changes)],
        propositions={"goal": Proposition("vdp", [-1.4, -2.9], [-0.7, -2])},
        specification=Specification("F goal", "co-safe"),
    )


def bent(name: str, **changes: Any) -> Agent:
    """A scalar agent that is pushed harder near 0, with a saturating drift."""
    values: dict[str, Any] = {
        "name": name,
        "states": ["x"],
        "inputs": ["u"],
        "dynamics": ["x - 0.2*tanh(x) + u/(1 + 0.2*x**2)"],
        "noise": [{"law": "gaussian", "std": 0.6}],
        "state_low": [-4],
        "state_high": [4],
        "input_low": [-1.5],
        "input_high": [1.5],
        "initial_state": [-2.0],
    }
    return Agent(**{**values, **changes})


def bent_team(horizon: int = 3, **changes: Any) -> Problem:
    """Two bent agents with a joint task."""
    return Problem(
        name="bent",
        horizon=horizon,
        agents=[bent("one", **changes), bent("two", initial_state=[2.0], **changes)],
        propositions={"a": Proposition("one", [0.0], [2.0]), "b": Proposition("two", [-2.0], [0.0])},
        specification=Specification("F (a & b)", "co-safe"),
    )
