"""The long computations of commands, each with a progress bar: synthesis, rollouts, training."""

from __future__ import annotations

import math
import sys
import time
from argparse import Namespace
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any, TypeVar

from tqdm import tqdm

from ..envs.tasks.problem import Problem, crossed_starts, doubts
from ..synthesis.certificates.proofs import CheckReport, Synthesis, rounded_down
from ..synthesis.extended_check.claims import checked_once
from ..synthesis.policy_search.portfolio import DESCRIBED, Status, bar_of, show_status
from ..synthesis.verbs.synthesize import synthesize
from ..validation.policies import Training
from ..validation.policies import train as train_baseline
from ..validation.statistical_tests import TrialPlan, executor_for
from .given import budget_of, cells_of, is_endless, problem_of, relation_of

Part = TypeVar("Part")

TICK, QUICK, PATIENCE, REMIND = 1.0, 0.25, 3.0, 15.0
"""Seconds from one showing of the clock to the next, and of a search; where there is no terminal, seconds after which a
strategy is told of that takes longer, and after which something is said of what is no search."""


def synthesized(options: Namespace) -> Synthesis:
    """Return the synthesis that the options for problem, models and search ask for."""
    problem, cells = problem_of(options), cells_of(options)
    for why in (crossed_starts(problem), *doubts(problem)):
        if why:
            print(f"certigym: note: {why}", file=sys.stderr)
    status = Status()
    with bar_of(DESCRIBED) as bar, ticking(bar, status):
        chosen = {**relation_of(options), **budget_of(options), "above": options.above}
        if is_endless(options):
            chosen["horizon"] = None
        return synthesize(problem, cells, **chosen, progress=status.take)


@contextmanager
def ticking(bar: tqdm, status: Status | None = None) -> Iterator[None]:
    """Let a bar go on while nothing is reported, so that a long step does not look like a halt.

    Where there is no bar, as output goes to no terminal, each strategy of a search that takes longer than ``PATIENCE``
    is a line there; of what is no search how far it is is another one every ``REMIND`` seconds.
    """
    ended, began = Event(), time.monotonic()

    def under_way() -> tuple[str, str]:
        """What is done, by name, and how it stands."""
        if status is not None:
            return status.strategy, f"{status.strategy}: {status.best}"
        said = getattr(bar, "desc", "").rstrip(": ")
        return said, f"{said}; {how_far}" if (how_far := getattr(bar, "postfix", None)) else said

    def tick() -> None:
        said, since, last, pause = "", began, began, 0.0
        while not ended.wait(pause):
            pause = TICK if bar.disable or status is None else QUICK
            if not bar.disable:
                bar.refresh() if status is None else show_status(bar, status)
                continue
            now, (name, line) = time.monotonic(), under_way()
            if name != said:
                said, since = name, now
            if name and (now - since >= PATIENCE or (status is None and now - last >= REMIND)):
                print(f"[{now - began:.0f} s] {line}", file=sys.stderr, flush=True)
                since, last = math.inf, now

    clock = Thread(target=tick, daemon=True)
    clock.start()
    try:
        yield
    finally:
        ended.set()
        clock.join()


def within(seconds: float, parts: Iterable[Part]) -> tuple[list[Part], bool]:
    """Return what is known of some parts, which are made one by one, after so many seconds, and whether that is all."""
    known, refusals, ended = list[Part](), list[ValueError | MemoryError](), Event()

    def collect() -> None:
        try:
            for part in parts:
                known.append(part)
            ended.set()
        except (ValueError, MemoryError) as error:
            refusals.append(error)

    # A daemon, so that what is not finished keeps no process alive.
    collecting = Thread(target=collect, daemon=True)
    collecting.start()
    collecting.join(seconds)
    for refusal in refusals:
        raise refusal
    return [*known], ended.is_set()


def checked_again(certificate: Any) -> CheckReport:
    """Return the check of a certificate from a file; meanwhile a bar says what there is, and that it is checked."""
    with bar_of() as bar, ticking(bar):
        bar.set_description_str(f"P >= {rounded_down(certificate.lower_bound)}; separate code computes it again")
        return checked_once(certificate)


@contextmanager
def trials(options: Namespace, total: int | None = None, unit: str = "episodes") -> Iterator[TrialPlan]:
    """Open the plan of rollouts that the options ask for, on its executor, with a bar of ``total`` episodes.

    Where rows of a sweep are counted, their rollouts are not: whoever asks for ``unit`` tells the plan of each.
    """
    with (
        executor_for(options.dask, options.workers) as executor,
        tqdm(total=total, unit=f" {unit}", disable=None, leave=False) as bar,
        ticking(bar),
    ):
        bar.set_description("rollouts" if unit == "episodes" else unit)
        done = 0

        def progress(count: int) -> None:
            nonlocal done
            done += count
            if bar.disable:  # a bar shows it as it is
                bar.set_postfix_str(f"{done} {unit}")
            bar.update(count)

        numbers = options.episodes, options.seed, options.confidence
        yield TrialPlan(*numbers, executor=executor, progress=progress)


def trained(problem: Problem, algorithm: str, steps: int | None, seed: int, **arguments: Any) -> Training:
    """Train a baseline with a progress bar; the arguments are those of ``train``."""
    with tqdm(total=steps, desc=f"{algorithm} (seed {seed})", unit=" steps", disable=None, leave=False) as bar:

        def progress(count: int, success: float) -> None:
            bar.set_postfix_str(f"success {success:.3f}")
            bar.update(count)

        return train_baseline(problem, algorithm, steps, seed, progress=progress, **arguments)
