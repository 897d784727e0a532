"""The commands that test: ``validate``, ``validate-field``, ``audit``, ``stress``, ``report``, ``reproduce``."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..envs.agents import write_json as save_json
from ..envs.problem import Problem
from ..synthesis.certificates import StartHull, load_certificate, rounded_down
from ..validation.audits import audit as audit_certificate
from ..validation.paper import refute_published
from ..validation.paper import reproduce as paper_figures
from ..validation.paper.arch import arch
from ..validation.reports import report as write_report
from ..validation.simulation import Mismatch
from ..validation.verdicts import (
    LADDERS,
    ValidationReport,
    corner_starts,
    each_report,
    find_weakest,
    random_starts,
    slice_starts,
    workspace_box,
)
from ..validation.verdicts import stress as stress_certificate
from ..validation.verdicts import validate as validate_certificate
from ..validation.verdicts import validate_field as field_of
from .given import budget_of, cells_of, problem_of, relation_of, search_of, show, state_of, write_json
from .work import trials


def validate(options: Namespace) -> int:
    """Test a saved certificate by rollouts."""
    certificate, state = load_certificate(options.certificate), state_of(options)
    if isinstance(certificate, StartHull) and state is not None:
        # A set of starts has a controller for each of them, which knows it.
        return validate_result(options, certificate.at(np.array(state)), None)
    return validate_result(options, certificate, state)


def validate_result(options: Namespace, result: Any, initial_state: Any) -> int:
    """Validate, print and write the report; after Ctrl-C it is about the finished episodes, and the status is 130."""
    with trials(options, options.episodes) as plan:
        report = validate_certificate(
            result,
            plan,
            initial_state=initial_state,
            sequential=options.sequential,
            mismatch=_mismatch(options.mismatch),
            disturbance=options.disturbance,
        )
    show(options, report, report.to_dict())
    return 130 if report.interrupted else int(report.refuted)


def print_horizons(options: Namespace) -> int:
    """Synthesize and validate at several horizons, and print each row when it is ready; Ctrl-C keeps finished rows."""
    problem = problem_of(options)
    settings = {"cells": cells_of(options), **relation_of(options), **budget_of(options), **search_of(options)}
    if options.json != "-":
        print(problem.name, flush=True)
    reports: list[ValidationReport] = []
    interrupted = False
    with trials(options) as plan:
        try:
            for report in each_report(problem, options.horizons, plan, settings):
                if report.interrupted:
                    raise KeyboardInterrupt
                reports.append(report)
                if options.json != "-":
                    bound, rate = rounded_down(report.lower_bound), f"simulated {report.estimate:.6f}"
                    print(f"{report.horizon:>4}  P >= {bound}  {rate}  {report.verdict}", flush=True)
        except KeyboardInterrupt:  # a row is about all episodes or is left out
            interrupted = True
    write_json(options, [report.to_dict() for report in reports])
    return 130 if interrupted else int(any(report.refuted for report in reports))


def validate_field(options: Namespace) -> int:
    """Test a saved certificate at many starts, or search for its weakest start."""
    certificate = load_certificate(options.certificate)
    states, shape = _starts(options, certificate.problem)
    # --episodes counts per start, except in a search, where it counts all of them.
    with trials(options, options.episodes if options.search else options.episodes * len(states)) as plan:
        if options.search:
            report = find_weakest(certificate, plan, candidates=states)
        else:
            report = field_of(certificate, states, plan, shape=shape)
    show(options, report, report.to_dict())
    return 130 if report.interrupted else int(report.verdict == "refuted")


def audit(options: Namespace) -> int:
    """Test a saved certificate step by step."""
    with trials(options, options.episodes) as plan:
        report = audit_certificate(options.certificate, plan)
    show(options, report, report.to_dict())
    return 130 if report.interrupted else int(report.refuted)


def stress(options: Namespace) -> int:
    """Test a saved certificate under mismatches; a refuted rung is no failure, for no rung is certified."""
    rungs = 1 + sum(len(rungs) for rungs in LADDERS.values())
    with trials(options, options.episodes * rungs) as plan:
        report = stress_certificate(options.certificate, plan)
    show(options, report, report.to_dict())
    return 130 if report.interrupted else 0


def report(options: Namespace) -> int:
    """Write one page about a saved certificate."""
    with trials(options) as plan:
        content = write_report(options.certificate, options.out, plan, axes=options.axes)
    show(options, f"{content.validation}\nwritten to {options.out}", content.to_dict())
    return int(content.refuted)


def reproduce(options: Namespace) -> int:
    """Recompute a figure or table of the paper, or refute its certificate."""
    if options.out and Path(options.out).exists() and not Path(options.out).is_dir():
        raise ValueError(f"`--out`: expected a folder, got the file {options.out!r}; name a folder, it is made")

    def say(text: str) -> None:
        if options.json != "-":
            print(text)

    if options.row is not None and options.what != "arch":
        raise ValueError("`--row`: expected only with arch; leave it out")
    if options.what == "arch":
        folder = Path(options.out or "reproduced")
        rows: Any = arch(folder, options.row, progress=say)
        say(f"written to {folder}")
        write_json(options, rows)
        return 0 if all(row["check"] == "valid" for row in rows) else 1
    if options.what == "refutation":
        result: Any = refute_published()
        where = ", ".join(f"{x:g}" for x in result["worst_initial_state"])
        say(
            f"published certificate at T = {result['T']}: {result['verdict']} at {result['refuted']} of "
            f"{result['initial_states']} initial states; largest excess {result['worst_excess']:.4f} at ({where})"
        )
        say(f"certificates at the right noise: {result['right_noise_verdict']}")
        if options.out:
            Path(options.out).mkdir(parents=True, exist_ok=True)
            save_json(Path(options.out) / "refutation.json", result)
    else:
        folder = Path(options.out or "reproduced")
        result = getattr(paper_figures, options.what)(folder, progress=say)
        say(f"written to {folder}")
        if not options.what.startswith("table") and not (folder / f"{options.what}.png").exists():
            print('certigym: no figure without matplotlib; install "certigym[viz]" for it', file=sys.stderr)
    write_json(options, result)
    return 0


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
