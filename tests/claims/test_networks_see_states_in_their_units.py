"""Networks that see states in their units, or answer with inputs in theirs, are enclosed by search and check alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.extended_check.steps.network_enclosures import network_maps
from certigym.synthesis.relations.kinds import Network
from certigym.synthesis.verbs.raw_networks import certify_network, differences
from kinds import mostly_thorough
from network_problems import RNG, means_at, reach, with_network
from problems import cart, scalar_agent

FORMS = [(scale, actions) for scale in ("raw", "unit") for actions in ("input", "unit")]
SHAPES = [([8], "tanh", False), ([16, 16], "relu", False), ([8, 8], "tanh", True), ([], "tanh", False)]


def network_of(problem: cg.Problem, form: tuple[str, str], hidden: list[int], kind: str, squashed: bool) -> Network:
    """A random network whose outputs reach both ends of the input box, in the units of its form."""
    agent = problem.agents[0]
    d, middle = agent.n_states, 0.5 * (agent.workspace.low + agent.workspace.high)
    sizes = [d + problem.automaton.n_states + 1, *hidden, agent.n_inputs]
    pairs = list(zip(sizes[:-1], sizes[1:], strict=True))
    weights = [1.5 * RNG.normal(size=(b, a)) / np.sqrt(a) for a, b in pairs]
    biases = [0.3 * RNG.normal(size=b) for _, b in pairs]
    if form[0] == "raw":
        weights[0][:, :d] /= 0.5 * (agent.workspace.high - agent.workspace.low)
        biases[0] -= weights[0][:, :d] @ middle
    if form[1] == "input" and not squashed:
        half, centre = 0.5 * (agent.input_high - agent.input_low), 0.5 * (agent.input_high + agent.input_low)
        weights[-1], biases[-1] = weights[-1] * half[:, None], biases[-1] * half + centre
    first, second = (tuple(x.astype(np.float32) for x in arrays) for arrays in (weights, biases))
    return Network(first, second, kind, squashed)


def policy_of(problem: cg.Problem, form: tuple[str, str], shape: tuple[list[int], str, bool]) -> Any:
    env = f"parallel_env(scale={form[0]}, actions={form[1]})"
    return cg.as_policy(network_of(problem, form, *shape), problem, env)


def agents() -> list[Any]:
    moved = cart(
        B=[[0.5, 0.0], [0.0, 0.5]], input_low=[-2.0, -0.25], input_high=[1.0, 1.5],
        noise_covariance=[[0.04, 0.0], [0.0, 0.05]], initial_state=[-1.0, 0.0],
    )  # fmt: skip
    return [scalar_agent("a"), cart(), moved]


@mostly_thorough("shape", SHAPES)
@pytest.mark.parametrize("form", FORMS)
@mostly_thorough("which", range(3))
def test_no_point_of_a_cell_leaves_its_map(which: int, form: tuple[str, str], shape: Any) -> None:
    """Dense samples of closed cells, corners among them, lie within the maps of the check."""
    agent = agents()[which]
    if shape[2] and form[1] == "input":
        pytest.skip("tanh answers with shares of the input box")
    problem, d = reach(agent, horizon=2), agent.n_states
    policy, cells = policy_of(problem, form, shape), 12 if d == 1 else 6
    part = certify_network(problem, policy, cells).certificate.proof.agents[0]
    shares = np.concatenate([RNG.random((100, d)), np.array(np.meshgrid(*[[0.0, 1.0]] * d)).reshape(d, -1).T])
    n = np.arange(part.grid.n_cells)
    for mode in range(2 * problem.automaton.n_states):
        t, q = divmod(mode, problem.automaton.n_states)
        if problem.automaton.absorbing[q]:
            continue
        maps = network_maps(agent, part, n, mode)
        for cell, (low, high) in enumerate(zip(part.grid.low, part.grid.high, strict=True)):
            points = low + shares * (high - low)
            means = means_at(problem, policy, 0, points.T, q, t).T
            z, gain, rho = (each[cell] for each in maps)
            off = np.abs(means - z - (points - 0.5 * (low + high)) @ gain.T)
            assert np.all(off <= rho + 1e-13)


def goal_seeker(problem: cg.Problem) -> Network:
    """All agents go to 2 on their first axes, seen in its unit, and answer with inputs."""
    row = np.zeros((1, problem.agents[0].n_states + problem.automaton.n_states + 1), dtype=np.float32)
    row[0, 0] = -0.9
    wide = np.concatenate([row, -row])
    out = np.array([[1.0, -1.0]], dtype=np.float32)
    return Network((wide, out), (np.array([1.8, -1.8], np.float32), np.zeros(1, np.float32)), "relu", False)


@pytest.fixture(scope="module")
def certified() -> tuple[cg.Problem, Any, cg.Synthesis]:
    problem = reach(scalar_agent("a"), scalar_agent("b"))
    policy = cg.as_policy(goal_seeker(problem), problem, "parallel_env")
    return problem, policy, cg.certify(problem, policy, 100)


def test_the_bound_is_that_of_the_network_itself(certified: tuple[cg.Problem, Any, cg.Synthesis]) -> None:
    problem, policy, found = certified
    assert cg.check(found)
    assert differences(found.certificate, policy) == []
    runs = cg.rollout(problem, policy, 20_000)
    assert 0.3 < found.certificate.lower_bound <= runs.successes / runs.episodes + 0.02
    # The controller of the certificate does what the network does, in every episode.
    assert np.array_equal(runs.success, cg.rollout(problem, found, 20_000).success)


def test_files_keep_the_form_and_refuse_another(certified: tuple[cg.Problem, Any, cg.Synthesis], tmp_path: Any) -> None:
    _, policy, found = certified
    cg.save(found.certificate, tmp_path / "c.npz")
    read = cg.load(tmp_path / "c.npz")
    assert cg.check(read) and differences(read, policy) == []
    assert read.proof.agents[0].relation["network"]["scale"] == "raw"
    assert read.proof.agents[0].relation["network"]["outputs"] == "box"
    for facts in ({"scale": "unit"}, {"outputs": "unit"}, {"scale": "metric"}, {"outputs": "metric"}):
        other = with_network(found.certificate, **facts)
        assert not _passes(other), facts
        assert differences(other, policy) != []


def _passes(certificate: Any) -> bool:
    try:
        return bool(cg.check(certificate))
    except ValueError:
        return False
