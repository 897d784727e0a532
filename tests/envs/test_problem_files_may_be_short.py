"""Shorthand of problem files: numbers as expressions, starts of copies, input boxes that move."""

from __future__ import annotations

import numpy as np
import pytest

import certigym as cg
from certigym.envs.tasks.problem.problem_file import problem_from_dict, problem_from_toml
from kinds import mostly_thorough

FILE = """
name = "short"
horizon = 12
[[agents]]
name = "pump"
copies = 2
states = ["level"]
inputs = ["flow"]
dynamics = ["level + flow - 0.2*cos(flow)"]
noise_scale = ["1 + 0.1*flow"]
noise_std = ["pi / 100"]
state_low = ["-2*pi"]
state_high = ["2*pi"]
input_low = ["-0.1*t"]
input_high = ["max(0, sin(0.5*t))"]
initial_state = [[0.0], ["pi / 2"]]
[propositions]
full = { agent = "pump_*", low = [1.0], high = [3.0] }
[specification]
formula = "F all(full)"
"""


def test_expressions_copies_and_moving_boxes_are_spelled_out() -> None:
    problem = problem_from_toml(FILE)
    first, second = problem.agents
    assert isinstance(first, cg.Agent)
    assert [agent.name for agent in problem.agents] == ["pump_0", "pump_1"]
    assert first.initial.low.tolist() == [0.0] and second.initial.low.tolist() == [np.pi / 2.0]
    assert first.state_low.tolist() == [-2.0 * np.pi] and first.state_high.tolist() == [2.0 * np.pi]
    np.testing.assert_allclose(first.noise_covariance, [[(np.pi / 100.0) ** 2]])
    assert first.laws is not None  # scales multiply laws
    # The smallest box that holds those of steps 0 to 11.
    assert first.input_low.tolist() == [-0.1 * 11.0]
    assert first.input_high.tolist() == [float(np.sin(0.5 * np.arange(12)).max())]
    clipped = "clip(flow, -0.1*t, max(0, sin(0.5*t)))"
    assert first.dynamics == (f"level + {clipped} - 0.2*cos({clipped})",)
    assert first.noise_scale == (f"1 + 0.1*{clipped}",)
    # What is written is spelled out, and the same problem.
    assert problem_from_dict(problem.to_dict()).fingerprint == problem.fingerprint


def test_deviations_that_name_states_or_the_time_are_scales() -> None:
    text = FILE.replace('noise_scale = ["1 + 0.1*flow"]\n', "").replace(
        '"pi / 100"', '"0.02 + 0.01*level**2 + 0.001*t"'
    )
    agent = problem_from_toml(text).agents[0]
    assert isinstance(agent, cg.Agent)
    assert agent.noise_scale == ("0.02 + 0.01*level**2 + 0.001*t",)
    assert agent.to_dict()["noise"] == [{"law": "gaussian", "std": 1.0}]
    # A name that nothing has is refused, and told with those that there are.
    with pytest.raises(ValueError, match="unknown name 'lavel'; did you mean 'level'"):
        problem_from_toml(text.replace("level**2", "lavel**2"))
    linear = text.replace('dynamics = ["level + flow - 0.2*cos(flow)"]', "A = [[1.0]]\nB = [[1.0]]")
    with pytest.raises(ValueError, match="is for agents written as expressions"):
        problem_from_toml(linear)
    # Beside a scale they are numbers.
    with pytest.raises(ValueError, match="`noise_std`: unknown name 'level'"):
        problem_from_toml(FILE.replace('"pi / 100"', '"0.01*level"'))


def test_inputs_beyond_a_box_that_moves_count_as_its_end() -> None:
    """A full input at every step, against a loop of ten lines without noise."""
    text = FILE.replace('"pi / 100"', "0.0").replace("copies = 2\n", "").replace('[[0.0], ["pi / 2"]]', "[0.0]")
    text = text.replace("pump_*", "pump").replace("all(full)", "full")
    problem = problem_from_toml(text)
    level, most = 0.0, float(problem.agents[0].input_high[0])
    env = cg.parallel_env(problem)
    env.reset(seed=0)
    for t in range(3):
        flow = min(most, max(0.0, float(np.sin(0.5 * t))))
        level += flow - 0.2 * float(np.cos(flow))
        env.step({"pump": np.array([most])})
        np.testing.assert_allclose(env.state()[0], level, rtol=1e-6)


@pytest.mark.thorough
def test_a_box_that_moves_is_certified_and_met() -> None:
    text = FILE.replace("copies = 2\n", "").replace('[[0.0], ["pi / 2"]]', "[0.0]").replace("all(full)", "full")
    problem = problem_from_toml(text.replace("pump_*", "pump"))
    result = cg.synthesize(problem)
    assert result.certificate.lower_bound > 0.99 and cg.check(result.certificate, problem)
    verdict = cg.validate(result, 5000, seed=1, confidence=1.0 - 1e-6)
    assert verdict.verdict != "refuted"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"-2*pi"', '"-2*t"', "`state_low`"),
        ('"max(0, sin(0.5*t))"', '"1/t"', "`input_high`: expected numbers at all steps"),
        ('"-0.1*t"', '"0.1"', "expected at most `input_high` at all steps, got more at step 0"),
        ('[[0.0], ["pi / 2"]]', "[[0.0]]", "one for each of 2 copies, got 1"),
    ],
)
def test_what_is_wrong_in_shorthand_is_named(old: str, new: str, said: str) -> None:
    with pytest.raises(ValueError, match=r"number 1 .'pump'.") as caught:
        problem_from_toml(FILE.replace(old, new))
    assert said in str(caught.value)


@pytest.mark.parametrize("are_copies", [False, True])
def test_a_box_that_moves_is_refused_where_others_name_the_input(are_copies: bool) -> None:
    text = FILE
    if not are_copies:
        text = FILE.replace("copies = 2\n", "").replace('[[0.0], ["pi / 2"]]', "[0.0]").replace("all(full)", "full")
        text = text.replace("pump_*", "pump")
    follower = """
[[agents]]
name = "tank"
states = ["level"]
inputs = ["flow"]
dynamics = ["level + flow - 0.1*pump.flow"]
noise_std = [0.1]
state_low = [-3]
state_high = [3]
input_low = [-1]
input_high = [1]
initial_state = [0]
[propositions]
"""
    follower = follower.replace("pump.flow", "pump_1.flow") if are_copies else follower
    text = text.replace("\n[propositions]\n", follower)
    with pytest.raises(ValueError, match="another agent names that input"):
        problem_from_toml(text)


def test_each_copy_may_have_a_box_of_starts() -> None:
    boxes = "initial_low = [[-0.1], [0.4]]\ninitial_high = [[0.1], [0.6]]"
    problem = problem_from_toml(FILE.replace('initial_state = [[0.0], ["pi / 2"]]', boxes))
    ends = [(agent.initial.low.tolist(), agent.initial.high.tolist()) for agent in problem.agents]
    assert ends == [([-0.1], [0.1]), ([0.4], [0.6])]
    with pytest.raises(ValueError, match="`initial_high`: expected one start, or one for each of 2 copies, got 1"):
        problem_from_toml(
            FILE.replace('initial_state = [[0.0], ["pi / 2"]]', boxes.replace("[[0.1], [0.6]]", "[[0.1]]"))
        )


CART = """
horizon = 10
[[agents]]
name = "cart"
states = ["place", "speed"]
inputs = ["push"]
A = [[1.0, 0.5], [0.0, 0.9]]
B = [[0.0], [0.5]]
noise_std = [0.05, 0.05]
state_low = [-4.0, -2.0]
state_high = [4.0, 2.0]
input_low = [-1.0]
input_high = [1.0]
initial_state = [-3.0, 0.0]
[joint_noise]
wind = { cart = { speed = 0.02 } }
[propositions]
rest = { agent = "cart", disc = { of = ["place", "speed"], centre = [1.0, 0.0], radius = 0.8 } }
[specification]
formula = "F rest"
"""


def test_states_and_inputs_of_matrices_have_names() -> None:
    problem = problem_from_toml(CART)
    (agent,) = problem.written_agents
    assert isinstance(agent, cg.LinearAgent)
    assert (agent.state_names, agent.input_names) == (("place", "speed"), ("push",))
    again = problem_from_dict(problem.to_dict())
    assert again.fingerprint == problem.fingerprint and again.written_agents[0].state_names == ("place", "speed")
    # Names change no behaviour.
    unnamed = problem_from_toml(
        CART.replace('states = ["place", "speed"]\ninputs = ["push"]\n', "")
        .replace('["place", "speed"]', "[0, 1]")
        .replace("{ speed = 0.02 }", "[0.0, 0.02]")
    )
    runs = []
    for each in (problem, unnamed):
        env = cg.parallel_env(each)
        env.reset(seed=1)
        runs.append([env.step({"cart": np.array([0.5])})[0]["cart"] for _ in range(10)])
    np.testing.assert_array_equal(runs[0], runs[1])


@mostly_thorough(
    ("task", "steps"),
    [
        ("F (all(full) & F all(full))", 100),  # no deadline: what is satisfied stays satisfied
        ("F (any(full) & F[0,70] all(full))", 140),
        ("F[0,30] all(full) & G[4,9] any(full)", 30),  # windows say when all is decided
    ],
    first=2,
)
def test_a_task_may_have_no_horizon(task: str, steps: int) -> None:
    for written in ("", 'horizon = "none"'):
        text = FILE.replace("horizon = 12", written).replace("F all(full)", task)
        problem = problem_from_toml(text)
        assert problem.horizon == steps
        assert (
            problem.fingerprint
            == problem_from_toml(FILE.replace("12", str(steps)).replace("F all(full)", task)).fingerprint
        )
