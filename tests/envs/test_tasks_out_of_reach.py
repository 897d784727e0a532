"""What no agent can reach is told in words, before any search, and nothing within reach is called so."""

from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.tasks.problem import out_of_reach
from kinds import mostly_thorough

NOISE = {"law": "gaussian", "std": 0.05}


def robot(**changes: Any) -> cg.Agent:
    given: dict[str, Any] = {
        "name": "robot",
        "states": ["x", "y"],
        "inputs": ["u", "v"],
        "dynamics": ["x + u", "y + v"],
        "noise": [NOISE, NOISE],
        "state_low": [-5, -5],
        "state_high": [5, 5],
        "input_low": [-0.5, -0.5],
        "input_high": [0.5, 0.5],
        "initial_state": [-4, 0],
    }
    return cg.Agent(**{**given, **changes})


def asked(
    formula: str, horizon: int = 10, agents: tuple[cg.Agent, ...] = (), **regions: cg.Proposition | cg.Pair
) -> cg.Problem:
    """Return a problem with a goal seven metres away."""
    regions = {"goal": cg.Proposition("robot", [3, -1], [4.5, 1]), **regions}
    return cg.Problem(
        name="asked",
        horizon=horizon,
        agents=agents or (robot(),),
        propositions=regions,
        specification=cg.Specification(formula),
    )


def test_a_goal_that_is_too_far_says_how_many_steps_it_takes() -> None:
    found = out_of_reach(asked("F goal", 8))
    assert found is not None and found.most <= 1e-6
    assert "`goal` is out of reach in 8 steps" in found.why and "it takes" in found.why
    needed = int(found.why.split("it takes ")[1].split()[0])
    # Seven metres, of which a step covers half a one and what noise adds.
    assert 9 <= needed <= 14
    assert out_of_reach(asked("F goal", needed)) is None
    # Without noise it takes one step for each half a metre.
    assert out_of_reach(asked("F goal", 13), rare=0.0) is not None
    assert out_of_reach(asked("F goal", 14), rare=0.0) is None


def test_walls_without_a_gap_are_seen_and_walls_with_one_are_not_called_so() -> None:
    wall = cg.Proposition("robot", [-1, -5], [1, 5])
    found = out_of_reach(asked("!wall U goal", 30, wall=wall))
    assert found is not None and "something is in the way" in found.why
    gap = cg.Proposition("robot", [-1, -5], [1, 4])
    assert out_of_reach(asked("!wall U goal", 30, wall=gap)) is None


def test_regions_that_exclude_each_other_are_told() -> None:
    left = cg.Proposition("robot", [-5, -5], [0, 5])
    found = out_of_reach(asked("G[0,9] left & F[3,8] goal", left=left))
    assert found is not None and "it is lost by step" in found.why


@pytest.mark.parametrize("formula", ["F goal", "!goal U hole", "G !goal & F hole", "G (hole -> F[1,3] goal)"])
def test_what_a_run_does_is_never_out_of_reach(formula: str) -> None:
    """Random runs, one after the other: whatever one of them satisfies must not be called impossible."""
    rng = np.random.default_rng(3)
    for _ in range(8):
        speed = rng.uniform(0.2, 1.0)
        agent = robot(
            dynamics=["x + u*cos(y)", "y + v - 0.1*x*u"],
            state_low=[-12, -12],
            state_high=[12, 12],
            input_low=[-speed, -speed],
            input_high=[speed, speed],
        )
        x, path = np.array([-4.0, 0.0]), []
        for _ in range(6):
            x = agent.mean(x, rng.uniform(-speed, speed, 2)) + 0.05 * rng.standard_normal(2)
            path.append(x)
        boxes = {name: cg.Proposition("robot", path[k] - 0.1, path[k] + 0.1) for name, k in (("goal", 5), ("hole", 3))}
        problem = asked(formula, 6, (agent,), **boxes)
        word = [problem.labeling.letter([x]) for x in [np.array([-4.0, 0.0]), *path]]
        named = [[name for name, holds in zip(problem.labeling.names, letter, strict=True) if holds] for letter in word]
        if problem.automaton.accepts(named):
            assert out_of_reach(problem) is None


def test_angles_unknowns_and_pairs_are_taken_for_all_they_may_be() -> None:
    rotor = cg.Agent(
        name="robot",
        states=["theta"],
        angles=["theta"],
        inputs=["u"],
        dynamics=["theta + u"],
        noise=[NOISE],
        state_low=[-np.pi],
        state_high=[np.pi],
        input_low=[-0.4],
        input_high=[0.4],
        initial_state=[3.0],
    )
    west = cg.Proposition("robot", heading={"of": "theta", "from": "pi + 0.5", "to": "pi + 0.8"})
    assert out_of_reach(asked("F goal", 3, (rotor,), goal=west)) is None
    blown = robot(dynamics=["x + u + w", "y + v"], disturbances={"w": [0.0, 0.5]})
    assert out_of_reach(asked("F goal", 8, (blown,))) is None
    near = cg.Pair(["robot", "other"], distance=0.5)
    other = robot(name="other", initial_state=[4, 0])
    assert out_of_reach(asked("F near", 8, (robot(), other), near=near)) is None
    far = out_of_reach(asked("F near", 4, (robot(), other), near=near))
    assert far is not None and "`near` is out of reach" in far.why


def test_noise_is_added_and_scaled() -> None:
    """Without the noise, or its scale, the goal would be called out of reach: a gust may come that carries there."""
    calm = robot(noise=[{"law": "uniform", "low": -0.6, "high": 0.6}, NOISE])
    assert out_of_reach(asked("F goal", 8, (calm,))) is None
    loud = robot(noise_scale=["1 + 10*abs(u)", "1"])
    assert out_of_reach(asked("F goal", 8, (loud,))) is None
    # The mean of a law is a part of the motion, with noise and without.
    pushed = robot(noise=[{"law": "uniform", "low": 0.3, "high": 0.5}, NOISE])
    assert out_of_reach(asked("F goal", 8, (pushed,)), rare=0.0) is None


@pytest.mark.thorough
def test_what_is_out_of_reach_takes_next_to_no_search_and_follows_what_comes_near() -> None:
    result = cg.synthesize(asked("F goal", 8))
    certificate = result.certificate
    assert certificate.lower_bound == 0.0 and cg.check(certificate)
    assert str(result.stats["nothing"]).startswith("`goal` is out of reach in 8 steps")
    assert "skipped: the task is out of reach" in str(result.stats["tried"])


@mostly_thorough("wind", ["", " + 0.1*sin(t)"])
def test_a_start_that_breaks_the_task_says_so_at_once(wind: str) -> None:
    """No run comes near: what is certified, 0, needs no more cells than there are regions."""
    cart = robot(dynamics=["x + 0.5*y", f"y + 0.5*u{wind}"], inputs=["u"], input_low=[-1], input_high=[1])
    here = cg.Proposition("robot", [-4.5, -1], [-3, 1])
    result = cg.synthesize(asked("G !here & F goal", 6, (cart,), here=here))
    certificate: Any = result.certificate
    assert certificate.lower_bound == 0.0 and cg.check(certificate)
    assert str(result.stats["nothing"]).startswith("the start itself breaks the task")
    on_cells = certificate.proof.base if wind else certificate
    assert sum(part.grid.n_cells for part in on_cells.proof.agents) < 60
    other = robot(name="other", dynamics=["x + v*y", "y + u"])
    with pytest.raises(ValueError, match=r"^the start itself breaks the task"):
        cg.synthesize(asked("G !near", 6, (cart, other), near=cg.Pair(["robot", "other"], [-1, -1], [1, 1])))


def test_what_is_named_is_what_is_needed() -> None:
    """A region that is only to be avoided is never said to be out of reach."""
    far = cg.Proposition("robot", [-5, -5], [-4.8, -4.9])
    found = out_of_reach(asked("!far U goal", 5, far=far))
    assert found is not None and "`goal`" in found.why and "`far`" not in found.why
    broken = out_of_reach(asked("G !here", 5, here=cg.Proposition("robot", [-4.5, -1], [-3, 1])))
    assert broken is not None and broken.why.startswith("the start itself breaks the task")
