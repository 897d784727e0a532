"""Run a function over many jobs on any executor; results come in the order of the jobs, never in that of completion.

Executors are those of ``concurrent.futures`` and whatever behaves like them (``submit(function, *arguments)`` gives an
object with ``result()`` and ``cancel()``), among them ``DaskExecutor``. What all jobs share travels once per worker and
not once per job, and only a bounded number of jobs is under way at any time.
"""

from __future__ import annotations

import hashlib
import itertools
import pickle
import signal
import threading
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

AHEAD = 32
"""Most jobs under way at a time."""


class Executor(Protocol):
    """What is asked of an executor: the ``submit`` of ``concurrent.futures.Executor``."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Any:
        """Start ``function(*arguments)`` somewhere; returns a future."""


@dataclass(frozen=True)
class _Packed:
    """A pickled object that a worker unpacks once, however many jobs mention it; it lives as long as the run."""

    digest: str
    data: bytes

    def __hash__(self) -> int:
        return hash(self.digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Packed) and self.digest == other.digest

    @classmethod
    def of(cls, shared: Any) -> _Packed:
        data = pickle.dumps(shared, protocol=pickle.HIGHEST_PROTOCOL)
        return cls(hashlib.sha256(data).hexdigest(), data)


@lru_cache(maxsize=4)
def _unpacked(packed: _Packed) -> Any:
    return pickle.loads(packed.data)


def _run_packed(function: Callable[[Any, Any], Any], packed: _Packed, job: Any) -> Any:
    return function(_unpacked(packed), job)


def in_order(
    function: Callable[[Any, Any], Any],
    shared: Any,
    jobs: Iterable[Any],
    executor: Executor | None = None,
    ahead: int = AHEAD,
) -> Generator[Any, None, None]:
    """Yield ``function(shared, job)`` for every job, in order, the same values for any executor.

    Parameters
    ----------
    function : callable
        Importable by the workers; its result must depend on its arguments only.
    shared : object
        Handed to every call; picklable.
    jobs : iterable
        Small picklable objects, drawn as they are needed.
    executor : Executor, optional
        Default: this process, one job after the other.
    ahead : int
        Most jobs under way; bounds the memory.

    Notes
    -----
    If the executor breaks for good (a worker of a ``ProcessPoolExecutor`` was killed), the jobs that are left run in
    this process, after a ``RuntimeWarning``: nothing is lost. Jobs under way are cancelled when the caller stops.
    """
    if executor is None:
        for job in jobs:
            yield function(shared, job)
        return
    share = getattr(executor, "share", None)
    head = (_run_packed, function, _Packed.of(shared)) if share is None else (function, share(shared))
    remaining, waiting = iter(jobs), deque[tuple[Any, Any]]()
    broken = False

    def start(job: Any) -> Any:
        nonlocal broken
        try:
            return None if broken else executor.submit(*head, job)
        except BrokenExecutor:
            broken = True
            return None

    try:
        waiting.extend((job, start(job)) for job in itertools.islice(remaining, max(1, ahead)))
        while waiting:
            job, future = waiting[0]
            try:
                result = function(shared, job) if future is None else future.result()
            except BrokenExecutor as error:
                if not broken or future is not None:
                    warnings.warn(f"the executor broke ({error}); going on in this process", RuntimeWarning, 2)
                broken = True
                waiting = deque((job, None) for job, _ in waiting)
                continue
            waiting.popleft()
            waiting.extend((job, start(job)) for job in itertools.islice(remaining, 1))
            yield result
    finally:
        for _, future in waiting:
            if future is not None:
                future.cancel()


@contextmanager
def interrupts_at_checkpoints() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C back until the next call of the function handed out, which then raises KeyboardInterrupt.

    Interrupted at any other place, an executor may be left with a lock held. A second Ctrl-C is not held back. Outside
    the main thread, where Python delivers no signals, nothing changes.
    """
    asked = False

    def note(number: int, frame: Any) -> None:
        nonlocal asked
        asked = True
        signal.signal(signal.SIGINT, before)

    def checkpoint() -> None:
        if asked:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield checkpoint
        return
    before = signal.getsignal(signal.SIGINT)
    if before is None or before == signal.SIG_IGN:
        yield checkpoint
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield checkpoint
    finally:
        signal.signal(signal.SIGINT, before)
