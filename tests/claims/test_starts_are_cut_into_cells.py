"""Boxes of starts are cut into cells from which a network is certified: on average, and from every start."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import Cut, PathProof, StartsProof, changed, contents_of
from certigym.synthesis.certificates.proofs.canonical import canonical_bytes
from certigym.synthesis.checker import check_contents, parse_file
from certigym.synthesis.checker.distributions import LIGHT, LONG, NORMAL, STOPPED
from certigym.synthesis.checker.error_system import length_tail
from certigym.synthesis.trajectories.planning.policy_paths import networks_along

EPISODES = 20_000


def swing(start: Any) -> cg.Problem:
    """A pendulum that is to come to the middle, from starts in and out of it."""
    law = {"law": "triangular", "low": -1.0, "mode": 0.0, "high": 1.0}
    agent = cg.Agent(
        name="a", states=["x", "v"], inputs=["u"], noise={"laws": [law, law], "axes": [[0.002, 0.01], [0.03, 0.0]]},
        dynamics=["x + 0.05*(0.9*v + 0.75*sin(x) + 8*u)", "0.9*v + 0.75*sin(x) + 8*u"],
        state_space=([-0.8, -3.0], [0.8, 3.0]), input_space=(-1, 1), start=start,
    )  # fmt: skip
    bad = cg.Proposition("a", [-0.8, -3.0], [-0.65, 0.0])
    goal = cg.Proposition("a", [-0.2, -0.5], [0.2, 0.5])
    return cg.Problem(name="swing", horizon=25, agents=[agent], propositions={"bad": bad, "goal": goal},
                      specification=cg.Specification("!bad U goal"))  # fmt: skip


def network() -> list[Any]:
    """A relu network that damps, and pushes back: ``u = -(0.9 v + 0.75 x)/8 - 0.3 x + bumps``."""
    rng = np.random.default_rng(0)
    gains = np.array([[-0.39], [-0.11]])
    first = np.concatenate([np.eye(2), -np.eye(2), 0.4 * rng.standard_normal((2, 12))], axis=1)
    first = np.concatenate([first, np.zeros((1, 16))])  # the time is not looked at
    last = np.concatenate([gains, -gains, 0.003 * rng.standard_normal((12, 1))])
    bias = np.concatenate([np.zeros(4), 0.2 * rng.standard_normal(12)])
    layers = [(first, bias), (last, np.zeros(1))]
    return [(w.astype(np.float32), b.astype(np.float32)) for w, b in layers]


def given(problem: cg.Problem) -> Any:
    return cg.as_policy(network(), problem, env="parallel_env(automaton=hidden)", activation="relu")


@pytest.fixture(scope="module")
def found() -> Any:
    problem = swing(([-0.3, -0.4], [0.3, 0.4]))
    return cg.certify(problem, given(problem)).certificate


@pytest.mark.thorough
def test_both_bounds_hold_in_rollouts(found: Any) -> None:
    """From starts in all of the box, and from its corners, its middle and other places."""
    assert isinstance(found.proof.cut, Cut) and cg.check(found, found.problem)
    assert 0.0 < found.proof.failure < found.proof.worst < 1e-5
    assert "every start" in found.proof.about
    starts = [*itertools.product((-0.3, 0.1, 0.3), (-0.4, 0.1, 0.4))]
    runs = [cg.rollout(found.problem, found.controller, episodes=EPISODES, seed=0)]
    for start in starts:
        problem = swing(list(start))
        runs.append(cg.rollout(problem, given(problem), episodes=EPISODES // 10, seed=1))
    assert all(run.successes == len(run.success) for run in runs)


def test_starts_outside_of_the_workspace_are_refused_in_words() -> None:
    problem = swing(([0.7, -0.1], [0.85, 0.1]))
    with pytest.raises(ValueError, match="a start lies outside the workspace"):
        networks_along(problem, [given(problem).agent_policy(0)])


def test_files_hold_them(found: Any, tmp_path: Any) -> None:
    cg.save(found, tmp_path / "c.npz")
    again: Any = cg.load(tmp_path / "c.npz")
    assert cg.check(again, found.problem)
    assert (again.proof.failure, again.proof.worst) == (found.proof.failure, found.proof.worst)
    verdict = check_contents(parse_file(canonical_bytes(found)))
    assert verdict.proved and "networks" in verdict.modules
    # the worst of its cells, and as many of them as are cut
    assert max(failure for failure, *_ in verdict.steps) <= found.proof.worst
    assert len(verdict.steps) == len([*found.proof.paths])


def test_forged_cells_are_refused(found: Any) -> None:
    proof, cut = found.proof, found.proof.cut
    forged = {
        "a cut elsewhere": replace(cut, at=cut.at + 0.2),
        "sides that change places": replace(cut, below=cut.above, above=cut.below),
        "a cell without a proof": replace(cut, below=None),
    }
    for name, own in forged.items():
        assert not cg.check(changed(found, cut=own), found.problem), name
    for less in ({"worst": 0.9 * proof.worst}, {"failure": 0.9 * proof.failure}):
        assert not cg.check(changed(found, **less), found.problem), less
    wider = found.problem.replace(initial_low=[-0.4, -0.4], initial_high=[0.3, 0.4])
    assert not cg.check(replace(found, problem=wider), wider)


@pytest.mark.parametrize(("key", "value"), [("cut", 2.0), ("cut", -0.3), ("state", 2), ("agent", 1), ("kind", "cells")])
def test_cuts_outside_of_the_box_are_none(found: Any, key: str, value: Any) -> None:
    contents = contents_of(found)
    header = {**contents.header, "proof": {**contents.header["proof"], key: value}}
    with pytest.raises(ValueError, match="proof"):
        check_contents(replace(contents, header=header, used=set()))


def test_what_fails_from_a_cell_counts_by_its_share(found: Any) -> None:
    """Without the proof of one side of the first cut, half of the starts, half of them may fail."""
    half = changed(found, cut=replace(found.proof.cut, above=None), failure=0.51, worst=1.0)
    report = cg.check(half, found.problem)
    assert report and 0.49 < report.recomputed <= 0.5
    assert not cg.check(changed(half, failure=0.49), found.problem)


def test_lengths_of_sub_gaussian_vectors_have_these_tails() -> None:
    """Sums of signs and of uniform numbers in one to five dimensions: 100,000 draws, 5 deviations of each share."""
    rng = np.random.default_rng(4)
    for d in (1, 2, 3, 5):
        for draw in (lambda n: rng.choice([-1.0, 1.0], n), lambda n: np.sqrt(3.0) * rng.uniform(-1.0, 1.0, n)):
            parts = draw((100_000, 3, d)).sum(axis=1) / np.sqrt(3.0)
            lengths = np.linalg.norm(parts @ np.linalg.qr(rng.standard_normal((d, d)))[0], axis=1)
            for radius in (np.sqrt(d) + 0.5, np.sqrt(d) + 1.0, np.sqrt(d) + 2.0):
                share, p = float(np.mean(lengths > radius)), length_tail(float(radius), d, 1.0, LIGHT)
                assert share <= p + 5.0 * np.sqrt(p / len(lengths))
    assert length_tail(3.0, 2, 1.0, LIGHT) == length_tail(3.0, 2, 1.0, STOPPED) > length_tail(3.0, 2, 1.0, NORMAL)
    assert length_tail(3.0, 2, 1.0, LONG) == length_tail(1.0, 2, 1.0, LIGHT) == 1.0
    assert 0.0 < length_tail(1e9, 3, 1.0, LIGHT) < 1e-200


def test_shares_are_those_of_the_volume() -> None:
    """A quarter of the starts, or three quarters, of which nothing is claimed."""
    problem = swing(([0.25, -0.1], [0.35, 0.1]))
    certificate = cg.certify(problem, given(problem)).certificate
    path = certificate.proof
    assert isinstance(path, PathProof) and path.networks is not None and path.failure < 1e-6
    for below, above, share in ((None, path, 0.25), (path, None, 0.75)):
        cut = Cut(0, 0, 0.275, below, above)
        for failure, is_right in ((share + 1e-5, True), (share - 1e-5, False)):
            proof = StartsProof(cut, path.networks, failure, 1.0)
            assert bool(cg.check(replace(certificate, proof=proof), problem)) is is_right
