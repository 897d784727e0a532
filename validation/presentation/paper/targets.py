"""All that can be reproduced, by name: what computes each target, and which numbers were published of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from . import reproduce
from .arch import arch
from .judged_lines import Bound, Claim, Digits, Line, judged_lines
from .refutation import refutation
from .reproduction import Reproduction

TARGETS = ("fig3", "fig4", "table1", "table2", "refutation", "arch")
"""In the order in which ``all`` computes them."""


def target_of(target: str, row: str | None = None) -> Reproduction:
    """Return what computes a target, or one row of it.

    Raises
    ------
    ValueError
        If there is no such target or row.
    """
    if target not in TARGETS:
        raise ValueError(f"`target`: expected one of {', '.join(TARGETS)}, got {target!r}")
    if target == "arch":
        return arch(row)
    return refutation() if target == "refutation" else getattr(reproduce, target)()


def lines_of(target: str, result: Any, row: str | None = None) -> list[dict[str, Any]]:
    """Return the judged lines of what a target gave; with ``row`` none can be missing."""
    return judged_lines(target, LINES[target](result), only=row)


def _fig3(rows: Sequence[dict[str, Any]]) -> list[Line]:
    """Return the lines of Fig. 3: the published computation repeated, and what is certified at the stated noise."""
    lines = list[Line]()
    for row in rows:
        at, robust, posterior = f"T = {row['T']}: ", row["published"], row["a_posteriori_published"]
        lines += [
            Digits(f"{at}robust tree, variance as deviation", robust, row["robust_tree_variance_as_std"]),
            Line(f"{at}robust tree, stated noise", robust, row["robust_tree"]),
            Bound(f"{at}robust tree, certified", robust, row["robust_tree_certified"]),
            Bound(f"{at}a-posteriori, certified", posterior, row["a_posteriori"]),
            Bound(f"{at}exact relation, certified", robust, row["exact"]),
        ]
    return lines


def _fig4(rows: Sequence[dict[str, Any]]) -> list[Line]:
    """Return the lines of Fig. 4, of which no digits were published."""
    lines = list[Line]()
    for row in rows:
        for name in [key for key in row if key != "T"]:
            kind, setting, n = name.rsplit("_", 2)
            what = "exact relation" if kind == "exact" else "robust tree"
            judged = Bound if kind == "exact" else Line
            lines.append(judged(f"T = {row['T']}, setting {setting}, {n} agents: {what}", None, row[name]))
    return lines


def _table1(rows: Sequence[dict[str, Any]]) -> list[Line]:
    """Return the lines of Table 1: bytes."""
    lines = list[Line]()
    for row in rows:
        name = row["problem"]
        lines += [
            Line(f"{name}: joint bytes", row["published_joint_bytes"], row["joint_bytes"]),
            Line(f"{name}: bytes per term", row["published_bytes_per_term"], row["bytes_per_term"]),
        ]
    return lines


def _table2(rows: Sequence[dict[str, Any]]) -> list[Line]:
    """Return the lines of Table 2: the published claims against rollouts, and what is certified."""
    lines = list[Line]()
    for k, row in enumerate(rows):
        name = f"point {k // 2 + 1}{', eased' if row['published'] is None else ''}: "
        if row["published"] is not None:
            lines += [
                Claim(f"{name}upper limit of rollouts", row["published"], row["ci_high"]),
                Bound(f"{name}the paper's method", row["published"], row["robust_tree_certified"]),
            ]
        lines += [
            Bound(f"{name}exact relation", row["published"], row["exact"]),
            Line(f"{name}rollouts", row["published"], row["estimate"]),
        ]
    return lines


def _refutation(result: dict[str, Any]) -> list[Line]:
    """Return the lines of the refutation of the certificate at T = 6."""
    right = result["right_noise"]
    return [
        Line("initial states at which the claim is refuted", None, result["refuted"]),
        Line("initial states", None, result["initial_states"]),
        Line("share of states with a success rate below the claim", None, result["fraction_below_claim"]),
        Line("largest excess of a claim", None, result["worst_excess"]),
        Line("worst start, x1", None, result["worst_initial_state"][0]),
        Line("worst start, x2", None, result["worst_initial_state"][1]),
        Claim("success rate at the worst start", result["worst_claim"], result["worst_estimate"]),
        Line("mean over the region", result["published_mean"], result["simulated_mean"]),
        *(
            judged(f"{name} relation at the stated noise, {what}", None, right[name][key])
            for name in ("paper", "exact")
            for what, key, judged in (("certified", "lower_bound", Bound), ("rollouts", "estimate", Line))
        ),
    ]


def _arch(rows: Sequence[dict[str, Any]]) -> list[Line]:
    """Return a line for each row of the field's benchmarks."""
    lines = list[Line]()
    for row in rows:
        # What fails its check is worth nothing.
        holds = row["check"] == "valid"
        lines.append(Bound(row["row"], row["published"], row["certified"] if holds else 0.0))
    return lines


LINES: dict[str, Callable[[Any], list[Line]]] = {
    "fig3": _fig3,
    "fig4": _fig4,
    "table1": _table1,
    "table2": _table2,
    "refutation": _refutation,
    "arch": _arch,
}
"""How the numbers of a target become lines."""
