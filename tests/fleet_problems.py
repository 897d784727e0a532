"""Teams on the move, and what is certified of them along paths."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import certigym as cg
from certigym.synthesis.certificates.proofs import AlongPath, PathProof
from certigym.synthesis.certificates.proofs.canonical import verdict_of


def path_of(problem: cg.Problem) -> AlongPath:
    found: Any = cg.synthesize(problem, relation="path").certificate
    assert isinstance(found.proof, PathProof)
    return found


def wrong_paths(certificate: AlongPath) -> tuple[list[str], float]:
    """Return why the checker proves nothing of a certificate, and what it proves of the failure."""
    verdict = verdict_of(certificate)
    return [] if verdict.proved else [verdict.reason], verdict.recomputed


def problem_of(agents: list[Any], regions: dict[str, Any], formula: str, horizon: int) -> cg.Problem:
    """Return a problem; formulas with G are judged at the end."""
    task = cg.Specification(formula, "finite-trace" if "G" in formula else "co-safe")
    return cg.Problem(name="fleet", agents=agents, propositions=regions, specification=task, horizon=horizon)


def unicycle(name: str, start: list[float], std: float, side: float = 5.0) -> cg.Agent:
    return cg.Agent(
        name=name, states=["x", "y", "heading"], inputs=["speed", "turn"],
        dynamics=["x + 0.5*speed*cos(heading)", "y + 0.5*speed*sin(heading)", "heading + 0.5*turn"],
        outputs=["x", "y"], noise_covariance=std**2 * np.eye(3), state_low=[-side, -5, -7], state_high=[side, 5, 7],
        input_low=[0, -1], input_high=[1.5, 1], initial_state=start,
    )  # fmt: skip


def swap(n: int = 2, std: float = 0.05, near: float = 0.8, horizon: int = 12, side: float = 5.0) -> cg.Problem:
    """Return unicycles on a circle that swap places with those across, in a street of some width."""
    agents, regions = [], dict[str, Any]()
    for k in range(n):
        angle = 2.0 * math.pi * (k + 0.5) / n
        x, y = 3.0 * math.cos(angle), 3.0 * math.sin(angle)
        agents.append(unicycle(f"car_{k}", [x, y, math.atan2(-y, -x)], std, side))
        regions[f"goal_{k}"] = cg.Proposition(f"car_{k}", [-x - 0.8, -y - 0.8], [-x + 0.8, -y + 0.8])
    regions["near"] = cg.Pair("car_*", [-near, -near], [near, near])
    goals = " & ".join(f"goal_{k}" for k in range(n))
    return problem_of(agents, regions, f"!any(near) U ({goals})", horizon)


def walker(name: str, start: list[float], std: float, **changes: Any) -> cg.LinearAgent:
    d = len(start)
    arguments: dict[str, Any] = {
        "A": np.eye(d), "B": np.eye(d), "noise_covariance": std**2 * np.eye(d), "state_low": [-9.0] * d,
        "state_high": [9.0] * d, "input_low": [-1.0] * d, "input_high": [1.0] * d, "initial_state": start,
    }  # fmt: skip
    return cg.LinearAgent(name=name, **{**arguments, **changes})


def mixed() -> cg.Problem:
    """Return a unicycle, a cart with a velocity and a walker: one pair keeps apart, another one meets at last."""
    cart = cg.LinearAgent(
        name="cart", A=[[1, 0.5], [0, 1]], B=[[0.125], [0.5]], noise_covariance=np.diag([0.02**2, 0.03**2]),
        state_low=[-5, -2], state_high=[5, 2], input_low=[-1], input_high=[1], initial_state=[0.0, 0.0],
        output_matrix=[[1, 0]],
    )  # fmt: skip
    regions = {
        "there": cg.Proposition("car", [2, -1], [4, 1]),
        "near": cg.Pair(["car", "walker"], [-0.6, -0.6], [0.6, 0.6]),
        "met": cg.Pair(["cart", "walker"], [-0.5], [0.5], outputs=[[0], [0]]),
    }
    agents = [unicycle("car", [-3, 0, 0], 0.03), cart, walker("walker", [2.5, 0.3], 0.05)]
    return problem_of(agents, regions, "!near U (there & met)", 10)
