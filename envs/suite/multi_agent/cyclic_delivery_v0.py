"""Cyclic delivery: four planar robots pick up a load together and deliver it together; if one strays, all start again.

A loss sends the task back to its start, so the automaton has a cycle, and the regions are boxes of the plane. Both make
the number of terms of a value function grow.

| state | letter | next |
|---|---|---|
| empty | all robots in pickup | carrying |
| empty | any other letter | empty |
| carrying | some robot in loss | empty |
| carrying | all robots in delivery | done (accepting) |
| carrying | any other letter | carrying |

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.automata import automaton_from_transitions
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition

# The guards of a state must exclude each other on all letters, so the last two repeat that no robot is in loss.
_TRANSITIONS = (
    ("empty", "all(pickup)", "carrying"),
    ("empty", "!all(pickup)", "empty"),
    ("carrying", "any(loss)", "empty"),
    ("carrying", "all(delivery) & !any(loss)", "done"),
    ("carrying", "!all(delivery) & !any(loss)", "carrying"),
)
_FAMILIES = {
    "pickup": ([-2.0, -2.0], [2.0, 2.0]),
    "loss": ([-10.0, -12.0], [-6.0, 0.0]),
    "delivery": ([-18.0, -4.0], [-14.0, 0.0]),
}
_START = ((-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0))


def problem(horizon: int = 30) -> Problem:
    """Return the cyclic delivery of the module docstring."""
    robots = LinearAgent(
        name="robot",
        A=[[0.9, 0.0], [0.0, 0.9]],
        B=[[1.0, 0.0], [0.0, 1.0]],
        noise_covariance=[[0.25, 0.0], [0.0, 0.25]],
        state_low=[-20.0, -20.0],
        state_high=[5.0, 5.0],
        input_low=[-2.0, -2.0],
        input_high=[2.0, 2.0],
    ).copies(4)
    members = {key: tuple(f"{key}_{robot}" for robot in range(4)) for key in _FAMILIES}
    automaton = automaton_from_transitions(
        [name for family in members.values() for name in family],
        ["empty", "carrying", "done"],
        "empty",
        ["done"],
        _TRANSITIONS,
        "co-safe",
        families=members,
    )
    return Problem(
        name="cyclic-delivery-v0",
        horizon=horizon,
        agents=[robot.replace(initial_state=start) for robot, start in zip(robots, _START)],
        propositions={key: Proposition("robot_*", low, high) for key, (low, high) in _FAMILIES.items()},
        specification=Specification(automaton=automaton),
    )
