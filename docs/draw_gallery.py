"""Draw the moving pictures of the gallery: ``python docs/draw_gallery.py [ID ...]``.

Every environment gets a small film of one episode under certified controllers. The certificates are those that
``benchmarks/defaults.py`` has kept; one that is missing is made with the defaults.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import certigym as cg
from certigym.envs.interfaces.rendering import SIDE, WIDTH
from certigym.validation.presentation.figures.moving_pictures import Player, film
from environment_pages import FOLDER, filmed

CERTIFICATES = Path(__file__).parent / "_certificates"
"""Where ``benchmarks/defaults.py`` keeps certificates; not in the repository."""

WAIT, HOLD = 250, 1500
"""Milliseconds for which each picture stays, and the last one."""

SMALLER, RIM = 0.75, 8
"""Size of a film by that of its frames, and pixels of a frame that are left around panels."""

COLORS = 48
"""Of a film, twice: flat colours need no more, and every colour costs bytes."""

MOST_STEPS = 40
"""Steps of a film; of longer episodes every second one is shown."""


def certificate(id: str) -> cg.Certificate:
    """Return the kept certificate of an id, or make it."""
    file = CERTIFICATES / f"{id}.npz"
    if not file.exists():
        CERTIFICATES.mkdir(exist_ok=True)
        cg.save(cg.synthesize(cg.make_problem(id)).certificate, file)
    return cg.load(file)


def write(frames: list[np.ndarray], path: Path, width: int, height: int) -> None:
    """Write pictures as a GIF of some size, with one palette for all, so that equal parts cost nothing."""
    shown = frames if len(frames) <= MOST_STEPS else [*frames[:-1:2], frames[-1]]
    images = [Image.fromarray(frame).resize((width, height), Image.Resampling.LANCZOS) for frame in shown]
    # One palette from pictures early and late: colours of large areas, and rare ones such as an agent's dot.
    samples = [images[k * (len(images) - 1) // 3] for k in range(4)]
    sheet = Image.new("RGB", (width, height * len(samples)))
    for k, sample in enumerate(samples):
        sheet.paste(sample, (0, k * height))
    palette, colors = Image.new("P", (1, 1)), []
    for method in (Image.Quantize.MEDIANCUT, Image.Quantize.MAXCOVERAGE):
        colors += (sheet.quantize(COLORS, method=method).getpalette() or [])[: 3 * COLORS]
    palette.putpalette(colors)
    drawn = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    durations = [WAIT] * (len(drawn) - 1) + [HOLD]
    drawn[0].save(path, save_all=True, append_images=drawn[1:], duration=durations, loop=0, optimize=True)
    print(f"{path.name}: {path.stat().st_size // 1024} KiB", flush=True)


def _panels(frames: list[np.ndarray]) -> list[np.ndarray]:
    """Return what pages show of frames: the panels, without the column of words and the paper around them."""
    panels = [frame[:, : WIDTH - SIDE] for frame in frames]
    # Maps are in scale, and so may leave paper below or beside them. What never changes reaches as far as any agent.
    rows, columns = (np.flatnonzero((panels[0] < 255).any(axis=axes)) for axes in ((1, 2), (0, 2)))
    return [panel[: rows[-1] + RIM, : columns[-1] + RIM] for panel in panels]


def main(ids: list[str]) -> None:
    """Draw the films of some environments, or of all."""
    for id in ids or filmed():
        claim = certificate(id)
        frames, _ = film(claim.problem, Player.of("certified", claim), seed=1)
        panels = _panels(frames)
        high, wide = (round(SMALLER * pixels) for pixels in panels[0].shape[:2])
        write(panels, FOLDER / f"{id}.gif", wide, high)


if __name__ == "__main__":
    main(sys.argv[1:])
