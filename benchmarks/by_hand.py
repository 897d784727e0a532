"""What an engineer does first, for ``own_models.py``: a plan without noise, and linear-quadratic feedback around it.

Plans are the nominal paths that are found with a tenth, a half and all of the noise: how far to keep from limits is a
matter of trying. The feedback is the textbook's: dynamics are linearised by differences at every step, states weighed
by the widths of their workspaces, inputs by those of their boxes, and what the feedback asks for beyond a box is cut
off. The plan that does best in a few rollouts is taken. Nothing is certified; further rollouts say how often the task
is satisfied.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import certigym as cg
from certigym.synthesis.certificates.controllers import PathController
from certigym.validation.statistical_tests import TrialPlan, clopper_pearson

SHARES, TRIED, EPISODES, CONFIDENCE, STEP = (0.1, 0.5, 1.0), 2_000, 20_000, 0.999, 1e-5


def by_hand(problem: cg.Problem, seed: int) -> tuple[float, float] | None:
    """Return exact limits of the rate of success, or None where there is no plan to follow."""
    low, high = 1.0, 1.0
    for task in problem.tasks if problem.groups else (problem,):
        tried: list[tuple[int, PathController]] = []
        for share in SHARES:
            try:
                plan = cg.synthesize(task.replace(disturbance_scale=share), relation="path").certificate
            except ValueError:
                continue
            follower = PathController(task, tuple(_followed(task, i, path) for i, path in enumerate(plan.proof.paths)))
            tried.append((cg.rollout(task, follower, TrialPlan(TRIED, seed + 1)).successes, follower))
        if not tried:
            return None
        found = cg.rollout(task, max(tried, key=lambda one: one[0])[1], TrialPlan(EPISODES, seed))
        limits = clopper_pearson(found.successes, found.episodes, CONFIDENCE)
        low, high = low * limits[0], high * limits[1]
    return low, high


def _followed(task: cg.Problem, i: int, path: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nominal inputs, gains (S, m, d) and nominal states of one agent."""
    agent = task.agents[i]
    states = path.states
    if states is None:
        states = [agent.initial.low]
        for u in path.inputs:
            states.append(agent.mean(states[-1], u))
    states = np.array(states)
    width, half = agent.state_high - agent.state_low, 0.5 * (agent.input_high - agent.input_low)
    Q, R = np.diag(1.0 / width**2), np.diag(1.0 / np.maximum(half, 1e-9) ** 2)
    P, gains = Q, []
    for t in reversed(range(len(path.inputs))):
        A, B = _slopes(agent.at(t), states[t], path.inputs[t], width, half)
        K = -np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        P = Q + A.T @ P @ (A + B @ K)
        gains.append(K)
    return path.inputs, np.array(gains[::-1]), states


def _slopes(agent: Any, x: np.ndarray, u: np.ndarray, width: np.ndarray, half: np.ndarray) -> tuple[Any, Any]:
    """Return the Jacobians (d, d) and (d, m) of the mean, by central differences."""
    columns = []
    for k, size in enumerate([*width, *np.maximum(half, 1e-9)]):
        off = np.zeros(len(x) + len(u))
        off[k] = STEP * size
        ends = [agent.mean(x + sign * off[: len(x)], u + sign * off[len(x) :]) for sign in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / (2.0 * STEP * size))
    both = np.stack(columns, axis=1)
    return both[:, : len(x)], both[:, len(x) :]
