"""Every problem can be drawn; pictures show what moves, and ask clearly for what is not installed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
import fake_pygame
from certigym.cli.main import main
from kinds import IDS_OF_KINDS
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
