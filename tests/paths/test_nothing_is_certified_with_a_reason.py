"""Where the bound is 0 the search goes on, and says whether the task or the models are to blame."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.tasks.problem.problem_file import problem_from_toml
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.trajectories.chance_constraints.noise_free_runs import most_missed, satisfies

FILE = """
name = "{name}"
specification = "{formula}"
horizon = {horizon}
[agents.robot]
states = ["x", "y"]
inputs = ["ux", "uy"]
dynamics = ["x + 0.5*ux", "y + 0.5*uy"]
noise_std = [{std}, {std}]
state_low = [0, 0]
state_high = [10, 10]
input_low = [-1, -1]
input_high = [1, 1]
initial_state = [1, 1]
[propositions.goal]
agent = "robot"
low = [3, 1]
high = [{high}, 9]
[propositions.wall]
agent = "robot"
low = [2, 0]
high = [{wall}, 10]
"""


def problem(
    formula: str = "F goal", horizon: int = 6, std: float = 0.05, high: float = 9.0, wall: float = 2.75
) -> cg.Problem:
    return problem_from_toml(FILE.format(name="try", formula=formula, horizon=horizon, std=std, high=high, wall=wall))


def test_runs_without_noise_are_judged_as_the_simulator_does() -> None:
    asked = problem("!wall U goal")
    straight = np.linspace([1.0, 1.0], [3.5, 1.0], 6)
    assert not satisfies(asked, [straight])  # at 2.0 and 2.5 it is in the wall
    jumped = np.array([[1.0, 1.0], [1.9, 1.0], [2.8, 1.0], [3.2, 1.0]])
    assert satisfies(asked, [jumped])
    assert not satisfies(asked, [jumped[:3]])
    letters = np.array([[0, 0], [0, -1], [0, -1], [0, -1], [0, -1], [1, 0]], dtype=np.int8)
    names = asked.automaton.propositions
    letters = letters if names == ("goal", "wall") else letters[:, ::-1]
    assert most_missed(asked, letters, [straight]) == "agent `robot` is 0.25 deep in `wall` at step 3"
    assert "0.5 short of `goal` at step 5" in most_missed(asked, letters, [straight - np.array([1.0, 0.0])])
    away = straight.copy()
    away[4] = [-12.0, 1.0]
    assert most_missed(asked, letters, [away]) == "agent `robot` leaves its workspace at step 4 by 12"
    # finite traces are judged at the horizon alone
    assert satisfies(problem("G !wall", 3), [np.ones((4, 2))])
    assert not satisfies(problem("G !wall", 4), [np.ones((4, 2))])


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("formula", "horizon", "blamed"),
    [("F goal", 3, "it takes 4 at least"), ("!wall U goal", 8, "something is in the way")],
)
def test_a_task_that_cannot_be_done_is_to_blame(formula: str, horizon: int, blamed: str) -> None:
    found = cg.synthesize(problem(formula, horizon, 0.05), effort=2)
    assert found.certificate.lower_bound == 0.0
    why = found.stats["nothing"]
    assert isinstance(why, str) and blamed in why
    # The reason is in the file, too, and no verb calls a claim of nothing confirmed.
    report = cg.validate(found.certificate, 200)
    assert report.details["nothing"] == why and report.verdict == "vacuous"
    assert "certified     nothing: P >= 0" in str(report) and "why           " in str(report)


@cache
def narrow() -> tuple[cg.Problem, Any]:
    """A gap that a run without noise jumps, with far too much noise."""
    asked = problem("!wall U goal", 6, 0.5, 3.6, wall=2.4)
    return asked, cg.synthesize(asked, relation="path")


@pytest.mark.thorough
def test_where_noise_is_to_blame_the_controller_follows_a_run() -> None:
    asked, found = narrow()
    assert found.certificate.lower_bound < 1e-6 and cg.check(found.certificate, asked).valid
    assert satisfies(asked, [part.states for part in found.certificate.proof.paths])
    # With hardly any noise the same controller does the task.
    calm = problem("!wall U goal", 6, 1e-6, 3.6, wall=2.4)
    rollouts = cg.rollout(calm, found.controller, 200, seed=1)
    assert rollouts.success.mean() == 1.0


@pytest.mark.thorough
def test_a_claim_of_nothing_along_a_path_cannot_be_made_one_of_something() -> None:
    asked, found = narrow()
    certificate = found.certificate
    assert not cg.check(changed(certificate, failure=0.5), asked).valid


@pytest.mark.thorough
def test_what_a_path_certifies_stays_where_grids_hold_too_few_cells() -> None:
    """Nobody asked for cells, so that none are to be fewer: twelve states, one of them without noise."""
    chain = cg.LinearAgent(
        name="chain", A=0.9 * np.eye(12), B=np.eye(12)[:, :2], noise_covariance=0.04 * np.diag([0] + [1] * 11),
        state_low=[-5] * 12, state_high=[5] * 12, input_low=[-1] * 2, input_high=[1] * 2, initial_state=[0] * 12,
    )  # fmt: skip
    problem = cg.Problem(
        name="chain", horizon=6, agents=[chain],
        propositions={"rest": cg.Proposition("chain", [-0.5] * 12, [0.5] * 12)},
        specification=cg.Specification("G rest", "finite-trace"),
    )  # fmt: skip
    result = cg.synthesize(problem)
    assert 0.0 < result.certificate.lower_bound < 0.01
    assert "it has 12 states, 10 cells along each of them are 1e+12 in all" in str(result.stats["tried"])
    with pytest.raises(ValueError, match="ask for fewer"):
        cg.synthesize(problem, cells=10)
    noisy = cg.Problem(
        name="noisy", horizon=6, agents=[chain.replace(noise_covariance=0.04 * np.eye(12))],
        propositions=problem.declared, specification=problem.specification,
    )  # fmt: skip
    assert "more states than grids hold as a rule" in str(cg.synthesize(noisy).stats["tried"])
