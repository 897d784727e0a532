"""Small problems that several tests use."""

from __future__ import annotations

from typing import Any

import certigym as cg

SCALAR: dict[str, Any] = {
    "name": "left",
    "A": [[0.9]],
    "B": [[0.5]],
    "noise_covariance": [[0.25]],
    "state_low": [-20.0],
    "state_high": [5.0],
    "input_low": [-5.0],
    "input_high": [5.0],
    "initial_state": [-10.0],
}
PLANAR: dict[str, Any] = {
    "name": "planar",
    "A": [[0.95, 0.1], [-0.1, 0.95]],
    "B": [[0.5, 0.0], [0.0, 0.5]],
    "noise_covariance": [[0.25, 0.1], [0.1, 0.5]],
    "state_low": [-10.0, -10.0],
    "state_high": [10.0, 10.0],
    "input_low": [-2.0, -1.0],
    "input_high": [2.0, 1.0],
    "initial_low": [-1.0, 0.0],
    "initial_high": [1.0, 0.0],
    "offset": [0.125, -0.25],
}


def scalar(**changes: Any) -> cg.LinearAgent:
    return cg.LinearAgent(**{**SCALAR, **changes})


def planar(**changes: Any) -> cg.LinearAgent:
    return cg.LinearAgent(**{**PLANAR, **changes})


def mixed_problem(
    horizon: int = 6, formula: str = "safe U (goal & near & !low)", semantics: str = "co-safe"
) -> cg.Problem:
    """Agents of three sizes, one with an output matrix; the middle one stands between two equal ones."""
    watcher = planar(name="watcher", output_matrix=[[1.0, 1.0]])
    return cg.Problem(
        name="mixed",
        horizon=horizon,
        agents=[scalar(name="a_0"), planar(), scalar(name="a_1", A=[[1.0]], initial_state=[0.0]), watcher],
        propositions={
            "goal": cg.Proposition("planar", [-5.0, -5.0], [5.0, 5.0]),
            "near": cg.Proposition("watcher", [-3.0], [3.0]),
            "safe": cg.Proposition("a_1", [-19.0], [5.0]),
            "low": cg.Proposition("a_0", [-20.0], [-7.0]),
        },
        specification=cg.Specification(formula, semantics),
    )


TOML = """
name = "my-task"
horizon = 12
[[agents]]
name = "left"
A = [[0.9]]
B = [[0.5]]
noise_covariance = [[0.25]]
state_low = [-20.0]
state_high = [5.0]
input_low = [-5.0]
input_high = [5.0]
initial_state = [-10.0]
[[agents]]
name = "drone"
copies = 3
A = [[1, 0], [0, 1]]
B = [[1.0], [0.5]]
noise_covariance = [[0.25, 0], [0, 0]]
state_low = [-20.0, -5]
state_high = [5.0, 5]
input_low = [-5.0]
input_high = [5.0]
initial_low = [-1.0, 0]
initial_high = [0.0, 0]
output_matrix = [[1.0, 0.0]]
offset = [0.5, 0.0]
[propositions]
p1 = { agent = "left", low = [0.0], high = [5.0] }
safe = { agent = "drone_*", low = [-5.0], high = [5.0] }
[specification]
formula = "all(safe) U p1"
semantics = "co-safe"
"""

HOP = """
name = "hop"
horizon = 3
[[agents]]
name = "left"
A = [[0.9]]
B = [[0.5]]
noise_covariance = [[0.25]]
state_low = [-4.0]
state_high = [4.0]
input_low = [-4.0]
input_high = [4.0]
initial_state = [-1.0]
[propositions]
goal = { agent = "left", low = [2.0], high = [4.0] }
[specification]
formula = "F goal"
semantics = "co-safe"
"""
