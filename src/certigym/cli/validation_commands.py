"""What the sub-commands about validation do; every function returns an exit status."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

from ..synthesis.certificates import Certificate, Synthesis, load_certificate, rounded_down
from ..validation.audits import audit as audit_certificate
from ..validation.reports import gather_report, write_report
from ..validation.simulation import Executor, Mismatch, executor_for
from ..validation.verdicts import (
    LADDERS,
    FieldReport,
    ValidationInterrupted,
    ValidationReport,
    corner_starts,
    each_report,
    find_weakest,
    random_starts,
    slice_starts,
    validate_field,
    workspace_box,
)
from ..validation.verdicts import stress as stress_certificate
from ..validation.verdicts import validate as validate_certificate
from .given import cells_of, named_problem, show, write_json

Progress = Callable[[int], None]


def validate_result(options: Namespace, result: Synthesis | Certificate, initial_state: Any) -> int:
    """Validate, print, write; what Ctrl-C leaves is printed and written too, with status 130."""
    status = 0
    with _rollouts(options, options.episodes) as (executor, progress):
        try:
            report: ValidationReport = validate_certificate(
                result, options.episodes, options.seed, confidence=options.confidence, initial_state=initial_state,
                sequential=options.sequential, mismatch=_mismatch(options.mismatch), executor=executor,
                progress=progress,
            )  # fmt: skip
        except ValidationInterrupted as interrupted:
            report, status = interrupted.report, 130
    show(options, report, report.to_dict())
    return status or int(report.refuted)


def field(options: Namespace) -> int:
    """Test a saved certificate at many starts."""
    certificate = load_certificate(options.certificate)
    states, shape = _starts(options, certificate)
    count = options.episodes if options.search else options.episodes * len(states)
    with _rollouts(options, count) as (executor, progress):
        if options.search:
            report: FieldReport = find_weakest(
                certificate, options.episodes, options.seed, candidates=states, confidence=options.confidence,
                executor=executor, progress=progress,
            )  # fmt: skip
        else:
            report = validate_field(
                certificate, states, options.episodes, options.seed, confidence=options.confidence, shape=shape,
                executor=executor, progress=progress,
            )  # fmt: skip
    show(options, report, report.to_dict())
    return 130 if report.interrupted else int(report.verdict == "refuted")


def audit(options: Namespace) -> int:
    """Audit a saved certificate."""
    certificate = load_certificate(options.certificate)
    with _rollouts(options, options.episodes) as (executor, progress):
        report = audit_certificate(
            certificate, options.episodes, options.seed, confidence=options.confidence, executor=executor,
            progress=progress,
        )  # fmt: skip
    show(options, report, report.to_dict())
    return 130 if report.interrupted else int(report.refuted)


def stress(options: Namespace) -> int:
    """Test a saved certificate under mismatches; always status 0, for no rung is certified."""
    certificate = load_certificate(options.certificate)
    rungs = 1 + sum(len(rungs) for rungs in LADDERS.values())
    with _rollouts(options, options.episodes * rungs) as (executor, progress):
        report = stress_certificate(
            certificate, options.episodes, options.seed, confidence=options.confidence, executor=executor,
            progress=progress,
        )  # fmt: skip
    show(options, report, report.to_dict())
    return 130 if report.interrupted else 0


def sweep(options: Namespace) -> int:
    """Synthesize and validate at several horizons, a row as soon as it is found; Ctrl-C leaves those that are there."""
    problem = named_problem(options.problem)
    cells = cells_of(options)
    shown = options.json != "-"
    if shown:
        print(problem.name, flush=True)
    reports: list[ValidationReport] = []
    interrupted = False
    with executor_for(options.dask, options.workers) as executor:
        try:
            for r in each_report(
                problem, options.horizons, options.episodes, options.seed, executor=executor, cells=cells
            ):
                reports.append(r)
                if shown:
                    row = f"{r.horizon:>4}  P >= {rounded_down(r.lower_bound)}  simulated {r.estimate:.6f}  {r.verdict}"
                    print(row, flush=True)
        except KeyboardInterrupt:  # of an unfinished validation, nothing is kept
            interrupted = True
    write_json(options, [r.to_dict() for r in reports])
    return 130 if interrupted else int(any(r.refuted for r in reports))


def report(options: Namespace) -> int:
    """Write one page about a saved certificate."""
    certificate = load_certificate(options.certificate)
    with _rollouts(options, None) as (executor, progress):
        content = gather_report(
            certificate, options.episodes, options.seed, confidence=options.confidence, axes=options.axes,
            executor=executor, progress=progress,
        )  # fmt: skip
    write_report(content, options.out)
    show(options, f"{content.validation}\nwritten to {options.out}", content.to_dict())
    return int(content.refuted)


@contextmanager
def _rollouts(options: Namespace, total: int | None) -> Iterator[tuple[Executor | None, Progress]]:
    """Executor and progress bar."""
    with (
        executor_for(options.dask, options.workers) as executor,
        tqdm(total=total, desc="rollouts", unit=" episodes", disable=None, leave=False) as bar,
    ):
        yield executor, lambda n: bar.update(n) and None


def _starts(options: Namespace, certificate: Certificate) -> tuple[Any, tuple[int, ...] | None]:
    low, high = workspace_box(certificate.problem)
    box = (low if options.low is None else _numbers(options.low, "--low"),
           high if options.high is None else _numbers(options.high, "--high"))  # fmt: skip
    if options.axes is None:
        import numpy as np

        problem = certificate.problem
        corners = corner_starts(problem, box=box)
        return np.concatenate([corners, random_starts(problem, options.random, options.seed, box)]), None
    shape = tuple(options.points or [20])
    shape = shape * len(options.axes) if len(shape) == 1 else shape
    return slice_starts(certificate, options.axes, shape, box=box), shape


def _numbers(words: Sequence[str], option: str) -> list[float]:
    try:
        return [float(word) for word in " ".join(words).replace(",", " ").split()]
    except ValueError:
        raise ValueError(f"`{option}`: expected numbers, got {' '.join(words)!r}") from None


def _mismatch(words: Sequence[str] | None) -> Mismatch | None:
    """Mismatch from ``NAME=VALUE`` words."""
    if not words:
        return None
    values: dict[str, Any] = {}
    for word in words:
        name, _, value = word.strip().partition("=")
        if name not in Mismatch.__dataclass_fields__:
            known = ", ".join(Mismatch.__dataclass_fields__)
            raise ValueError(f"`--mismatch`: expected NAME=VALUE with a name among {known}, got {word.strip()!r}")
        try:
            values[name] = value if name == "noise_family" else int(value) if name == "delay" else float(value)
        except ValueError:
            raise ValueError(f"`--mismatch`: expected a number after {name}=, got {value!r}") from None
    return Mismatch(**values)
