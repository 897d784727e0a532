"""Value trees of many independent groups take minutes: a path, which takes a second, is tried before them."""

from __future__ import annotations

import certigym as cg
from certigym.synthesis.verbs.synthesize import strategies_ahead


def couples(number: int) -> cg.Problem:
    """Return couples that have to meet in the middle, each at some time."""
    lifter = cg.Agent(
        name="lifter",
        states=["x"],
        inputs=["u"],
        dynamics=["x + 0.5*u"],
        noise_covariance=[[0.01]],
        state_low=[-4],
        state_high=[4],
        input_low=[-1.5],
        input_high=[1.5],
        initial_state=[-2],
    )
    return cg.Problem(
        name="couples",
        horizon=10,
        agents=lifter.copies(2 * number),
        propositions={"mid": cg.Proposition("lifter_*", [-0.4], [0.4])},
        specification=cg.Specification(
            " & ".join(f"F (mid_{2 * k} & mid_{2 * k + 1})" for k in range(number)), "co-safe"
        ),
    )


def test_paths_come_first_where_trees_have_many_terms() -> None:
    order = {
        number: [strategy.name for _, strategies in strategies_ahead(couples(number)) for strategy in strategies]
        for number in (2, 4)
    }
    assert order[2].index("others") < order[2].index("path")
    assert order[4].index("path") < min(order[4].index("others"), order[4].index("linear"))
