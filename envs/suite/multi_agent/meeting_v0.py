"""Meeting: two robots meet in either of two rooms at the same time, and then report to their desks at the same time.

Neither room is better than the other. What counts is that both robots choose the same room and the same step. Each
policy sees only its robot, so they must agree on both beforehand. The pillar in the middle must not be touched.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition

_TASK = "!any(pillar) U (((cafe_0 & cafe_1) | (lab_0 & lab_1)) & (!any(pillar) U (desk_0 & desk_1)))"


def problem(horizon: int = 20) -> Problem:
    """Return the meeting of the module docstring."""
    first, second = LinearAgent(
        name="robot",
        A=[[1.0, 0.0], [0.0, 1.0]],
        B=[[1.0, 0.0], [0.0, 1.0]],
        noise_covariance=[[0.04, 0.0], [0.0, 0.04]],
        state_low=[-8.0, -8.0],
        state_high=[8.0, 8.0],
        input_low=[-1.5, -1.5],
        input_high=[1.5, 1.5],
    ).copies(2)
    return Problem(
        name="meeting-v0",
        horizon=horizon,
        agents=[first.replace(initial_state=[-5.0, -2.0]), second.replace(initial_state=[5.0, -2.0])],
        propositions={
            "cafe": Proposition("robot_*", [-6.0, 4.0], [-3.0, 7.0]),
            "lab": Proposition("robot_*", [3.0, 4.0], [6.0, 7.0]),
            "pillar": Proposition("robot_*", [-2.0, -2.0], [2.0, 4.0]),
            "desk_0": Proposition("robot_0", [-7.0, -7.0], [-4.0, -4.0]),
            "desk_1": Proposition("robot_1", [4.0, -7.0], [7.0, -4.0]),
        },
        specification=Specification(_TASK, "co-safe"),
    )
