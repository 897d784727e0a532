"""Draw the figures of README and documentation into ``docs/figures``: ``python docs/draw_figures.py [NAME ...]``."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import certigym as cg
from certigym.validation.figures import certificate_figures as figures
from certigym.validation.figures import figure_scenes
from certigym.validation.figures.figure_style import SOFT, new_figure

FOLDER = Path(__file__).parent / "figures"


def _reach_avoid(horizon: int, cells: int, **settings: Any) -> cg.Certificate:
    return cg.synthesize(cg.make_problem("reach-avoid-v0", horizon=horizon), cells=cells, **settings).certificate


def relation() -> Any:
    """A position-velocity agent in its tube."""
    problem = cg.make_problem("reach-avoid-kinematic-v0", horizon=8)
    result = cg.synthesize(problem, cells=60, relation="tube", max_sweeps=0)
    return figures.relation_figure(result.certificate, seed=1)


def tree() -> Any:
    """The tree of a short task."""
    return figure_scenes.tree_figure(_reach_avoid(3, 200))


def bounds() -> Any:
    """One task under two relations."""
    problem, horizons = cg.make_problem("reach-avoid-v0"), range(1, 11)
    return figures.horizon_figure(
        {
            "exact relation": cg.validate_horizons(problem, horizons, 4000, cells=250),
            "paper relation": cg.validate_horizons(problem, horizons, 4000, cells=250, relation="paper"),
        }
    )


def value() -> Any:
    """A map of starts."""
    return figures.value_figure(_reach_avoid(6, 1000))


def ranks() -> Any:
    """Growth and pruning."""
    return figures.rank_figure(_reach_avoid(16, 500))


def automaton() -> Any:
    """A task with two stages."""
    return figure_scenes.automaton_figure(cg.make_problem("meeting-v0"))


def suite() -> Any:
    """Success on every problem of the suite, from the leaderboard."""
    rows = json.loads((FOLDER.parent / "leaderboard.json").read_text(encoding="utf-8"))["rows"]
    rates: dict[str, dict[str, float]] = {}
    for row in rows:
        here = rates.setdefault(row["problem"], {})
        here[row["policy"]] = sum(row["successes"]) / (row["episodes"] * max(1, len(row["successes"])))
        if row["policy"] == "certified":
            here["bound"] = row["lower_bound"]
    order = sorted(rates, key=lambda id: (rates[id].get("bound", 0.0), id))
    kinds = {
        "random": ("x", SOFT, "random inputs"),
        "ppo": ("D", "#d98a3d", "PPO without help"),
        "warm-ppo": ("s", "#7b5ea7", "PPO from a clone of the certified controllers"),
        "certified": ("o", "#1f5fae", "certified controllers"),
    }
    figure, (plot,) = new_figure(8.6, 0.235 * len(order) + 1.3)
    for policy, (mark, color, name) in kinds.items():
        points = [(rates[id][policy], k) for k, id in enumerate(order) if policy in rates[id]]
        face = color if mark in "ox" else "white"
        style: Any = {"marker": mark, "markerfacecolor": face, "markeredgecolor": color, "linestyle": "none"}
        plot.plot(*zip(*points), label=name, **style)
    bounds = [(rates[id]["bound"], k) for k, id in enumerate(order)]
    plot.barh(
        range(len(order)), [b for b, _ in bounds], height=0.62, color="#cfe0f4", label="certified bound", zorder=0
    )
    plot.set_yticks(range(len(order)), order, fontsize=8)
    plot.set_ylim(-0.7, len(order) - 0.3)
    plot.set_xlim(-0.02, 1.02)
    plot.set_xlabel("probability of success")
    plot.grid(axis="x", alpha=0.3)
    figure.legend(loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    return figure


FIGURES: dict[str, Callable[[], Any]] = {
    draw.__name__: draw for draw in (relation, tree, bounds, value, ranks, automaton, suite)
}


def main(names: list[str]) -> None:
    """Draw the named figures, or all, as PNG with a palette: small enough to commit."""
    from PIL import Image

    FOLDER.mkdir(exist_ok=True)
    for name in names or list(FIGURES):
        buffer = io.BytesIO()
        FIGURES[name]().savefig(buffer, format="png", dpi=130)
        path = FOLDER / f"{name}.png"
        Image.open(buffer).convert("RGB").quantize(192, dither=Image.Dither.NONE).save(path, optimize=True)
        print(f"{path.name}: {path.stat().st_size // 1024} KiB")


if __name__ == "__main__":
    main(sys.argv[1:])
