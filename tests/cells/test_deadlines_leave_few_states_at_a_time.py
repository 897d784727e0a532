"""Operators with deadlines count steps: values are computed of automaton states that occur at a time, and no others."""

from __future__ import annotations

import numpy as np
import pytest

import certigym as cg
from certigym.envs.tasks.automata import translate, translation
from certigym.synthesis.abstraction.models import joint as joint_module
from certigym.synthesis.abstraction.models.joint import count_of_decisions, join
from certigym.synthesis.policy_search.portfolio.refinement_levels import work_of
from certigym.synthesis.verbs.abstract import abstract
from kinds import mostly_thorough
from problems import two_agents


def test_a_counter_is_in_one_state_at_a_time() -> None:
    problem = two_agents("G[0,8] !b", horizon=8)
    joint = join(problem, abstract(problem, 12, relation="exact"))
    undecided = joint.occurs[:, ~joint.absorbing]
    assert undecided.shape[1] >= 8 and np.all(undecided.sum(axis=1) <= 1)
    # Without deadlines all states occur at nearly all times, and all are computed.
    problem = two_agents("F (a & F c)", horizon=8)
    assert join(problem, abstract(problem, 12, relation="exact")).occurs.all()


@mostly_thorough("formula", ["G[0,6] !b", "F[0,5] (a & F[0,3] c)", "G[0,3] !b & F[2,6] a"], first=2)
def test_bounds_are_those_of_all_states(formula: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """States that do not occur add nothing to the value at the start, nor to the bound for any policy."""
    problem = two_agents(formula, horizon=6)
    found = cg.synthesize(problem, 16, relation="exact")
    assert cg.check(found.certificate) and found.certificate.lower_bound > 0.01
    monkeypatch.setattr(joint_module, "MOST_OCCURRING", -1.0)
    whole = cg.synthesize(problem, 16, relation="exact")
    assert found.certificate.lower_bound == pytest.approx(whole.certificate.lower_bound, rel=1e-9)
    most, above = (float(one.stats["abstract_upper_bound"]) for one in (found, whole))  # type: ignore[arg-type]
    assert found.certificate.lower_bound <= most == pytest.approx(above, rel=1e-9)


def test_work_is_that_of_states_that_occur(monkeypatch: pytest.MonkeyPatch) -> None:
    """A window of T steps costs as much as none: estimates that count all its states leave no effort for its cells."""
    window, none = two_agents("G[0,8] !b", horizon=8), two_agents("G !b", horizon=8, semantics="finite-trace")
    assert count_of_decisions(window) <= 8 and count_of_decisions(none) == 8
    abstraction = abstract(window, 12, relation="exact")
    few = work_of(abstraction, window, rank=1)
    joint = join(window, abstraction)
    assert count_of_decisions(window) >= joint.occurs[:, ~joint.absorbing].sum()
    monkeypatch.setattr(joint_module, "MOST_OCCURRING", -1.0)
    assert work_of(abstraction, window, rank=1) > 4.0 * few


def test_long_windows_take_no_more_steps_than_letters(monkeypatch: pytest.MonkeyPatch) -> None:
    """The weaker windows that a window implies are not expanded again in every state: that took 132,000 steps here."""
    monkeypatch.setattr(translation, "MOST_STEPS", 40_000)
    automaton = translate("G[0,40] (l -> F[0,8] s) & G[20,50] !l", ["l", "s"], "finite-trace")
    assert automaton.n_states == 213
