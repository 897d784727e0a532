"""Every problem can be drawn; pictures show what moves, and ask clearly for what is not installed."""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
import fake_pygame
from certigym.cli.main import main
from certigym.envs.interfaces import AGENTS
from certigym.envs.interfaces.palette import rgb
from certigym.envs.interfaces.scene import figure, panels
from certigym.envs.tasks.problem import problem_from_toml
from kinds import ALL_IDS, mostly_thorough
from sample_problems import HOP as TASK
from sample_problems import mixed_problem


def step(env: Any) -> None:
    env.step({agent: env.action_space(agent).low for agent in env.agents})


@pytest.mark.parametrize("name", [*ALL_IDS, "mixed"])
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


def test_the_marker_of_an_agent_is_where_the_agent_is() -> None:
    env = cg.parallel_env("car-park-planar-v0", render_mode="rgb_array", initial_state=[0.0, 0.0])
    env.reset(seed=0)
    frame = env.render()
    assert isinstance(frame, np.ndarray)
    rows, columns = np.nonzero((frame == rgb(AGENTS[0])).all(axis=-1))
    # the map spans 34..474 by 16..456 pixels and -10..10 on both axes; the name stands to the right of the marker
    assert abs(np.median(rows) - 236) <= 2 and abs(columns.min() + 5 - 254) <= 2


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


def test_the_command_says_what_it_cannot_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import certigym.validation.presentation.figures.moving_pictures as command

    task = tmp_path / "task.toml"
    task.write_text(TASK)
    monkeypatch.setattr(command.shutil, "which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    for out, extra, message in (
        ("x.mp4", [], "MP4 needs ffmpeg"),
        ("x.avi", [], "expected a file that ends in .gif, .mp4 or .png"),
        ("x.gif", ["--fps", "0"], "expected 1 to 60"),
    ):
        assert main(["plot", "episode", str(task), "--cells", "20", "--out", str(tmp_path / out), *extra]) == 2
        assert message in capsys.readouterr().err.splitlines()[-1]


@mostly_thorough("rock", ["", 'rock = { agent = "a", disc = { centre = [-1, -1], radius = 0.5 } }'])
@mostly_thorough("outputs", [["x", "y"], ["2*x", "-3*y + 1"], ["x + y", "x - 2*y"], ["x**2", "y"]])
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


def test_mp4_goes_through_ffmpeg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for ffmpeg counts the bytes it is given: whole pictures, the last one held."""
    import certigym.validation.presentation.figures.moving_pictures as command

    task, tool = tmp_path / "task.toml", tmp_path / "ffmpeg"
    task.write_text(TASK)
    tool.write_text(
        f"#!{sys.executable}\nimport sys\nopen(sys.argv[-1], 'w').write(str(len(sys.stdin.buffer.read())))\n"
    )
    tool.chmod(0o755)
    monkeypatch.setattr(command.shutil, "which", lambda name: str(tool))
    out = tmp_path / "x.mp4"
    assert main(["plot", "episode", str(task), "--cells", "20", "--out", str(out)]) == 0
    pictures, rest = divmod(int(out.read_text()), 480 * 720 * 3)
    assert rest == 0 and (pictures - 1 - 36) / 6 in (1, 2, 3)  # six pictures a step
    tool.write_text(f"#!{sys.executable}\nimport sys\nsys.stdin.buffer.read()\nsys.exit('no such codec')\n")
    assert main(["plot", "episode", str(task), "--cells", "20", "--out", str(out)]) == 2


def test_policies_are_shown_beside_each_other_on_the_same_start(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from PIL import Image

    task, out, data = tmp_path / "task.toml", tmp_path / "x.gif", tmp_path / "x.json"
    task.write_text(TASK)
    command = ["plot", "episode", str(task), "--cells", "40", "--beside", "random", "idle", "--out", str(out)]
    assert main([*command, "--json", str(data)]) == 0
    said = capsys.readouterr().out
    assert "certified P >=" in said and "random: " in said and "idle: " in said
    shown = json.loads(data.read_text())["shown"]
    assert [one["policy"] for one in shown][1:] == ["random", "idle"]
    with Image.open(out) as film:
        assert film.size == (3 * 720, 480)
        assert film.n_frames == 1 + 6 * max(one["steps"] for one in shown)  # type: ignore[attr-defined]
        first = np.asarray(film.convert("RGB")).reshape(480, 3, 720, 3)
    # The tracks begin at the same point; captions and the meter differ.
    assert (first[:, 0, :500] == first[:, 1, :500]).all() and (first[:, 0] != first[:, 1]).any()


@pytest.mark.parametrize(
    ("names", "like"),
    [
        (("car_0", "x"), "car"),
        (("robot", "forklift"), "robot"),
        (("a", "drone-window"), "drone"),
        (("a", "b"), "robot"),
    ],
)
def test_agents_look_like_what_they_are_called(names: tuple[str, str], like: str) -> None:
    """The body of a car is longer than wide, a drone has four rotors; all of them look where they point."""
    bodies = [corners for corners, is_body in figure(names, np.pi / 2) if is_body]
    assert len(bodies) == {"car": 1, "robot": 1, "drone": 7}[like]
    across, up = np.ptp(np.concatenate(bodies), axis=0)
    assert (up > 1.5 * across) == (like == "car")
    (nose,) = [corners for corners, is_body in figure(names, np.pi / 2) if not is_body]
    assert nose[:, 1].max() > 0.3 and abs(nose[:, 0].mean()) < 1e-9


def test_a_task_in_space_has_a_second_view() -> None:
    """The wall of the quadrotor has a gate, which its height alone lets it through: seen from above it is closed."""
    above, beside = panels(cg.make_problem("quadrotor-v0"))
    assert (above.names, beside.names) == (("x", "y"), ("x", "z"))
    assert above.curves[0].number == beside.curves[0].number
    assert len(panels(cg.make_problem("meeting-v0"))) == 1
