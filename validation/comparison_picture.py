"""Pictures of comparisons and training curves (matplotlib, loaded when a picture is drawn)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .compare import Comparison
    from .train import Training

FORMATS = (".png", ".svg", ".pdf")


def draw_comparison(comparison: Comparison, path: str | Path) -> None:
    """Write success rates with their limits, and certified bounds as ticks.

    Raises
    ------
    ValueError
        If matplotlib is not installed or the format is unknown.
    """
    figure, axes = _canvas(path, 1.2 + 0.35 * len(comparison.entries))
    for row, entry in enumerate(reversed(comparison.entries)):
        reach = [[entry.rate - entry.ci_low], [entry.ci_high - entry.rate]]
        axes.errorbar([entry.rate], [row], xerr=reach, fmt="o", color="tab:blue", capsize=3)
        if entry.lower_bound is not None:
            axes.plot([entry.lower_bound], [row], marker="|", markersize=16, color="tab:red", linestyle="none")
    axes.set_yticks(range(len(comparison.entries)), [entry.name for entry in reversed(comparison.entries)])
    axes.set_ylim(-0.7, len(comparison.entries) - 0.3)
    axes.set_xlabel(f"success rate, {100 * comparison.confidence:g} % limits; red: certified bound")
    axes.set_title(f"{comparison.problem}, horizon {comparison.horizon}, {comparison.episodes} episodes")
    figure.savefig(path)


def draw_curves(trainings: Sequence[Training], path: str | Path) -> None:
    """Write the success rate while training against the world steps, a line per training.

    Raises
    ------
    ValueError
        If matplotlib is not installed or the format is unknown.
    """
    figure, axes = _canvas(path, 3.2)
    for training in trainings:
        points = [(point["steps"], point["success"]) for point in training.curve]
        axes.plot(*zip(*points, strict=True), label=f"{training.algorithm}, seed {training.seed}")
    axes.set_xlabel("world steps")
    axes.set_ylabel("success rate while exploring")
    axes.set_ylim(-0.02, 1.02)
    axes.set_title(trainings[0].problem.name)
    axes.legend()
    figure.savefig(path)


def _canvas(path: str | Path, height: float) -> tuple[Any, Any]:
    if Path(path).suffix not in FORMATS:
        raise ValueError(f"`{path}`: expected a file name that ends in {', '.join(FORMATS)}")
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ValueError('pictures need matplotlib: install "certigym[viz]"') from error
    figure = Figure(figsize=(7.0, height), layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()
