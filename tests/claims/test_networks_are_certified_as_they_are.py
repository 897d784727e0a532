"""The certified bound of a deployed network is below what it attains, and no changed network or enclosure passes."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import certigym as cg
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.relations.kinds import Network
from certigym.synthesis.relations.kinds.network_bounds import line_around
from certigym.synthesis.verbs.raw_networks import certify_network, differences
from certigym.validation.policies.actors import CentralActor, SharedActor, load_actor, save_actor
from certigym.validation.policies.views import CentralView
from network_problems import RNG, means_at, network, proportional, reach, with_network
from problems import scalar_agent


@pytest.fixture(scope="module")
def certified() -> tuple[cg.Problem, SharedActor, cg.Synthesis]:
    """Two scalar agents and the certificate of their network."""
    problem = reach(scalar_agent("a"), scalar_agent("b"))
    actor = proportional(problem)
    return problem, actor, certify_network(problem, actor, 100)


@pytest.mark.parametrize("kind", ["tanh", "relu", "clip"])
def test_lines_hold_their_function(kind: str) -> None:
    """On intervals of all widths, degenerate ones among them."""
    ends = np.sort(RNG.uniform(-4.0, 4.0, (2, 500)), axis=0)
    ends[1, :50] = ends[0, :50]
    ends[1, 50:100] = ends[0, 50:100] + 1e-13
    line = line_around(kind, *ends)
    function = {"tanh": np.tanh, "relu": lambda z: np.maximum(z, 0.0), "clip": lambda z: np.clip(z, -1.0, 1.0)}[kind]
    for share in np.linspace(0.0, 1.0, 101):
        z = ends[0] + share * (ends[1] - ends[0])
        assert np.all(np.abs(function(z) - line.slope * z - line.middle) <= line.radius)  # type: ignore[operator]


def dense(problem: cg.Problem, actor: Any, points: int) -> float:
    """Probability that one scalar agent reaches [1, 3], by the midpoint rule on many points."""
    agent = problem.agents[0]
    edges = np.linspace(-4.0, 4.0, points + 1)
    middle, std = 0.5 * (edges[1:] + edges[:-1]), float(np.sqrt(agent.noise_covariance[0, 0]))
    goal = (middle >= 1.0) & (middle < 3.0)
    initial = problem.automaton.initial
    value = goal.astype(float)
    start = np.array(agent.initial.low)[:, None]
    for t in reversed(range(problem.horizon)):
        at = start if t == 0 else middle[None]
        means = means_at(problem, actor, 0, at, initial, t)[0]
        later = np.diff(norm.cdf((edges[None] - means[:, None]) / std), axis=1) @ value
        value = later if t == 0 else np.where(goal, 1.0, later)
    return float(value[0])


@pytest.mark.thorough
def test_bounds_approach_dense_programming_from_below() -> None:
    """One agent: the bound rises with the cells, and stays below a computation with many points."""
    problem = reach(scalar_agent("a", initial_state=[-2.0]), horizon=3)
    actor = proportional(problem)
    truth = dense(problem, actor, 2000)
    assert abs(truth - dense(problem, actor, 1000)) < 1e-5
    bounds = [certify_network(problem, actor, cells).certificate.lower_bound for cells in (25, 100, 800)]
    assert bounds[0] < bounds[1] < bounds[2] < truth
    assert truth - bounds[2] < 0.01


def test_certificates_hold_and_travel(certified: tuple[cg.Problem, SharedActor, cg.Synthesis], tmp_path: Path) -> None:
    """Checked, saved and loaded; the controllers of the file do what the network does, and rollouts agree."""
    problem, actor, synthesis = certified
    certificate = synthesis.certificate
    assert cg.check(certificate) and certificate.lower_bound > 0.3
    cg.save(certificate, tmp_path / "c.npz")
    loaded = cg.load(tmp_path / "c.npz")
    assert cg.check(loaded) and loaded.lower_bound == certificate.lower_bound
    save_actor(actor, tmp_path / "a.npz")
    same: Any = load_actor(tmp_path / "a.npz", problem)
    assert differences(loaded, same) == []
    # The network itself and the controllers of the certificate succeed in the same episodes.
    ours = cg.rollout(problem, loaded.controller, episodes=20_000, seed=1)
    deployed = cg.rollout(problem, cg.as_controller(problem, same), episodes=20_000, seed=1)
    assert np.array_equal(ours.success, deployed.success)
    # False alarm 1e-6; a bound that is too large by .02 is refuted.
    report = cg.validate(synthesis, episodes=20_000, seed=1, confidence=1.0 - 1e-6)
    assert report.ci_high >= certificate.lower_bound


def test_a_single_agent_may_have_a_network_that_sees_all() -> None:
    """SAC: squashed, and not told which agent it is; rollouts are those of the actor itself."""
    problem = reach(scalar_agent("a", initial_state=[-1.0]), horizon=3)
    view = CentralView(problem)
    actor: Any = CentralActor(problem, network([view.size, 16, 16, 1], "relu", True))
    synthesis = cg.certify(problem, actor, 200)
    assert cg.check(synthesis) and differences(synthesis.certificate, actor) == []
    ours, deployed = (cg.rollout(problem, policy, episodes=5000, seed=0) for policy in (synthesis.controller, actor))
    assert np.array_equal(ours.success, deployed.success)
    assert not cg.check(with_network(synthesis.certificate, squashed=False))


def test_other_weights_are_refused(certified: tuple[cg.Problem, SharedActor, cg.Synthesis]) -> None:
    """A bias of the last layer that was changed after certification."""
    _, actor, synthesis = certified
    last = [bias.tolist() for bias in actor.network.biases]
    last[-1] = [-0.2]
    wrong = with_network(synthesis.certificate, biases=last)
    assert not cg.check(wrong)
    assert differences(wrong, actor) != []


def test_the_wrong_time_is_refused(certified: tuple[cg.Problem, SharedActor, cg.Synthesis]) -> None:
    """What the network does at another time, and a view of another horizon, of another agent or of fewer states."""
    problem, _, synthesis = certified
    part = synthesis.certificate.proof.agents[0]
    shifted = part.policy.copy()
    shifted[0] = part.policy[1]
    wrong = dataclasses.replace(part, policy=shifted)
    report = cg.check(changed(synthesis.certificate, agents=(wrong, synthesis.certificate.proof.agents[1])))
    assert "another time" in str(report)
    for facts in ({"horizon": problem.horizon - 1}, {"agent": 1}):
        assert "another problem" in str(cg.check(with_network(synthesis.certificate, **facts)))


def test_what_is_not_certified_is_refused_in_words(certified: tuple[cg.Problem, SharedActor, cg.Synthesis]) -> None:
    """Networks that see all states, weights of double precision, other relations."""
    problem, actor, _ = certified
    view = CentralView(problem)
    with pytest.raises(ValueError, match="own state"):
        central: Any = CentralActor(problem, network([view.size, 2]))
        cg.certify(problem, central, 50)
    double = Network(tuple(w.astype(float) for w in actor.network.weights), actor.network.biases, "tanh", False)
    with pytest.raises(ValueError, match="single precision"):
        cg.certify(problem, SharedActor(problem, double), 50)


@pytest.mark.thorough
@pytest.mark.parametrize("algorithm", ["ippo", "sac"])
def test_trained_actors_are_certified(algorithm: str) -> None:
    """Actors of Stable-Baselines3, hardly trained: PPO clips and has tanh, SAC squashes and has relu."""
    pytest.importorskip("stable_baselines3")
    agents = [scalar_agent("a"), scalar_agent("b")] if algorithm == "ippo" else [scalar_agent("a")]
    problem = reach(*agents, horizon=3)
    settings: dict[str, Any] = {"worlds": 8, "hidden": [16, 16]}
    settings |= {"learning_starts": 64, "batch_size": 32} if algorithm == "sac" else {}
    actor: Any = cg.train(problem, algorithm, steps=256, seed=0, **settings).actor
    certified = cg.certify(problem, actor, 150)
    assert cg.check(certified) and differences(certified.certificate, actor) == []
    found = {part.relation["network"]["activation"] for part in certified.certificate.proof.agents}
    assert found == {"tanh" if algorithm == "ippo" else "relu"}
    # False alarm 1e-6; a bound that is too large by .04 is refuted.
    report = cg.validate(certified, episodes=4000, seed=1, confidence=1.0 - 1e-6)
    assert report.ci_high >= certified.certificate.lower_bound
