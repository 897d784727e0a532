"""Park a car on a line: come to rest in the bay, and never touch the forbidden stretch behind it.

A classic problem of the field for a single agent, whose small inputs cannot undo the noise of a step at once.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(horizon: int = 60) -> Problem:
    """Return the problem CarPark1 of the literature."""
    car = LinearAgent(
        name="car_0",
        A=[[0.9]],
        B=[[0.5]],
        noise_covariance=[[1.0]],
        state_low=[-10.0],
        state_high=[10.0],
        input_low=[-1.0],
        input_high=[1.0],
        initial_state=[-4.0],
    )
    return Problem(
        name="car-park-v0",
        horizon=horizon,
        agents=[car],
        propositions={"p1": Proposition("car_0", [4.75], [6.0]), "p2": Proposition("car_0", [6.0], [10.0])},
        specification=Specification("!p2 U p1", "co-safe"),
    )
