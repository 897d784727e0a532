"""The value explorer of a report: a map of starts with what is certified at each, and ten episodes from each of them.

Everything that the page can show is computed before it is written, at the points of a grid: lower bounds at every time
and automaton state, and the paths of episodes from the start. The page itself computes nothing, so that what it shows
is what ``Certificate.at`` and ``value_in_time`` say at the same points, rounded down. A certificate that speaks of its
own start alone has that start among the points, with its bound; at the others stands what the check proves of the same
controllers (`other_starts`), or that nothing is known.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.interfaces import AGENTS, MOST_STRETCHED, Curve, Panel, coordinate_name, have_one_scale, panels
from ....envs.tasks.problem import Problem
from ....synthesis.certificates.proofs import members_of, on_cells, seen_by, speaks_of_one_start
from ....synthesis.extended_check.claims import ValueInTime, claimed_values
from ...statistical_tests import Loop, OddsScale, paths, slice_axes, slice_starts, start_box
from .inline_pictures import panel_axes
from .other_starts import MOST_WORK, along_paths, bounds_from, reach, work_of

EPISODES = 10
"""Episodes that are shown from each start."""

LINE_POINTS = 41
"""Starts along a line."""

MAP_POINTS = (29, 25, 21, 17, 15, 13, 11, 9, 7, 5)
"""Starts along each axis of a map: the first number is taken with which the page stays small."""

MOST_NUMBERS = 300_000
"""Coordinates of episodes, and values: each of both adds less than two megabytes to a page."""

FEWEST_POINTS = 4
"""Starts along each axis with which a map of what is proved is worth its time."""

MOST_PANELS = 4
"""Panels in which episodes are drawn."""

UNIT = 1_000_000_000
"""Bounds are handed over as whole numbers of this part, rounded down."""

UNKNOWN = 2**32 - 1
"""What is handed over where no bound is known."""


@dataclass(frozen=True, eq=False)
class Explored:
    """What the explorer of a page shows.

    Parameters
    ----------
    axes : tuple of int
        Joint coordinates that vary, one or two.
    starts : (N, D) array
        Joint starts, the last axis varying fastest.
    shape : tuple of int
        Points per axis.
    bounds : (N,) array
        Lower bounds from these starts, at the start of an episode; NaN where none is known.
    times : tuple of int
        Times of ``values``: all of them, or evenly many if there are too many; none along a path.
    values : (len(times), Q, N) array
        Lower bounds in the middle of a run: at a time, in an automaton state, at a joint state.
    states : (T + 1, N * EPISODES, D) array
        Episodes; number ``r`` begins at start ``r`` modulo N. NaN after their decision.
    success : (N * EPISODES,) bool array
    own : int or None
        Number of the start that the certificate is about, if it is about one alone.
    """

    axes: tuple[int, ...]
    starts: NDArray[Any]
    shape: tuple[int, ...]
    bounds: NDArray[Any]
    times: tuple[int, ...]
    values: NDArray[Any]
    states: NDArray[Any]
    success: NDArray[np.bool_]
    own: int | None = None


def explored(certificate: Any, seed: int, axes: Sequence[int] | None = None) -> Explored:
    """Return what can be explored of a certificate."""
    problem = certificate.problem
    chosen = _axes(problem) if axes is None else slice_axes(problem, axes)
    starts, shape, own, bounds = bounds_of_starts(certificate, chosen)
    count = EPISODES * len(starts)
    states, success = paths(Loop(problem, certificate.controller, seed, count, starts), count)
    times, values = _in_time(certificate, starts)
    return Explored(chosen, starts, shape, bounds, times, values, states, success, own)


def bounds_of_starts(
    certificate: Any, axes: tuple[int, ...], work: float = MOST_WORK
) -> tuple[NDArray[Any], tuple[int, ...], int | None, NDArray[Any]]:
    """Return starts, points per axis, the number of the certificate's own start (None: any), and lower bounds."""
    if speaks_of_one_start(certificate) and not has_values(certificate):
        return _around_one_start(certificate, axes, work)
    shape = _shape(certificate.problem, len(axes))
    starts = slice_starts(certificate.problem, axes, shape)
    return starts, shape, None, certificate.at(starts)


def has_values(certificate: Any) -> bool:
    """Whether a certificate knows its bound at every start: on grids, and of written out times, too."""
    return all(on_cells(member) is not None for member in members_of(certificate))


def _around_one_start(
    certificate: Any, axes: tuple[int, ...], work: float
) -> tuple[NDArray[Any], tuple[int, ...], int, NDArray[Any]]:
    """Return starts, points per axis, the number of the certificate's own start, and what is known from them."""
    problem, (most, *_) = certificate.problem, _shape(certificate.problem, len(axes))
    known = along_paths(certificate)
    points = int((work / work_of(certificate)) ** (1.0 / len(axes))) if known else 0
    known = points >= FEWEST_POINTS
    shape = (min(most, points) if known else min(most, 17),) * len(axes)
    starts = slice_starts(problem, axes, shape, box=reach(certificate, axes) if known else None)
    # The point that is nearest to its own start becomes that start.
    middle, number = 0.5 * np.sum(start_box(problem), axis=0), 0
    for axis, count in zip(axes, shape, strict=True):
        line = np.unique(starts[:, axis])
        nearest = int(np.argmin(np.abs(line - middle[axis])))
        starts[starts[:, axis] == line[nearest], axis] = middle[axis]
        number = number * count + nearest
    if known:
        return starts, shape, number, bounds_from(certificate, starts)
    low, high = start_box(problem)
    inside = np.all((starts >= low) & (starts <= high), axis=1)
    return starts, shape, number, np.where(inside, certificate.lower_bound, np.nan)


def _axes(problem: Problem) -> tuple[int, ...]:
    """Return both coordinates of the first agent on a map if it has one, otherwise those of `slice_axes`."""
    first = panels(problem)[0]
    return (coordinates_of(first.curves[0]) if first.is_map else ()) or slice_axes(problem, None)


def coordinates_of(curve: Curve) -> tuple[int, ...]:
    """Return the joint coordinates that a curve shows; none where it shows others, such as sums."""
    if all(np.count_nonzero(row) == 1 and row.max() == 1.0 for row in curve.rows):
        return tuple(int(np.argmax(row)) for row in curve.rows)
    return ()


def _shape(problem: Problem, axes: int) -> tuple[int, ...]:
    """Return how many starts there are along each axis."""
    if axes == 1:
        return (LINE_POINTS,)
    curves = sum(len(panel.curves) for panel in panels(problem)[:MOST_PANELS])
    numbers = 2 * EPISODES * curves * (problem.horizon + 1)
    points = next((n for n in MAP_POINTS if n * n * numbers <= MOST_NUMBERS), MAP_POINTS[-1])
    return points, points


def _in_time(certificate: Any, starts: NDArray[Any]) -> tuple[tuple[int, ...], NDArray[Any]]:
    """Return times, and lower bounds (times, Q, N) in the middle of a run; none of either along a path."""
    if on_cells(certificate) is None:
        return (), np.zeros((0, 0, len(starts)))
    horizon, n_states = certificate.problem.horizon, certificate.problem.automaton.n_states
    most = max(2, MOST_NUMBERS // (n_states * len(starts)))
    times = tuple(sorted(set(np.linspace(0, horizon - 1, min(horizon, most)).astype(int).tolist())))
    value = ValueInTime(on_cells(certificate), claimed_values(on_cells(certificate)), seen_by(certificate))
    table = [[value.at(starts, q, horizon - time) for q in range(n_states)] for time in times]
    return times, np.array(table).reshape(len(times), n_states, len(starts))


def explorer_data(content: Explored, problem: Problem) -> dict[str, Any]:
    """Return what the script of the page reads: bounds as whole numbers, rounded down, and points of pictures."""
    grid = [np.unique(content.starts[:, k]) for k in content.axes]
    half = [0.5 * (x[1] - x[0]) for x in grid]
    shown = panels(problem)[:MOST_PANELS]
    return {
        "names": [coordinate_name(problem, k) for k in content.axes],
        "grid": [x.tolist() for x in grid],
        # an end that is 0 but for rounding is 0
        "low": [float(np.round(x[0] / h - 1.0, 9) * h) + 0.0 for x, h in zip(grid, half)],
        "high": [float(np.round(x[-1] / h + 1.0, 9) * h) + 0.0 for x, h in zip(grid, half)],
        "unit": UNIT,
        # At the start, and later: on the scale of odds, where colours begin and end, and what stands below them.
        "scales": [_scale(numbers) for numbers in (content.bounds, content.values)],
        "own": content.own,
        "bounds": _packed(_down(content.bounds), "<u4"),
        "times": list(content.times),
        "states": list(problem.automaton.state_names) if content.times else [],
        "values": _packed(_down(content.values), "<u4"),
        "episodes": EPISODES,
        "length": len(content.states),
        "success": content.success.astype(int).tolist(),
        "middle": [_nearest(x, content.axes[k], problem) for k, x in enumerate(grid)],
        "scaled": _is_scaled(content, problem),
        "regions": _regions(content.axes, shown[0]),
        "panels": [_curves(panel, content, problem.horizon) for panel in shown],
    }


def _scale(bounds: NDArray[Any]) -> dict[str, Any]:
    """Return the scale of the colours of some bounds."""
    odds = OddsScale.of(bounds[~np.isnan(bounds)])
    return {"low": odds.low, "high": odds.high, "ticks": [[name, odds.at(p)] for name, p in odds.ticks]}


def _nearest(line: NDArray[Any], axis: int, problem: Problem) -> int:
    """Return the number of the point on a line of starts that is nearest to the middle of the problem's start."""
    i = next(i for i, columns in enumerate(problem.columns) if axis < columns.stop)
    start, k = problem.agents[i].initial, axis - problem.columns[i].start
    return int(np.argmin(np.abs(line - 0.5 * (start.low[k] + start.high[k]))))


def _is_scaled(content: Explored, problem: Problem) -> bool:
    """Return whether both axes of the map have one scale: if they have on a panel, and starts make no strip of it."""
    if not have_one_scale(problem, content.axes):
        return False
    across, up = (float(np.ptp(content.starts[:, k])) for k in content.axes)
    return 1.0 / MOST_STRETCHED <= up / across <= MOST_STRETCHED


def _regions(axes: tuple[int, ...], panel: Panel) -> list[dict[str, Any]]:
    """Return the regions of the map if its axes are those of a panel."""
    if not panel.shows(axes):
        return []
    return [{"name": r.name, "role": r.role, "low": r.low, "high": r.high} for r in panel.named if r.time is None]


def _curves(panel: Panel, content: Explored, horizon: int) -> list[dict[str, Any]]:
    """Return the points of every curve of a panel, in tenths of picture units, as text; -1 after the decision."""
    axes = panel_axes(panel, horizon)
    curves = []
    for curve in panel.curves:
        track = np.clip(content.states @ curve.rows.T, panel.low, panel.high)
        across = track[..., 0] if panel.is_map else np.broadcast_to(np.arange(len(track))[:, None], track.shape[:2])
        x, y = axes.at(across, track[..., -1])  # type: ignore[arg-type]
        points = np.stack([x, y], axis=-1)
        whole = np.where(np.isnan(points).any(axis=-1, keepdims=True), -1, np.nan_to_num(np.round(10 * points)))
        # Episode by episode, so that the script reads what it draws in one piece.
        curves.append(
            {
                "role": f"agent{curve.number % len(AGENTS)}",
                "points": _packed(whole.swapaxes(0, 1), "<i2"),
                "turns": _turns(curve, content.states),
            }
        )
    return curves


def _turns(curve: Curve, states: NDArray[Any]) -> str | None:
    """Return where an agent with a heading points at the end of every episode, in whole degrees, clockwise."""
    if curve.heading is None:
        return None
    lengths = (~np.isnan(states).any(axis=2)).sum(axis=0)
    angles = states[np.maximum(lengths - 1, 0), np.arange(len(lengths)), curve.heading]
    return _packed(np.round(-np.degrees(np.nan_to_num(angles))) % 360, "<i2")


def _down(bounds: NDArray[Any]) -> NDArray[Any]:
    """Return bounds as whole numbers of `UNIT`, rounded down."""
    whole = np.floor(bounds * UNIT)
    # The product is rounded: one unit less where it was rounded up.
    return np.where(np.isnan(bounds), UNKNOWN, np.where(whole / UNIT > bounds, whole - 1, whole))


def _packed(numbers: NDArray[Any], kind: str) -> str:
    """Return whole numbers as text, little end first."""
    return b64encode(np.ascontiguousarray(numbers).astype(kind).tobytes()).decode("ascii")
