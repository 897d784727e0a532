"""Package delivery by four robots (PD8): pick up together, cross two corridors, deliver each to its own slot.

| | |
|---|---|
| Import | `from certigym.envs import package_delivery_v0` |
| Make | `pettingzoo.make("parallel", "certigym/package-delivery-v0")` |
| Actions | continuous |
| Agents | `['x_0', 'y_0', ..., 'x_3', 'y_3']`: the coordinates of robots A, B, C, D |
| Action shape, values | `(1,)`, [-5, 5]; values beyond are clipped |
| Observation shape, values | `(1 + 4 + 1,)`: own state in [-20, 5], automaton state one-hot, fraction of time left |
| State shape, values | `(8 + 4 + 1,)`: all states, then as above |

**Dynamics** of each coordinate: `x' = .9 x + .5 u + w`, `w ~ N(0, .25)` (variance .25); workspace [-20, 5].

**Propositions**: families over the robots' y: `pickup` [0, 5], `center` [-5, 5], `row` [-10, -5), `low` [-15, -10),
`delivery` [-20, -15); over their x: `column` [-10, -5); the slots of x, each of its own robot: `slot_a` [-20, -14),
`slot_b` [-14, -8), `slot_c` [-8, -2), `slot_d` [-2, 5]. A robot with row and column is in the *loss square*.

**Task**, co-safe, an automaton by hand:

| state | letter | next |
|---|---|---|
| init | no robot in pick-up | init |
| init | all robots in pick-up | carrying |
| carrying | all y in center, or all y in low | carrying |
| carrying | all y in the row, no x in the column | carrying |
| carrying | some robot in the loss square | init |
| carrying | all robots delivered in their slots | done (accepting) |
| any | any other letter | failed |

**Rewards**: 1 to every agent on satisfaction, else 0.

**Start**: (x, y) of A, B, C, D: (-17.8375, 3.2875), (-16.8625, 3.2875), (1.4125, 3.2875), (3.3625, 3.2875).

**Episode ends**: (1) done: terminated; (2) a coordinate leaves the workspace: terminated; (3) failed: terminated;
(4) horizon: truncated.

**Arguments**: `horizon` (20).

**Versions**: v0, first. `package-delivery-eased-v0` has the variance .01.
"""

from __future__ import annotations

from .agent import LinearAgent
from .automaton import Automaton
from .labeling import Proposition
from .problem import Problem
from .specification import Specification
from .suite import environments

_START = (-17.8375, 3.2875, -16.8625, 3.2875, 1.4125, 3.2875, 3.3625, 3.2875)
_SLOTS = {"slot_a": (-20.0, -14.0), "slot_b": (-14.0, -8.0), "slot_c": (-8.0, -2.0), "slot_d": (-2.0, 5.0)}
_FAMILIES = {
    "pickup": ("y_*", 0.0, 5.0),
    "center": ("y_*", -5.0, 5.0),
    "row": ("y_*", -10.0, -5.0),
    "low": ("y_*", -15.0, -10.0),
    "delivery": ("y_*", -20.0, -15.0),
    "column": ("x_*", -10.0, -5.0),
}
# No point lies in two of the bands center, low, row and delivery. The guards say so again, because an automaton is
# checked for overlaps on all letters, also on those that no point has.
_TRANSITIONS = (
    ("init", "!any(pickup)", "init"),
    ("init", "all(pickup)", "carrying"),
    ("carrying", "all(center) & !any(row)", "carrying"),
    ("carrying", "all(low) & !any(row)", "carrying"),
    ("carrying", "all(row) & !any(column)", "carrying"),
    ("carrying", "(row_0 & column_0) | (row_1 & column_1) | (row_2 & column_2) | (row_3 & column_3)", "init"),
    (
        "carrying",
        "all(delivery) & slot_a & slot_b & slot_c & slot_d & !any(center) & !any(low) & !any(row)",
        "done",
    ),
)


def problem(horizon: int = 20) -> Problem:
    """Return the problem PD8 of the module docstring."""
    return make("package-delivery-v0", horizon, variance=0.25)


def make(name: str, horizon: int, variance: float) -> Problem:
    """Return a package delivery with another noise variance."""
    agents = [
        LinearAgent(
            name=f"{axis}_{robot}",
            A=[[0.9]],
            B=[[0.5]],
            noise_covariance=[[variance]],
            state_low=[-20.0],
            state_high=[5.0],
            input_low=[-5.0],
            input_high=[5.0],
            initial_state=[_START[2 * robot + (axis == "y")]],
        )
        for robot in range(4)
        for axis in "xy"
    ]
    propositions = {key: Proposition(agent, [low], [high]) for key, (agent, low, high) in _FAMILIES.items()}
    for robot, (key, (low, high)) in enumerate(_SLOTS.items()):
        propositions[key] = Proposition(f"x_{robot}", [low], [high])
    members = {key: tuple(f"{key}_{robot}" for robot in range(4)) for key in _FAMILIES}
    automaton = Automaton.from_transitions(
        [*(name for family in members.values() for name in family), *_SLOTS],
        ["init", "carrying", "done", "failed"],
        "init",
        ["done"],
        _TRANSITIONS,
        "co-safe",
        otherwise="failed",
        families=members,
    )
    return Problem(
        name=name,
        horizon=horizon,
        agents=agents,
        propositions=propositions,
        specification=Specification(automaton=automaton),
    )


parallel_env, env, raw_env = environments("package-delivery-v0")
