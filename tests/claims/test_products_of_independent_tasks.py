"""Tasks that fall apart are certified part by part; the product holds for the whole, whose size does not matter."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certificate_archives import contents, packed
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.simulation.batch_simulator import Dynamics
from certigym.envs.tasks.problem import groups as independent
from certigym.synthesis.certificates.controllers.product_controller import ProductController
from certigym.synthesis.certificates.proofs import ProductProof, changed, is_exact
from certigym.synthesis.policy_search.bounds.dense import dense_optimum
from certigym.synthesis.verbs.abstract import abstract
from certigym.validation.statistical_tests.binomial import REFUTED
from certigym.validation.statistical_tests.chunks import chunk_results, frames
from certigym.validation.statistical_tests.loop import Loop
from certigym.validation.statistical_tests.rollouts import rollout
from team_problems import pairs

FALSE_ALARM = 1e-6


def apart(monkeypatch: pytest.MonkeyPatch, *arguments: object, **named: object) -> cg.Problem:
    """The pairs, taken apart whatever their number."""
    with monkeypatch.context() as patched:
        patched.setattr(independent, "MOST_STATES", 0)
        return pairs(*arguments, **named)  # type: ignore[arg-type]


def test_the_optimum_of_the_whole_is_the_product_of_the_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dense programming over four agents at once, against two agents and two."""
    whole, problem = pairs(2, 3, starts=(-2.0, -1.2)), apart(monkeypatch, 2, 3, starts=(-2.0, -1.2))
    assert whole.groups == () and [group.agents for group in problem.groups] == [(0, 1), (2, 3)]
    together = dense_optimum(whole, list(abstract(whole, 8).models))
    parts = [dense_optimum(task, list(abstract(task, 8).models)) for task in problem.tasks]
    for q in range(whole.automaton.n_states):  # states by the states of the parts, found by their values
        choices = [np.einsum("ab,cd->abcd", first, second) for first in parts[0] for second in parts[1]]
        assert min(np.abs(together[q] - choice).max() for choice in choices) < 1e-12
    certificate = cg.synthesize(problem, 8, relation="exact").certificate
    assert isinstance(certificate.proof, ProductProof)
    cells = [abstract(whole, 8).models[i].grid.cell_of(whole.agents[i].initial.low[:, None])[0] for i in range(4)]
    optimum = together[(whole.initial_q, *cells)]
    assert 0.5 * optimum < certificate.lower_bound <= optimum
    assert certificate.gap is not None and is_exact(certificate)


def test_joint_episodes_have_the_verdicts_of_the_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The automaton of the whole reads the joint letters of what the parts simulate."""
    whole, problem = pairs(2, 4, starts=(-2.0, -1.2)), apart(monkeypatch, 2, 4, starts=(-2.0, -1.2))
    controller = cg.synthesize(problem, 20, relation="exact").controller
    loop = Loop(problem, controller, seed=3, chunk=400)
    dynamics, q, failed = Dynamics.of(whole), None, np.zeros(400, dtype=bool)
    tracks = []
    for part in loop.parts:
        states = [core.joint(part.arranged[0], frame.worlds) for frame in frames(part, *part.arranged, 0)]
        tracks.append([*states, *states[-1:] * (whole.horizon + 1 - len(states))])
    for joint in (np.concatenate(states, axis=1) for states in zip(*tracks, strict=True)):
        letters = core.letters(dynamics, core.split_joint(dynamics, joint))
        failed |= np.any((joint < -4.0) | (joint > 4.0), axis=1)
        q = whole.automaton.next_state(np.full(400, whole.automaton.initial) if q is None else q, letters)
    expected = whole.automaton.accepting[q] & ~failed
    found = rollout(problem, controller, 400, seed=3, chunk=400).success
    assert 40 < expected.sum() < 360
    np.testing.assert_array_equal(found, expected)


@pytest.mark.thorough
def test_a_hundred_agents_are_certified_checked_and_simulated(tmp_path: Path) -> None:
    problem = pairs(50, 6)
    result = cg.synthesize(problem, 40, relation="exact")
    certificate = result.certificate
    assert isinstance(certificate.proof, ProductProof)
    assert result.stats["tasks"] == 50 and result.stats["distinct_tasks"] == 1
    report = cg.validate(result, 20_000, seed=1, confidence=1 - FALSE_ALARM)
    assert report.verdict != REFUTED and report.details["inadmissible"] == 0
    assert abs(report.estimate - certificate.lower_bound) < 0.02
    cg.save(certificate, tmp_path / "pairs.npz")
    loaded = cg.load(tmp_path / "pairs.npz")
    assert isinstance(loaded.proof, ProductProof) and loaded.lower_bound == certificate.lower_bound
    checked = cg.check(loaded, problem)
    assert checked and checked.recomputed == pytest.approx(certificate.lower_bound, abs=1e-6)


@pytest.mark.thorough
def test_upper_ends_of_the_parts_multiply_in_the_check(monkeypatch: pytest.MonkeyPatch) -> None:
    certificate: Any = cg.synthesize(apart(monkeypatch, 3, starts=(-2.0, 1.0)), 16, relation="exact").certificate
    report = cg.check(certificate)
    parts: Any = [cg.check(part).above for part in certificate.proof.parts]
    assert report and len({*parts}) == 2 and None not in parts
    assert math.prod(parts) <= report.above <= certificate.lower_bound + certificate.gap
    assert report.above == pytest.approx(math.prod(parts), rel=1e-12)
    first, *others = certificate.proof.parts
    unknown = changed(certificate, parts=(changed(first, gap=None), *others))
    assert cg.check(unknown) and cg.check(unknown).above is None
    co_safe: Any = cg.synthesize(apart(monkeypatch, 2, semantics="co-safe"), 16, relation="exact").certificate
    assert cg.check(co_safe) and cg.check(co_safe).above is None


@pytest.mark.thorough
def test_other_starts_multiply(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = apart(monkeypatch, 2, 4, starts=(-2.0, -1.2))
    certificate = cg.synthesize(problem, 40, relation="exact").certificate
    assert isinstance(certificate.proof, ProductProof)
    states = np.random.default_rng(0).uniform(-3, 3, size=(50, 4))
    expected = certificate.proof.parts[0].at(states[:, :2]) * certificate.proof.parts[1].at(states[:, 2:])
    np.testing.assert_allclose(certificate.at(states), expected, rtol=1e-12)
    named = dict(zip(problem.agent_names, states[0][:, None], strict=True))
    assert certificate.at(named)[0] == certificate.at(states)[0]
    low, high = [-2.0, 1.0, -1.5, 1.0], [-1.5, 2.0, -1.0, 1.5]
    smallest, mean = certificate.min(low, high), certificate.mean(low, high)
    inside = np.random.default_rng(1).uniform(low, high, size=(500, 4))
    of_parts = [
        part.mean(low[k : k + 2], high[k : k + 2]) for part, k in zip(certificate.proof.parts, (0, 2), strict=True)
    ]
    assert mean == pytest.approx(math.prod(of_parts), rel=1e-12)
    assert smallest <= certificate.at(inside).min() and smallest < mean < certificate.at(inside).max()
    moved = problem.replace(initial_state=states[0])
    assert cg.synthesize(moved, 40, relation="exact").certificate.lower_bound > 0.0
    with pytest.raises(ValueError, match="expected shape"):
        certificate.at([[0.0, 0.0]])


def test_parts_have_to_be_those_of_the_whole_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = apart(monkeypatch, 2, 3, starts=(-2.0, -1.2))
    certificate = cg.synthesize(problem, 20, relation="exact").certificate
    assert isinstance(certificate.proof, ProductProof)
    first, second = certificate.proof.parts
    assert cg.check(certificate)
    for parts in [(second, first), (second, second), (second,)]:
        assert not cg.check(changed(certificate, parts=parts))


def test_tasks_that_differ_in_a_region_alone_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(independent, "MOST_STATES", 0)
    agents = [pairs(1).agents[0].replace(name=name) for name in ("one", "two")]
    problem = cg.Problem(
        name="goals",
        horizon=3,
        agents=agents,
        propositions={"a": cg.Proposition("one", [-1.0], [0.0]), "b": cg.Proposition("two", [1.0], [2.0])},
        specification=cg.Specification("F a & F b", "finite-trace"),
    )
    result = cg.synthesize(problem, 20, relation="exact")
    assert result.stats["distinct_tasks"] == 2 and cg.check(result.certificate)


def test_given_starts_are_those_of_every_part(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = apart(monkeypatch, 2, 3)
    starts = np.array([[-0.5, -0.5, -0.5, -0.5], [-0.5, -0.5, -0.5, 9.0], [9.0, -0.5, -0.5, -0.5]])
    loop = Loop(problem, cg.synthesize(problem, 20, relation="exact").controller, seed=1, chunk=300, starts=starts)
    ((first, _),) = [(one.success, one.inadmissible) for one in chunk_results(loop, [(0, 300)])]
    assert first[0::3].sum() > 50 and not first[1::3].any() and not first[2::3].any()


def test_parts_of_a_controller_draw_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = apart(monkeypatch, 2, 3)
    drawn: list[int | None] = []

    class Part:
        def __init__(self, task: cg.Problem) -> None:
            self.problem = task

        def reset(self, observations: object, infos: object, seed: int | None) -> None:
            drawn.append(seed)

    parts: Any = tuple(Part(task) for task in problem.tasks)
    controller, observations = ProductController(problem, parts), dict.fromkeys(problem.agent_names)
    for seed in (3, 3, 4):
        controller.reset(observations, None, seed)
    assert drawn[:2] == drawn[2:4] and len(set(drawn)) == 4


def test_agents_without_a_task_have_to_stay_in_the_workspace(monkeypatch: pytest.MonkeyPatch) -> None:
    """An idle agent at the edge of its workspace counts."""
    monkeypatch.setattr(independent, "MOST_STATES", 0)
    base = pairs(2, 3)
    idle = base.agents[0].replace(name="idle", A=[[1.0]], B=[[0.01]], initial_state=[3.9])
    problem = cg.Problem(
        name="idle",
        horizon=3,
        agents=[*base.agents, idle],
        propositions=base.declared,
        specification=base.specification,
    )
    assert [group.agents for group in problem.groups] == [(0, 1), (2, 3), (4,)]
    with_idle, without = (
        cg.synthesize(p, 40, relation="exact").certificate for p in (problem, apart(monkeypatch, 2, 3))
    )
    assert with_idle.lower_bound < 0.7 * without.lower_bound
    assert not cg.validate(with_idle, 20_000, confidence=1 - FALSE_ALARM).refuted


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "pairs.npz"
    cg.save(cg.synthesize(pairs(12, 3, starts=(-2.0, -1.2)), 20, relation="exact").certificate, path)
    header, arrays = contents(path.read_bytes())
    assert sorted(set(header["proof"]["parts"])) == [0, 1]

    def written(**changes: object) -> Path:
        return packed({**header, **changes}, arrays, tmp_path / "changed.npz")

    assert cg.load(written())
    parts = header["proof"]["parts"]
    forged: list[dict[str, Any]] = [{"proof": {"kind": "product", "parts": [1 - k for k in parts]}}]
    forged += [{"proof": {"kind": "product", "parts": wrong}} for wrong in (parts[:-1], [7] * 12)]
    for changes in (*forged, {"fingerprint": "0" * 64}):
        with pytest.raises(ValueError, match="expected a certigym certificate"):
            cg.load(written(**changes))
    with pytest.raises(ValueError, match="more than 1000"):
        cg.load(path, max_bytes=1000)


def test_audits_of_products_see_a_false_part() -> None:
    certificate = cg.synthesize(pairs(12, 3), 20, relation="exact").certificate
    assert isinstance(certificate.proof, ProductProof)
    assert not cg.audit(certificate, 2000).refuted
    boastful = tuple(changed(part, lower_bound=min(1.0, part.lower_bound + 0.2)) for part in certificate.proof.parts)
    report = cg.audit(changed(certificate, parts=boastful), 2000)
    assert report.refuted and report.start_p < 5e-4
    assert cg.compare(certificate.problem, {"certified": certificate}, 200).entries[0].lower_bound is not None
