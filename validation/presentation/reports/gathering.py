"""One self-contained HTML page about a certificate: what is claimed, what rollouts show, and how to repeat them.

The page loads nothing; all drawings are inline SVG, and all text from the certificate is escaped.
The data behind the page are embedded as JSON; ``ReportContent.to_dict`` returns the same data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.arguments import write_text
from ....synthesis.certificates.proofs import (
    CheckReport,
    as_certificate,
    certificate_from,
    members_of,
    on_cells,
    speaks_of_one_start,
    split,
)
from ....synthesis.extended_check.claims import checked_once, claimed_values
from ...statistical_tests import (
    Loop,
    Plan,
    TrialOptions,
    TrialPlan,
    audit,
    bound_by_steps_left,
    names_plan,
    paths,
    planned,
    slice_axes,
    slice_starts,
    start_box,
    validate,
    validate_field,
)
from .content import ReportContent
from .explorer import explored
from .page import page_of

DRAWN = 40
"""Rollouts that are drawn: enough to see where failures gather."""

LINE_POINTS, MAP_POINTS = 40, 20
"""Starts along a line, and per axis of a map: by default every one of 400 starts gets 250 episodes."""

AUDITED = 20_000
"""Most episodes of the audit, which needs fewer than the validation."""

AFTER_INTERRUPT = 1000
"""Episodes of audit and map if Ctrl-C ended the validation: a short test that completes the page."""


@names_plan
def report(
    certificate: Any,
    path: str | Path,
    plan: TrialPlan | int | None = None,
    *,
    axes: Sequence[int] | None = None,
    checked: CheckReport | None = None,
    **trial: Unpack[TrialOptions],
) -> ReportContent:
    """Write one self-contained page about a certificate, and return what it shows.

    Parameters
    ----------
    certificate : Synthesis, Certificate or path
        Those about pairs of agents and along paths speak of one start: their pages have neither audit nor tests at
        other starts; the explorer shows what the check proves of the same controllers from other starts, if anything.
    path : str or Path
        The page (``.html``).
    plan, **trial
        Episodes of the validation (default 100,000), seed, confidence (.999), chunk, executor, progress; see
        ``TrialPlan``. The audit takes at most 20,000 episodes; all starts of the map together take as many as the
        validation. After Ctrl-C during the validation the report is about the episodes finished by then, with a short
        audit and few episodes per start of the map.
    axes : sequence of int, optional
        Joint coordinates of the map, one or two; default: the first coordinate of each of the first two agents.
    checked : CheckReport, optional
        What ``check`` said of this certificate, if it was asked before; it is not checked again then.

    Returns
    -------
    ReportContent
    """
    content = gathered(certificate, planned(plan, trial, 100_000), axes, checked)
    write_text(path, page_of(content))
    return content


def gathered(
    certificate: Any, plan: Plan, axes: Sequence[int] | None = None, checked: CheckReport | None = None
) -> ReportContent:
    """Run check (unless ``checked``), validation, audit and the tests of a map, and return what a report shows."""
    claim = certificate_from(certificate)
    problem = claim.problem
    checked = checked_once(claim) if checked is None else checked
    if speaks_of_one_start(claim):
        # It has neither audit nor map of tests: it says nothing of other states and times.
        states, success = paths(Loop(problem, claim.controller, plan.seed, max(DRAWN, 1)), DRAWN)
        nothing: dict[str, Any] = {"audit": None, "field": None, "axes": (), "bounds": None}
        tests: dict[str, Any] = {"validation": validate(certificate, plan), "checked": checked}
        tests["explored"] = explored(claim, plan.seed, axes) if checked else None
        return ReportContent(certificate=claim, states=states, success=success, **tests, **nothing)
    claim = as_certificate(claim)
    shown = slice_axes(problem, axes)
    shape = (LINE_POINTS,) if len(shown) == 1 else (MAP_POINTS, MAP_POINTS)
    grid = slice_starts(problem, shown, shape)
    # Few rollouts for the drawings first: they take no time and need the whole paths.
    states, success = paths(Loop(problem, claim.controller, plan.seed, max(DRAWN, 1)), DRAWN)
    validation = validate(certificate, plan)  # not `claim`: a synthesis knows about its search, too
    episodes = min(plan.episodes, AFTER_INTERRUPT) if validation.interrupted else plan.episodes
    each = replace(plan, episodes=max(20, episodes // len(grid)))
    return ReportContent(
        certificate=claim,
        validation=validation,
        audit=audit(claim, replace(plan, episodes=min(episodes, AUDITED))),
        checked=checked,
        field=validate_field(claim, grid, each, shape=shape),
        axes=shown,
        bounds=_bounds(claim, 0.5 * np.sum(start_box(problem), axis=0)),
        states=states,
        success=success,
        explored=explored(claim, plan.seed, axes) if checked else None,
    )


def _bounds(certificate: Any, state: NDArray[Any]) -> NDArray[Any]:
    """Return lower bounds (T,) from a joint state if only the last 1 .. T steps are played.

    For independent tasks they are the products of the bounds of all tasks.
    """
    if on_cells(certificate) is certificate:
        return bound_by_steps_left(certificate, claimed_values(certificate), state)
    pairs = zip(members_of(certificate), split(certificate.problem, state), strict=True)
    return np.prod([_bounds(of_task, states[0]) for of_task, states in pairs], axis=0)
