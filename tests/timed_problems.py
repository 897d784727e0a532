"""Problems that name the time: moving references, changing drifts and noises."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ndtr

import certigym as cg


def robot(name: str = "robot", **changes: Any) -> cg.Agent:
    """A scalar agent whose drift changes with the time."""
    arguments: dict[str, Any] = {
        "states": ["x"], "inputs": ["u"], "dynamics": ["x + u + 0.4*sin(0.9*t)"],
        "noise": [{"law": "gaussian", "std": 0.3}], "state_low": [-4], "state_high": [4], "input_low": [-1.2],
        "input_high": [1.2], "initial_state": [0.2],
    }  # fmt: skip
    return cg.Agent(name=name, **{**arguments, **changes})


def still(name: str = "robot", **changes: Any) -> cg.LinearAgent:
    """A linear agent, which does not name the time."""
    arguments: dict[str, Any] = {
        "A": [[1.0]], "B": [[1.0]], "noise_covariance": [[0.09]], "state_low": [-4], "state_high": [4],
        "input_low": [-1.2], "input_high": [1.2], "initial_state": [0.2],
    }  # fmt: skip
    return cg.LinearAgent(name=name, **{**arguments, **changes})


def band(shift: int = 0, width: float = 0.9, name: str = "robot") -> cg.Proposition:
    """A band around a reference that moves; with a shift, from time 1 on, that of another time."""
    reference = f"1.6*sin(0.8*(t + {shift}*min(t, 1)))" if shift else "1.6*sin(0.8*t)"
    return cg.Proposition(name, [f"{reference} - {width}"], [f"{reference} + {width}"])


def follow(agent: Any, region: Any = None, horizon: int = 6, formula: str = "G band", **more: Any) -> cg.Problem:
    """The agent is to stay in the band."""
    kind = "finite-trace" if formula.startswith("G") else "co-safe"
    regions = {"band": band() if region is None else region, **more}
    task = cg.Specification(formula, kind)
    return cg.Problem(name="follow", horizon=horizon, agents=[agent], propositions=regions, specification=task)


def best_probability(problem: cg.Problem, bins: int = 400, inputs: int = 49) -> float:
    """Return about the largest probability of staying in, or of reaching, the only region of a scalar agent.

    A dense program by itself: the time goes into expressions that are written here, once more.
    """
    agent = problem.agents[0]
    edges = np.linspace(agent.state_low[0], agent.state_high[0], bins + 1)
    x = 0.5 * (edges[1:] + edges[:-1])
    u = np.linspace(agent.input_low[0], agent.input_high[0], inputs)
    reaches = problem.specification.is_co_safe

    def holds(t: int) -> np.ndarray:
        low, high = 1.6 * np.sin(0.8 * t) - 0.9, 1.6 * np.sin(0.8 * t) + 0.9
        return (low <= x) & (x < high)

    value = holds(problem.horizon).astype(float)
    for t in reversed(range(problem.horizon)):
        drift = 0.4 * np.sin(0.9 * t) if agent.names_time else 0.0
        means = np.clip(x[:, None] + u[None] + drift, -6.0, 6.0)
        cuts = np.linspace(-6.0, 6.0, 1201)
        masses = np.diff(ndtr((edges[None] - cuts[:, None]) / 0.3), axis=1)
        smooth = masses @ value
        now = np.interp(means, cuts, smooth).max(axis=1)
        value = np.where(holds(t), 1.0, now) if reaches else holds(t) * now
    return float(np.interp(agent.initial.low[0], x, value))
