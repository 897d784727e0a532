"""Linear cells choose among constant inputs and targets, cell by cell; search, check and controller read both alike."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.abstraction.kernels import MultilinearKernel
from certigym.synthesis.abstraction.models import corner_model
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.extended_check.steps.symbolic_linear import MatrixMaps
from certigym.synthesis.relations.kinds import ExactRelation
from kinds import mostly_thorough

FALSE_ALARM = 1e-6
"""Probability that rollouts refute a true certificate, over all cases."""

FACTS: dict[str, Any] = {
    "state_low": [-2.0, -2.0],
    "state_high": [2.0, 2.0],
    "input_low": [-0.6, -0.6],
    "input_high": [0.6, 0.6],
    "initial_state": [-1.4, -1.1],
}


def planar(written: bool) -> cg.Problem:
    """A robot on a plane whose steps are short, as matrices or as expressions, is to come to a corner."""
    agent: cg.LinearAgent | cg.Agent
    if written:
        agent = cg.Agent(
            name="robot", states=["x", "y"], inputs=["u", "v"], dynamics=["0.95*x + u", "y - 0.05*x + v"],
            noise=[{"law": "gaussian", "std": 0.2}, {"law": "gaussian", "std": 0.2}], **FACTS,
        )  # fmt: skip
    else:
        agent = cg.LinearAgent(
            name="robot", A=[[0.95, 0.0], [-0.05, 1.0]], B=np.eye(2), noise_covariance=0.04 * np.eye(2), **FACTS
        )
    return cg.Problem(
        name="planar",
        horizon=6,
        agents=[agent],
        propositions={
            "goal": cg.Proposition("robot", [0.5, 0.5], [1.8, 1.8]),
            "hole": cg.Proposition("robot", [-0.5, -0.5], [0.0, 0.0]),
        },
        specification=cg.Specification("!hole U goal", "co-safe"),
    )


@cache
def certified(written: bool) -> cg.Certificate:
    certificate = cg.synthesize(planar(written), 14, relation="linear").certificate
    assert isinstance(certificate, cg.Certificate)
    return certificate


@mostly_thorough("written", [False, True])
def test_policies_choose_both_and_hold(written: bool) -> None:
    certificate = certified(written)
    part = certificate.proof.agents[0]
    n_inputs = len(part.relation["menu"])
    assert part.relation["aims"] is True
    live = ~certificate.problem.automaton.finished
    chosen = part.policy[:, live]
    assert np.any(chosen >= n_inputs) and np.any((chosen >= 0) & (chosen < n_inputs))
    report = cg.check(certificate)
    assert report and report.recomputed == pytest.approx(certificate.lower_bound, abs=1e-4)
    assert not cg.validate(certificate, 50_000, seed=4, confidence=1 - FALSE_ALARM / 2).refuted


def test_matrices_and_expressions_of_one_system_certify_the_same() -> None:
    assert certified(True).lower_bound == pytest.approx(certified(False).lower_bound, abs=1e-3)


def test_both_are_worth_more_than_targets_and_no_less_than_inputs(monkeypatch: pytest.MonkeyPatch) -> None:
    both = certified(False)
    input_set = np.array(both.proof.agents[0].relation["menu"])
    # Targets beside a single input, which is the middle of its box.
    monkeypatch.setattr(corner_model, "with_rest", lambda box, levels: np.zeros((1, 2)))
    targets = cg.synthesize(planar(False), 14, relation="linear").certificate
    monkeypatch.undo()
    # The same inputs, on the same lattice, without targets.
    monkeypatch.setattr(corner_model, "reaches_every_mean", lambda agent: False)
    monkeypatch.setattr(corner_model, "with_rest", lambda box, levels: input_set)
    inputs = cg.synthesize(
        planar(False), 14, relation="linear", search=cg.SearchOptions(targets_per_cell=8)
    ).certificate
    monkeypatch.undo()
    assert "aims" not in inputs.proof.agents[0].relation and cg.check(inputs)
    assert both.lower_bound > targets.lower_bound + 0.02
    # Targets make steps at the faces of cells, which costs next to nothing where inputs alone would do.
    assert both.lower_bound > inputs.lower_bound - 0.002


def forged(certificate: cg.Certificate, change: Any, **relation: Any) -> cg.Certificate:
    """Change choices, the claim being as it was."""
    part = certificate.proof.agents[0]
    policy = change(part.policy.copy(), len(part.relation["menu"]))
    return changed(
        certificate, agents=(replace(part, policy=policy, relation={**part.relation, **relation}),)
    )  # fmt: skip


FORGERIES: dict[str, Any] = {
    "targets are inputs": lambda policy, n: np.where(policy >= n, policy % n, policy),
    "inputs are targets": lambda policy, n: np.where((policy >= 0) & (policy < n), policy + n, policy),
    "targets of neighbours": lambda policy, n: np.where(policy >= n, policy + 3, policy),
    "other inputs": lambda policy, n: np.where((policy >= 0) & (policy < n), (policy + 1) % n, policy),
}


@pytest.mark.parametrize("written", [False, True])
@pytest.mark.parametrize("how", FORGERIES)
def test_other_choices_are_refused(how: str, written: bool) -> None:
    assert not cg.check(forged(certified(written), FORGERIES[how]))


@pytest.mark.parametrize("written", [False, True])
def test_one_target_out_of_reach_is_refused_at_any_time(written: bool) -> None:
    """Rows of a policy that are alike are verified once: one cell of any row makes another row of it."""
    certificate = certified(written)
    times, states, _ = certificate.proof.agents[0].policy.shape
    for t, q in np.ndindex(times, states):

        def far(policy: np.ndarray, n: int, row: tuple[int, int] = (t, q)) -> np.ndarray:
            policy[(*row, 0)] = n + int(np.prod(certificate.proof.agents[0].lattice_shape)) - 1
            return policy

        report = cg.check(forged(certificate, far))
        assert not report and "inputs beyond its input box" in report.failures[0]


def test_files_without_the_word_have_no_targets(tmp_path: Any) -> None:
    """Choices beyond the menu are out of range where a relation does not offer targets."""
    certificate = certified(False)
    part = certificate.proof.agents[0]
    silent = {name: value for name, value in part.relation.items() if name != "aims"}
    other = changed(certificate, agents=(replace(part, relation=silent),))
    file = tmp_path / "silent.npz"
    cg.save(other, file)
    with pytest.raises(ValueError, match="out of range"):
        cg.load(file)


def test_what_is_read_between_lattice_points_is_charged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sabotage of the search alone: values without what they lack; the check refuses the claim."""
    monkeypatch.setattr(MultilinearKernel, "_lacking", lambda self, table, *rest: np.zeros((len(table), len(rest[0]))))
    wrong = cg.synthesize(planar(False), 14, relation="linear").certificate
    monkeypatch.undo()
    assert wrong.lower_bound > certified(False).lower_bound and not cg.check(wrong)


def test_targets_that_inputs_do_not_reach_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sabotage of the search alone: windows of targets as if inputs were twice as strong."""
    honest = ExactRelation.reserve
    monkeypatch.setattr(ExactRelation, "reserve", lambda self, half: honest(self, half) + 0.6)
    wrong = cg.synthesize(planar(False), 14, relation="linear").certificate
    monkeypatch.undo()
    report = cg.check(wrong)
    assert wrong.lower_bound > certified(False).lower_bound
    assert not report and "inputs beyond its input box" in report.failures[0]


def test_the_first_number_beyond_the_menu_is_a_target() -> None:
    """The lattice point 0, and not once more the last input."""
    part, states, q = certified(False).proof.agents[0], np.zeros((2, 1)), np.zeros(1, dtype=np.int64)
    n, inputs = len(part.relation["menu"]), []
    for number in (n - 1, n):
        controller = forged(certified(False), lambda policy, _, number=number: np.full_like(policy, number)).controller
        inputs.append(controller.agents[0].act(states, q, 0, None)[0][:, 0])
    np.testing.assert_allclose(inputs[0], np.array(part.relation["menu"])[-1])
    assert not np.allclose(inputs[0], inputs[1])


def test_the_check_charges_what_means_of_matrices_are_off_by() -> None:
    """Twice: once for the controller's input, once for what the check computes itself."""
    certificate = certified(False)
    maps = MatrixMaps(certificate.problem.agents[0], certificate.proof.agents[0], np.array([1e-3, 2e-3]))  # type: ignore[arg-type]
    np.testing.assert_array_equal(maps.at(np.arange(3))[2], np.tile([2e-3, 4e-3], (3, 1)))
