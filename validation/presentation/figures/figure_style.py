"""The common look of all figures; matplotlib is loaded with the first figure, and its global state is never used.

The colours are those of all pictures (``envs.pictures``), which readers with any of the usual colour deficiencies can
tell apart; maps use ``cividis``. A certified lower bound is a solid line, and the range that it leaves open above it is
tinted, so that it reads as a bound and not as an estimate. Results of rollouts are points with limits.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ....envs.interfaces import AGENTS
from ....envs.systems.arguments import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
INK, SOFT, PALE = "#1b1f24", "#6b7280", "#b6bcc6"
"""Colours of text, of notes and arrows, and of lines in the background."""
BOUND, ESTIMATE, FAILURE = AGENTS[0], "#b3541e", "#b00020"
SERIES = AGENTS
"""Colours of agents and of lines, in the order in which they are used."""
MARKS = ("o", "s", "^", "D", "v", "P")
AT_LEAST = "^"
"""Triangle that points up, the mark of a lower bound."""
MAP = "cividis"


def new_figure(width: float = 6.4, height: float = 4.0, rows: int = 1, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """Return a figure and its rows x columns axes, sizes in inches; it belongs to no window and no pyplot state.

    Raises
    ------
    ValueError
        If matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure as Sheet
    except ImportError as error:
        raise ValueError('figures need matplotlib; install it with `pip install "certigym[viz]"`') from error
    # A canvas instead of pyplot: no global state, and no window.
    figure = Sheet(figsize=(width, height), layout="constrained", dpi=120, facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, squeeze=False)
    panels = [axes for line in grid for axes in line]
    for axes in panels:
        _dress(axes)
    return figure, panels


def check_format(path: str | Path, argument: str = "path") -> None:
    """Check the ending of a file name, before anything is computed.

    Raises
    ------
    ValueError
        If the name does not end in .png, .svg or .pdf.
    """
    if Path(path).suffix.lower() not in FORMATS:
        raise ValueError(f"`{argument}`: expected a file name that ends in {', '.join(FORMATS)}, got {str(path)!r}")


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, SVG or PDF; raise ValueError if the name ends in anything else."""
    check_format(path)
    # Without a date, equal figures are equal files.
    kind, image = Path(path).suffix.lower(), BytesIO()
    figure.savefig(image, format=kind[1:], metadata={"Date": None} if kind == ".svg" else None)
    write_bytes(path, image.getvalue())


def draw_bound(axes: Axes, x: Any, lower: Any, label: str, color: str = BOUND, upper: Any = 1.0, **style: Any) -> None:
    """Draw a lower bound over x: a solid line, and tinted the range up to ``upper``, which is 1 by default.

    ``upper=None`` leaves the tint out, for several bounds on the same axes.
    """
    lower = np.asarray(lower, dtype=float)
    if upper is not None:
        top = np.broadcast_to(np.asarray(upper, dtype=float), lower.shape)
        axes.fill_between(x, lower, top, color=color, alpha=0.10, linewidth=0)
    axes.plot(x, lower, color=color, linewidth=2.0, label=label, **style)


def draw_estimates(axes: Axes, x: Any, estimate: Any, low: Any, high: Any, label: str, color: str = ESTIMATE) -> None:
    """Draw success rates of rollouts with their limits."""
    middle = np.asarray(estimate, dtype=float)
    reach = np.maximum([middle - np.asarray(low), np.asarray(high) - middle], 0.0)
    axes.errorbar(x, middle, yerr=reach, fmt="o", markersize=4, color=color, capsize=3, linewidth=1.2, label=label)


def legend_above(axes: Axes, columns: int = 3) -> None:
    """Put a legend over the axes, where it covers no data."""
    place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2, "frameon": False}
    axes.legend(**place, ncols=columns, fontsize=8.5, columnspacing=1.4, handlelength=1.8)


def whole_ticks(axis: Axis) -> None:
    """Put ticks at whole numbers only."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(integer=True))


def _dress(axes: Axes) -> None:
    """Give axes the common look: no frame above and to the right, soft lines, a grid behind the data."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(SOFT)
    axes.tick_params(colors=INK, labelsize=9)
    axes.grid(color="#e5e7eb", linewidth=0.7)
    axes.set_axisbelow(True)
