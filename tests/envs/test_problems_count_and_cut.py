"""Tables in notebooks are escaped; counts are whole numbers, columns cut joint vectors, replaced problems are new."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import certigym as cg
from certigym.envs.systems.arguments import checked_count, slices_of
from problems import scalar_agent


def many_kinds(n: int) -> cg.Problem:
    """A problem whose agents all differ in their workspaces, and whose name needs escaping in HTML."""
    return cg.Problem(
        name="<b>many & more</b>",
        horizon=5,
        agents=[scalar_agent(f"agent_{i}", state_low=[-1.0 - i], state_high=[1.0 + i]) for i in range(n)],
        propositions={"safe": cg.Proposition("agent_*", [-0.5], [0.5])},
        specification=cg.Specification("G all(safe)", "finite-trace"),
    )


def test_names_and_formulas_are_escaped() -> None:
    text = many_kinds(3)._repr_html_()
    assert "<b>" not in text and "&lt;b&gt;many &amp; more" in text
    assert "&amp;" in cg.make_problem("meeting-v0")._repr_html_()


# --- what the same rooms count and cut ------------------------------------------------------------------------


@pytest.mark.parametrize("value", [True, 1.0, "1", None, np.bool_(True), np.float64(1.0), 0, 11])
def test_counts_are_whole_numbers(value: object) -> None:
    with pytest.raises(ValueError, match=r"`n`: expected a whole number from 1 to 10 \(steps\), got "):
        checked_count(value, "n", most=10, unit="steps")


def test_counts_become_ints() -> None:
    assert checked_count(np.int64(3), "n") == 3 and type(checked_count(np.int64(3), "n")) is int
    with pytest.raises(ValueError, match="`n`: expected a whole number of at least 0, got -1"):
        checked_count(-1, "n", least=0)


def test_columns_cut_joint_vectors() -> None:
    problem = cg.make_problem("building-automation-v0")
    assert problem.columns == (slice(0, 2), slice(2, 4)) and problem.input_columns == (slice(0, 1), slice(1, 2))
    assert problem.n_inputs == 2 and slices_of([]) == ()
    joint = np.arange(float(problem.n_states))
    assert [joint[columns].tolist() for columns in problem.columns] == [[0.0, 1.0], [2.0, 3.0]]


def test_replaced_problems_compute_their_properties_again() -> None:
    problem = cg.make_problem("reach-avoid-v0")
    before = problem.fingerprint, problem.initial_q, problem.tasks
    changed = problem.replace(horizon=3, initial_state=[[-10.0], [-4.0]], disturbance_scale=0.5, name="other")
    assert (changed.name, changed.horizon, changed.n_agents) == ("other", 3, 2)
    assert changed.fingerprint != before[0]
    there = problem.replace(initial_state=[[2.0], [-4.0]])
    assert changed.initial_q == before[1] == problem.automaton.initial and there.initial_q != before[1]
    assert changed.tasks == (changed,) and before[2] == (problem,)
    assert changed.labeling is problem.labeling and changed.automaton is problem.automaton
    assert problem.replace().fingerprint == problem.fingerprint
    for copied in (pickle.loads(pickle.dumps(changed)), copy.deepcopy(changed)):
        assert copied.fingerprint == changed.fingerprint and repr(copied) == repr(changed)
