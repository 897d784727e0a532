"""Package delivery by four robots (PD8): pick up together, cross two corridors, deliver each to its own slot.

The agents x_k and y_k are the coordinates of robot k. A robot that is in the row and in the column is in the *loss
square*.

| state | letter | next |
|---|---|---|
| init | no robot in pickup | init |
| init | all robots in pickup | carrying |
| carrying | all y in center, or all y in low | carrying |
| carrying | all y in the row, no x in the column | carrying |
| carrying | some robot in the loss square | init |
| carrying | all robots delivered in their slots | done (accepting) |
| any | any other letter | failed |

**Versions**: v0: the first version. `package-delivery-eased-v0` has the variance .01; `package-delivery-kinematic-v0`
has robots with velocities.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.automata import automaton_from_transitions
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition

# Starts of x_0, y_0, x_1, y_1, ..., as published; slots on the x axes; regions by family: agents, lower and upper end.
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
# No point lies in two of the bands center, low, row and delivery. The guards say so once more, because an automaton is
# checked for overlaps on all letters, even on those that no point has.
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
    return delivery("package-delivery-v0", horizon, coordinate(variance=0.25))


def coordinate(variance: float) -> LinearAgent:
    """Return one coordinate of a robot of PD8, with the given noise variance."""
    return LinearAgent(
        name="robot",
        A=[[0.9]],
        B=[[0.5]],
        noise_covariance=[[variance]],
        state_low=[-20.0],
        state_high=[5.0],
        input_low=[-5.0],
        input_high=[5.0],
    )


def delivery(name: str, horizon: int, agent: LinearAgent) -> Problem:
    """Return a package delivery by four robots whose coordinates move like `agent`; its first state is the position."""
    # Regions restrict the position alone; other states start at 0 and may be anywhere in the workspace.
    rest, low, high = [0.0] * (agent.n_states - 1), agent.state_low.tolist()[1:], agent.state_high.tolist()[1:]
    agents = [
        agent.replace(name=f"{axis}_{robot}", initial_state=[_START[2 * robot + (axis == "y")], *rest])
        for robot in range(4)
        for axis in "xy"
    ]
    propositions = {key: Proposition(who, [a, *low], [b, *high]) for key, (who, a, b) in _FAMILIES.items()}
    for robot, (key, (a, b)) in enumerate(_SLOTS.items()):
        propositions[key] = Proposition(f"x_{robot}", [a, *low], [b, *high])
    members = {key: tuple(f"{key}_{robot}" for robot in range(4)) for key in _FAMILIES}
    automaton = automaton_from_transitions(
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
