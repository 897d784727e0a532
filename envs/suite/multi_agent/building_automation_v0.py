"""Building automation (BAS4): two heated zones keep their temperatures comfortable for six steps.

Each zone is an agent with two states, the temperatures of the air and of the radiator's return, and one input, the
supply temperature. The zones are decoupled. The input acts on the air alone, so the input matrix has more rows than
columns.

**Versions**: v0: the first version.
"""

from __future__ import annotations

from ...systems.agents import LinearAgent
from ...tasks.problem import Problem, Specification
from ...tasks.regions import Proposition


def problem(horizon: int = 6) -> Problem:
    """Return the problem BAS4 of the literature."""
    common = {"state_low": [18.0, 25.0], "state_high": [22.0, 40.0], "input_low": [15.0], "input_high": [22.0]}
    zones = [
        LinearAgent(
            name="zone_0",
            A=[[0.6682, 0.02632], [1.0005, -0.000499]],
            B=[[0.1320], [0.0]],
            offset=[3.3378, 13.0207],
            noise_covariance=[[0.0774, 0.0], [0.0, 0.3872]],
            initial_state=[20.0, 33.0],
            **common,
        ),
        LinearAgent(
            name="zone_1",
            A=[[0.683, 0.02096], [0.8004, 0.1996]],
            B=[[0.1402], [0.0]],
            offset=[2.9272, 10.4166],
            noise_covariance=[[0.0774, 0.0], [0.0, 0.3098]],
            initial_state=[20.0, 33.0],
            **common,
        ),
    ]
    return Problem(
        name="building-automation-v0",
        horizon=horizon,
        agents=zones,
        propositions={"comfort": Proposition("zone_*", [19.5, 25.0], [20.5, 40.0])},
        specification=Specification("G all(comfort)", "finite-trace"),
    )
