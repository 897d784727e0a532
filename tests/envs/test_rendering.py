"""Every problem can be drawn; pictures show what moves, and ask clearly for what is not installed."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
import fake_pygame
from certigym.cli.main import main
from certigym.envs.interfaces.scene import panels
from certigym.envs.tasks.problem import problem_from_toml
from kinds import IDS_OF_KINDS, mostly_thorough
from sample_problems import HOP as TASK
from sample_problems import mixed_problem


def step(env: Any) -> None:
    env.step({agent: env.action_space(agent).low for agent in env.agents})


@pytest.mark.parametrize("name", [*IDS_OF_KINDS, "mixed"])
def test_every_problem_is_drawn(name: str) -> None:
    env = cg.parallel_env(mixed_problem() if name == "mixed" else name, render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    assert isinstance(first, np.ndarray) and first.shape == (480, 720, 3) and first.dtype == np.uint8
    step(env)
    second = env.render()
    assert isinstance(second, np.ndarray) and (first != second).any()
    env.reset(seed=0)
    assert np.array_equal(np.asarray(env.render()), first)
    twin = pickle.loads(pickle.dumps(env))
    assert (twin.render() == first).all()


def test_scalar_agents_are_tracks_and_planar_ones_share_a_map() -> None:
    def shapes(id: str) -> list[tuple[bool, int]]:
        return [(panel.is_map, len(panel.curves)) for panel in panels(cg.make_problem(id))]

    assert shapes("reach-avoid-v0") == [(False, 1), (False, 1)]
    assert shapes("reach-avoid-kinematic-v0") == [(False, 1), (False, 1)]  # position over time, no region on velocity
    assert shapes("invariance-20-v0") == [(False, 20)]
    assert shapes("building-automation-v0") == [(False, 2)]
    assert shapes("meeting-v0") == [(True, 2)]
    assert shapes("package-delivery-v0") == [(True, 4)]  # x_k and y_k are one robot
    assert shapes("package-delivery-kinematic-v0") == [(True, 4)]
    (plane,) = panels(cg.make_problem("package-delivery-v0"))
    assert [curve.name for curve in plane.curves] == ["robot 0", "robot 1", "robot 2", "robot 3"]
    joint = np.arange(8.0)
    assert (plane.curves[2].rows @ joint).tolist() == [4.0, 5.0]
    lost = [region for region in plane.regions if region.name == "column"]
    assert lost[0].low == (-10.0, -20.0) and lost[0].high == (-5.0, 5.0)


def test_a_batch_draws_each_of_its_worlds_as_the_scalar_environment_does() -> None:
    envs = cg.vector_env("meeting-v0", 2, render_mode="rgb_array")
    env = cg.central_env("meeting-v0", render_mode="rgb_array")
    envs.reset(seed=0)
    start = env.reset(seed=0)[1]["state"]
    frames = envs.render()
    assert frames is not None and len(frames) == 2 and (frames[0] == env.render()).all()
    state = envs.step(np.zeros((2, 4)))[4]["state"]
    assert (state[0] != start).any()
    frames = envs.render()
    assert frames is not None and (frames[0] != frames[1]).any()
    assert cg.vector_env("meeting-v0", 2).render() is None
    with pytest.raises(ValueError, match="`render_mode`: expected None or 'rgb_array', got 'human'"):
        cg.vector_env("meeting-v0", 2, render_mode="human")


def test_a_window_shows_every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = fake_pygame.install(monkeypatch)
    env = cg.central_env("meeting-v0", render_mode="human")
    env.reset(seed=0)
    env.step(np.zeros(4))
    assert len(shown) == 2 and shown[0].shape == (480, 720, 3) and env.render() is None
    env.close()
    env.close()
    parallel = cg.parallel_env("meeting-v0", render_mode="human")
    parallel.reset(seed=0)
    assert len(shown) == 3
    parallel.close()


def test_what_is_not_installed_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ImportError, match="pip install pygame"):
        cg.parallel_env("meeting-v0", render_mode="human").reset(seed=0)
    monkeypatch.setitem(sys.modules, "PIL", None)
    env = cg.parallel_env("meeting-v0", render_mode="rgb_array")
    env.reset(seed=0)
    with pytest.raises(ImportError, match=r"certigym\[viz\]"):
        env.render()


def test_the_command_draws_a_certified_rollout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from PIL import Image

    task, certificate, out = tmp_path / "task.toml", tmp_path / "c.npz", tmp_path / "x.gif"
    task.write_text(TASK)
    assert main(["plot", "episode", str(task), "--cells", "40", "--out", str(out), "--seed", "1"]) == 0
    said = capsys.readouterr().out
    steps = int(said.split(": ")[2].split()[0])
    with Image.open(out) as picture:
        assert picture.n_frames == 6 * steps + 1 and picture.size == (720, 480)  # type: ignore[attr-defined]
    assert main(["synthesize", str(task), "--cells", "40", "--out", str(certificate)]) == 0
    assert main(["plot", "episode", str(certificate), "--out", str(tmp_path / "y.gif"), "--seed", "1"]) == 0
    assert (tmp_path / "y.gif").read_bytes() == out.read_bytes()
    assert main(["plot", "episode", str(certificate), "--out", str(tmp_path / "y.png")]) == 0


@mostly_thorough("rock", ["", 'rock = { agent = "a", disc = { centre = [-1, -1], radius = 0.5 } }'])
@mostly_thorough("outputs", [["2*x", "-3*y + 1"], ["x + y", "x - 2*y"], ["x**2", "y"]])
def test_boxes_of_outputs_are_drawn_where_they_are(outputs: list[str], rock: str) -> None:
    """Whatever states are multiplied with; where a limit bends nothing is drawn, which is less than something wrong."""
    problem = problem_from_toml(f"""
        horizon = 4
        specification = "{"!rock U goal" if rock else "F goal"}"
        [[agents]]
        name = "a"
        states = ["x", "y"]
        inputs = ["u"]
        dynamics = ["x + u", "y + u"]
        outputs = {outputs}
        noise_std = [0.1, 0.1]
        state_low = [-3, -3]
        state_high = [3, 3]
        input_low = [-1]
        input_high = [1]
        initial_state = [0, 0]
        [propositions]
        goal = {{ agent = "a", low = [0.5, 0.5], high = [1.5, 2] }}
        {rock}""")
    (panel,) = panels(problem)
    states = np.random.default_rng(0).uniform(-3.0, 3.0, (2000, 2))
    p = problem.automaton.propositions.index("goal")
    truth = np.array([problem.labeling.letter([state])[p] for state in states], dtype=bool)
    assert truth.any()
    places, (rows,) = states, [curve.rows for curve in panel.curves]
    assert np.array_equal(rows, np.eye(2))
    drawn = [region for region in panel.regions if region.name == "goal"]
    if "x**2" in outputs:
        assert not drawn
        return
    (region,) = drawn
    inside = np.all((np.array(region.low) <= places) & (places < np.array(region.high)), axis=1)
    if region.outline is not None:
        for first, last in zip(region.outline.edges[0], np.roll(region.outline.edges[0], -1, axis=0), strict=True):
            along, off = last - first, places - first
            inside &= along[0] * off[:, 1] - along[1] * off[:, 0] >= 0.0  # edges go counter-clockwise
    assert np.array_equal(inside, truth)
