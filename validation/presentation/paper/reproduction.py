"""Reproductions as pieces that need no other: they are computed side by side, and each is told of when it is found."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ...statistical_tests import processes

TICK = 1.0
"""Seconds after which a listener hears what is computed, found or not."""


@dataclass(frozen=True)
class PieceResult:
    """What a piece gave, and how it is told in one line."""

    value: Any
    words: str


@dataclass(frozen=True)
class Reproduction:
    """A figure or table that is computed again.

    Parameters
    ----------
    pieces : dict
        What computes each piece, by its name: functions without arguments that can be sent to another process.
    joined : callable
        Takes what all pieces gave, in their order, and a folder; writes the files, and returns the rows.
    """

    pieces: Mapping[str, Callable[[], PieceResult]]
    joined: Callable[[Sequence[Any], Path], Any]

    def rows(self, out: Path) -> Any:
        """Compute all pieces in this process, write the files, and return the rows."""
        return self.joined([compute().value for compute in self.pieces.values()], out)


class Listener(Protocol):
    """Hears how far a reproduction is."""

    def now(self, names: Sequence[str]) -> None:
        """Hear what is computed now; called when that changes, and every `TICK` seconds."""

    def found(self, name: str, words: str, seconds: float) -> None:
        """Hear what a piece gave, and its processor seconds."""


def timed(compute: Callable[[], PieceResult]) -> tuple[PieceResult, float]:
    """Return what a piece gave, and the processor seconds of that."""
    began = time.process_time()
    return compute(), time.process_time() - began


def computed(
    reproductions: Mapping[str, Reproduction], listener: Listener, workers: int = 1
) -> Iterator[tuple[str, list[Any]]]:
    """Yield the name of each reproduction with what its pieces gave, in their order, as soon as these are found."""
    waiting = [(name, piece) for name, whole in reproductions.items() for piece in whole.pieces]
    values: dict[tuple[str, str], Any] = {}
    left = list(reproductions)
    for key, value in _values(reproductions, waiting, listener, workers):
        values[key] = value
        while left and all((left[0], piece) in values for piece in reproductions[left[0]].pieces):
            name = left.pop(0)
            yield name, [values[name, piece] for piece in reproductions[name].pieces]


def _values(
    reproductions: Mapping[str, Reproduction], keys: Sequence[tuple[str, str]], listener: Listener, workers: int
) -> Iterator[tuple[tuple[str, str], Any]]:
    """Yield what the pieces gave, as they are found, of so many processes; a single piece is computed in this one."""
    workers = min(workers, len(keys))
    # A process beside this one has one thread for its linear algebra, so one is used, too: on busy cores threads wait
    # for one another.
    if len(keys) <= 1:
        for key in keys:
            listener.now([", ".join(key)])
            found, seconds = timed(reproductions[key[0]].pieces[key[1]])
            listener.found(", ".join(key), found.words, seconds)
            yield key, found.value
        return
    running: dict[Future[tuple[PieceResult, float]], tuple[str, str]] = {}
    waiting = list(keys)
    with processes(workers) as pool, _children_end_with_us():
        while waiting or running:
            while waiting and len(running) < workers:
                key = waiting.pop(0)
                running[pool.submit(timed, reproductions[key[0]].pieces[key[1]])] = key
            listener.now([", ".join(key) for key in running.values()])
            for future in wait(running, TICK, FIRST_COMPLETED).done:
                key = running.pop(future)
                found, seconds = future.result()
                listener.found(", ".join(key), found.words, seconds)
                yield key, found.value


@contextmanager
def _children_end_with_us() -> Iterator[None]:
    """End the processes that compute if they are not waited for: after Ctrl-C, or when a piece failed."""
    try:
        yield
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()
        raise
