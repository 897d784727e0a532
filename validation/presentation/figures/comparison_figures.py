"""Pictures of comparisons and training curves (matplotlib, loaded when a picture is drawn)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...statistical_tests import paired_difference
from .figure_style import BOUND, ESTIMATE, MARKS, SERIES, SOFT, check_format, legend_above, new_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ...policies import Comparison, Training


LONGEST_NAME = 28
"""Characters of a policy's name that are shown; longer names, such as paths, would leave no room for the rates."""


MOST_PAIRS = 12
"""Pairs of policies that are drawn: more would be a page of their own."""


def draw_comparison(comparison: Comparison, path: str | Path) -> None:
    """Draw and write success rates with their limits and certified bounds, and below them what pairs differ by.

    All policies meet the same starts and noise. For each pair the lower panel shows the difference of the success rates
    with exact limits for pairs (`paired_difference`) and the exact McNemar p-value after Holm's method; certified lower
    bounds are marks that point upwards. Of more than twelve pairs the first ones are drawn.

    Raises
    ------
    ValueError
        If matplotlib is not installed or the format is unknown.
    """
    check_format(path)
    entries = list(reversed(comparison.entries))  # matplotlib counts rows from below
    pairs = comparison.pairs[:MOST_PAIRS]
    # Panels as high as their rows need: constrained layouts know ratios of heights.
    heights = [1.5 + 0.35 * len(entries), *([1.0 + 0.35 * len(pairs)] if pairs else [])]
    figure, (axes, *below) = new_figure(7.6, sum(heights), rows=len(heights))
    if below:
        place = below[0].get_subplotspec()
        assert place is not None
        place.get_gridspec().set_height_ratios(heights)
        _draw_pairs(below[0], comparison, pairs)
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
    letters = reversed(_letters(comparison))
    axes.set_yticks(rows, [f"{letter}  {_short(entry.name)}" for letter, entry in zip(letters, entries)])
    axes.set_ylim(-0.7, len(entries) - 0.3)
    axes.set_xlabel("P(satisfied)")
    legend_above(axes)
    title = f"{comparison.problem}, horizon {comparison.horizon}, {comparison.episodes} episodes"
    axes.set_title(title, loc="left", fontsize=10, color=SOFT, pad=24)
    save_figure(figure, path)


def _draw_pairs(axes: Axes, comparison: Comparison, pairs: Sequence[Any]) -> None:
    """Draw differences of success rates with exact limits, and p-values at the right."""
    episodes, confidence = comparison.episodes, comparison.confidence
    rows = range(len(pairs) - 1, -1, -1)  # the first pair on top
    gains = [(pair.only_first - pair.only_second) / episodes for pair in pairs]
    limits = [paired_difference(pair.only_first, pair.only_second, episodes, confidence) for pair in pairs]
    reach = [[g - low for g, (low, _) in zip(gains, limits)], [high - g for g, (_, high) in zip(gains, limits)]]
    axes.axvline(0.0, color=SOFT, linestyle="--", linewidth=1.0)
    axes.errorbar(gains, rows, xerr=reach, fmt="s", color=SERIES[1], markersize=4, capsize=3)
    # Letters, which stand before the names above: two long names would leave no room.
    letters = {entry.name: letter for entry, letter in zip(comparison.entries, _letters(comparison))}
    axes.set_yticks(rows, [f"{letters[pair.first]} - {letters[pair.second]}" for pair in pairs])
    axes.set_ylim(-0.6, len(pairs) - 0.4)
    axes.set_xlabel(f"difference of success rates, exact {100 * confidence:g} % limits of pairs")
    # The text stands outside of the axes, where no limits are.
    for row, pair in zip(rows, pairs, strict=True):
        p = "p < 1e-300" if pair.adjusted == 0.0 else f"p = {pair.adjusted:.2g}"
        axes.text(1.01, row, p, transform=axes.get_yaxis_transform(), va="center", fontsize=8.5, color=SOFT)
    axes.set_title("paired on common noise; exact McNemar p, Holm", loc="left", fontsize=9, color=SOFT)


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


def _letters(comparison: Comparison) -> list[str]:
    """Return what policies are called in pairs: A to Z, and numbers if there are more."""
    count = len(comparison.entries)
    return [chr(ord("A") + k) if count <= 26 else str(k + 1) for k in range(count)]


def _short(name: str) -> str:
    """Return a name, or its end if it is long: the end of a path tells more than its beginning."""
    return name if len(name) <= LONGEST_NAME else "…" + name[1 - LONGEST_NAME :]
