"""Public records print themselves in a few lines without arrays; the main ones are tables in notebooks."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.baselines import IdleController
from certigym.synthesis.certificates import controllers
from certigym.synthesis.extended_check.shields import shield_of
from certigym.synthesis.relations.grids import Grid
from certigym.validation import policies
from certigym.validation import statistical_tests as audits
from certigym.validation import statistical_tests as simulation
from certigym.validation import statistical_tests as verdicts
from certigym.validation.policies import Attempt, Probe
from kinds import mostly_thorough

MOST_CHARACTERS, MOST_LINES = 1500, 15
EPISODES = 100

BEHIND_DOORS = {
    "AuditReport": audits.AuditReport,
    "Comparison": policies.Comparison,
    "Controller": controllers.Controller,
    "FieldReport": verdicts.FieldReport,
    "InputTable": controllers.InputTable,
    "Probe": policies.Probe,
    "Rollouts": simulation.Rollouts,
    "StressReport": verdicts.StressReport,
    "TrialPlan": simulation.TrialPlan,
    "ValidationReport": verdicts.ValidationReport,
}
"""What verbs return and take, whose names are at the doors of rooms."""

RECORDS = {name: getattr(cg, name) for name in cg.__all__ if inspect.isclass(getattr(cg, name))} | BEHIND_DOORS
CLASSES = sorted(RECORDS)


@pytest.fixture(scope="module")
def tree() -> cg.Synthesis:
    """A value tree of two agents."""
    return cg.synthesize(cg.make_problem("reach-avoid-v0", horizon=4), 60)


@pytest.fixture(scope="module")
def product() -> cg.Synthesis:
    """A hundred agents with independent tasks."""
    return cg.synthesize(cg.make_problem("invariance-b-100-v0", horizon=2), 20)


def examples(result: cg.Synthesis) -> dict[str, Callable[[], Any]]:
    """How to make one object of every public class; those of one problem are made around its synthesis."""
    problem, certificate = result.certificate.problem, result.certificate
    starts = np.concatenate([agent.initial.low for agent in problem.agents])
    grid = Grid((np.linspace(-1.0, 1.0, 501),))
    formula = " & ".join(f"F goal_{k}" for k in range(500))
    compared: dict[str, Any] = {"certified": result}
    if not problem.groups:
        compared |= {f"idle {k}": IdleController() for k in range(20)}
    return {
        "Agent": many_states,
        "AuditReport": lambda: cg.audit(result, EPISODES),
        "Automaton": lambda: cg.make_problem("package-delivery-v0").automaton,
        "Certificate": lambda: certificate,
        "Comparison": lambda: cg.compare(problem, compared, EPISODES),
        "Controller": lambda: result.controller,
        "FieldReport": lambda: cg.validate_field(result, [starts] * 20, 20),
        "FormulaError": lambda: refused("F a & " * 400),
        "InputTable": lambda: controllers.InputTable(grid, np.zeros((20, 5, 500, 1))),
        "LinearAgent": lambda: problem.agents[0],
        "Mismatch": lambda: cg.Mismatch(noise_scale=1.5, noise_family="student-t", dropout=0.1),
        "Pair": lambda: cg.Pair("agent_*", np.zeros(200), np.ones(200)),
        "Probe": lambda: probe_of(certificate),
        "Problem": lambda: problem,
        "Proposition": lambda: cg.Proposition("agent", np.zeros(200), np.ones(200)),
        "Rollouts": lambda: cg.rollout(problem, result, EPISODES),
        "SearchOptions": lambda: cg.SearchOptions(max_sweeps=2, value="tree"),
        "Shield": lambda: shield_of(exact_one(), 1e-3),
        "Specification": lambda: cg.Specification(formula, "co-safe"),
        "StressReport": lambda: cg.stress(result, EPISODES),
        "Synthesis": lambda: result,
        "TrialPlan": lambda: simulation.TrialPlan(EPISODES, seed=3),
        "ValidationReport": lambda: cg.validate(result, EPISODES),
    }


def many_states() -> cg.Agent:
    """An agent with as many states, parameters and disturbances as there may be, and long expressions."""
    states = [f"a_rather_long_name_of_a_state_{k}" for k in range(30)]
    return cg.Agent(
        name="large",
        states=states,
        inputs=["u"],
        parameters={f"p{k}": 1.0 for k in range(30)},
        disturbances={f"v{k}": [-1.0, 1.0] for k in range(30)},
        dynamics=[" + ".join(states) + " + u"] * 30,
        noise_covariance=np.eye(30),
        state_low=[-1.0] * 30,
        state_high=[1.0] * 30,
        input_low=[-1.0],
        input_high=[1.0],
    )


def exact_one() -> cg.Synthesis:
    """A certificate that has menus."""
    return cg.synthesize(cg.make_problem("reach-avoid-v0", horizon=4), 60, relation="exact")


def probe_of(certificate: Any) -> Probe:
    """The record of a probe that was never made: it needs learners, which are an extra."""
    names, problem = inspect.signature(Probe).parameters, certificate.problem
    numbers: dict[str, Any] = dict.fromkeys(names, 50)
    numbers |= {"problem": problem.name, "information": "own state", "fingerprint": problem.fingerprint}
    numbers |= {"gap": None, "lower_bound": certificate.lower_bound, "confidence": 0.99, "episodes": EPISODES}
    numbers |= {"attempts": (Attempt(0, 0.1, 1000, 0.5),) * 50, "actor": np.zeros(1000)}
    return Probe(**numbers)


def refused(formula: str) -> cg.FormulaError:
    """The error of a formula that ends too early."""
    with pytest.raises(cg.FormulaError) as caught:
        cg.translate(formula, ["a"], "co-safe")
    return caught.value


def test_every_public_class_has_an_example(tree: cg.Synthesis) -> None:
    assert sorted(examples(tree)) == CLASSES


@mostly_thorough("size", ["tree", "product"])
@pytest.mark.parametrize("name", CLASSES)
def test_public_records_are_short(name: str, size: str, request: pytest.FixtureRequest) -> None:
    record = examples(request.getfixturevalue(size))[name]()
    text = repr(record)
    assert isinstance(record, RECORDS[name]) or name == "Controller"
    assert 0 < len(text) < MOST_CHARACTERS and len(text.splitlines()) <= MOST_LINES, text
    assert "array(" not in text and " object at 0x" not in text and max(map(len, text.splitlines())) <= 250, text
