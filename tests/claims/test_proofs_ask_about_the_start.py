"""From a start outside the workspace no task is satisfied, and where a start has read a letter every proof knows it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import AgentPath, AlongPath, PathProof
from certigym.synthesis.trajectories.planning import nonlinear_search, path_search


def robot(name: str, start: Any, **changes: Any) -> cg.LinearAgent:
    """Four states, steered one by one."""
    arguments: dict[str, Any] = {
        "A": np.eye(4), "B": np.eye(4), "noise_covariance": 1e-4 * np.eye(4), "state_low": [-2.0] * 4,
        "state_high": [2.0] * 4, "input_low": [-1.0] * 4, "input_high": [1.0] * 4, "initial_state": start,
    }  # fmt: skip
    return cg.LinearAgent(name=name, **{**arguments, **changes})


def returns(*agents: cg.LinearAgent, near: bool = False) -> cg.Problem:
    """Each comes to the middle; with ``near``, all but while two are near."""
    regions: dict[str, Any] = {
        f"goal_{k}": cg.Proposition(agent.name, [-0.5] * 4, [0.5] * 4) for k, agent in enumerate(agents)
    }
    formula = "F(" + " & ".join(regions) + ")"
    if near:
        names = [agent.name for agent in agents]
        regions["near"] = cg.Pair(names, [-0.1] * 4, [0.1] * 4)
        formula = f"(!near) U ({' & '.join(regions).replace(' & near', '')})"
    task = cg.Specification(formula, "co-safe")
    return cg.Problem(name="returns", horizon=6, agents=agents, propositions=regions, specification=task)


def moved(problem: cg.Problem, start: list[float]) -> cg.Problem:
    return problem.replace(initial_state={problem.agent_names[0]: start})


INSIDE, OUTSIDE = [1.0, 0.0, 0.0, 0.0], [2.0 + 1e-9, 0.0, 0.0, 0.0]


def path_from(start: list[float]) -> AlongPath:
    """A path that comes back in at time 1: all that is asked from then on holds."""
    problem = returns(robot("robot", start))
    inputs = np.zeros((3, 4))
    inputs[:2, 0] = -0.9
    letters = np.zeros((4, 1), dtype=np.int8)
    letters[3] = 1
    faces = np.full(letters.shape, -1)
    states = np.array(start) + np.vstack([np.zeros(4), np.cumsum(inputs, axis=0)])
    path = AgentPath(inputs, np.zeros((3, 4, 4)), states, np.full((4, 8), np.inf))
    proof = PathProof((path,), letters, faces, 1e-6)
    return cg.Certificate(problem, proof, {"relation": "path"})


def test_paths_from_outside_are_refused_by_the_check() -> None:
    assert cg.check(path_from([1.9, 0.0, 0.0, 0.0]))
    assert cg.check(path_from([2.0, 0.0, 0.0, 0.0]))  # the workspace is closed
    report = cg.check(path_from(OUTSIDE))
    assert not report and "lies outside the workspace of its agent" in str(report)


def test_paths_from_outside_are_refused_by_the_search() -> None:
    with pytest.raises(ValueError, match="expected a start in the workspace of agent `robot`"):
        cg.synthesize(returns(robot("robot", OUTSIDE)))
    with pytest.raises(ValueError, match="outside its workspace"):
        path_search.path_certificate(returns(robot("robot", OUTSIDE)))
    assert cg.synthesize(returns(robot("robot", INSIDE))).certificate.lower_bound > 0.999


@pytest.mark.usefixtures("search_alone")
def test_teams_and_products_from_outside_are_refused_by_the_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search is made to forget the start, and claims nearly 1; the check of what it made is not fooled."""
    monkeypatch.setattr("certigym.synthesis.verbs.synthesize._refuse_outside", lambda problem: None)
    monkeypatch.setattr(path_search, "refuse_without_path", lambda problem: None)
    monkeypatch.setattr(nonlinear_search, "is_inside", lambda nominal: True)
    monkeypatch.setattr("certigym.envs.tasks.problem.Problem.starts_outside", ())
    agents = robot("left", OUTSIDE), robot("right", [-1.0, 1.0, 0.0, 0.0])
    forged = [
        cg.synthesize(returns(*agents), relation="path").certificate,
        cg.synthesize(returns(agents[0]), relation="path").certificate,
    ]
    assert all(each.lower_bound > 0.9 for each in forged)
    monkeypatch.undo()
    for certificate in forged:
        report = cg.check(certificate)
        assert not report and "outside the workspace" in str(report)


@pytest.mark.parametrize("relation", ["exact", "linear", "boxes"])
def test_grids_are_worth_nothing_outside(relation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells end at the workspace; a value that is carried to a start outside is not that of the check."""
    one = {"A": [[1.0]], "B": [[1.0]], "noise_covariance": [[0.01]], "state_low": [-2.0], "state_high": [2.0],
           "input_low": [-1.0], "input_high": [1.0]}  # fmt: skip
    agent = cg.LinearAgent(name="robot", **one, initial_state=[1.5])
    task = cg.Specification("F goal", "co-safe")
    problem = cg.Problem(
        name="back", horizon=4, agents=[agent], propositions={"goal": cg.Proposition("robot", [-0.5], [0.5])},
        specification=task,
    )  # fmt: skip
    certificate = cg.synthesize(problem, 40, relation=relation).certificate
    assert isinstance(certificate, cg.Certificate) and certificate.lower_bound > 0.9
    forged = replace(certificate, problem=moved(problem, [2.0 + 1e-9]))
    assert not cg.check(forged)
    assert certificate.at([2.0 + 1e-9])[0] == 0.0


def test_several_letters_may_lead_to_one_state() -> None:
    """A region that the task does not speak of at the start parts the letters, not the runs."""
    agent = robot("robot", INSIDE)
    regions = {
        "goal": cg.Proposition("robot", [-0.5] * 4, [0.5] * 4),
        "aside": cg.Proposition("robot", [0.7] * 4, [2] * 4),
    }
    task = cg.Specification("X (aside | F goal)", "co-safe")
    problem = cg.Problem(name="later", horizon=3, agents=[agent], propositions=regions, specification=task)
    wide = problem.replace(initial_low=[0.6] * 4, initial_high=[0.9] * 4)
    assert wide.initial_q == problem.initial_q is not None
