"""Teams whose tasks are independent are certified task by task, where that knows their noise more closely.

The certificate is of the team as it was written: its controllers act in its environments, with its one automaton.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.certificates.controllers.product_controller import states_apart
from certigym.synthesis.certificates.proofs import Certificate, ProductProof

FALSE_ALARM = 1e-6

BOXES = {"state_space": (-4, 4), "input_space": (-1, 1)}
LEFT: dict[str, Any] = {
    "states": ["x"], "inputs": ["u"], "dynamics": ["x + u"], "noise_std": [1.0], "noise_scale": ["0.2 + 0.1*abs(x)"]
}  # fmt: skip
RIGHT: dict[str, Any] = {
    "states": ["y"], "inputs": ["v"], "dynamics": ["0.9*y + v"], "noise": [{"law": "laplace", "scale": 0.2}]
}  # fmt: skip
REGIONS = {
    "goal": {"agent": "left", "low": 0.5, "high": 1.2},
    "rock": {"agent": "left", "low": -1.2, "high": -0.9},
    "home": {"agent": "right", "low": -0.4, "high": 0.4},
}


def team(task: str = "(F goal & G !rock) & F[0,3] home", semantics: str = "finite-trace", **more: Any) -> cg.Problem:
    """Two agents of one state, in noise that varies and in Laplace noise."""
    agents = [cg.Agent(name="left", start=-2.0, **LEFT, **BOXES), cg.Agent(name="right", start=2.0, **RIGHT, **BOXES)]
    return cg.Problem(
        horizon=5, agents=agents, propositions={**REGIONS, **more}, specification=cg.Specification(task, semantics)
    )


@pytest.fixture(scope="module")
def found() -> Any:
    return cg.synthesize(team(), effort=1.0)


@pytest.mark.thorough
def test_the_product_is_proved_and_near_what_rollouts_of_the_whole_show(found: Any) -> None:
    certificate = found.certificate
    assert isinstance(certificate.proof, ProductProof) and certificate.problem.groups == ()
    assert cg.check(certificate).valid
    episodes = 20_000
    successes = int(cg.rollout(certificate.problem, found.controller, episodes=episodes, seed=5).success.sum())
    assert binom.cdf(successes, episodes, certificate.lower_bound) > FALSE_ALARM
    assert certificate.lower_bound > successes / episodes - 0.08


@pytest.mark.thorough
def test_controllers_act_in_both_environments_of_the_whole(found: Any) -> None:
    """As often as in batches, up to chance, of 150 episodes: seen by infos, by observations, and as one vector."""
    problem, controller = found.certificate.problem, found.controller
    by_agents, as_one = cg.parallel_env(problem), cg.make(problem)
    counts = np.zeros(3, dtype=int)
    for seed in range(150):
        for k in (0, 1):
            observations, infos = by_agents.reset(seed=seed)
            controller.reset(observations, infos, seed=seed)
            while by_agents.agents:
                actions = controller.act(observations, infos if k == 0 else None)
                observations, rewards, _, _, infos = by_agents.step(actions)
            counts[k] += max(rewards.values()) > 0.0
        observation, _ = as_one.reset(seed=seed)
        is_over = False
        while not is_over:
            observation, reward, terminated, truncated, _ = as_one.step(controller.predict(observation)[0])
            is_over = terminated or truncated
        counts[2] += reward > 0.0
    assert counts[0] == counts[1]
    share = float(cg.rollout(problem, controller, episodes=100_000, seed=6).success.mean())
    # far beyond what 150 episodes differ by chance, which is as unlikely as the false alarm allows
    assert np.all(np.abs(counts / 150.0 - share) < 0.2)


@pytest.mark.thorough
def test_parts_of_other_tasks_are_refused(found: Any) -> None:
    certificate = found.certificate
    easier = cg.synthesize(team("F goal & F[0,3] home").tasks_apart[0], relation="vertices", effort=0.5).certificate
    parts = certificate.proof.parts
    for forged in ((easier, parts[1]), parts[::-1], parts[:1]):
        proof = ProductProof(tuple(forged))
        assert not cg.check(Certificate(certificate.problem, proof, certificate.settings)).valid
    swapped = replace(parts[1], problem=team("F goal & F home").tasks_apart[1])
    assert not cg.check(Certificate(certificate.problem, ProductProof((parts[0], swapped)), {})).valid


@pytest.mark.parametrize("semantics", ["finite-trace", "co-safe"])
@pytest.mark.parametrize("task", ["(!rock U goal) & F[0,3] home", "F (goal & X goal) & F home & F[1,2] home"])
def test_states_of_the_whole_say_those_of_the_tasks(task: str, semantics: str) -> None:
    problem = team(task, semantics)
    whole, parts = problem.automaton, [own.automaton for own in problem.tasks_apart]
    states, rng = states_apart(whole, parts), np.random.default_rng(1)
    is_over = whole.absorbing & (~whole.accepting | (whole.semantics == "co-safe"))
    for _ in range(300):
        q, own = whole.initial, [part.initial for part in parts]
        for _ in range(problem.horizon + 1):
            letter = rng.random((len(whole.propositions), 1)) < 0.4
            q = int(whole.next_state(np.array([q]), letter)[0])
            for k, part in enumerate(parts):
                read = letter[[whole.propositions.index(name) for name in part.propositions]]
                own[k] = int(part.next_state(np.array([own[k]]), read)[0])
            if is_over[q]:
                break
            assert states[q].tolist() == own


def test_who_is_compared_or_shares_a_task_stays_together() -> None:
    assert team("F (goal & home)").apart == ()
    assert len(team("G (!rock & home)").apart) == 2
    near = {"agents": ["left", "right"], "low": [-0.1], "high": [0.1]}
    assert team("F goal & F home & G !near", near=near).apart == ()


@pytest.mark.thorough
def test_there_is_no_shield_of_the_whole(found: Any) -> None:
    with pytest.raises(ValueError, match=r"independent tasks|values of all states"):
        cg.shield(None, found.certificate, probability=0.1)
