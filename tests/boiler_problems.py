"""A boiler whose input warms several rooms: one input that moves several agents."""

from __future__ import annotations

from typing import Any

from certigym import Agent, Problem, Proposition, Specification


def boiler(**changes: Any) -> Agent:
    """A boiler that chooses the heat of all rooms, and must not get too hot itself."""
    values: dict[str, Any] = {
        "name": "boiler",
        "states": ["water"],
        "inputs": ["heat"],
        "dynamics": ["0.6*water + 8*heat"],
        "noise": [{"law": "gaussian", "std": 2.0}],
        "state_low": [0],
        "state_high": [80],
        "input_low": [0],
        "input_high": [3],
        "initial_state": [30],
    }
    return Agent(**{**values, **changes})


def room(i: int, **changes: Any) -> Agent:
    """A room that loses warmth, and gains what the boiler gives and what its own heater adds."""
    values: dict[str, Any] = {
        "name": f"room_{i}",
        "states": ["warmth"],
        "inputs": ["trim"],
        "dynamics": [f"warmth + {0.1 + 0.01 * i}*(12 - warmth) + 0.6*boiler.heat + trim"],
        "noise": [{"law": "gaussian", "std": 0.2}],
        "state_low": [16],
        "state_high": [25],
        "input_low": [-0.2],
        "input_high": [0.3],
        "initial_state": [19.0 + 0.5 * i],
    }
    return Agent(**{**values, **changes})


def boiler_problem(n: int = 2, horizon: int = 5, formula: str = "G (all(comfort) & cool)", **changes: Any) -> Problem:
    """n rooms stay comfortable while the boiler stays cool; ``changes`` are those of the rooms."""
    return Problem(
        name="boiler",
        horizon=horizon,
        agents=[boiler(), *(room(i, **changes) for i in range(n))],
        propositions={"comfort": Proposition("room_*", [18.0], [21.5]), "cool": Proposition("boiler", [0.0], [60.0])},
        specification=Specification(formula, "finite-trace"),
    )
