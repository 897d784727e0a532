"""Draw the cards of the gallery: ``python docs/draw_cards.py [ID ...]``.

A card shows whole episodes under certified controllers, large enough to be read at a width of 300 pixels: on a map, or
against time where agents have one coordinate. Certificates are those that ``benchmarks/defaults.py`` has kept.
"""

from __future__ import annotations

import io
import sys
from typing import Any

import numpy as np
from matplotlib.patches import Rectangle
from PIL import Image

from certigym.envs.interfaces import LOOKS, Panel, Region, agent_color, panels
from certigym.synthesis.certificates.proofs import certificate_from
from certigym.validation.presentation.figures.figure_style import FAILURE, INK, SOFT, new_figure
from certigym.validation.statistical_tests import Loop, paths
from draw_gallery import certificate
from environment_pages import FOLDER, filmed

INCHES, DOTS = (3.0, 2.2), 200
"""Size of a card, and dots to the inch: two for each pixel of a card that is 300 pixels wide."""

EPISODES, PANELS, NAMES = 6, 2, 5
"""Episodes and panels of a card, and regions of a panel up to which they have names."""

COLORS = 40
"""Colours of a file."""

FAINT, FEWER = 0.45, 2
"""Of crowded panels: how much of the colour of regions is left, without hatches, and how many episodes are drawn."""


def card(id: str) -> Any:
    """Return the figure of one environment."""
    claim = certificate_from(certificate(id))
    states, success = paths(Loop(claim.problem, claim.controller, 1, EPISODES), EPISODES)
    shown = panels(claim.problem)[:PANELS]
    side = len(shown) if shown[0].is_map else 1
    figure, plots = new_figure(*INCHES, rows=len(shown) // side, columns=side)
    for panel, plot in zip(shown, plots, strict=True):
        _regions(plot, panel, claim.problem.horizon)
        few = FEWER if panel.is_crowded(claim.problem.horizon) else EPISODES
        _episodes(plot, panel, states[:, :few], success[:few])
        _axes(plot, panel, claim.problem.horizon)
    figure.get_layout_engine().set(w_pad=0.03, h_pad=0.03, hspace=0.02, wspace=0.02)
    return figure


def _axes(plot: Any, panel: Panel, horizon: int) -> None:
    """Give a panel its limits, and as few words as tell what is drawn."""
    plot.grid(visible=False)
    plot.set_xlim(*((panel.low[0], panel.high[0]) if panel.is_map else (0, horizon)))
    plot.set_ylim(panel.low[-1], panel.high[-1])
    plot.tick_params(labelsize=7, length=2, pad=1.5)
    for axis in (plot.xaxis, plot.yaxis):
        axis.set_major_locator(_few())
    for spine in plot.spines.values():
        spine.set_visible(True)
        spine.set_color(SOFT)
    if panel.is_map:
        plot.set_aspect("equal")
    else:
        plot.set_xlabel("control step", fontsize=7.5, labelpad=1, color=SOFT)


def _few() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=4, integer=True)


def _regions(plot: Any, panel: Panel, horizon: int) -> None:
    """Draw the regions in the looks of their roles, with names where there are few."""
    faint = FAINT if panel.is_crowded(horizon) else 1.0
    for region in panel.drawn:
        look, (corner, size) = LOOKS[region.role], _box(panel, region, horizon)
        plot.add_patch(Rectangle(corner, *size, facecolor=look.color, alpha=0.2 * faint, linewidth=0, zorder=0.5))
        lines: dict[str, Any] = {"fill": False, "edgecolor": look.color, "zorder": 0.6}
        if faint == 1.0:
            plot.add_patch(Rectangle(corner, *size, hatch=2 * look.hatch, alpha=0.45, linewidth=0, **lines))
        plot.add_patch(Rectangle(corner, *size, linewidth=0.9 * faint, **lines))
    named = panel.named if len(panel.named) <= NAMES else ()
    for region in named:
        (x, y), (width, height) = _box(panel, region, horizon)
        place: dict[str, Any] = {"fontsize": 7.5, "color": INK, "zorder": 6, "clip_on": True}
        box = {"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}
        right = x + width if panel.is_map else horizon
        middle = min(max(0.5 * (x + right), panel.low[0]), panel.high[0]) if panel.is_map else 0.97 * horizon
        align = "center" if panel.is_map else "right"
        plot.text(middle, y + 0.5 * height, region.name, ha=align, va="center", bbox=box, **place)


def _box(panel: Panel, region: Region, horizon: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the corner and the size of a region on the axes of its panel."""
    if panel.is_map:
        (a, b), (c, d) = region.low, region.high
        return (a, b), (c - a, d - b)
    first, last = region.span(horizon)
    return (first, region.low[0]), (last - first, region.high[0] - region.low[0])


def _episodes(plot: Any, panel: Panel, states: Any, success: Any) -> None:
    """Draw whole episodes: a ring where they begin, a dot or an arrow where they end, a cross where they fail."""
    many = len(panel.curves) > 6
    for curve in panel.curves:
        track, color = states @ curve.rows.T, agent_color(curve.number)
        for m in range(1 if many else track.shape[1]):
            here = track[~np.isnan(track[:, m]).any(axis=1), m]
            x = here[:, 0] if panel.is_map else np.arange(len(here))
            plot.plot(x, here[:, -1], color=color, linewidth=0.9, alpha=0.75, zorder=3)
            arrow = curve.arrow(states[len(here) - 1, m])
            mark: Any = {"marker": "o", "ms": 3.6} if arrow is None else {"marker": arrow.tolist(), "ms": 8}
            end: dict[str, Any] = mark | {"color": color} if success[m] else {"marker": "X", "ms": 6, "color": FAILURE}
            plot.plot(x[-1:], here[-1:, -1], mec="white", mew=0.4, zorder=5, **end)
            plot.plot(x[:1], here[:1, -1], marker="o", ms=4.2, mfc="white", mec=color, mew=1.1, zorder=4)


def main(ids: list[str]) -> None:
    """Draw the cards of some environments, or of all, as PNG with a palette."""
    total = 0
    for id in ids or filmed():
        buffer, path = io.BytesIO(), FOLDER / f"{id}.png"
        card(id).savefig(buffer, format="png", dpi=DOTS)
        Image.open(buffer).convert("RGB").quantize(COLORS, dither=Image.Dither.NONE).save(path, optimize=True)
        total += path.stat().st_size
        print(f"{path.name}: {path.stat().st_size // 1024} KiB", flush=True)
    print(f"{total // 1024} KiB in all")


if __name__ == "__main__":
    main(sys.argv[1:])
