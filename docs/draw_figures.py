"""Draw the figures of README and documentation into ``docs/figures``: ``python docs/draw_figures.py [NAME ...]``."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import certigym as cg
from certigym.validation.figures import certificate_figures as figures
from certigym.validation.figures import figure_scenes

FOLDER = Path(__file__).parent / "figures"


def _reach_avoid(horizon: int, cells: int, **settings: Any) -> cg.Certificate:
    return cg.synthesize(cg.make_problem("reach-avoid-v0", horizon=horizon), cells=cells, **settings).certificate


def certified_rollouts() -> Any:
    """Three robots through a door (README)."""
    problem = cg.make_problem("door-formation-v0")
    return figure_scenes.rollouts_figure(cg.synthesize(problem, cells=24).certificate, episodes=25)


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


FIGURES: dict[str, Callable[[], Any]] = {
    draw.__name__: draw for draw in (certified_rollouts, relation, tree, bounds, value, ranks, automaton)
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
