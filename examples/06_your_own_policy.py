"""Certify policies that come from elsewhere, improve them, and compare them on common random numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

import certigym as cg
from certigym.baselines import IdleController, RandomController
from certigym.synthesis.certificates.controllers import InputTable, vectorized
from certigym.synthesis.relations.grids import Grid
from certigym.validation.policies import Comparison

problem = cg.make_problem("reach-avoid-v0", horizon=5)


def homing(x: Any, q: int, time: int) -> Any:
    """Steer for the middle of the goal; takes one agent's state, the automaton state and the time, returns an input."""
    return np.clip((2.5 - 0.9 * x) / 0.5, -5.0, 5.0)


@vectorized
def resting(x: Any, q: Any, time: int) -> Any:
    """Stay near -3; takes many states at once."""
    return np.clip((-3.0 - 0.9 * x) / 0.5, -5.0, 5.0)


policy: dict[str, Any] = {"agent_0": homing, "agent_1": resting}
certified = cg.certify(problem, policy, cells=100)
improved = cg.improve(problem, policy, cells=100)
print(f"certified {certified.certificate.lower_bound:.4f}, improved {improved.certificate.lower_bound:.4f}")
assert improved.certificate.lower_bound >= certified.certificate.lower_bound

# a table of inputs: full speed below 0, hardly any above
grid = Grid((np.array([-20.0, 0.0, 5.0]),))
inputs = np.tile(np.array([[5.0], [0.5]]), (1, problem.automaton.n_states, 1, 1))
mixed = cg.certify(problem, {"agent_0": InputTable(grid, inputs), "agent_1": resting}, cells=100)
print(f"a table and a function {mixed.certificate.lower_bound:.4f}")

comparison: Comparison = cg.compare(
    problem,
    {
        "raw": policy,
        "wrapped": certified,
        "improved": improved,
        "random": RandomController(),
        "idle": IdleController(),
    },
    episodes=5_000,
)
print(comparison)

# the raw policy in rollouts: simulated, never certified
raw = cg.rollout(problem, cg.as_controller(problem, policy), 5_000)
print(f"raw: {raw.successes} of {raw.episodes}")
