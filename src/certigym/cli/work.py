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
from ..synthesis.policy_search.ascent import BAR, shown_on
from ..synthesis.verbs.synthesize import synthesize
from ..validation.policies import Training
from ..validation.policies import train as train_baseline
from ..validation.statistical_tests import TrialPlan, executor_for
from .given import budget_of, cells_of, is_endless, problem_of, relation_of

Part = TypeVar("Part")

TICK, PATIENCE, REMIND = 1.0, 3.0, 15.0
"""Seconds from one showing of the clock to the next, what it counts; where there is no clock, seconds after which a way
is told of that takes longer, and seconds after which something is said in any case."""


def synthesized(options: Namespace) -> Synthesis:
    """Return the synthesis that the options for problem, models and search ask for."""
    problem, cells = problem_of(options), cells_of(options)
    for why in (crossed_starts(problem), *doubts(problem)):
        if why:
            print(f"certigym: note: {why}", file=sys.stderr)
    with tqdm(bar_format=BAR, disable=None, leave=False) as bar, ticking(bar):
        report = shown_on(bar)
        chosen = {**relation_of(options), **budget_of(options), "above": options.above}
        if is_endless(options):
            chosen["horizon"] = None
        return synthesize(problem, cells, **chosen, progress=report)


@contextmanager
def ticking(bar: tqdm) -> Iterator[None]:
    """Let the clock of a bar go on while nothing is reported, so that a long step does not look like a halt.

    Where there is no bar, as output goes to no terminal, each way that takes longer than ``PATIENCE`` is a line there,
    and how far it is another one every ``REMIND`` seconds.
    """
    ended = Event()

    def tick() -> None:
        said, began = "", time.monotonic()
        since = last = began
        while not ended.wait(TICK):
            bar.refresh()
            now, under_way = time.monotonic(), (getattr(bar, "desc", "") if bar.disable else "").rstrip(": ")
            # How much was spent stands last, and is another way of saying the same.
            way = under_way.rpartition(", ")[0] or under_way
            if way != said:
                said, since = way, now
            if under_way and (now - since >= PATIENCE or now - last >= REMIND):
                how_far = getattr(bar, "postfix", None)
                line = f"{under_way}; {how_far}" if how_far else under_way
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
    with tqdm(bar_format=BAR, disable=None, leave=False) as bar, ticking(bar):
        bar.set_description_str(f"P >= {rounded_down(certificate.lower_bound)}; separate code computes it again")
        return checked_once(certificate)


@contextmanager
def trials(options: Namespace, total: int | None = None) -> Iterator[TrialPlan]:
    """Open the plan of rollouts that the options ask for, on its executor, with a bar of ``total`` episodes."""
    with (
        executor_for(options.dask, options.workers) as executor,
        tqdm(total=total, unit=" episodes", disable=None, leave=False) as bar,
        ticking(bar),
    ):
        bar.set_description("rollouts")
        done = 0

        def progress(count: int) -> None:
            nonlocal done
            done += count
            if bar.disable:  # a bar shows it as it is
                bar.set_postfix_str(f"{done} episodes")
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
