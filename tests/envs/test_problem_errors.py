"""Every wrong argument of a problem is refused at construction, by an error that names it, says what came and helps."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest

import certigym as cg
from sample_problems import planar, scalar

AGENT = [
    ({"name": "2nd"}, r"`name`: expected letters.*got '2nd'"),
    ({"A": [[0.9, 0.1]]}, r"`A`: expected a square matrix, got shape 1 x 2"),
    ({"A": [[float("nan")]]}, r"`A`: expected finite numbers.*got nan"),
    ({"A": [[10**400]]}, r"`A`: expected finite numbers"),
    ({"B": [[0.5], [0.5]]}, r"`B`: expected numbers of shape \(1, any\)"),
    ({"noise_covariance": [[-0.25]]}, r"`noise_covariance`: expected a positive semidefinite matrix.*-0.25"),
    ({"state_low": [5.0]}, r"`state_low`: expected numbers less than `state_high`, got 5.0 and 5.0 on axis 0"),
    ({"state_high": [float("inf")]}, r"`state_high`: expected finite numbers.*got inf"),
    ({"initial_low": [0.0]}, r"`initial_state`: expected a point or a box.*got both"),
    ({"initial_state": None, "initial_low": [0.0]}, r"`initial_high`: expected both corners"),
    ({"initial_state": [0.0, 0.0]}, r"`initial_state`: expected numbers of shape \(1\)"),
    ({"output_matrix": [[1.0, 0.0]]}, r"`output_matrix`: expected numbers of shape \(any, 1\)"),
]


@pytest.mark.parametrize(("changes", "message"), AGENT)
def test_agent(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        scalar(**changes)


def test_covariance_must_be_symmetric() -> None:
    with pytest.raises(ValueError, match=r"`noise_covariance`: expected a symmetric matrix.*\(S \+ S.T\) / 2"):
        planar(noise_covariance=[[1.0, 0.5], [0.4, 1.0]])
    with pytest.raises(ValueError, match="positive semidefinite"):
        planar(noise_covariance=[[1.0, 2.0], [2.0, 1.0]])


GOOD: dict[str, Any] = {"name": "task", "horizon": 3}
GOAL = {"goal": cg.Proposition("left", [0.0], [5.0])}
PROBLEM = [
    ({"name": ""}, r"`name`: expected a line of 1 to 200"),
    ({"horizon": 0}, r"`horizon`: expected a whole number from 1 to 1000000 \(control steps\), got 0"),
    ({"agents": []}, r"`agents`: expected a list of at least one LinearAgent"),
    ({"agents": [scalar(), scalar()]}, r"`agents`: expected different names, got 'left' twice; rename one"),
    ({"agents": [scalar(initial_state=None)]}, r"`agents`: expected a start for every agent, got none for 'left'"),
    ({"propositions": [1]}, r"`propositions`: expected a mapping"),
    ({"propositions": {"F": GOAL["goal"]}}, r"`propositions.F`: .*a word of the formula language"),
    ({"propositions": {"goal": cg.Proposition("lefd", [0], [1])}}, r"got 'lefd'; did you mean 'left'\?"),
    ({"propositions": {"goal": cg.Proposition("d_*", [0], [1])}}, r"expected a pattern that matches an agent, got 'd_"),
    ({"propositions": {"goal": cg.Proposition("left", [0, 0], [1, 1])}}, r"expected corners of length 1"),
    ({"propositions": {"goal": cg.Proposition("left", [5.0], [6.0])}}, r"expected a region that meets the workspace"),
    ({"specification": cg.Specification("F gaol", "co-safe")}, r"gaol"),
    ({"specification": cg.Specification("G goal", "co-safe")}, r"G"),
]


@pytest.mark.parametrize(("changes", "message"), PROBLEM)
def test_problem(changes: dict[str, Any], message: str) -> None:
    arguments = {
        "agents": [scalar()],
        "propositions": GOAL,
        "specification": cg.Specification("F goal", "co-safe"),
        **GOOD,
        **changes,
    }
    with pytest.raises(ValueError, match=message):
        cg.Problem(**arguments)


def test_members_of_families_must_be_new_names() -> None:
    agents = scalar(name="d").copies(2)
    for other in ("safe_1", "safe"):
        propositions = {"safe": cg.Proposition("d_*", [0], [1])}
        if other == "safe":  # a pattern that matches the whole name of one agent of another family
            agents = (*agents, scalar(name="e"))
            propositions = {"safe_d": cg.Proposition("d_0", [0], [1]), "safe": cg.Proposition("*_0", [0], [1])}
        else:
            propositions[other] = cg.Proposition("d_1", [0], [1])
        with pytest.raises(ValueError, match="expected new names"):
            cg.Problem(
                agents=agents, propositions=propositions, specification=cg.Specification("true", "co-safe"), **GOOD
            )


@pytest.mark.parametrize(
    ("formula", "semantics"),
    [
        ("F a", "co-safe"),
        ("!a U (b & X[3] all(c))", "co-safe"),
        ("G[0,5] a & F any(c)", "co-safe"),
        ("!(G a)", "co-safe"),
        ("!(a W b) | !all(c)", "co-safe"),
        ("G (a -> F[0,3] b)", "finite-trace"),
        ("F G all(c)", "finite-trace"),
        ("!F a", "finite-trace"),
        ("a W b", "finite-trace"),
        ("F (a &", "finite-trace"),  # the problem says what is wrong with it
    ],
)
def test_a_formula_says_its_semantics(formula: str, semantics: str) -> None:
    assert cg.Specification(formula).semantics == semantics


def test_arrays_are_read_only_and_copied() -> None:
    given = np.array([[0.9]])
    agent = scalar(A=given)
    given[0, 0] = 3.0
    assert agent.A[0, 0] == 0.9
    with pytest.raises(ValueError, match="read-only"):
        agent.A[0, 0] = 1.0


def test_arrays_stay_read_only_when_records_travel() -> None:
    """Pickled arrays come back writable unless the record sees to it."""
    agent = planar()
    assert agent.workspace.low[0] == -10.0 and agent.noise_factor.shape == (2, 2)  # cached from here on
    records = [agent, agent.workspace, cg.Proposition("left", [0.0], [5.0]), cg.make_problem("reach-avoid-v0")]
    for record in records:
        for twin in (pickle.loads(pickle.dumps(record)), copy.deepcopy(record), copy.copy(record)):
            members = [twin, *twin.agents, *twin.propositions.values()] if isinstance(twin, cg.Problem) else [twin]
            arrays = [value for member in members for value in vars(member).values() if isinstance(value, np.ndarray)]
            assert not any(array.flags.writeable for array in arrays) and repr(twin) == repr(record)
            assert arrays or isinstance(twin, cg.Problem)
    twin = pickle.loads(pickle.dumps(agent))
    assert twin.to_dict() == agent.to_dict() and not twin.workspace.low.flags.writeable
    assert agent.copies(2)[1].A is agent.A
