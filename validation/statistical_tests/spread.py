"""Run a function over many jobs on any executor; results come in the order of the jobs, not of their completion.

An executor is one of ``concurrent.futures`` or an object that behaves like one, such as ``DaskExecutor``: its
``submit(function, *arguments)`` returns an object with ``result()`` and ``cancel()``. Data that all jobs share are sent
once per worker, not once per job, and only a bounded number of jobs is under way at any time.
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
"""Most jobs under way at a time: enough to keep some tens of workers busy, few enough to bound the memory."""


class Executor(Protocol):
    """The part of ``concurrent.futures.Executor`` that is needed here: ``submit``."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Any:
        """Start ``function(*arguments)`` somewhere and return a future."""


@dataclass(frozen=True)
class _Packed:
    """A pickled object that a worker unpacks once, however many jobs mention it.

    Two of them are equal if their digests are, so that a worker finds the unpacked object in its cache.
    """

    digest: str
    data: bytes

    def __hash__(self) -> int:
        return hash(self.digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Packed) and self.digest == other.digest

    @classmethod
    def of(cls, shared: Any) -> _Packed:
        """Pickle an object."""
        data = pickle.dumps(shared, protocol=pickle.HIGHEST_PROTOCOL)
        return cls(hashlib.sha256(data).hexdigest(), data)


@lru_cache(maxsize=4)  # a worker may serve a few runs at a time
def _unpacked(packed: _Packed) -> Any:
    """Return the object that was packed, from the cache of this process if it is there."""
    return pickle.loads(packed.data)


def _run_packed(function: Callable[[Any, Any], Any], packed: _Packed, job: Any) -> Any:
    """Run one job in a worker."""
    return function(_unpacked(packed), job)


def in_order(
    function: Callable[[Any, Any], Any],
    shared: Any,
    jobs: Iterable[Any],
    executor: Executor | None = None,
    ahead: int = AHEAD,
) -> Generator[Any, None, None]:
    """Yield ``function(shared, job)`` for every job, in order; the values are the same on every executor.

    Parameters
    ----------
    function : callable
        Importable by the workers; its result must depend on its arguments only.
    shared : object
        First argument of every call; picklable.
    jobs : iterable
        Small picklable objects, drawn when they are needed.
    executor : Executor, optional
        Default: this process, one job after the other.
    ahead : int
        Most jobs under way at a time; bounds the memory.

    Notes
    -----
    If the executor breaks for good (a worker of a ``ProcessPoolExecutor`` was killed, say), the jobs that are left run
    in this process, after a ``RuntimeWarning``: no job is lost. Jobs under way are cancelled when the caller stops.
    """
    if executor is None:
        for job in jobs:
            yield function(shared, job)
        return
    # An executor that can share data itself does so; for others the data are packed into every job.
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
        # Keep a window of jobs under way; always wait for the oldest, which gives the results their order.
        waiting.extend((job, start(job)) for job in itertools.islice(remaining, max(1, ahead)))
        while waiting:
            job, future = waiting[0]
            try:
                result = function(shared, job) if future is None else future.result()
            except BrokenExecutor as error:
                # Forget all futures: the jobs of the window run here, one by one, as all later ones will.
                if not broken or future is not None:
                    warnings.warn(f"the executor broke ({error}); continuing in this process", RuntimeWarning, 2)
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
    """Hold Ctrl-C back until the next call of the yielded function, which then raises KeyboardInterrupt.

    An interrupt at any other place may leave an executor with a lock held. A second Ctrl-C is not held back. Outside
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
    # Leave alone a handler that Python did not install, and processes that ignore Ctrl-C.
    if before is None or before == signal.SIG_IGN:
        yield checkpoint
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield checkpoint
    finally:
        signal.signal(signal.SIGINT, before)
