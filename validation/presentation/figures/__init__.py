"""Figures for papers and pages (matplotlib).

Figures for papers and pages (matplotlib, loaded when a figure is drawn).
"""

from .certificate_figures import horizon_figure, rank_figure, value_figure
from .comparison_figures import draw_comparison, draw_curves
from .figure_scenes import automaton_figure, rollouts_figure, tree_figure
from .figure_style import check_format, save_figure
from .moving_pictures import Player, check_film, film, render_episode

__all__ = [
    "Player",
    "check_film",
    "film",
    "render_episode",
    "automaton_figure",
    "check_format",
    "draw_comparison",
    "draw_curves",
    "horizon_figure",
    "rank_figure",
    "rollouts_figure",
    "save_figure",
    "tree_figure",
    "value_figure",
]
