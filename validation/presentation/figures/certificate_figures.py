"""Figures of certificates: value over a slice of starts, bound against horizon, growth of the rank.

Every function returns a matplotlib ``Figure``; ``save_figure`` writes it. Rollouts over regions, automata and value
trees are drawn in ``figure_scenes``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ....envs.interfaces import coordinate_name, have_one_scale
from ....envs.tasks.problem import Problem
from ....synthesis.certificates.cell_probabilities import regrow_trains
from ....synthesis.certificates.proofs import OnGrid, as_certificate, of_first_task, on_cells
from ....synthesis.certificates.value_functions import Trains
from ...statistical_tests import OddsScale, ValidationReport, slice_axes, slice_starts, workspace_box
from .figure_regions import bands, region_boxes
from .figure_style import (
    AT_LEAST,
    ESTIMATE,
    INK,
    MAP,
    MARKS,
    PALE,
    SERIES,
    SOFT,
    draw_bound,
    draw_estimates,
    legend_above,
    new_figure,
    whole_ticks,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STATES_SHOWN = 5
"""Automaton states with a coloured line and a name in a figure of ranks: as many as can be told apart."""

MANY_TERMS_DRAWN = 200
"""Largest number of terms up to which the axis of a figure of ranks is linear; beyond, it is logarithmic."""


def value_figure(
    certificate: Any, axes: Sequence[int] | None = None, at: Any = None, points: int | None = None
) -> Figure:
    """Draw the certified lower bound over a slice of initial states: a curve over one coordinate or a map over two.

    Parameters
    ----------
    certificate : Synthesis, Certificate or path
    axes : sequence of int, optional
        One or two joint coordinates; default: the first coordinate of the first two agents.
    at : array_like (D,), optional
        Joint state that gives the other coordinates; default: the middle of the problem's start.
    points : int, optional
        Points per axis; default: 600 along a line, 160 per axis of a map.

    Raises
    ------
    ValueError
        If the axes are not one or two different joint coordinates, or matplotlib is missing.
    """
    certificate = as_certificate(certificate)
    problem = certificate.problem
    shown = slice_axes(problem, axes)
    count = points or (600 if len(shown) == 1 else 160)
    if count < 2:
        raise ValueError(f"`points`: expected at least 2, got {count}")
    states = slice_starts(problem, shown, (count,) * len(shown), at)
    bounds = certificate.at(states)
    names = [f"start of {coordinate_name(problem, k)} (state units)" for k in shown]
    title = f"{problem.name}, horizon {problem.horizon}: {certificate.proof.bound} bound"
    if on_cells(certificate) is certificate and certificate.proof.rounding is not None:
        title += ", 0 at cells that runs from its start do not reach"
    if len(shown) == 1:
        figure, (plot,) = new_figure(6.4, 3.8)
        x = states[:, shown[0]]
        draw_bound(plot, x, bounds, "certified lower bound", upper=1.0)
        bands(plot, problem, shown[0], across=True)
        plot.set_ylim(-0.02, 1.04)
        plot.set_xlim(*_limits(problem, shown[0]))
        plot.set_xlabel(names[0])
        plot.set_ylabel("P(satisfied) at least")
        legend_above(plot, 2)
        plot.set_title(title, loc="left", fontsize=10, color=SOFT, pad=24)
        return figure
    return _map(problem, shown, states, bounds.reshape(count, count).T, names, title)


def _map(
    problem: Problem,
    shown: Sequence[int],
    states: NDArray[Any],
    grid: NDArray[Any],
    names: Sequence[str],
    title: str,
) -> Figure:
    """Draw bounds (N, N) over two coordinates, with contours that the scale repeats, and the regions."""
    figure, (plot,) = new_figure(6.6, 5.0)
    x, y = (np.unique(states[:, k]) for k in shown)
    odds = OddsScale.of(grid)
    shares = np.vectorize(odds.at)(grid)
    image = plot.pcolormesh(x, y, shares, cmap=MAP, vmin=0.0, vmax=1.0, shading="nearest", rasterized=True)
    scale = figure.colorbar(image, ax=plot, label="certified lower bound on P(satisfied), by its odds", pad=0.02)
    scale.set_ticks([odds.at(p) for _, p in odds.ticks], labels=[name for name, _ in odds.ticks])
    # Contours that are not on the map would warn; dark ones stand on bright colours.
    inside = [level for _, p in odds.ticks if shares.min() < (level := odds.at(p)) < shares.max()]
    if inside:
        colors = ["white" if level < 0.6 else INK for level in inside]
        scale.add_lines(plot.contour(x, y, shares, levels=inside, colors=colors, linewidths=0.9))
    # Regions are boxes inside the map if both coordinates belong to one agent, otherwise bars along its edges.
    rows = region_boxes(plot, problem, shown)
    for k, across in zip(shown, (True, False), strict=True):
        if rows is None:
            levels = bands(plot, problem, k, across)
            rows = levels if across else rows
    plot.grid(visible=False)
    plot.set_xlim(*_limits(problem, shown[0]))
    plot.set_ylim(*_limits(problem, shown[1]))
    plot.set_aspect("equal" if have_one_scale(problem, shown) else "auto")
    plot.set_xlabel(names[0])
    plot.set_ylabel(names[1])
    plot.set_title(title, loc="left", fontsize=10, color=SOFT, pad=6 + 17 * (rows or 0))
    return figure


def horizon_figure(reports: Sequence[ValidationReport] | Mapping[str, Sequence[ValidationReport]]) -> Figure:
    """Draw certified bounds and success rates against the horizon, as one series or as several by name.

    Parameters
    ----------
    reports : sequence of ValidationReport, or mapping from a name to one
        Reports of ``validate``, one per horizon.

    Raises
    ------
    ValueError
        If there is no report, or matplotlib is missing.
    """
    series = reports if isinstance(reports, Mapping) else {"": reports}
    if not series or not all(len(line) for line in series.values()):
        raise ValueError("`reports`: expected at least one report per series, got none; see `validate`")
    figure, (plot,) = new_figure(6.8, 4.2)
    several = len(series) > 1
    for k, (name, line) in enumerate(series.items()):
        color = SERIES[k % len(SERIES)]
        x = [report.horizon for report in line]
        prefix = f"{name}: " if name else ""
        lower = [report.lower_bound for report in line]
        upper = None if several else [r.lower_bound + r.gap if r.gap is not None else 1.0 for r in line]
        label = f"{prefix}probability (exact)" if all(r.exact for r in line) else f"{prefix}certified: at least"
        draw_bound(plot, x, lower, label, color, upper, marker=AT_LEAST, markersize=5)
        # Estimates stand a little to the right of their bound, so that neither hides the other.
        low, high = [report.ci_low for report in line], [report.ci_high for report in line]
        label = f"{prefix}rollouts, {100 * line[0].confidence:g} % limits"
        shade = color if several else ESTIMATE
        offset = 0.13 * (k + 1)
        draw_estimates(plot, np.array(x) + offset, [r.estimate for r in line], low, high, label, shade)
    first = next(iter(series.values()))[0]
    plot.set_ylim(-0.02, 1.04)
    whole_ticks(plot.xaxis)
    plot.set_xlabel("horizon T (control steps)")
    plot.set_ylabel("P(satisfied)")
    legend_above(plot, 2)
    plot.set_title(first.problem, loc="left", fontsize=10, color=SOFT, pad=24 + 14 * (len(series) - 1))
    return figure


def rank_figure(certificate: Any) -> Figure:
    """Draw how many terms of the value function each automaton state formed and kept, against the steps left.

    The difference of both numbers was united or dropped; the numbers are exact. Of independent tasks the first one is
    drawn.
    """
    certificate = of_first_task(certificate)
    problem = certificate.problem
    left = problem.horizon - np.arange(problem.horizon)
    figure, (plot,) = new_figure(6.6, 4.0)
    n_kept, n_formed = _counts(certificate)
    # The states with the most terms get colours and names, the others are grey.
    order = [q for q in np.argsort(-n_kept.max(axis=1), kind="stable") if n_kept[q].any()]
    for q in order[STATES_SHOWN:]:
        plot.plot(left, np.where(n_kept[q] > 0, n_kept[q], np.nan), color=PALE, linewidth=0.9)
    for number, q in enumerate(order[:STATES_SHOWN]):
        color, mark = SERIES[number % len(SERIES)], MARKS[number % len(MARKS)]
        plot.plot(
            left, np.where(n_formed[q] > 0, n_formed[q], np.nan), color=color, linewidth=1.2, linestyle=(0, (4, 2))
        )
        label = f"state {problem.automaton.state_names[q]}: kept"
        plot.plot(
            left, np.where(n_kept[q] > 0, n_kept[q], np.nan), color=color, linewidth=2, marker=mark, ms=4, label=label
        )
    rest = len(order) - STATES_SHOWN
    if rest > 0:
        plot.plot([], [], color=PALE, linewidth=0.9, label=f"{rest} other states: kept")
    plot.plot([], [], color=SOFT, linewidth=1.2, linestyle=(0, (4, 2)), label="formed, before uniting and dropping")
    peak = int(n_formed.max(initial=1))
    if peak > MANY_TERMS_DRAWN:
        plot.set_yscale("log")
    else:
        plot.set_ylim(0, peak * 1.08 + 0.5)
        whole_ticks(plot.yaxis)
    whole_ticks(plot.xaxis)
    plot.set_xlabel("steps left (control steps)")
    plot.set_ylabel("terms of the value function")
    legend_above(plot, 2)
    rows = -(-(min(len(order), STATES_SHOWN) + 1 + (rest > 0)) // 2)
    title = f"{problem.name}, horizon {problem.horizon}: rank {certificate.proof.rank}"
    plot.set_title(title, loc="left", fontsize=10, color=SOFT, pad=10 + 14 * rows)
    return figure


def _counts(certificate: OnGrid) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the numbers (Q, T) of terms that each automaton state keeps at each time, and that it formed (exact).

    Tensor trains form no terms: their ranks take the place of both.
    """
    if on_cells(certificate) is certificate and certificate.proof.rounding is not None:
        # Trains are computed again from the last time to the first.
        columns: list[list[int]] = []

        def note(time: int, value: Trains) -> None:
            columns.append([0 if train is None else train.rank for train in value.states])

        proof = certificate.proof
        regrow_trains(certificate.problem, proof.agents, proof.guards, proof.rounding, note)
        ranks = np.array(columns[::-1]).T
        return ranks, ranks
    steps, states = certificate.proof.merge_log, range(certificate.problem.automaton.n_states)
    kept = [[len(step.kept[q]) for step in steps] for q in states]
    return np.array(kept), np.array([[len(step.origin[q]) for step in steps] for q in states])


def _limits(problem: Problem, k: int) -> tuple[float, float]:
    """Return the range of joint coordinate k in the workspaces."""
    low, high = workspace_box(problem)
    return float(low[k]), float(high[k])
