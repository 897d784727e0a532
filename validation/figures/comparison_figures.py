"""Pictures of comparisons and training curves (matplotlib, loaded when a picture is drawn)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .figure_style import BOUND, ESTIMATE, MARKS, SERIES, SOFT, check_format, legend_above, new_figure, save_figure

if TYPE_CHECKING:
    from ..policies import Comparison, Training


LONGEST_NAME = 32
"""Characters of a policy's name that are shown; longer names, such as paths, would leave no room for the rates."""


def draw_comparison(comparison: Comparison, path: str | Path) -> None:
    """Draw and write success rates with their limits, and certified lower bounds as marks that point upwards.

    Raises
    ------
    ValueError
        If matplotlib is not installed or the format is unknown.
    """
    check_format(path)
    entries = list(reversed(comparison.entries))  # matplotlib counts rows from below
    figure, (axes,) = new_figure(7.0, 1.5 + 0.35 * len(entries))
    rows = range(len(entries))
    rates = [entry.rate for entry in entries]
    reach = [[e.rate - e.ci_low for e in entries], [e.ci_high - e.rate for e in entries]]
    label = f"success rate, {100 * comparison.confidence:g} % limits"
    axes.errorbar(rates, rows, xerr=reach, fmt="o", color=ESTIMATE, markersize=4, capsize=3, label=label)
    # Bounds stand a little below the estimate of their policy.
    bounds = [(e.lower_bound, row - 0.25) for row, e in enumerate(entries) if e.lower_bound is not None]
    if bounds:
        x, y = zip(*bounds, strict=True)
        axes.plot(x, y, marker=">", markersize=7, color=BOUND, linestyle="none", label="certified: at least")
    axes.set_yticks(rows, [_short(entry.name) for entry in entries])
    axes.set_ylim(-0.7, len(entries) - 0.3)
    axes.set_xlabel("P(satisfied)")
    legend_above(axes)
    title = f"{comparison.problem}, horizon {comparison.horizon}, {comparison.episodes} episodes"
    axes.set_title(title, loc="left", fontsize=10, color=SOFT, pad=24)
    save_figure(figure, path)


def draw_curves(trainings: Sequence[Training], path: str | Path, lower_bound: float | None = None) -> None:
    """Draw and write the success rate while training against the world steps, one line per training.

    A certified lower bound is drawn as a line across; it is about the certified controllers, not about the learners.

    Raises
    ------
    ValueError
        If matplotlib is not installed or the format is unknown.
    """
    check_format(path)
    figure, (axes,) = new_figure(7.0, 3.6)
    for number, training in enumerate(trainings):
        points = [(point["steps"], point["success"]) for point in training.curve]
        color, mark = SERIES[number % len(SERIES)], MARKS[number % len(MARKS)]
        label = f"{training.algorithm}, seed {training.seed}"
        axes.plot(*zip(*points, strict=True), color=color, marker=mark, markersize=3.5, label=label)
    if lower_bound is not None:
        # Not the colour of bounds: that of the first training is the same.
        axes.axhline(lower_bound, color=SOFT, linestyle="--", linewidth=1.2, label="certified controllers: at least")
    axes.set_xlabel("world steps")
    axes.set_ylabel("success rate while exploring")
    axes.set_ylim(-0.02, 1.02)
    legend_above(axes)
    axes.set_title(trainings[0].problem.name, loc="left", fontsize=10, color=SOFT, pad=24)
    save_figure(figure, path)


def _short(name: str) -> str:
    """Return a name, or its end if it is long: the end of a path tells more than its beginning."""
    return name if len(name) <= LONGEST_NAME else "…" + name[1 - LONGEST_NAME :]
