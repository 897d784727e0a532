"""Quadrotor: a drone with twelve states flies through a gate of one metre, and on to a place behind it.

Position, velocity, roll, pitch, yaw and the three rates of the body; thrust and three torques (accelerations per mass
and inertia). Rates become angles by the kinematics of Euler angles, and push each other by gyroscopic terms. Four walls
leave the gate open.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import Agent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition

DEVIATION = 0.0035
"""Standard deviation of the noise in every state."""

LOW, HIGH = [-1.0, -2.0, -2.0], [6.0, 2.0, 2.0]
"""Corners of the space that the drone may fly in."""


def problem(horizon: int = 24) -> Problem:
    """Return the drone of the module docstring."""
    drone = Agent(
        name="drone_0",
        states=["x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw", "p", "q", "r"],
        inputs=["thrust", "roll_torque", "pitch_torque", "yaw_torque"],
        dynamics=[
            "x + 0.1*vx",
            "y + 0.1*vy",
            "z + 0.1*vz",
            "vx + 0.1*thrust*(cos(roll)*sin(pitch)*cos(yaw) + sin(roll)*sin(yaw))",
            "vy + 0.1*thrust*(cos(roll)*sin(pitch)*sin(yaw) - sin(roll)*cos(yaw))",
            "vz + 0.1*(thrust*cos(roll)*cos(pitch) - 9.81)",
            "roll + 0.1*(p + sin(roll)*tan(pitch)*q + cos(roll)*tan(pitch)*r)",
            "pitch + 0.1*(cos(roll)*q - sin(roll)*r)",
            "yaw + 0.1*(sin(roll)*q + cos(roll)*r)/cos(pitch)",
            "p + 0.1*(roll_torque - 0.5*q*r)",
            "q + 0.1*(pitch_torque + 0.5*p*r)",
            "r + 0.1*yaw_torque",
        ],
        outputs=["x", "y", "z"],
        noise=[{"law": "gaussian", "std": DEVIATION}] * 12,
        state_low=[*LOW, -6.0, -6.0, -6.0, -1.2, -1.2, -1.2, -9.0, -9.0, -9.0],
        state_high=[*HIGH, 6.0, 6.0, 6.0, 1.2, 1.2, 1.2, 9.0, 9.0, 9.0],
        input_low=[0.0, -20.0, -20.0, -10.0],
        input_high=[20.0, 20.0, 20.0, 10.0],
        initial_state=[0.0, 0.8, -0.5] + [0.0] * 9,
    )
    (front, back), (gate_low, gate_high) = (1.5, 1.8), ((-0.5, -0.5), (0.5, 0.5))
    return Problem(
        name="quadrotor-v0",
        horizon=horizon,
        agents=[drone],
        propositions={
            "goal": Proposition("drone_0", [2.5, -0.8, -0.8], [4.0, 0.8, 0.8]),
            "left": Proposition("drone_0", [front, LOW[1], LOW[2]], [back, gate_low[0], HIGH[2]]),
            "right": Proposition("drone_0", [front, gate_high[0], LOW[2]], [back, HIGH[1], HIGH[2]]),
            "below": Proposition("drone_0", [front, LOW[1], LOW[2]], [back, HIGH[1], gate_low[1]]),
            "above": Proposition("drone_0", [front, LOW[1], gate_high[1]], [back, HIGH[1], HIGH[2]]),
        },
        specification=Specification("(!left & !right & !below & !above) U goal", "co-safe"),
    )
