"""Moving pictures of certified rollouts: GIF by Pillow, MP4 by ffmpeg."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ....envs.interfaces import Picture, verdict_text
from ....envs.systems.arguments import write_bytes
from ....envs.tasks.problem import Problem
from ....synthesis.certificates.proofs import Certificate
from ....synthesis.extended_check.claims import ValueInTime, VertexValueInTime, claim_text, value_in_time
from ...statistical_tests import Batchable, Loop, paths, task_tracks

_HOLD = 1.5  # seconds for which the last picture stays, so that its verdict can be read
_MOST_BETWEEN, _MOST_PICTURES = 6, 240  # pictures of a control step, and of an episode, at most
_COLORS = 128  # of a GIF: enough for flat colours, and half the size of 256


@dataclass(frozen=True, eq=False)
class Player:
    """One policy of a moving picture.

    Parameters
    ----------
    controller : object with ``batch(dynamics)``
    caption : str
        The line below the problem's name.
    value : ValueInTime, optional
        Certified values, for a meter of the bound from every state on.
    """

    controller: Batchable
    caption: str
    value: ValueInTime | VertexValueInTime | None = None

    @classmethod
    def of(cls, name: str, policy: Any) -> Player:
        """Return a policy in any form that ``compare`` takes, of several seeds the first."""
        policy = policy[0] if isinstance(policy, (list, tuple)) else policy
        claim = getattr(policy, "certificate", policy)
        if isinstance(claim, Certificate):
            return cls(claim.controller, f"certified {claim_text(claim)}", _values(claim))
        return cls(getattr(policy, "controller", policy), Path(name).stem)


def _values(claim: Certificate) -> ValueInTime | VertexValueInTime | None:
    """Return the values of a certificate at all times; None for kinds that have none."""
    try:
        return value_in_time(claim)
    except ValueError:
        return None


def render_episode(problem: Problem, players: Sequence[Player], out: str, seed: int, fps: int) -> dict[str, Any]:
    """Write a moving picture of one episode, policies side by side with the same start and the same noise.

    Parameters
    ----------
    problem : Problem
    players : sequence of Player
    out : str
        File to write: `.gif`, `.mp4`, or `.png` for the last picture alone.
    seed : int
        Seed of the episode.
    fps : int
        Control steps shown per second.

    Returns
    -------
    dict
        Facts about the episode: problem, seed, file, and for each policy its caption, steps, and whether the task was
        satisfied.

    Raises
    ------
    ValueError
        If the kind of file is unknown, or if the program that writes it is not installed.
    """
    kind, ffmpeg = check_film(out, seed, fps)
    between = 1 if kind == ".png" else _between(problem.horizon)
    filmed = [film(problem, player, seed, between) for player in players]
    longest = max(len(frames) for frames, _ in filmed)
    # Whoever is decided first waits at the last picture.
    films = [frames + [frames[-1]] * (longest - len(frames)) for frames, _ in filmed]
    frames = [np.concatenate(pictures, axis=1) for pictures in zip(*films, strict=True)]
    if kind == ".mp4":
        _write_mp4(ffmpeg, frames, out, fps * between)
    else:
        from PIL import Image

        images, file = [Image.fromarray(frame) for frame in frames], BytesIO()
        if kind == ".png":
            images[-1].save(file, format="PNG")
        else:
            durations = [1000 // (fps * between)] * (len(images) - 1) + [int(1000 * _HOLD)]
            images = [image.quantize(_COLORS) for image in images]
            images[0].save(file, format="GIF", save_all=True, append_images=images[1:], duration=durations, loop=0)
        write_bytes(out, file.getvalue())
    shown = [
        {"policy": player.caption, "steps": (len(each) - 1) // between, "satisfied": satisfied}
        for player, (each, satisfied) in zip(players, filmed, strict=True)
    ]
    return {"problem": problem.name, "seed": seed, "file": out, "shown": shown}


def check_film(out: str, seed: int, fps: int) -> tuple[str, str]:
    """Return the kind of a file and the path of ffmpeg, if it is needed; raise ValueError if it cannot be written."""
    kind = Path(out).suffix.lower()
    if kind not in (".gif", ".mp4", ".png"):
        raise ValueError(f"`--out`: expected a file that ends in .gif, .mp4 or .png, got {out!r}")
    if not 1 <= fps <= 60 or seed < 0:
        raise ValueError(f"`--fps`, `--seed`: expected 1 to 60 and at least 0, got {fps} and {seed}")
    return kind, _ffmpeg() if kind == ".mp4" else ""


def _between(steps: int) -> int:
    """Return how many pictures a control step has: fewer in long episodes, whose files would be large."""
    return max(1, min(_MOST_BETWEEN, _MOST_PICTURES // steps))


def film(problem: Problem, player: Player, seed: int, between: int = 1) -> tuple[list[np.ndarray], bool]:
    """Return the pictures of one episode, some for each control step, and whether it satisfied the task."""
    try:
        picture = Picture(problem, player.caption)
    except ImportError as error:
        raise ValueError(str(error)) from error
    states, success = paths(Loop(problem, player.controller, seed, 1), 1)
    read, hold = task_tracks(problem, states)
    track = states[~np.isnan(states[:, 0]).any(axis=1), 0]
    wraps = np.concatenate([agent.wrapped_axes for agent in problem.agents])
    frames = list[np.ndarray]()
    for time in range(len(track)):
        names = problem.told(name for name, holds in zip(problem.automaton.propositions, hold[time, :, 0]) if holds)
        last = time == len(track) - 1
        verdict = verdict_text(last and bool(success[0]), last and time < problem.horizon, last)
        value = None
        if player.value is not None:
            value = float(player.value.at(track[time], int(read[time, 0]), problem.horizon - time)[0])
        frames.append(picture.frame(track[: time + 1], int(read[time, 0]), names, verdict, value))
        for part in () if last else np.arange(1, between) / between:
            # Angles take the shorter way.
            way = track[time + 1] - track[time]
            way = np.where(wraps, (way + np.pi) % (2.0 * np.pi) - np.pi, way)
            moving = np.concatenate([track[: time + 1], (track[time] + part * way)[None]])
            frames.append(picture.frame(moving, int(read[time, 0]), names, verdict, value, float(part)))
    return frames, bool(success[0])


def _ffmpeg() -> str:
    """Return the path of ffmpeg, from the system or from imageio-ffmpeg; raise ValueError if there is none."""
    path = shutil.which("ffmpeg")
    if path is None:
        try:
            import imageio_ffmpeg
        except ImportError as error:
            raise ValueError(
                "`--out`: MP4 needs ffmpeg on the path, or `pip install imageio-ffmpeg`; found neither, write a .gif"
            ) from error
        path = str(imageio_ffmpeg.get_ffmpeg_exe())
    return path


def _write_mp4(ffmpeg: str, frames: list[np.ndarray], out: str, fps: int) -> None:
    """Send the pictures to ffmpeg, which repeats each one up to 30 pictures per second."""
    height, width, _ = frames[0].shape
    source = f"-f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {fps} -i -".split()
    frames = frames + [frames[-1]] * round(_HOLD * fps)
    # ffmpeg seeks in what it writes: let it write elsewhere, and move the film to its place as a whole
    with TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        command = [ffmpeg, "-y", "-loglevel", "error", *source, "-pix_fmt", "yuv420p", "-r", "30", str(film)]
        done = subprocess.run(
            command, input=b"".join(frame.tobytes() for frame in frames), capture_output=True, check=False
        )
        if done.returncode:
            raise ValueError(f"`--out`: ffmpeg failed: {done.stderr.decode(errors='replace').strip()[:200]}")
        write_bytes(out, film.read_bytes())
