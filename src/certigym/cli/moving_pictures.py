"""Moving pictures of certified rollouts: GIF by Pillow, MP4 by ffmpeg."""

from __future__ import annotations

import shutil
import subprocess
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ..envs.agents import write_bytes
from ..envs.interfaces import ProblemEnv
from ..synthesis.certificates import Certificate, shown_bound

_HOLD = 1.5  # seconds for which the last picture stays, so that its verdict can be read
_COLORS = 128  # of a GIF: enough for flat colours, and half the size of 256


def render_rollout(certificate: Certificate, out: str, seed: int, fps: int) -> dict[str, Any]:
    """Write a moving picture of one episode under a certificate's controllers.

    Parameters
    ----------
    certificate : Certificate
    out : str
        File to write: `.gif`, `.mp4`, or `.png` for the last picture alone.
    seed : int
        Seed of the episode.
    fps : int
        Control steps shown per second.

    Returns
    -------
    dict
        Facts about the episode: problem, bound, seed, steps, whether the task was satisfied, the file.

    Raises
    ------
    ValueError
        If the kind of file is unknown, or if the program that writes it is not installed.
    """
    kind = Path(out).suffix.lower()
    if kind not in (".gif", ".mp4", ".png"):
        raise ValueError(f"`--out`: expected a file that ends in .gif, .mp4 or .png, got {out!r}")
    if not 1 <= fps <= 60 or seed < 0:
        raise ValueError(f"`--fps`, `--seed`: expected 1 to 60 and at least 0, got {fps} and {seed}")
    # Look for ffmpeg before the episode is simulated.
    ffmpeg = _ffmpeg() if kind == ".mp4" else ""
    frames, satisfied = _frames(certificate, seed)
    if kind == ".mp4":
        _write_mp4(ffmpeg, frames, out, fps)
    else:
        from PIL import Image

        images, file = [Image.fromarray(frame) for frame in frames], BytesIO()
        if kind == ".png":
            images[-1].save(file, format="PNG")
        else:
            durations = [1000 // fps] * (len(images) - 1) + [int(1000 * _HOLD)]
            images = [image.quantize(_COLORS) for image in images]
            images[0].save(file, format="GIF", save_all=True, append_images=images[1:], duration=durations, loop=0)
        write_bytes(out, file.getvalue())
    return {
        "problem": certificate.problem.name,
        "lower_bound": certificate.lower_bound,
        "seed": seed,
        "steps": len(frames) - 1,
        "satisfied": satisfied,
        "file": out,
    }


def _frames(certificate: Certificate, seed: int) -> tuple[list[np.ndarray], bool]:
    """Return the pictures of one episode, and whether it satisfied the task."""
    caption = f"certified {shown_bound(certificate.lower_bound, None)}"
    env = ProblemEnv(certificate.problem, "rgb_array", caption=caption)
    controller = certificate.controller
    observations, infos = env.reset(seed=seed)
    controller.reset(observations, infos)
    try:
        frames = [np.asarray(env.render())]
        while env.agents:
            observations, _, _, _, infos = env.step(controller.act(observations, infos))
            frames.append(np.asarray(env.render()))
    except ImportError as error:
        raise ValueError(str(error)) from error
    return frames, bool(infos[env.possible_agents[0]]["satisfied"])


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
