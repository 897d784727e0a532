"""What is made anew from a certificate is made with its settings: upper ends, and searches that begin with it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.verbs.upper_bounds import bound_above
from kinds import mostly_thorough
from problems import scalar_agent


def task(horizon: int = 4) -> cg.Problem:
    """One agent that is to reach a goal."""
    return cg.Problem(
        name="goal",
        horizon=horizon,
        agents=[scalar_agent("a", A=[[0.9]], input_low=[-1.0], input_high=[1.0], noise_covariance=[[0.05]])],
        propositions={"goal": cg.Proposition("a", [0.5], [1.5])},
        specification=cg.Specification("F goal", "co-safe"),
    )


SETTINGS: dict[str, dict[str, Any]] = {
    "exact": {"targets_per_cell": 3},
    "linear": {"targets_per_cell": 6},
    "boxes": {"targets_per_cell": 7},
    "paper": {"epsilon": 0.2, "inputs": 14, "feedback": -0.1, "delta": 0.2},
}


@mostly_thorough("kind", SETTINGS, first=2)
def test_settings_that_are_not_given_are_those_of_the_certificate(kind: str) -> None:
    given, problem = SETTINGS[kind], task()
    certificate = cg.synthesize(problem, 40, relation=kind, search=cg.SearchOptions(**given)).certificate
    assert {name: certificate.settings[name] for name in given} == given
    # Without the settings other lattices or relations would come out, and the start would not fit.
    again = cg.synthesize(problem, start=certificate, search=cg.SearchOptions(max_sweeps=0)).certificate
    longer = cg.synthesize(task(6), start=certificate, search=cg.SearchOptions(max_sweeps=0)).certificate
    for other in (again, longer):
        assert {name: other.settings[name] for name in given} == given
    assert again.lower_bound == pytest.approx(certificate.lower_bound, abs=1e-9)
    end = bound_above(certificate)
    assert cg.check(end)
    assert certificate.lower_bound <= end.upper_bound


def test_what_is_given_counts_more_than_what_was() -> None:
    certificate = cg.synthesize(task(), 40, relation="exact", search=cg.SearchOptions(targets_per_cell=3)).certificate
    with pytest.raises(ValueError, match="`start`: expected a certificate of the same agents, task, cells"):
        cg.synthesize(task(), start=certificate, search=cg.SearchOptions(targets_per_cell=2))
    # Settings of another relation than the one that is asked for are not carried over: nobody gave them.
    lossy = cg.synthesize(task(), 40, relation="paper", search=cg.SearchOptions(epsilon=0.2)).certificate
    with pytest.raises(ValueError, match="`start`: expected a certificate of the same agents"):
        cg.synthesize(task(), start=lossy, relation="exact")


@pytest.mark.parametrize("value", ["3", [3], True, float("nan")])
def test_settings_of_a_file_that_are_none_are_refused_by_the_name_of_the_argument(value: Any) -> None:
    certificate = cg.synthesize(task(), 40, relation="exact").certificate
    odd = replace(certificate, settings={**certificate.settings, "targets_per_cell": value})
    with pytest.raises(ValueError, match="`start`: expected a certificate with settings of its relations"):
        cg.synthesize(task(), start=odd)
    with pytest.raises(ValueError, match=r"^`certificate`: "):
        bound_above(changed(odd, gap=None))


def test_a_start_may_be_a_synthesis_and_what_is_no_certificate_is_called_start() -> None:
    result = cg.synthesize(task(), 40)
    assert cg.synthesize(task(), start=result).certificate.lower_bound >= result.certificate.lower_bound
    with pytest.raises(ValueError, match=r"^`start`: expected a Synthesis, a certificate or the path of one, got int"):
        cg.synthesize(task(), start=3)
