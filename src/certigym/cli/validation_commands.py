"""The commands that test: ``validate``, ``validate-field``, ``audit``, ``stress``, ``sweep``, ``report``."""

from __future__ import annotations

import math
from argparse import Namespace
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..envs.tasks.problem import Problem
from ..synthesis.certificates.proofs import Certificate, CheckReport, load_certificate, rounded_down, shown_bound
from ..validation.presentation.reports import report as write_report
from ..validation.statistical_tests import (
    CHANGES,
    LABEL_WIDTH,
    LADDERS,
    NOT_CERTIFIED,
    Mismatch,
    SweepRow,
    ValidationReport,
    checked_changes,
    corner_starts,
    each_report,
    find_weakest,
    random_starts,
    slice_starts,
    told_of,
    workspace_box,
)
from ..validation.statistical_tests import audit as audit_certificate
from ..validation.statistical_tests import stress as stress_certificate
from ..validation.statistical_tests import sweep as swept
from ..validation.statistical_tests import validate as validate_certificate
from ..validation.statistical_tests import validate_field as field_of
from .given import budget_of, cells_of, limit_of, problem_of, relation_of, say, show, state_of, write_json
from .work import checked_again, trials

NOTES = (("checker", "checker"), ("no deadline", "no_deadline"), ("note", "note"))
"""Lines below a report, and the keys of what they say; the first is a detail."""

DETAILS = "-v shows what was tried, what limits the bound, and how it was checked"
"""What `run` says below a report in short."""

INVALID = "invalid: it fails its check"
"""What a row says of a certificate that its check refuses."""


def _certificate(options: Namespace) -> Certificate:
    """Return the certificate that is named, which is no larger than the options allow."""
    return load_certificate(options.certificate, limit_of(options))


def validate(options: Namespace) -> int:
    """Test a saved certificate by rollouts."""
    certificate = _certificate(options)
    return validate_result(options, certificate, state_of(options), checked_again(certificate))


def _said_if_refused(options: Namespace, certificate: Any) -> CheckReport:
    """Check a saved certificate, and say first of all that it is NOT valid where it is not."""
    if not (checked := checked_again(certificate)):
        say(options, f"{NOT_CERTIFIED}: {checked}")
    return checked


def validate_result(
    options: Namespace,
    result: Any,
    initial_state: Any,
    checked: CheckReport | None = None,
    more: Mapping[str, Any] | None = None,
) -> int:
    """Validate, print and write the report; after Ctrl-C it is about the finished episodes, and the status is 130.

    A check that failed is its headline, and the status is 1 whatever the rollouts say. ``more`` is told besides, also
    what holds without a deadline. Where the command has an option for details they are told only if it is given.
    """
    with trials(options, options.episodes) as plan:
        report = validate_certificate(
            result,
            plan,
            initial_state=initial_state,
            sequential=options.sequential,
            mismatch=_mismatch(options.mismatch),
            disturbance=options.disturbance,
        )
    report = report if checked is None else report.with_check(checked)
    is_short = not getattr(options, "verbose", True)
    said = {label: (more or {}).get(key) for label, key in NOTES[is_short:]}
    said |= {"details": DETAILS} if is_short else {}
    lines = [_headline(report), report.in_short if is_short else str(report)]
    lines += [f"{label:<{LABEL_WIDTH}}{text}" for label, text in said.items() if text]
    show(options, "\n".join(lines), {**report.to_dict(), **(more or {})})
    return 130 if report.interrupted else int(report.refuted or report.is_invalid)


def _headline(report: ValidationReport) -> str:
    """Return the claim, what rollouts show, and what the check says, on one line of 80 characters."""
    check = report.details.get("check")
    checked = "CHECKED" if check and check["valid"] else "NOT CHECKED" if check is None else "CHECK FAILED"
    word = "CLAIMED" if report.is_invalid else "CERTIFIED" if check is None else "PROVED"
    seconds = sum(value for value in report.seconds.values() if value is not None)
    if report.lower_bound <= 0.0 and not report.is_invalid:
        estimate = f"ESTIMATE {report.estimate:.5f} [{report.ci_low:.5f}, {report.ci_high:.5f}] by rollouts"
        return f"{word} nothing  {estimate}  {checked}  {seconds:.1f} s"
    measured = f"MEASURED {report.estimate:.5f} [{report.ci_low:.5f}, {report.ci_high:.5f}]"
    # Not the digits that only exact claims have: the last of them depend on the products of matrices of a machine.
    return f"{word} {shown_bound(report.lower_bound, None)}  {measured}  {checked}  {seconds:.1f} s"


def print_horizons(options: Namespace, horizons: Sequence[int]) -> int:
    """Synthesize and validate at several horizons, and print each row when it is ready; Ctrl-C keeps finished rows."""
    problem = problem_of(options)
    settings = {"cells": cells_of(options), **relation_of(options), **budget_of(options), "above": options.above}
    say(options, problem.name)
    reports: list[ValidationReport] = []
    interrupted = False
    with trials(options) as plan:
        try:
            for report in each_report(problem, horizons, plan, settings):
                if report.interrupted:
                    raise KeyboardInterrupt
                reports.append(report)
                bound, rate = rounded_down(report.lower_bound), f"simulated {report.estimate:.6f}"
                word = INVALID if report.is_invalid else report.verdict
                say(options, f"{report.horizon:>4}  P >= {bound}  {rate}  {word}")
        except KeyboardInterrupt:  # a row is about all episodes or is left out
            interrupted = True
    write_json(options, [report.to_dict() for report in reports])
    return 130 if interrupted else int(any(report.refuted or report.is_invalid for report in reports))


def sweep(options: Namespace) -> int:
    """Synthesize and validate at every combination of some changes, and print each row when it is ready.

    Ctrl-C keeps the rows that are finished.
    """
    problem, over = problem_of(options), _changes(options.over)
    settings = {"cells": cells_of(options), **relation_of(options), **budget_of(options)}
    settings = {name: value for name, value in settings.items() if name not in over}
    say(options, problem.name)
    rows, interrupted = list[SweepRow](), False
    with trials(options, math.prod(map(len, over.values())), "settings") as plan:
        try:
            for row in swept(problem, over, plan, settings):
                rows.append(row)
                plan.tell(1)
                say(options, _told_row(row))
        except KeyboardInterrupt:
            interrupted = True
        write_json(options, [row.to_dict() for row in rows])
    return 130 if interrupted else int(any(row.verdict in ("refuted", "check failed") for row in rows))


def _changes(words: Sequence[str]) -> dict[str, list[float | int]]:
    """Return the values by what is changed: words ``noise=0.5,1,2``."""
    over = dict[str, list[str]]()
    for word in words:
        name, equals, values = word.partition("=")
        if not equals or name in over:
            raise ValueError(f"`--over`: expected NAME=VALUE,VALUE of each of {', '.join(CHANGES)} once, got {word!r}")
        over[name] = [value for value in values.split(",") if value]
    return checked_changes(over)


def _told_row(row: SweepRow) -> str:
    """Return a row of a sweep as a line."""
    changed = "  ".join(f"{name} {value:<6g}" for name, value in row.changes.items())
    if row.verdict == "refused":
        return f"{changed}  refused: {row.method}"
    rate = row.successes / row.episodes
    measured = f"MEASURED {rate:.5f} [{row.low:.5f}, {row.high:.5f}]"
    return f"{changed}  P >= {rounded_down(row.lower_bound)}   {measured}   {row.verdict}   {row.seconds:.1f} s"


def validate_field(options: Namespace) -> int:
    """Test a saved certificate at many starts, or search for its weakest start."""
    certificate = _certificate(options)
    states, shape = _starts(options, certificate.problem)
    checked = _said_if_refused(options, certificate)
    # --episodes counts per start, except in a search, where it counts all of them.
    with trials(options, options.episodes if options.search else options.episodes * len(states)) as plan:
        if options.search:
            report = find_weakest(certificate, plan, candidates=states)
        else:
            report = field_of(certificate, states, plan, shape=shape)
    show(options, report, {**report.to_dict(), "check": told_of(checked)})
    return 130 if report.interrupted else int(report.verdict == "refuted" or not checked)


def audit(options: Namespace) -> int:
    """Test a saved certificate step by step."""
    certificate = _certificate(options)
    checked = _said_if_refused(options, certificate)
    with trials(options, options.episodes) as plan:
        report = audit_certificate(certificate, plan)
    show(options, report, {**report.to_dict(), "check": told_of(checked)})
    return 130 if report.interrupted else int(report.refuted or not checked)


def stress(options: Namespace) -> int:
    """Test a saved certificate under mismatches; a refuted rung is no failure, for no rung is certified."""
    certificate = _certificate(options)
    checked = _said_if_refused(options, certificate)
    rungs = 1 + sum(len(rungs) for rungs in LADDERS.values())
    with trials(options, options.episodes * rungs) as plan:
        report = stress_certificate(certificate, plan)
    show(options, report, {**report.to_dict(), "check": told_of(checked)})
    return 130 if report.interrupted else int(not checked)


def report(options: Namespace) -> int:
    """Write one page about a saved certificate."""
    with trials(options) as plan:
        content = write_report(_certificate(options), options.out, plan, axes=options.axes)
    show(options, f"{content.validation.with_check(content.checked)}\nwritten to {options.out}", content.to_dict())
    return int(content.refuted)


def _starts(options: Namespace, problem: Problem) -> tuple[Any, tuple[int, ...] | None]:
    """Return the starts that the options of ``validate-field`` name, and their shape if they are a slice."""
    # Without --low and --high the box is that of all workspaces; without --axes the starts are corners and random.
    low, high = workspace_box(problem)
    box = (
        low if options.low is None else _numbers(options.low, "--low"),
        high if options.high is None else _numbers(options.high, "--high"),
    )
    if options.axes is None:
        corners = corner_starts(problem, box=box)
        return np.concatenate([corners, random_starts(problem, options.random, options.seed, box)]), None
    shape = tuple(options.points or [20])
    shape = shape * len(options.axes) if len(shape) == 1 else shape
    return slice_starts(problem, options.axes, shape, box=box), shape


def _numbers(words: Sequence[str], option: str) -> list[float]:
    """Return numbers that are separated by blanks or commas."""
    try:
        return [float(word) for word in " ".join(words).replace(",", " ").split()]
    except ValueError:
        raise ValueError(f"`{option}`: expected numbers, got {' '.join(words)!r}") from None


def _mismatch(words: Sequence[str] | None) -> Mismatch | None:
    """Return the mismatch that ``NAME=VALUE`` words describe; None without words."""
    if not words:
        return None
    values: dict[str, Any] = {}
    for word in words:
        name, _, value = word.strip().partition("=")
        if name not in Mismatch.__dataclass_fields__:
            names = ", ".join(Mismatch.__dataclass_fields__)
            raise ValueError(f"`--mismatch`: expected NAME=VALUE with a name among {names}, got {word.strip()!r}")
        try:
            values[name] = value if name == "noise_family" else int(value) if name == "delay" else float(value)
        except ValueError:
            raise ValueError(f"`--mismatch`: expected a number after {name}=, got {value!r}") from None
    return Mismatch(**values)
