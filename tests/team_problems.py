"""Teams in pairs, on a ring, and in the wind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import certigym as cg
from written_problems import bent


def pairs(n: int, horizon: int = 5, semantics: str = "finite-trace", starts: Sequence[float] = (-2.0,)) -> cg.Problem:
    """Pair k is to meet in [-1, 0) or in [0, 1); all are to stay in [-3, 3)."""
    agents = []
    for k in range(n):
        for side, sign in (("left", 1.0), ("right", -1.0)):
            agent = cg.LinearAgent(
                name=f"{side}_{k}",
                A=[[0.9]],
                B=[[0.5]],
                noise_covariance=[[0.25]],
                state_low=[-4.0],
                state_high=[4.0],
                input_low=[-2.0],
                input_high=[2.0],
                initial_state=[sign * starts[k % len(starts)]],
            )
            agents.append(agent)
    regions = {"a": (-1.0, 0.0), "b": (0.0, 1.0), "safe": (-3.0, 3.0)}
    propositions = {
        f"{name}_{side}": cg.Proposition(f"{side}_*", [low], [high])
        for side in ("left", "right")
        for name, (low, high) in regions.items()
    }
    meet = " & ".join(f"F (a_left_{k} & a_right_{k} | b_left_{k} & b_right_{k})" for k in range(n))
    stay = "G" if semantics == "finite-trace" else f"G[0,{horizon}]"
    formula = f"{stay} (all(safe_left) & all(safe_right)) & {meet}"
    return cg.Problem(
        name="pairs",
        horizon=horizon,
        agents=agents,
        propositions=propositions,
        specification=cg.Specification(formula, semantics),
    )


def room(i: int, n: int, told: bool = True, **changes: Any) -> cg.Agent:
    """One of n rooms on a ring, whose heater reaches its temperature."""
    left, right = f"room_{(i - 1) % n}", f"room_{(i + 1) % n}"
    arguments: dict[str, Any] = {
        "name": f"room_{i}",
        "states": ["warmth"],
        "inputs": ["heat"],
        "dynamics": [f"warmth + 0.1*({left}.warmth + {right}.warmth - 2*warmth) - 0.5 + heat"],
        "noise": [{"law": "gaussian", "std": 0.2}],
        "state_low": [17],
        "state_high": [25],
        "input_low": [-0.5],
        "input_high": [1.5],
        "initial_state": [20.0 + 0.1 * i],
    }
    arguments |= {"communicated": [left, right]} if told else {}
    return cg.Agent(**{**arguments, **changes})


def ring(n: int = 3, told: bool = True, horizon: int = 6, **changes: Any) -> cg.Problem:
    """Rooms on a ring that stay comfortable."""
    return cg.Problem(
        name="ring",
        horizon=horizon,
        agents=[room(i, n, told, **changes) for i in range(n)],
        propositions={"comfort": cg.Proposition("room_*", [19.0], [22.5])},
        specification=cg.Specification("G all(comfort)", "finite-trace"),
    )


def windy_team(wind: float = 0.3) -> cg.Problem:
    """Two agents in the wind; each is to come to its region."""
    dynamics = ["x - 0.2*tanh(x) + u/(1 + 0.2*x**2) + wind"]
    agents = [
        bent("one", dynamics=dynamics, disturbances={"wind": [-wind, wind]}),
        bent("two", dynamics=dynamics, disturbances={"wind": [-wind, wind]}, initial_state=[2.0]),
    ]
    return cg.Problem(
        name="windy",
        horizon=5,
        agents=agents,
        propositions={"a": cg.Proposition("one", [0.0], [2.0]), "b": cg.Proposition("two", [-2.0], [0.0])},
        specification=cg.Specification("F (a & b)", "co-safe"),
    )
