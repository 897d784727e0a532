"""Formation through a door: three robots pass one after the other and take their places behind it.

The door is wide enough for one robot: two may never be in it at the same time, and nobody may enter before the robot
ahead is through. The task is satisfied when all three stand in their slots at the same time, and nobody has touched the
wall. A robot moves at most 1.2 per step and axis, so it cannot jump over the door.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition

_SAFE = "!any(north) & !any(south) & !(door_0 & door_1) & !(door_0 & door_2) & !(door_1 & door_2)"
_TASK = f"(({_SAFE}) U (slot_0 & slot_1 & slot_2)) & (!door_1 U through_0) & (!door_2 U through_1)"
# Lower and upper corner of each robot's slot.
_SLOTS = (((5.0, -1.0), (7.0, 1.0)), ((3.0, 1.0), (5.0, 3.0)), ((3.0, -3.0), (5.0, -1.0)))


def problem(horizon: int = 24) -> Problem:
    """Return the formation of the module docstring."""
    robots = LinearAgent(
        name="robot",
        A=[[1.0, 0.0], [0.0, 1.0]],
        B=[[1.0, 0.0], [0.0, 1.0]],
        noise_covariance=[[0.02, 0.0], [0.0, 0.02]],
        state_low=[-8.0, -4.0],
        state_high=[8.0, 4.0],
        input_low=[-1.2, -1.2],
        input_high=[1.2, 1.2],
    ).copies(3)
    propositions = {
        "north": Proposition("robot_*", [-1.0, 1.5], [1.0, 4.0]),
        "south": Proposition("robot_*", [-1.0, -4.0], [1.0, -1.5]),
        "door": Proposition("robot_*", [-1.0, -1.5], [1.0, 1.5]),
        "through": Proposition("robot_*", [1.0, -4.0], [8.0, 4.0]),
    }
    for k, (low, high) in enumerate(_SLOTS):
        propositions[f"slot_{k}"] = Proposition(f"robot_{k}", low, high)
    return Problem(
        name="door-formation-v0",
        horizon=horizon,
        agents=[robot.replace(initial_state=[-3.0 - 2.0 * k, 0.0]) for k, robot in enumerate(robots)],
        propositions=propositions,
        specification=Specification(_TASK, "co-safe"),
    )
