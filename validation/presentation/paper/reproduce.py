"""The paper's figures and tables, recomputed: published values beside ours.

Each reproduction writes numbers (CSV) and, if matplotlib is installed, a figure (PNG) into a folder.
The name of each column says whether a number is a certificate for the continuous system at the stated noise, or only
reproduces a published number:

``published``                     read off the paper's figure or its public data
``robust_tree_variance_as_std``   the published computation, kernel built from the variance: **not a certificate**
``robust_tree``                   the same computation at the stated noise
``*_certified``, ``exact``, ``a_posteriori``   certificates of this package at the stated noise
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Sequence
from functools import partial
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import numpy as np

from ....envs.interfaces import AGENTS
from ....envs.suite import make_problem
from ....envs.systems.arguments import counted, write_bytes, write_text
from ....synthesis.abstraction.models import join, start_of
from ....synthesis.certificates.proofs import rounded_down
from ....synthesis.policy_search.ascent import start_value
from ....synthesis.verbs.abstract import abstract
from ....synthesis.verbs.search_options import SearchOptions
from ....synthesis.verbs.synthesize import synthesize
from ...statistical_tests import clopper_pearson, rollout
from .heuristics import paper_steps
from .published import published_curve
from .reproduction import PieceResult, Reproduction

Row = dict[str, Any]

FIGURE_3 = (
    (0.127733, 0.127516), (0.277626, 0.277231), (0.448067, 0.447354), (0.632929, 0.632644), (0.837324, 0.837061),
    (0.972968, 0.974444), (0.969974, 0.974028), (0.966656, 0.973203), (0.963399, 0.973480), (0.960138, 0.973267),
    (0.956946, 0.971875), (0.953937, 0.971715), (0.951378, 0.971692), (0.950349, 0.973315), (0.954188, 0.973332),
    (0.958705, 0.971912),
)  # fmt: skip
"""Published robust-tree and a-posteriori values of Fig. 3 at T = 1 .. 16."""

TABLE_2 = (
    ((1.4125, 1.2875, 3.3625, 1.2875, -17.8375, 1.2875, -16.8625, 1.2875), 0.616),
    ((-17.8375, 3.2875, -16.8625, 3.2875, 1.4125, 3.2875, 3.3625, 3.2875), 0.615),
    ((-18.0875, -7.2875, -16.8625, -7.2875, -13.5375, -7.2875, -11.8625, -7.2875), 0.162),
)
"""Initial points and published values of Table 2."""

FIGURE_4_CELLS = (40, 45, 50, 55, 59)
"""Start cells, the same for every agent, over which Fig. 4 averages."""


def fig3(horizons: Sequence[int] = range(1, 17), cells: int = 1000) -> Reproduction:
    """Recompute Fig. 3, reach-avoid: bounds, averaged over x1 in [-20, 0], x2 in [-5, -2.5], against the horizon."""
    pieces: dict[str, Callable[[], PieceResult]] = {
        "the published computation": partial(_published_means, max(horizons))
    }
    pieces |= {f"T = {t}": partial(_fig3_bounds, t, cells) for t in horizons}
    return Reproduction(pieces, partial(_fig3_joined, tuple(horizons)))


def _published_means(horizon: int) -> PieceResult:
    """Return the published values at all horizons, with the variance as deviation and at the stated noise."""
    # One pass gives all horizons.
    means = [(step.mean, stated.mean) for step, stated in zip(published_curve(horizon), published_curve(horizon, 0.5))]
    return PieceResult(means, f"{means[-1][0]:.6f} at T = {horizon}, {means[-1][1]:.6f} at the stated noise")


def _fig3_bounds(t: int, cells: int) -> PieceResult:
    """Return what is certified at one horizon: every kind of bound for the policies that are best in it."""
    problem = make_problem("reach-avoid-v0", horizon=t)
    exact = synthesize(problem, cells, relation="exact").certificate
    paper: Any = synthesize(problem, cells, relation="paper", search=SearchOptions(epsilon=0.1)).stats["largest_bounds"]
    bounds = {
        "robust_tree_certified": paper["robust tree"],
        "a_posteriori": paper["a-posteriori"],
        "exact": exact.lower_bound,
    }
    return PieceResult(bounds, f"exact relation {rounded_down(exact.lower_bound, 6)}")


def _fig3_joined(horizons: Sequence[int], found: Sequence[Any], out: Path) -> list[Row]:
    """Write Fig. 3, and return its rows."""
    means, *bounds = found
    rows = []
    for t, certified in zip(horizons, bounds, strict=True):
        robust, a_posteriori = FIGURE_3[t - 1] if t <= len(FIGURE_3) else (None, None)
        rows.append(
            {
                "T": t,
                "published": robust,
                "robust_tree_variance_as_std": means[t - 1][0],
                "robust_tree": means[t - 1][1],
                "robust_tree_certified": certified["robust_tree_certified"],
                "a_posteriori_published": a_posteriori,
                "a_posteriori": certified["a_posteriori"],
                "exact": certified["exact"],
            }
        )
    _write(out / "fig3.csv", rows)
    title = "Reach-avoid, two agents"
    _curves(out / "fig3.png", rows, "T", "lower bound, mean over the region", title, less="published")
    return rows


def fig4(horizon: int = 7) -> Reproduction:
    """Recompute Fig. 4, invariance of 4 and 20 agents in both settings: mean over five start cells by horizon."""
    cases = [(setting, n) for setting in ("A", "B") for n in (4, 20)]
    pieces = {f"setting {setting}, {n} agents": partial(_fig4_columns, setting, n, horizon) for setting, n in cases}
    return Reproduction(pieces, _fig4_joined)


def _fig4_columns(setting: str, n: int, horizon: int) -> PieceResult:
    """Return both columns of one setting, for horizons 1, 2, ..."""
    problem = make_problem("invariance-v0", n_agents=n, setting=setting, horizon=horizon)
    joint = join(problem, abstract(problem, 100, relation="paper", search=SearchOptions(epsilon=0.1)))
    q = int(np.flatnonzero(~joint.absorbing)[0])
    starts = np.array([[cell] * n for cell in FIGURE_4_CELLS])
    # The paper's method gives all horizons in one pass, the exact relation one certificate per horizon.
    robust = [float(np.mean(step.terms.at(q, starts))) for step in paper_steps(joint)]
    exact = []
    for t in range(1, horizon + 1):
        certificate = synthesize(problem.replace(horizon=t), 100, relation="exact").certificate
        centres = certificate.proof.agents[0].grid.centres[list(FIGURE_4_CELLS), 0]
        exact.append(float(np.mean(certificate.at(np.repeat(centres[:, None], n, axis=1)))))
    columns = {f"robust_tree_{setting}_{n}": robust, f"exact_{setting}_{n}": exact}
    return PieceResult(columns, f"exact relation {rounded_down(exact[-1], 6)} at T = {horizon}")


def _fig4_joined(found: Sequence[Any], out: Path) -> list[Row]:
    """Write Fig. 4, and return its rows."""
    columns = {name: values for of_case in found for name, values in of_case.items()}
    horizons = range(1, len(next(iter(columns.values()))) + 1)
    rows: list[Row] = [{"T": t, **{name: values[t - 1] for name, values in columns.items()}} for t in horizons]
    _write(out / "fig4.csv", rows)
    _curves(out / "fig4.png", rows, "T", "lower bound, mean over five starts", "Invariance, 4 and 20 agents")
    return rows


def table1() -> Reproduction:
    """Recompute Table 1: bytes of a joint value function against one term of the tree, computed and measured."""
    published = {
        "reach-avoid-v0": (1000, 2.4e7, 1.6e4),
        "invariance-20-v0": (100, 2.4e41, 1.6e4),
        "package-delivery-v0": (1200, 1.02e26, 7.7e4),
    }
    pieces = {name: partial(_bytes, name, *numbers) for name, numbers in published.items()}
    return Reproduction(pieces, partial(_table_joined, "table1.csv"))


def _bytes(name: str, cells: int, published_joint: float, published_term: float) -> PieceResult:
    """Return the row of one problem: its bytes."""
    # A short horizon and one sweep are enough to count bytes.
    problem = make_problem(name)
    small = problem.replace(horizon=min(problem.horizon, 7))
    certificate = synthesize(small, cells, search=SearchOptions(max_sweeps=1)).certificate
    sizes = [agent.grid.n_cells for agent in certificate.proof.agents]
    measured = sum(factors.nbytes for factors in certificate.proof.tree.factors)
    terms = sum(len(index) for index in certificate.proof.tree.index)
    row = {
        "problem": name,
        "agents": problem.n_agents,
        "cells": cells,
        "published_joint_bytes": published_joint,
        "joint_bytes": problem.automaton.n_states * 8.0 * float(np.prod([float(s) for s in sizes])),
        "published_bytes_per_term": published_term,
        "bytes_per_term": 8 * sum(sizes),
        "terms": terms,
        "measured_bytes": measured,
        "measured_bytes_without_sharing": 8 * sum(sizes) * terms,
    }
    return PieceResult(row, f"{counted(terms, 'term')} in {measured} bytes")


def table2(cells: int = 1200, episodes: int = 400_000) -> Reproduction:
    """Recompute Table 2, package delivery of four robots: the paper's method with disjoint letters, and ours."""
    pieces: dict[str, Callable[[], PieceResult]] = {"the paper's method": partial(_paper_at_points, cells)}
    for k in range(len(TABLE_2)):
        pieces[f"point {k + 1}"] = partial(_at_point, k, "package-delivery-v0", cells, episodes)
        pieces[f"point {k + 1}, eased"] = partial(_at_point, k, "package-delivery-eased-v0", cells, episodes)
    return Reproduction(pieces, _table2_joined)


def _paper_at_points(cells: int) -> PieceResult:
    """Return what the paper's method certifies from each point."""
    # It does not depend on the start, so one run serves all points.
    problem = make_problem("package-delivery-v0")
    joint = join(problem, abstract(problem, cells, relation="paper", search=SearchOptions(epsilon=0.1)))
    *_, last = paper_steps(joint)
    starts = [start_of(problem.replace(initial_state=list(point)), joint) for point, _ in TABLE_2]
    bounds = [start_value(start, last.terms) for start in starts]
    return PieceResult(bounds, ", ".join(rounded_down(bound, 6) for bound in bounds))


def _at_point(k: int, name: str, cells: int, episodes: int) -> PieceResult:
    """Return the row of a point: our certificate is synthesized from there, and tested by rollouts from there."""
    point, published = TABLE_2[k]
    here = make_problem(name).replace(initial_state=list(point))
    result = synthesize(here, cells, relation="exact")
    runs = rollout(here, result.controller, episodes, seed=0)
    low, high = clopper_pearson(runs.successes, runs.episodes, 0.999)
    row = {
        "problem": name,
        "initial_state": " ".join(f"{x:g}" for x in point),
        "published": None if "eased" in name else published,
        "robust_tree_certified": None,
        "exact": result.certificate.lower_bound,
        "gap": result.certificate.gap,
        "estimate": runs.successes / runs.episodes,
        "ci_low": low,
        "ci_high": high,
        "episodes": runs.episodes,
        "seconds": result.stats["seconds"]["synthesize"],  # type: ignore[index]
    }
    return PieceResult(row, f"{rounded_down(result.certificate.lower_bound, 5)}, rollouts {row['estimate']:.5f}")


def _table2_joined(found: Sequence[Any], out: Path) -> list[Row]:
    """Write Table 2, and return its rows: what the paper's method certifies stands beside what was published."""
    bounds, *rows = found
    joined = [
        {**row, "robust_tree_certified": None if row["published"] is None else bounds[k // 2]}
        for k, row in enumerate(rows)
    ]
    return _table_joined("table2.csv", joined, out)


def _table_joined(name: str, rows: Sequence[Row], out: Path) -> list[Row]:
    """Write rows, and return them."""
    _write(out / name, rows)
    return list(rows)


def _write(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as CSV; missing numbers are empty."""
    path.parent.mkdir(parents=True, exist_ok=True)
    file = StringIO(newline="")
    writer = csv.DictWriter(file, fieldnames=list(rows[0]))
    writer.writeheader()
    writer.writerows({key: "" if value is None else value for key, value in row.items()} for row in rows)
    write_text(path, file.getvalue())


WORDS = {
    "published": "published: robust tree",
    "a_posteriori_published": "published: a-posteriori",
    "robust_tree_variance_as_std": "published computation, variance as deviation (no bound)",
    "robust_tree": "published computation, stated noise (no bound)",
    "robust_tree_certified": "certified: robust tree",
    "a_posteriori": "certified: a-posteriori",
    "exact": "certified: exact relation",
}
"""What the columns of Fig. 3 are called in its figure."""

LOOKS_OF_CURVES: dict[str, dict[str, Any]] = {
    "published": {"color": "#1b1f24", "marker": "x", "linestyle": "none", "markersize": 6},
    "a_posteriori_published": {"color": "#1b1f24", "marker": "+", "linestyle": "none", "markersize": 7},
    "robust_tree_variance_as_std": {"color": "#8a8f98", "linestyle": (0, (4, 2))},
    "robust_tree": {"color": "#8a8f98", "linestyle": (0, (1, 1.5))},
}
"""What is published is black, what is no bound is grey and broken; certificates have colours."""


def words_of(column: str) -> str:
    """Return what a column is called in a figure.

    Examples
    --------
    >>> words_of("exact"), words_of("robust_tree_A_20")
    ('certified: exact relation', 'robust tree, setting A, 20 agents')
    """
    if column in WORDS:
        return WORDS[column]
    kind, _, case = column.partition("_A_") if "_A_" in column else column.partition("_B_")
    setting = "A" if "_A_" in column else "B"
    name = {"exact": "certified: exact relation"}.get(kind, kind.replace("_", " "))
    return f"{name}, setting {setting}, {case} agents" if case else name


def _curves(path: Path, rows: Sequence[Row], x: str, label: str, title: str, less: str | None = None) -> None:
    """Draw every column against ``x``, if matplotlib is installed; below, how much they are above the one ``less``."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return
    names = [key for key in rows[0] if key != x]
    table = {name: np.array([np.nan if row[name] is None else row[name] for row in rows], float) for name in names}
    steps, count = [row[x] for row in rows], 1 if less is None else 2
    figure = Figure(figsize=(7, 4.6 if less is None else 7.4), layout="constrained")
    plots = figure.subplots(count, 1, squeeze=False, sharex=True)[:, 0]
    certified = iter(itertools.cycle(AGENTS))
    for name, values in table.items():
        look = LOOKS_OF_CURVES.get(name) or {"color": next(certified), "marker": "o", "markersize": 3.5}
        plots[0].plot(steps, values, label=words_of(name), linewidth=1.4, **look)
        if less is not None and name != less:
            plots[1].plot(steps, values - table[less], linewidth=1.4, **look)
    plots[0].set(ylabel=label, title=title, ylim=(-0.02, 1.02))
    if less is not None:
        plots[1].axhline(0.0, color=LOOKS_OF_CURVES[less]["color"], linewidth=0.8)
        plots[1].set(ylabel=f"more than {words_of(less)}")
    plots[-1].set(xlabel="horizon T (control steps)")
    for plot in plots:
        plot.grid(alpha=0.3)
        plot.spines[["top", "right"]].set_visible(False)
    figure.legend(*plots[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    image = BytesIO()
    figure.savefig(image, format=path.suffix[1:], dpi=150)
    write_bytes(path, image.getvalue())
