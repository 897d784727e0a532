"""Where nothing is certified the controllers are at least as good as textbook feedback, and it is said what fails."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.abstraction.models import Settings
from certigym.synthesis.certificates.proofs import AlongPath, changed
from certigym.synthesis.policy_search.ascent import Search
from certigym.synthesis.policy_search.cell_certificates import (
    Plan,
    rollouts_of,
    textbook_runs,
    with_textbook_feedback,
)
from certigym.synthesis.policy_search.portfolio import Effort

REGIONS = ("lane", -1.0, 1.0), ("far", 3.0, 3.5)


def task(formula: str) -> cg.Problem:
    return cg.Problem(
        name="cart",
        horizon=16,
        agents=[
            cg.Agent(
                name="cart",
                states=["x", "v"],
                inputs=["u"],
                dynamics=["x + 0.2*v", "v + 0.2*u + 0.05*sin(x)"],
                noise_std=[0.15, 0.3],
                state_low=[-4.0, -4.0],
                state_high=[4.0, 4.0],
                input_low=[-3.0],
                input_high=[3.0],
                initial_state=[0.0, 0.0],
            )
        ],
        propositions={name: cg.Proposition("cart", [low, -4.0], [high, 4.0]) for name, low, high in REGIONS},
        specification=cg.Specification(formula, "finite-trace"),
    )


CART = task("G lane")


def plan() -> Plan:
    return Plan(Settings(), Search(), Effort(10.0))


def without_feedback() -> cg.Synthesis:
    """A run that claims nothing, and whose controllers do not look at the state."""
    run: AlongPath = textbook_runs(CART, 0.1, plan(), 1.0)[0]
    paths = tuple(replace(path, gains=np.zeros_like(path.gains)) for path in run.proof.paths)
    open_loop = changed(run, paths=paths)
    return cg.Synthesis(open_loop, open_loop.controller, {"nothing": "too much noise, with noise most is lost at v"})


@pytest.mark.thorough
def test_controllers_without_feedback_give_way_to_better_ones() -> None:
    found = without_feedback()
    chosen = with_textbook_feedback(found, plan())
    before, after = (rollouts_of(CART, one.controller)[0] for one in (found, chosen))
    assert before < 0.5 * after and 0 < after < 1000
    # What the checker proves of them is claimed: next to nothing here.
    assert 1e-4 < chosen.certificate.lower_bound < 0.01 and cg.check(chosen.certificate, CART).valid
    # What is said is in the file, too, and counts the rollouts of the controllers that are given.
    why = str(chosen.stats["nothing"])
    assert why.startswith(
        f"too much noise; in 1000 rollouts {after} satisfy the task, most others fail as `lane` is left"
    )
    assert "with noise" not in why and chosen.certificate.settings["nothing"] == why


def test_a_claim_keeps_its_controllers() -> None:
    found = without_feedback()
    claimed = replace(found, certificate=changed(found.certificate, failure=0.4))
    assert with_textbook_feedback(claimed, plan()) is claimed


@pytest.mark.parametrize(("formula", "says"), [("F far", "it is not done at the end"), ("G lane", "`lane` is left")])
def test_what_most_rollouts_fail_as(formula: str, says: str) -> None:
    asked = task(formula)
    controller = replace(textbook_runs(CART, 0.1, plan(), 1.0)[-1].controller, problem=asked)
    assert rollouts_of(asked, controller)[1].startswith(says)
