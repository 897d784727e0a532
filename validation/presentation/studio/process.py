"""A worker process as the server sees it: jobs go in, messages come out, and it can be broken off or replaced."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from .work import serve

Hear = Callable[[dict[str, Any]], None]


class Worker:
    """A process that does jobs of `work`.

    Parameters
    ----------
    hear : callable
        Called, in a thread of its own, with each message; ``{"died": True}`` if the process ended by itself.
    """

    def __init__(self, hear: Hear) -> None:
        self._hear = hear
        self._first: dict[str, Any] | None = None
        self._lock = threading.Lock()
        self._start()

    def _start(self) -> None:
        # A process of its own, not a copy of this one, which has threads.
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        self._process = context.Process(target=serve, args=(there,), daemon=True, name="certigym studio")
        self._process.start()
        there.close()
        self._pipe: Connection = here
        threading.Thread(target=self._listen, args=(here,), daemon=True).start()
        if self._first is not None:
            with suppress(OSError):  # one that ends at once is heard of, as any other
                here.send(self._first)

    def _listen(self, pipe: Connection) -> None:
        while True:
            try:
                message = pipe.recv()
            except (EOFError, OSError):
                # closed by whoever reads it: another thread might close it in the middle of a message
                pipe.close()
                if pipe is self._pipe:  # not one that was replaced
                    self._hear({"died": True})
                return
            self._hear(message)

    def begin_with(self, job: dict[str, Any] | None) -> None:
        """Let every process that replaces this one do this job first: what it must have before it can do others."""
        with self._lock:
            self._first = job

    def send(self, job: dict[str, Any]) -> None:
        """Hand in a job; a process that has died is replaced first."""
        with self._lock:
            if not self._process.is_alive():
                self._start()
            try:
                self._pipe.send(job)
            except OSError:
                self._start()
                self._pipe.send(job)

    def stop(self) -> None:
        """Break off the job under way, as Ctrl-C does."""
        with self._lock:
            if self._process.is_alive():
                self._pipe.send({"job": "stop"})

    def replace(self) -> None:
        """End the process at once, whatever it does, and start another one."""
        with self._lock:
            self._end()
            self._start()

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._end()

    def _end(self) -> None:
        self._pipe = None  # type: ignore[assignment]
        self._process.kill()
        self._process.join(5.0)
